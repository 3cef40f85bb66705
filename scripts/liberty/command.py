# SPDX-License-Identifier: Apache-2.0
"""Liberty of the sky130_fd_sc_hd cells: from the user's PDK, else the files of rtl/synth/liberty.

`dermis liberty` measures entries of these files again in ngspice (docs/liberty.md).
"""

from __future__ import annotations

import os
from pathlib import Path

import click

from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene.design import ROOT
from scripts.liberty import cells, measure, syntax
from scripts.liberty.measure import CORNERS, SAMPLES, Corner

DIRECTORY = ROOT / "rtl" / "synth" / "liberty"
SMALLEST_NS = 0.02
"""An error is relative to the value or to this, whichever is larger: a table may cross zero."""
_PDK_PLACE = Path("sky130A", "libs.ref", "sky130_fd_sc_hd", "lib")


def file_name(corner: Corner) -> str:
    """Return the file name of a corner, the same as in a PDK."""
    return f"{cells.PREFIX}{corner.name}.lib"


def liberty_file(corner: str) -> Path:
    """Return the Liberty file of corner "ss", "tt" or "ff": the one in PDK_ROOT if that is set,
    else ours.

    Raises
    ------
    InputError
        The corner does not exist, or PDK_ROOT is set and lacks the file.
    """
    if corner not in CORNERS:
        raise InputError("corner", "name", corner, f"one of {', '.join(CORNERS)}")
    name = file_name(CORNERS[corner])
    root = os.environ.get("PDK_ROOT")
    path = Path(root) / _PDK_PLACE / name if root else DIRECTORY / name
    if root and not path.is_file():
        allowed = f"a directory with {_PDK_PLACE / name}, or not set"
        raise InputError("environment", "PDK_ROOT", root, allowed)
    if not path.is_file():
        raise InputError(path, "file", "missing", "the file of the repository")
    return path


def sample_error(library: syntax.Group, corner: Corner, name: str, directory: Path) -> float:
    """Return the largest relative error of the entries of a cell that are measured again.

    Raises
    ------
    InputError
        The library lacks an entry.
    SimulatorError
        ngspice failed, or a measurement did.
    """
    sample, worst = SAMPLES[name], 0.0
    arcs = library.one("cell", cells.PREFIX + name).one("pin", sample.output).of("timing")
    timing = next(arc for arc in arcs if arc.attributes["related_pin"] == f'"{sample.pin}"')
    for kind, table in measure.measure(name, corner, directory).items():
        group = timing.one(kind)
        slews, loads, told = group.numbers("index_1"), group.numbers("index_2"), group.table()
        for slew, line in zip(sample.slews, table, strict=True):
            for load, value in zip(sample.loads, line, strict=True):
                entry = told[slews.index(slew)][loads.index(load)]
                worst = max(worst, abs(value - entry) / max(abs(value), SMALLEST_NS))
    return worst


@click.command()
@click.option("--check", is_flag=True, hidden=True, help="As without it.")
@click.option(
    "--corner",
    "corners",
    multiple=True,
    type=click.Choice(list(CORNERS)),
    help="Only this corner (repeatable).",
)
def liberty_command(check: bool, corners: tuple[str, ...]) -> int:
    """Measure entries of the Liberty files again in ngspice; write build/liberty.json."""
    rows = []
    for corner in corners or CORNERS:
        path = DIRECTORY / file_name(CORNERS[corner])
        library = syntax.read(path)
        for name in SAMPLES:
            error = sample_error(library, CORNERS[corner], name, ROOT / "build" / "liberty" / corner)
            rows.append(verdict.judge(f"liberty.sample_error.{corner}_{name}", error, path.name))
    verdict.write_rows("liberty", rows)
    verdict.print_rows(rows, "Liberty of the standard cells")
    return verdict.exit_code(rows)
