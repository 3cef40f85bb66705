# SPDX-License-Identifier: Apache-2.0
"""Costs of the effects of a scene, one off at a time, in codes and processor time."""

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.errors import InputError, counted
from dermis.files import write_between
from dermis.places import BUILD, ROOT
from dermis.processes.cpu_time import cpu_seconds
from dermis.records import Plan
from dermis.report import figures, progress, verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from dermis.scene.scene import Scene
from dermis.scene.schema import Strict

FRAMES = 64
"""Default number of frames; 1 with cosim, which takes seconds for a frame."""

PAIRS = 3
"""Pairs of runs, with and without an effect, for a ratio of times; 1 with cosim."""

EVERYTHING = "all_effects"

DOCS = "docs/effects.md"
BEGIN, END = "<!-- begin: ablate (written by dermis ablate --docs) -->", "<!-- end: ablate -->"
PICTURE = "docs/figures/ablate.png"


@dataclass(frozen=True)
class Cost:
    """Changes made by one effect."""

    name: str  # the effect; EVERYTHING for all of them together
    code_max_lsb: int  # largest |code with - code without| of any taxel
    moved: float  # share of the taxels whose code moves, 0..1
    mean_shift_lsb: float  # mean of code with - code without over all taxels
    time_ratio: float  # processor time with over without, median of pairs of runs
    engine: str  # the cheapest that can do the scene without it


def with_effects(world: Scene, on: Mapping[str, Strict], engine: str | None = None) -> Plan:
    """Return the plan of a scene with exactly these effects, also where it has `auto`."""
    effects = world.table.effects.model_copy(update={"auto": None})
    table = world.table.model_copy(update={"effects": effects})
    return plan.make(replace(world, table=table, effects=dict(on)), engine)


def measure(
    world: Scene,
    engine: str | None = None,
    frames: int | None = None,
    pairs: int | None = None,
    show: progress.Tell = lambda done, doing="": None,
) -> tuple[Plan, list[Cost]]:
    """Ablate a scene; return the plan with everything on, and the costs: everything first, then the largest first.

    Parameters
    ----------
    engine : of all runs; default the cheapest that can do all effects at once, so that times compare
    frames : most frames, around the one with the most conductance; default FRAMES, 1 with cosim
    pairs : pairs of runs, with and without an effect, for a ratio of times, NaN without; default PAIRS, 1 with cosim
    show : called with the number of effects done and the next one

    Raises InputError if no effect is on, or the engine cannot do them all.
    """
    on = world.effects  # with `auto`: all effects that it may choose
    if not on:
        raise InputError(world.path, "effects", "none on", "at least one effect, or auto")
    full = with_effects(world, on, engine)
    if engine is None:  # also if the scene names an engine
        full = replace(full, engine=engines.cheapest(full) or full.engine)
    engines.check(full)
    slow = full.engine == "cosim"
    full = full.busiest(frames or (1 if slow else FRAMES))
    pairs = (1 if slow else PAIRS) if pairs is None else pairs
    run, costs = engines.runner(full.engine), []
    codes = run(full).codes.astype(int)
    for name in (EVERYTHING, *on):
        show(len(costs), f"{name} off")
        rest = {} if name == EVERYTHING else {other: p for other, p in on.items() if other != name}
        less = with_effects(world, rest, full.engine).part(full.first_frame, full.first_frame + full.frames)
        costs.append(_cost(name, full, codes - run(less).codes, less, pairs))
    return full, costs[:1] + sorted(costs[1:], key=_size, reverse=True)


def _cost(name: str, full: Plan, shift: NDArray[np.int_], without: Plan, pairs: int) -> Cost:
    run = engines.runner(full.engine)
    ratios = [cpu_seconds(lambda: run(full)) / cpu_seconds(lambda: run(without)) for _ in range(pairs)]
    ratio, enough = statistics.median(ratios) if ratios else np.nan, engines.cheapest(without) or full.engine
    moved, mean = float((shift != 0).mean()), float(shift.mean())
    return Cost(name, int(np.abs(shift).max()), moved, mean, ratio, enough)


def _size(cost: Cost) -> tuple[float, ...]:
    return cost.code_max_lsb, cost.moved, abs(cost.mean_shift_lsb), cost.time_ratio


def rows_of(costs: list[Cost], full: Plan) -> list[Row]:
    """Return four rows for each effect."""
    rows = []
    for cost in costs:
        what = "every effect" if cost.name == EVERYTHING else cost.name
        note = f"{full.engine}, {counted(full.frames, 'frame')}, everything on against {what} off"
        for key, unit, more in (
            ("code_max_lsb", "lsb", ""),
            ("moved", "1", "; share of the taxels"),
            ("mean_shift_lsb", "lsb", "; with minus without"),
            ("time_ratio", "1", f"; processor time; without it engine {cost.engine} would do"),
        ):
            rows.append(verdict.report(f"ablate.{cost.name}.{key}", getattr(cost, key), unit, note + more))
    return rows


