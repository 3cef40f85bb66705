# SPDX-License-Identifier: Apache-2.0
"""`dermis sweep`: resistance against frequency for the four interfaces, csv and figures."""

from __future__ import annotations

import os

import click

from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.report import output
from dermis.scene.design import TOPOLOGIES
from scripts.judged import SHOW, finish
from scripts.sweep import curves, figures

POINTS_MAX = 4096
FIGURES = {
    "behavioural": {
        "sweep_frequency.png": figures.frequency_figure,
        "sweep_code.png": figures.code_figure,
    },
    "sky130": {"sweep_transistors.png": figures.transistor_figure},
}
FILES = {"sweep.csv", *(name for named in FIGURES.values() for name in named)}


@click.command("sweep", context_settings=SHOW)
@click.option("--points", type=click.IntRange(8, POINTS_MAX), help="Number of resistances; 256, sky130 8.")
@click.option(
    "--topology", type=click.Choice(TOPOLOGIES), multiple=True, help="Only this interface (repeatable)."
)
@click.option(
    "--view",
    type=click.Choice(list(FIGURES)),
    default="behavioural",
    help="SPICE blocks: models or transistors.",
)
@click.option("--out", "directory", type=click.Path(), help="Directory for results; default below build/.")
@click.option("--plot/--no-plot", default=True, help="Draw the figures.")
@click.option("--physical/--no-physical", default=True, help="Also sweep with the physical defaults.")
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
    out = output.prepare(BUILD / name if directory is None else directory)
    chosen = tuple(dict.fromkeys(topology)) or TOPOLOGIES
    if view == "behavioural":
        points = points or 256
        made, rows, failed = curves.run(chosen, points, out, with_physical=physical)
    else:
        if not physical:
            allowed = "only with --view behavioural, whose blocks are ideal or have physical defaults"
            raise InputError("command line", "--no-physical", f"--view {view}", allowed)
        points = points or curves.POINTS_TRANSISTORS
        made, rows, failed = curves.run_transistors(chosen, points, out)
    for file in FILES:
        (out / file).unlink(missing_ok=True)  # no file of an earlier sweep stays
    if made:
        write_atomic(out / "sweep.csv", figures.table(made))
        for file, draw in FIGURES[view].items() if plot else ():
            draw(made, out / file)
    title = f"{points} resistances, {len(chosen)} interfaces: Verilog and ngspice ({view} blocks)"
    code = finish(name, rows, title)
    click.echo(f"table, figures and scenes are in {os.path.relpath(out)}")
    return SimulatorError.exit_code if failed else code
