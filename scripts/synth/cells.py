# SPDX-License-Identifier: Apache-2.0
"""The two cell libraries of synthesis: where they lie, and what their Liberty says of each cell."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dermis.errors import InputError
from dermis.files import text_of
from dermis.scene.design import ROOT

SYNTH = ROOT / "rtl" / "synth"
OSU035 = Path("/usr/share/qflow/tech/osu035")


@dataclass(frozen=True)
class Technology:
    """A cell library and the few cells that the flow names itself.

    Parameters
    ----------
    name : name on the command line
    corners : corners there is Liberty for, the typical one first
    slow, fast : corners of setup and of hold
    latch : the library's latch, of which there is one in every dermis_tech_latch
    buffer : cell, input pin, output pin; drives up to `fanout` inputs
    driver : cell that ABC takes as the driver of every flip-flop output and input pin
    load_ff : load ABC takes behind every output: a flop's input and its wire
    wire_ff, wire_ff_per_sink : stated capacitance of a net before there is a layout: its first and each further sink
    tie_high, tie_low : cell and pin of a constant; None where the library has no such cell and constants stay
    dont_use : cells of the Liberty that mapping must leave alone
    late, early : factors on delays of our own tables: of setup paths at the slow corner, of hold paths at the
        fast one
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
        """Factors on early and late delays of a corner; 1 for a foundry's own Liberty."""
        if self.name == "sky130":
            from scripts.liberty.command import DIRECTORY

            if self.liberty(corner).parent != DIRECTORY:
                return 1.0, 1.0
        return (
            self.early if corner == self.fast else 1.0,
            self.late if corner == self.slow else 1.0,
        )

    def latch_source(self) -> Path:
        """The Verilog that stands in the place of rtl/dermis_tech_latch.v."""
        return SYNTH / self.name / "dermis_tech_latch.v"

    def functions(self) -> list[Path]:
        """Verilog of cells whose Liberty Yosys does not read rightly, each file named like its cell."""
        own = self.latch_source()
        return sorted(path for path in own.parent.glob("*.v") if path != own)


# Wire capacitance: about 0.2 fF a um on thin metal in both, and 40 um (0.13 um rules) or 100 um (0.35 um rules) to the
# next sink of a block of some thousand cells. A guess until there is a layout; docs/synthesis.md shows what it moves.
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
        # Delay lines, clock cells and latches are no logic.
        dont_use=r"sky130_fd_sc_hd__(dly|clk|dl[rx]|probe|lpflow)\w*",
        # The tables made here are up to 15 % faster at ss than the foundry's, and 5 % slower at ff: docs/liberty.md.
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
    """What Liberty says of a cell: area in um2, its pins, and whether it stores."""

    name: str
    area_um2: float
    inputs: frozenset[str]
    outputs: frozenset[str]
    clocks: frozenset[str]
    asynchronous: frozenset[str] = field(default_factory=frozenset)
    flop: bool = False
    latch: bool = False
    reset: bool = False


_CELL = re.compile(r'^\s*cell\s*\(\s*"?(\w+)"?\s*\)\s*\{?', re.MULTILINE)
_PIN = re.compile(r'\bpin\s*\(\s*"?(\w+)"?\s*\)\s*\{')
_STATE = re.compile(r"\b(ff|latch)\s*\([^)]*\)\s*\{([^}]*)\}")


def _groups(text: str) -> list[tuple[str, str]]:
    """Cells of a Liberty text, each with its text."""
    starts = list(_CELL.finditer(text))
    ends = [m.start() for m in starts[1:]] + [len(text)] * bool(starts)
    return [(m.group(1), text[m.start() : end]) for m, end in zip(starts, ends, strict=True)]


def _attribute(text: str, name: str) -> str | None:
    found = re.search(rf'\b{name}\s*:\s*"?([^";]*)"?\s*;', text)
    return found.group(1).strip() if found else None


def _pins_in(state: str, keys: tuple[str, ...]) -> frozenset[str]:
    """Pins named in the functions of some attributes of an ff or latch group."""
    return frozenset(pin for key in keys for pin in re.findall(r"[A-Za-z_]\w*", _attribute(state, key) or ""))


def cells(liberty: Path) -> dict[str, Cell]:
    """Read what synthesis needs to know of each cell of a Liberty file.

    Raises
    ------
    InputError
        It holds no cells.
    """
    made: dict[str, Cell] = {}
    for name, body in _groups(text_of(liberty, "a Liberty file")):
        state = _STATE.search(body)
        pins = list(_PIN.finditer(body))
        ends = [m.start() for m in pins[1:]] + [len(body)] * bool(pins)
        directions = {
            m.group(1): _attribute(body[m.end() : end], "direction") or ""
            for m, end in zip(pins, ends, strict=True)
        }

        said = state.group(2) if state else ""
        made[name] = Cell(
            name=name,
            area_um2=float(_attribute(body, "area") or 0.0),
            inputs=frozenset(p for p, d in directions.items() if d == "input"),
            outputs=frozenset(p for p, d in directions.items() if d == "output"),
            clocks=_pins_in(said, ("clocked_on", "enable")) & directions.keys(),
            asynchronous=_pins_in(said, ("clear", "preset")) & directions.keys(),
            flop=bool(state and state.group(1) == "ff"),
            latch=bool(state and state.group(1) == "latch"),
            reset=bool(_pins_in(said, ("clear", "preset"))),
        )
    if not made:
        raise InputError(liberty, "cell", "none", "a Liberty file with cells")
    return made


def areas(technology: Technology, library: Mapping[str, Cell]) -> dict[str, float]:
    """Area of every cell in um2; from the LEF where Liberty says 0, as osu035 does of its latch."""
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
    """Write the Liberty that mapping may choose from: without the cells of `dont_use`."""
    text = text_of(liberty, "a Liberty file")
    unwanted = re.compile(technology.dont_use)
    pieces: list[str] = []
    position = 0
    for match in _CELL.finditer(text):
        if not unwanted.fullmatch(match.group(1)) or match.start() < position:
            continue
        depth = 0
        for brace in re.compile(r"[{}]").finditer(text, match.start()):
            depth += 1 if brace.group() == "{" else -1
            if depth == 0:
                pieces.append(text[position : match.start()])
                position = brace.end()
                break
    pieces.append(text[position:])
    target.write_text("".join(pieces), encoding="utf-8")
    return target