HEAD = ("off", "max change / LSB", "taxels that move", "mean shift / LSB", "time ratio", "then cheapest")


def cells(cost: Cost) -> tuple[str, ...]:
    """Return one line of the table."""
    return (
        cost.name,
        str(cost.code_max_lsb),
        f"{100 * cost.moved:.2f} %",
        f"{cost.mean_shift_lsb:+.4f}",
        f"{cost.time_ratio:.2f}",
        cost.engine,
    )


def docs_table(costs: list[Cost], title: str) -> str:
    """Return the costs as Markdown."""
    lines = [f"{title}.", "", f"| {' | '.join(HEAD)} |", "|---|--:|--:|--:|--:|---|"]
    for cost in costs:
        name, *rest = cells(cost)
        lines.append(f"| `{name}` | {' | '.join(rest)} |")
    return "\n".join(lines)


def figure(costs: list[Cost], title: str, path: Path) -> None:
    """Draw the costs as bars: codes on the left, time on the right."""
    order = costs[::-1]
    canvas = Figure(figsize=(11, 1.6 + 0.32 * len(order)), layout="constrained")
    codes, time = canvas.subplots(1, 2, sharey=True, width_ratios=[2, 1])
    y, largest = np.arange(len(order)), [c.code_max_lsb for c in order]
    codes.barh(y + 0.2, largest, 0.4, color=figures.BLUE, label="largest |shift|")
    mean = [abs(c.mean_shift_lsb) for c in order]
    codes.barh(y - 0.2, mean, 0.4, color=figures.ORANGE, label="|mean shift|")
    codes.set_xscale("symlog", linthresh=1.0)
    codes.set_xlim(0, 3 * max(1, *largest))  # room for the text after the longest bar
    codes.xaxis.set_major_formatter("{x:g}")
    codes.set_xlabel("shift of the code when the effect goes / LSB, and share of the taxels that move")
    codes.set_yticks(y, [c.name for c in order])
    codes.legend(frameon=False, fontsize=8, loc="lower right")
    for at, cost in zip(y, order, strict=True):
        place = max(cost.code_max_lsb, 0.02), at + 0.2
        codes.annotate(f" {100 * cost.moved:.3g} %", place, fontsize=7, va="center")
    time.barh(y, [c.time_ratio for c in order], 0.5, color=figures.GREEN)
    time.axvline(1.0, color=figures.GREY, lw=0.8)
    time.set_xlabel("processor time with / without")
    canvas.suptitle(title, fontsize=10)
    figures.save(canvas, path)


@click.command("ablate")
@click.argument("scene_name", metavar="SCENE")
@click.option("--engine", help="Engine of all runs; default: the cheapest with all effects.")
@click.option(
    "--frames", type=click.IntRange(min=1), help=f"Largest number of frames; default {FRAMES}, cosim 1."
)
@click.option(
    "--pairs", type=click.IntRange(min=1), help=f"Pairs of runs per time ratio; default {PAIRS}, cosim 1."
)
@click.option("--docs", is_flag=True, help=f"Also write the table in {DOCS} and its figure.")
def ablate_command(
    scene_name: str, engine: str | None, frames: int | None, pairs: int | None, docs: bool
) -> int:
    """Measure the cost of each effect of a scene: all on, then one off at a time.

    Writes the table to build/ablate.json and a figure to build/ablate.png. With `auto` in the
    scene, all effects that it may choose are on.
    """
    world = scene.load(scene.find(scene_name))
    with progress.slots("ablate", len(world.effects) + 1, "effects") as show:
        full, costs = measure(world, engine, frames, pairs, show)
    last = full.first_frame + full.frames - 1
    which = f"frame {last}" if full.frames == 1 else f"frames {full.first_frame} to {last}"
    title = f"{world.path.stem}: {len(costs) - 1} effects, engine {full.engine}, {which}"
    rows = rows_of(costs, full)
    figure(costs, title, BUILD / "ablate.png")
    verdict.write_rows("ablate", rows)
    verdict.print_table(title, HEAD, map(cells, costs), HEAD[1:-1])
    click.echo(f"figure: {BUILD / 'ablate.png'}")
    if docs:
        figure(costs, title, ROOT / PICTURE)
        table = docs_table(costs, f"`make ablate SCENE={scene_name}`: {title}")
        write_between(ROOT / DOCS, BEGIN, END, table)
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(rows)
