# SPDX-License-Identifier: Apache-2.0
"""Compare the sheets of spice/schematic with the netlists of spice/sky130, and draw them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.processes import children
from dermis.report import verdict
from dermis.report.verdict import Row
from scripts.judged import tool
from scripts.schematics import netlist
from scripts.schematics.drawing import PORTS, SHEETS, draw, places
from scripts.schematics.netlist import Subckt

TEXT = SHEETS.parent / "sky130"
WORK = BUILD / "schematics"
LIMIT_S = 120.0


def written(place: Path = TEXT) -> dict[str, Subckt]:
    """Return the subcircuits of the text."""
    found: dict[str, Subckt] = {}
    for path in [*sorted(place.glob("*.sp")), place / "devices.inc"]:
        found |= netlist.parse(path.read_text(encoding="utf-8"), path)
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
    found = netlist.parse(below, result)
    for name in {*names} & {*found}:
        for place in places(sheets / f"{name}.sch"):
            found[name].ports.extend(netlist.bits(place.values["lab"]) if place.kind in PORTS else ())
    return found


def compare(text: Mapping[str, Subckt], sheets: Mapping[str, Subckt]) -> list[Row]:
    """Return a row for each subcircuit with the number of its differences."""
    return [
        verdict.within(f"schematics.{name}", len(said), "differences", 0, 0, "; ".join(said))
        for name, said in netlist.differences(text, sheets).items()
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
