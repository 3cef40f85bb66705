# SPDX-License-Identifier: Apache-2.0
"""`dermis sweep`: resistance against frequency for the four interfaces, csv and figures."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.report import output, verdict
from dermis.scene.design import TOPOLOGIES
from scripts.sweep import curves, transistors


@click.command("sweep")
@click.option(
    "--points",
    type=click.IntRange(8, curves.POINTS_MAX),
    help="Number of resistances; default 256, sky130 8.",
)
@click.option(
    "--topology", type=click.Choice(TOPOLOGIES), multiple=True, help="Only this interface (repeatable)."
)
@click.option(
    "--view",
    type=click.Choice(["behavioural", "sky130"]),
    default="behavioural",
    show_default=True,
    help="SPICE blocks as models or transistors.",
)
@click.option(
    "--out",
    "directory",
    type=click.Path(),
    help="Directory for results; default build/sweep, build/sweep_sky130.",
)
@click.option("--plot/--no-plot", default=True, show_default=True, help="Draw the figures.")
@click.option(
    "--physical/--no-physical", default=True, show_default=True, help="Also sweep with the physical defaults."
)
def sweep_command(
    points: int | None,
    topology: tuple[str, ...],
    view: str,
    directory: str | None,
    plot: bool,
    physical: bool,
) -> int:
    """Sweep resistance against frequency, by ngspice and the real Verilog, for the four interfaces.

    sweep.csv and the figures go into OUT, the verdict table into build/sweep.json, in transistors
    into build/sweep_sky130.json.
    """
    name = "sweep" if view == "behavioural" else f"sweep_{view}"
    out = output.prepare(curves.OUT.with_name(name) if directory is None else directory)
    chosen = tuple(dict.fromkeys(topology)) or TOPOLOGIES
    if view == "behavioural":
        points = points or 256
        made, rows, failed = curves.run(chosen, points, out, physical=physical)
        figures = {"sweep_frequency.png": curves.frequency_figure, "sweep_code.png": curves.code_figure}
    else:
        if not physical:
            allowed = "only with --view behavioural, whose blocks are ideal or have physical defaults"
            raise InputError("command line", "--no-physical", f"--view {view}", allowed)
        points = points or transistors.POINTS
        made, rows, failed = transistors.run(chosen, points, out)
        figures = {transistors.FIGURE: transistors.figure}
    files: dict[str, Callable[[Path], None]] = {
        "sweep.csv": lambda path: write_atomic(path, curves.table(made)),
        **({file: partial(draw, made) for file, draw in figures.items()} if plot else {}),
    }
    for file in {"sweep.csv", *curves.FILES, *figures}:
        # No file of an earlier sweep stays.
        if made and file in files:
            files[file](out / file)
        else:
            (out / file).unlink(missing_ok=True)
    verdict.write_rows(name, rows)
    verdict.print_rows(
        rows, f"{points} resistances, {len(chosen)} interfaces: Verilog and ngspice ({view} blocks)"
    )
    click.echo(f"table, figures and scenes are in {os.path.relpath(out)}")
    return SimulatorError.exit_code if failed else verdict.exit_code(rows)
