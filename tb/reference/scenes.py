# SPDX-License-Identifier: Apache-2.0
"""Random scenes for tests and programs: every stimulus, interface and effect, to the ends of ranges.

``random_scene(random.Random(7), PROFILES["auto"])`` returns a `World`, whose ``read(directory)`` writes
its files and loads the scene. `of_resistances` makes a scene of given taxels.
"""

import functools
import math
import random
import tomllib
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dermis import effects
from dermis.converter.vfc import W_PRESET
from dermis.ndarrays import Floats
from dermis.scene import scene as scenes
from dermis.scene import schema
from dermis.scene.design import TOPOLOGIES, Design
from dermis.scene.design import load as load_design
from dermis.scene.schema import write_toml

Data = dict[str, Any]
Rng = random.Random


@dataclass(frozen=True)
class World:
    """A scene with everything it depends on, as plain data.

    Of a stored case `why` is the defect, `engines` whose laws it is checked against, and `refused` part of
    the line that refuses it, empty if it is not refused.
    """

    scene: Data  # tables of a scene file
    design: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # changes of models/design.toml
    files: Mapping[str, list[list[float]]] = field(default_factory=dict)  # lines of its csv files, by name
    why: str = ""
    engines: str = "closed,event"
    refused: str = ""

    def read(self, directory: Path) -> scenes.Scene:
        """Write the files into `directory` and load the scene; raises InputError as for any scene."""
        for name, lines in self.files.items():
            text = "\n".join(",".join(map(repr, line)) for line in lines) + "\n"
            (directory / name).write_text(text, encoding="ascii")
        design = load_design()
        if self.design:
            design = design.replace(**{name: dict(keys) for name, keys in self.design.items()})
        return scenes.from_data(self.scene, directory / "scene.toml", design)

    def to_toml(self) -> str:
        """Return everything as one TOML file, which `load` reads."""
        head = {"why": self.why or None, "engines": self.engines, "refused": self.refused or None}
        tables: Data = {f"scene.{name}": table for name, table in self.scene.items()}
        tables |= {f"design.{name}": dict(keys) for name, keys in self.design.items()}
        if self.files:
            tables["files"] = {f'"{name}"': lines for name, lines in self.files.items()}
        return "# SPDX-License-Identifier: Apache-2.0\n" + write_toml(head | tables)


def of_resistances(
    ohm: Floats, on: Data, interface: Data | None = None, name: str = "made", design: Design | None = None
) -> scenes.Scene:
    """Return a scene of taxels [frames, rows, cols] in ohm with effects `on`."""
    data = {
        "array": {"rows": ohm.shape[1], "cols": ohm.shape[2]},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "interface": interface or {},
        "effects": on,
    }
    path = Path(f"{name}.toml")
    table = schema.validate(scenes.SceneTable, data, path)
    return scenes.resolve(table.model_copy(update={"stimulus": table.stimulus.given(ohm)}), path, design)


