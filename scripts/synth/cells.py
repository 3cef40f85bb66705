# SPDX-License-Identifier: Apache-2.0
"""The two cell libraries of synthesis: their files, and the cells of their Liberty."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dermis.errors import InputError
from dermis.files import text_of
from dermis.scene.design import ROOT
from scripts import liberty as sky130_liberty

SYNTH = ROOT / "rtl" / "synth"
OSU035 = Path("/usr/share/qflow/tech/osu035")


@dataclass(frozen=True)
class Technology:
    """A cell library and the few cells that the flow names."""

    name: str  # on the command line
    corners: tuple[str, ...]  # with Liberty files, the typical one first
    slow: str  # corner of setup
    fast: str  # corner of hold
    latch: str  # one in every dermis_tech_latch
    driver: str  # of every flip-flop output and input pin in ABC
    load_ff: float  # of every output in ABC: the input of a flop and its wire
    wire_ff: float  # of a net before layout, its first sink
    wire_ff_per_sink: float  # each further sink
    dont_use: str  # cells that mapping must not use
    ties: tuple[tuple[str, str], tuple[str, str]] | None = None  # cell and pin of constants 1 and 0
    fanout: int = 12
    late: float = 1.0  # derate of our own tables: setup at the slow corner
    early: float = 1.0  # hold at the fast one

    def liberty(self, corner: str) -> Path:
        """Return the Liberty file of a corner; InputError if it is not installed."""
        return sky130_liberty.liberty_file(corner) if self.name == "sky130" else osu035("osu035_stdcells.lib")

    @property
    def typical(self) -> Path:
        """Liberty file of mapping."""
        return self.liberty(self.corners[0])

    def derates(self, corner: str) -> tuple[float, float]:
        """Return the early and late derates of a corner; 1 for the Liberty of a foundry."""
        if self.name == "sky130" and self.liberty(corner).parent != sky130_liberty.DIRECTORY:
            return 1.0, 1.0
        return self.early if corner == self.fast else 1.0, self.late if corner == self.slow else 1.0

    def functions(self) -> list[Path]:
        """Return the Verilog of cells whose Liberty Yosys misreads, one file per cell."""
        return sorted(path for path in (SYNTH / self.name).glob("*.v") if not path.name.startswith("dermis_"))


def for_cells(sources: Iterable[Path], technology: Technology | None) -> list[Path]:
    """Return Verilog sources with the technology cells of rtl/synth, and of a library's own directory, in place."""
    places = [SYNTH / technology.name, SYNTH] if technology else [SYNTH]
    return [next((d / path.name for d in places if (d / path.name).is_file()), path) for path in sources]


def osu035(name: str) -> Path:
    """Return a file of the OSU cells; InputError if they are not installed."""
    path, remedy = OSU035 / name, "Debian package qflow-tech-osu035 (make setup installs it)"
    if not path.is_file():
        raise InputError(path, "cells", "not there", remedy)
    return path


TECHNOLOGIES: Mapping[str, Technology] = {
    name: Technology(name, **entry)
    for name, entry in tomllib.loads((SYNTH / "technologies.toml").read_text()).items()
}


@dataclass(frozen=True)
class Cell:
    """A cell of a Liberty file: area in um2, pins, and kind of storage."""

    area_um2: float
    inputs: frozenset[str]
    clocks: frozenset[str]
    asynchronous: frozenset[str]
    flop: bool
    latch: bool


def cells(liberty: Path) -> dict[str, Cell]:
    """Read the cells of a Liberty file; InputError if it is none, or has no cells."""
    made: dict[str, Cell] = {}
    for group in sky130_liberty.read(liberty).of("cell"):
        state = next((g for g in group.groups if g.kind in ("ff", "latch")), sky130_liberty.Group("", ""))
        pins = {g.name: g.attributes.get("direction", "").strip('"') for g in group.of("pin")}
        made[group.name] = Cell(
            area_um2=float(group.attributes.get("area", 0.0)),
            inputs=frozenset(p for p, d in pins.items() if d == "input"),
            clocks=frozenset(pins.keys() & {*state.words("clocked_on", "enable")}),
            asynchronous=frozenset(pins.keys() & {*state.words("clear", "preset")}),
            flop=state.kind == "ff",
            latch=state.kind == "latch",
        )
    if not made:
        raise InputError(liberty, "cell", "none", "a Liberty file with cells")
    return made


def areas(technology: Technology, library: Mapping[str, Cell]) -> dict[str, float]:
    """Return the area of every cell in um2, from the LEF where Liberty has 0, as for osu035's latch."""
    found = {name: cell.area_um2 for name, cell in library.items()}
    if technology.name == "osu035":
        lef = osu035("osu035_stdcells.lef").read_text(errors="replace")
        sizes = re.findall(r"^MACRO (\w+).*?^\s*SIZE\s+([\d.]+)\s+BY\s+([\d.]+)", lef, re.M | re.S)
        found |= {name: float(w) * float(h) for name, w, h in sizes if found.get(name) == 0.0}
    return found


def mapping_liberty(technology: Technology, target: Path) -> Path:
    """Write the Liberty file for mapping, without the cells of `dont_use`."""
    text, unwanted = text_of(technology.typical, "a Liberty file"), re.compile(technology.dont_use)
    for cell in reversed(sky130_liberty.read(technology.typical).of("cell")):
        if unwanted.fullmatch(cell.name):
            text = text[: cell.start] + text[cell.end :]
    target.write_text(text, encoding="utf-8")
    return target
