# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/effects.md: every effect, and its place in each engine, read from the engines."""

import re
from pathlib import Path
from typing import Any

from dermis import engines, plan
from dermis.chip.netlist import frame_deck
from dermis.effects import EFFECTS, AutoTable, EffectsTable
from dermis.effects.effect import RECORDS
from dermis.engines import filter, rtl
from dermis.records import Plan
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES, Design
from scripts import markdown

NONE = "-"

# The smallest scene for a deck and the models: two different frames, three rows and columns.
_SIZE = 3
_CODES = [100, 120]

# Fields of Converter that change the input current and not its conversion.
_DUTY = frozenset({"gain", "i_offset_a", "inv_i_range_a"})

_NO_BOUND_LSB = 1e6

BOUND_SCENES = ("cylindrical_indenter", "slipping_cylinder")
"""Scenes for the table of bounds: one constant, one moving."""


def sample(
    name: str | None, engine: str = "closed", itself: bool = True, design: Design | None = None
) -> Plan:
    """Plan a small scene with what an effect needs, and the effect at its defaults if `itself`; None: no effect."""
    names = [*EFFECTS[name].needs, *([name] if itself else [])] if name else []
    usual = name is None or "conveyor_mirror" in EFFECTS[name].topologies
    data: dict[str, Any] = {
        "array": {"rows": _SIZE, "cols": _SIZE},
        "stimulus": {"kind": "uniform", "code": _CODES},
        "interface": {"topology": "conveyor_mirror" if usual else EFFECTS[name].topologies[0]},
        "effects": dict.fromkeys(names, True),
    }
    return plan.make(scene.from_data(data, Path("sample.toml"), design), engine)


def fields(name: str) -> list[tuple[str, str]]:
    """Return record and field of everything that an effect sets."""
    return [(record, field) for record in RECORDS for field in getattr(EFFECTS[name], record)]


def enters(name: str) -> str:
    """Return the records that an effect changes, in words."""
    where = {
        "network": "array solve",
        "converter": "converter state",
        "drive": "in time",
        "sensor": "resistances, before any engine",
    }
    said = ["duty" if field in _DUTY else where[record] for record, field in fields(name)]
    return ", ".join(dict.fromkeys(said))


def parameters(name: str, design: Design | None = None) -> str:
    """Return the parameters of an effect with their defaults; names end in the unit."""
    given = sample(name, design=design).scene.effects[name].model_dump()
    follows = {
        key: f", or `{other}` where only that is given" for key, other in EFFECTS[name].follows.items()
    }
    return ", ".join(f"`{k} = {_value(v)}`{follows.get(k, '')}" for k, v in given.items()) or "none"


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_value(v) for v in value)}]"
    return f"{value:.4g}"


def deck(name: str) -> str:
    """Return the additions of an effect to the SPICE deck: elements, parameters of other elements."""
    on = sample(name, "cosim")
    if engines.refused(on, "cosim"):
        return NONE
    levels = [0.0] * (2 * _SIZE + 1)
    lines = frame_deck(sample(name, "cosim", False), 0, levels).lines
    before = {line.split(maxsplit=1)[0]: line for line in lines}
    found: dict[str, dict[str, None]] = {}
    for line in frame_deck(on, 0, levels).lines:
        element, *words = line.split()
        if element.startswith(".") or line == before.get(element):
            continue
        changed = found.setdefault(re.sub(r"_?(r\d+)?(c\d+)?\d*$", "", element), {})
        if element in before:
            old = set(before[element].split())
            changed.update(dict.fromkeys(w.split("=")[0] for w in words if "=" in w and w not in old))
    return ", ".join(
        f"`{kind}`" + (f": {', '.join(f'`{p}`' for p in changed)}" if changed else "")
        for kind, changed in found.items()
    )


def verilog(name: str) -> str:
    """Return the additions of an effect to the real-number models; the array is solved outside."""
    on = sample(name, "rtl")
    if engines.refused(on, "rtl"):
        return NONE
    places = {n: place for n, place in rtl.value_places().items() if n not in ("VALUES", "EACH_FRAME")}
    bits = rtl.effect_bits(on) & ~rtl.effect_bits(sample(None, "rtl"))
    built = [f"`{n}`" for n in sorted(places, key=places.__getitem__) if bits >> places[n] & 1]
    return ", ".join(built) or "in the input currents"


def meanings(design: Design | None = None, _root: Path | None = None) -> str:
    """Return the table of effects with meaning and parameters."""
    rows = []
    for effect in EFFECTS.values():
        absent = [t for t in TOPOLOGIES if t not in effect.topologies]
        more = [f"not for {', '.join(absent)}"] if absent else []
        more += [f"acts only with {' and '.join(effect.needs)}"] if effect.needs else []
        more += ["random"] if effect.random else []
        text = effect.meaning + (f" ({'; '.join(more)})" if more else "")
        rows.append([f"`{effect.name}`", text, parameters(effect.name, design)])
    return markdown.table(["effect", "meaning", "parameters and defaults"], rows) + "\n"


def places(_design: Design | None = None, _root: Path | None = None) -> str:
    """Return the table of effects with their record fields and their place in each engine."""
    rows = []
    for name in EFFECTS:
        written = ", ".join(f"`{record.capitalize()}.{field}`" for record, field in fields(name))
        able = ["yes" if not engines.refused(sample(name), e) else NONE for e in ("closed", "event")]
        sheet = all(record == "sensor" for record, _ in fields(name))
        able += ["yes", "yes"] if sheet else [verilog(name), deck(name)]
        rows.append([f"`{name}`", written, enters(name), *able])
    head = ["effect", "record fields", "enters", "closed", "event", "rtl: Verilog model", "cosim: SPICE deck"]
    return markdown.table(head, rows) + "\n"


def bounds(design: Design | None = None, _root: Path | None = None) -> str:
    """Return the table of effects with the largest error of engine closed in two scenes, in LSB."""
    everything = EffectsTable(**dict.fromkeys(EFFECTS, True), auto=AutoTable())
    found = {}
    for name in BOUND_SCENES:
        world = scene.load(scene.find(name), design)
        made = plan.make(scene.with_effects(world, everything, world.table.run.engine))
        found[name] = filter.largest(made.part(f := made.fullest_frame(), f + 1))
    rows = [[f"`{name}`", *(_bound(largest.get(name)) for largest in found.values())] for name in EFFECTS]
    return markdown.table(["effect", *(f"{name} / LSB" for name in found)], rows) + "\n"


def _bound(value: float | None) -> str:
    if value is None:
        return NONE
    # Below a billionth of an LSB the value is rounding, which depends on the processor.
    return "none" if value > _NO_BOUND_LSB else f"{value:.2g}" if value > 1e-9 else "exact"


TABLES = {"meanings": meanings, "places": places, "bounds": bounds}