def load(path: Path) -> World:
    """Read a file of `World.to_toml`."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    head = {name: data[name] for name in ("why", "engines", "refused") if name in data}
    return World(data["scene"], data.get("design", {}), data.get("files", {}), **head)


@dataclass(frozen=True)
class Profile:
    sizes: Mapping[tuple[tuple[int, int], tuple[int, int]], float]  # weights of ends of rows and columns
    frames: tuple[int, ...] = (1, 1, 2, 3, 5)  # one of them is drawn
    plain: bool = False  # no effect that draws numbers, no parameter such as 1e30, resistances only
    designs: bool = True  # changed clocks and bits
    often: tuple[float, ...] = (0.0, 0.05, 0.15, 0.4, 0.8)  # shares of effects on, one of them is drawn
    auto: float = 0.0  # share of scenes with `auto`
    budgets: tuple[float, ...] = (0.0, 0.05, 0.25, 0.5, 2.0)  # of `auto`, LSB
    gentle: bool = False  # weak effects only, in combinations that engine event accepts all on


def _exactly(rows: int, cols: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return (rows, rows), (cols, cols)


_RARE = {_exactly(*size): 1e-3 for size in ((1, 256), (256, 1), (64, 3), (3, 64), (32, 32))}
_SMALL, _LARGE = {((1, 3), (1, 3)): 1.0}, {_exactly(16, 16): 1.0, ((3, 19), (3, 19)): 1.0}
# A Verilog build serves one size: few sizes keep a campaign from compiling all the time.
_FEW = {_exactly(*size): 1.0 for size in ((1, 1), (1, 5), (4, 1), (2, 3), (3, 3), (5, 4), (8, 8))}
PROFILES = {
    "closed,event": Profile(
        {((1, 4), (1, 4)): 0.55, ((1, 9), (1, 9)): 0.4, ((1, 20), (1, 20)): 0.045, **_RARE}, auto=0.15
    ),
    "rtl": Profile(_FEW, plain=True),
    "cosim": Profile(_SMALL, (1,), plain=True, designs=False),
    "auto": Profile(_LARGE, (24,), designs=False, often=(0.7,), auto=1.0, budgets=(0.0,), gentle=True),
}
"""Limits by engines of `dermis campaign`, and "auto" for comparisons of `auto` with everything on."""

KINDS = ("indenter", "slip", "tapping", "ramp", "several", "uniform", "frames", "resistance")

_LARGER_IS_WEAKER = ("gain_dc", "gbw_hz", "r_in_ohm", "r_out_ohm")
_LEVELS = ("v_max_v", "v_min_v", "v_overdrive_v", "temperature_c", "frequency_hz")
_EXTREMES = (0.0, 1e-30, 1e-21, 1e-12, 1e-6, 1.0, 1e3, 1e9, 1e15, 1e21, 1e30)
# Clocks of a gate beyond two a count: none, an odd one, those of gates of 511 and 512 clocks, many.
_BEYOND = (0, 1, 2, 3, 90, 290)
# In topology direct a column couples to others by the first and loads its integrator by the second;
# engine event refuses both together where they move each other by more than a count.
_COUPLING = ("lateral", "row_driver", "column_input", "trace"), ("integrator_gain", "integrator_bandwidth")


def number(rng: Rng, low: float, high: float) -> float:
    """Return a number of five digits whose logarithm is uniform, for 0 < low < high."""
    return float(f"{low * (high / low) ** rng.random():.4e}")


def random_scene(rng: Rng, profile: Profile) -> World:
    """Return a random world within the limits of a profile, a function of the state of `rng` alone."""
    [size] = rng.choices(list(profile.sizes), list(profile.sizes.values()))
    rows, cols = (rng.randint(*ends) for ends in size)
    design = _design(rng) if profile.designs and rng.random() > 0.6 else {}
    topology = rng.choice(TOPOLOGIES)
    interface = _interface(rng, topology, design, profile)
    frames = rng.choice(profile.frames)
    scene: Data = {
        "array": {"rows": rows, "cols": cols},
        "sensor": {"law": rng.choice(("inverse",) * 4 + ("power",))},
    }
    files: dict[str, list[list[float]]] = {}
    if not profile.plain and (profile.gentle or rng.random() > 0.65):
        kind = rng.choice(KINDS)
    else:
        kind = "resistance"
    if kind == "resistance":
        gate = design.get("timing", {}).get("gate_clocks", load_design().timing.gate_clocks)
        scene["stimulus"] = {"kind": kind, "file": "taxels.csv"}
        ohm = _taxel(rng, unit_ohm(interface), gate, profile)
        files["taxels.csv"] = [[ohm() for _ in range(cols)] for _ in range(frames * rows)]
    else:
        bits = design.get("timing", {}).get("code_bits", load_design().timing.code_bits)
        scene["stimulus"] = _stimulus(rng, kind, rows, cols, max(frames, 2), files, 2**bits)
    on = _effects(rng, topology, cols, profile)
    if rng.random() > 1.0 - profile.auto:
        # `auto` takes effects without an entry at their defaults.
        off = {e.name: False for e in effects.EFFECTS.values() if e.considered and e.random and profile.plain}
        on = {"auto": {"budget_lsb": rng.choice(profile.budgets)}} | off | on
    if profile.gentle:
        _gentle(rng, topology, on)
    scene |= {"interface": interface, "effects": on, "run": {"seed": rng.getrandbits(31)}}
    return World(scene, design, files)


def _design(rng: Rng) -> dict[str, Data]:
    """Return another clock, other bits, and a gate and a slot that fit them."""
    base = load_design()
    bits = rng.choice((1, 2, 3, 5, 7, 8, 8, 8, 9, 10))
    gate = 2 * (2**bits - 1) + rng.choice(_BEYOND)
    pause = rng.choice((rng.randint(1, 5), int(number(rng, 5, 300))))
    slot = gate + pause + rng.choice((2, 3, 10, 115))
    f_clk_hz = base.converter.f_clk_hz * rng.choice((0.01, 0.2, 1.0, 1.0, 4.0))
    return {
        # The frame time is that of the design's own array, whatever the size of the scene.
        "timing": {"gate_clocks": gate, "code_bits": bits, "break_clocks": pause,
                   "frame_s": slot * base.array.rows / f_clk_hz},
        "converter": {"f_clk_hz": f_clk_hz, "c_int_f": base.converter.i0_a / f_clk_hz, "t_edge_s": 1e-3 / f_clk_hz},
        "comparator": {"t_delay_s": 0.02 / f_clk_hz, "t_aperture_s": 1e-5 / f_clk_hz},
    }  # fmt: skip


def _interface(rng: Rng, topology: str, design: Mapping[str, Data], profile: Profile) -> Data:
    base, found = load_design(), {"topology": topology}
    if rng.random() > 0.6:
        found["k"] = rng.choice(base.interface.k_options)
    if rng.random() > 0.7:
        found["v_bias_v"] = number(rng, *((0.25, 0.6) if profile.gentle else (1e-3, 10.0)))
    if rng.random() > 0.8 and not profile.gentle:
        f_clk_hz = design.get("converter", {}).get("f_clk_hz", base.converter.f_clk_hz)
        found["i0_a"] = number(rng, 1e-9, 1e-2)
        found["c_int_f"] = found["i0_a"] / f_clk_hz / number(rng, 0.1, 1.4)  # a packet of 0.1 to 1.4 V
    return found


def unit_ohm(interface: Mapping[str, Any]) -> float:
    """Return the resistance of a taxel with a duty of 1."""
    base = load_design()
    current = interface.get("k", base.interface.k) * interface.get("i0_a", base.converter.i0_a)
    return interface.get("v_bias_v", base.interface.v_bias_v) / current


def _taxel(rng: Rng, unit: float, gate: int, profile: Profile) -> Callable[[], float]:
    """Return a function that draws the resistance of a taxel in ohm."""
    way, shorts = rng.random(), rng.random() > 0.7
    share = rng.choice((0.05, 0.3, 0.9)) if shorts and not profile.plain else 0.0

    def ohm() -> float:
        if share and rng.random() < share:
            return math.inf if profile.gentle else rng.choice((0.0, math.inf))
        if way < 0.45 or profile.gentle:
            return unit / number(rng, 2.75e-3, 0.55)
        if way < 0.6:  # on a threshold between two codes, or an ulp from it
            near = unit * gate / (rng.randint(0, 256) - W_PRESET)
            return near * (1.0 + rng.randint(-2, 2) * 2.0**-52)
        if way < 0.75:  # a duty of p/q
            return unit * rng.randint(1, 12) / max(rng.randint(0, 12), 1)
        if way < 0.9 or profile.plain:
            return unit * number(rng, 0.1, 1e5)
        return number(rng, 1e-3, 1e15)

    return ohm


@functools.cache
def _parameters(topology: str) -> dict[str, dict[str, float | None]]:
    """Return defaults by effect and parameter; None where the scene must give it."""
    design = load_design()
    return {
        effect.name: effect.table().model_dump() | effect.defaults(design, topology)
        for effect in effects.EFFECTS.values()
        if topology in effect.topologies
    }


def _effects(rng: Rng, topology: str, cols: int, profile: Profile) -> Data:
    often = rng.choice(profile.often)
    strengths = ("default", "scaled", "beyond", "scaled" if profile.plain else "extreme")
    strength = "scaled" if profile.gentle else rng.choice(strengths)
    decades = float(strength == "beyond")
    on: Data = {}
    for name, defaults in _parameters(topology).items():
        effect = effects.EFFECTS[name]
        rare = 0.4 if effect.random or (profile.gentle and not effect.considered) else 1.0
        if rng.random() <= 1.0 - often * rare or (effect.random and profile.plain):
            continue
        if strength == "default" and None not in defaults.values():
            on[name] = True
            continue
        on[name] = {}
        for key, default in defaults.items():
            value: Any = _value(rng, name, key, default if profile.gentle else None, decades)
            if strength == "extreme" and rng.random() > 0.7:
                value = math.copysign(rng.choice(_EXTREMES), value)
            kinds = typing.get_args(effect.table.model_fields[key].annotation)
            if any("list" in str(kind) for kind in kinds) and rng.random() > 0.7:
                value = [value * rng.choice((effect.signs(key)[0], 0.25, 0.5, 1)) for _ in range(cols)]
            on[name][key] = value
    return on


def _value(rng: Rng, name: str, key: str, default: float | None = None, decades: float = 0.0) -> float:
    """Draw a parameter within its range, or decades beyond; at most twice a default that is given."""
    effect = effects.EFFECTS[name]
    low, high = effect.range()[key]
    if default:
        size = abs(default)
        if key in _LARGER_IS_WEAKER:
            low, high = max(low, 0.5 * size), 1e3 * size
        elif key in _LEVELS:
            low, high = max(low, 0.8 * size), min(high, 1.2 * size)
        else:
            low, high = 1e-3 * size, min(high, 2.0 * size)
    return rng.choice(effect.signs(key)) * number(rng, low / 10.0**decades, max(low, high) * 10.0**decades)


def _gentle(rng: Rng, topology: str, on: Data) -> None:
    """Switch off effects that engine event refuses together."""
    if topology == "direct":
        on |= dict.fromkeys(rng.choice(_COUPLING), False)
    if "motion" in on and not {"line_capacitance", "mirror_lag"} <= on.keys():
        del on["motion"]  # refused with both at their defaults


def _body(rng: Rng, rows: int, cols: int) -> Data:
    return {
        "shape": rng.choice(("flat", "triangular", "cylindrical", "spherical", "round")),
        "width": number(rng, 0.5, max(cols, 1)),
        "length": number(rng, 0.5, max(rows, 1)),
        "center_row": round(rng.uniform(0, rows - 1), 3),
        "center_col": round(rng.uniform(0, cols - 1), 3),
        "angle_deg": rng.randint(-180, 180),
        "samples": rng.randint(1, 3),
    }


def _stimulus(
    rng: Rng, kind: str, rows: int, cols: int, frames: int, files: dict[str, Any], codes: int
) -> Data:
    forces = [number(rng, 1e-2, 18.0) for _ in range(frames)]
    if kind == "uniform":
        drawn, ohms = [rng.randint(0, 255) % codes for _ in forces], [number(rng, 250.0, 1e5) for _ in forces]
        return {"kind": kind} | rng.choice(({"code": drawn}, {"force_n": forces}, {"r_ohm": ohms}))
    if kind == "frames":
        untouched = rng.random()
        files["frames.csv"] = [
            [float(rng.randint(0, 255) % codes if rng.random() > untouched else 0) for _ in range(cols)]
            for _ in range(frames * rows)
        ]
        return {"kind": kind, "file": "frames.csv", "unit": "codes"}
    form = _body(rng, rows, cols)
    if kind == "indenter":
        return {"kind": kind, "force_n": forces} | form
    if kind == "ramp":
        return {"kind": kind, "frames": frames, "force_n": forces[:4]} | form
    if kind == "several":
        parts = [{"kind": "ramp", "frames": frames, "force_n": forces[:3]} for _ in range(2)]
        return {"kind": kind, "parts": [part | _body(rng, rows, cols) for part in parts]}
    moving: Data = {"frequency_hz": number(rng, 5, 80)}
    if kind == "slip":
        moving = {"speed_pitch_per_s": number(rng, 1, 1e3), "direction_deg": rng.randint(-180, 180)}
    return {"kind": kind, "frames": frames, "force_n": forces[0]} | moving | form
