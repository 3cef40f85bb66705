# SPDX-License-Identifier: Apache-2.0
"""The two cell libraries of synthesis: their files, and the cells of their Liberty."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dermis.errors import InputError
from dermis.scene.design import ROOT
from scripts.liberty import syntax
from scripts.liberty.syntax import Group

SYNTH = ROOT / "rtl" / "synth"
OSU035 = Path("/usr/share/qflow/tech/osu035")


@dataclass(frozen=True)
class Technology:
    """A cell library and the few cells that the flow names.

    Parameters
    ----------
    name : name on the command line
    corners : corners with Liberty files, the typical one first
    slow, fast : corners of setup and of hold
    latch : latch of the library, one in every dermis_tech_latch
    buffer : cell, input pin, output pin; drives up to `fanout` inputs
    driver : driver of every flip-flop output and input pin in ABC
    load_ff : load of every output in ABC: the input of a flop and its wire
    wire_ff, wire_ff_per_sink : capacitance of a net before layout: its first and each further sink
    tie_high, tie_low : cell and pin of a constant; None if the library has no such cell
    dont_use : cells that mapping must not use
    late, early : derates of our own tables: setup at the slow corner, hold at the fast one
    """

    name: str
    corners: tuple[str, ...]
    slow: str
    fast: str
    latch: str
    buffer: tuple[str, str, str]
    driver: str
    load_ff: float
    wire_ff: float
    wire_ff_per_sink: float
    tie_high: tuple[str, str] | None
    tie_low: tuple[str, str] | None
    dont_use: str
    fanout: int = 12
    late: float = 1.0
    early: float = 1.0
    description: str = ""

    def liberty(self, corner: str) -> Path:
        """Return the Liberty file of a corner.

        Raises
        ------
        InputError
            It is not installed, or there is none of this corner.
        """
        if corner not in self.corners:
            raise InputError("command line", "corner", corner, f"one of {', '.join(self.corners)}")
        if self.name == "osu035":
            path = OSU035 / "osu035_stdcells.lib"
            if not path.is_file():
                raise InputError(
                    path, "Liberty", "not there", "Debian package qflow-tech-osu035 (make setup installs it)"
                )
            return path
        from scripts.liberty.command import liberty_file

        return Path(liberty_file(corner))

    def derates(self, corner: str) -> tuple[float, float]:
        """Return the early and late derates of a corner; 1 for the Liberty of a foundry."""
        if self.name == "sky130":
            from scripts.liberty.command import DIRECTORY

            if self.liberty(corner).parent != DIRECTORY:
                return 1.0, 1.0
        return (
            self.early if corner == self.fast else 1.0,
            self.late if corner == self.slow else 1.0,
        )

    def latch_source(self) -> Path:
        """Return the Verilog that replaces rtl/dermis_tech_latch.v."""
        return SYNTH / self.name / "dermis_tech_latch.v"

    def functions(self) -> list[Path]:
        """Return the Verilog of cells whose Liberty Yosys misreads, one file per cell."""
        own = self.latch_source()
        return sorted(path for path in own.parent.glob("*.v") if path != own)


# Wire capacitance: about 0.2 fF per um on thin metal, and 40 um (0.13 um rules) or 100 um (0.35 um
# rules) to the next sink in a block of some thousand cells. An estimate until layout;
# docs/synthesis.md shows its influence.
TECHNOLOGIES: Mapping[str, Technology] = {
    "sky130": Technology(
        name="sky130",
        corners=("tt", "ss", "ff"),
        slow="ss",
        fast="ff",
        latch="sky130_fd_sc_hd__dlrtn_1",
        buffer=("sky130_fd_sc_hd__buf_4", "A", "X"),
        driver="sky130_fd_sc_hd__inv_2",
        load_ff=10.0,
        wire_ff=8.0,
        wire_ff_per_sink=8.0,
        tie_high=("sky130_fd_sc_hd__conb_1", "HI"),
        tie_low=("sky130_fd_sc_hd__conb_1", "LO"),
        # Delay cells, clock cells and latches are not for logic.
        dont_use=r"sky130_fd_sc_hd__(dly|clk|dl[rx]|probe|lpflow)\w*",
        # Our tables are up to 15 % faster at ss than those of the foundry, and 5 % slower at ff:
        # docs/liberty.md.
        late=1.15,
        early=0.9,
        description="SkyWater sky130_fd_sc_hd, 130 nm, 1.8 V",
    ),
    "osu035": Technology(
        name="osu035",
        corners=("typical",),
        slow="typical",
        fast="typical",
        latch="LATCH",
        buffer=("BUFX4", "A", "Y"),
        driver="INVX2",
        load_ff=35.0,
        wire_ff=20.0,
        wire_ff_per_sink=20.0,
        tie_high=None,
        tie_low=None,
        dont_use=r"PAD\w*|TBUF\w*|CLKBUF\w*|[HF]AX1|LATCH|DFFNEGX1",
        description="OSU standard cells, 0.35 um, 3.3 V (Debian qflow-tech-osu035)",
    ),
}


@dataclass(frozen=True)
class Cell:
    """A cell of a Liberty file: area in um2, pins, and kind of storage."""

    name: str
    area_um2: float
    inputs: frozenset[str]
    outputs: frozenset[str]
    clocks: frozenset[str]
    asynchronous: frozenset[str] = field(default_factory=frozenset)
    flop: bool = False
    latch: bool = False
    reset: bool = False


def _pins_in(state: Group | None, keys: tuple[str, ...]) -> frozenset[str]:
    """Return the pins in the functions of some attributes of an ff or latch group."""
    said = " ".join(state.attributes.get(key, "") for key in keys) if state else ""
    return frozenset(re.findall(r"[A-Za-z_]\w*", said))


def cells(liberty: Path) -> dict[str, Cell]:
    """Read the cells of a Liberty file.

    Raises
    ------
    InputError
        It is not a Liberty file, or has no cells.
    """
    made: dict[str, Cell] = {}
    for group in syntax.read(liberty).of("cell"):
        state = next((g for g in group.groups if g.kind in ("ff", "latch")), None)
        pins = {g.name: g.attributes.get("direction", "").strip('"') for g in group.of("pin")}
        asynchronous = _pins_in(state, ("clear", "preset"))
        made[group.name] = Cell(
            name=group.name,
            area_um2=float(group.attributes.get("area", 0.0)),
            inputs=frozenset(p for p, d in pins.items() if d == "input"),
            outputs=frozenset(p for p, d in pins.items() if d == "output"),
            clocks=_pins_in(state, ("clocked_on", "enable")) & pins.keys(),
            asynchronous=asynchronous & pins.keys(),
            flop=state is not None and state.kind == "ff",
            latch=state is not None and state.kind == "latch",
            reset=bool(asynchronous),
        )
    if not made:
        raise InputError(liberty, "cell", "none", "a Liberty file with cells")
    return made


def areas(technology: Technology, library: Mapping[str, Cell]) -> dict[str, float]:
    """Return the area of every cell in um2, from the LEF where Liberty has 0, as for the latch of
    osu035.
    """
    found = {name: cell.area_um2 for name, cell in library.items()}
    missing = {name for name, area in found.items() if area <= 0.0}
    if technology.name == "osu035" and missing:
        lef = (OSU035 / "osu035_stdcells.lef").read_text(errors="replace")
        for name in missing:
            size = re.search(rf"^MACRO {name}\b.*?^\s*SIZE\s+([\d.]+)\s+BY\s+([\d.]+)", lef, re.M | re.S)
            if size:
                found[name] = float(size.group(1)) * float(size.group(2))
    return found


def mapping_liberty(technology: Technology, liberty: Path, target: Path) -> Path:
    """Write the Liberty file for mapping, without the cells of `dont_use`."""
    library = syntax.read(liberty)
    unwanted = re.compile(technology.dont_use)
    library.groups = [g for g in library.groups if g.kind != "cell" or not unwanted.fullmatch(g.name)]
    target.write_text(syntax.render(library), encoding="utf-8")
    return target
