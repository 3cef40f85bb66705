# SPDX-License-Identifier: Apache-2.0
"""The command `dermis plan`: the effects of a run, and decisions of its filter for a sample of its frames."""

from typing import Any

import click

from dermis import engines, records
from dermis import plan as planning
from dermis.engines import masking
from dermis.errors import DermisError, counted
from dermis.processes.cpu_time import cpu_seconds
from dermis.report import progress, verdict
from dermis.scene import scene as scenes

# Frames that `dermis plan` looks at, around the fullest one, and taxels in all of them.
_SAMPLE, _SAMPLE_TAXELS = 12, 12 * 32 * 32


def print_plan(plan: records.Plan) -> None:
    """Print the engine and the effects of a plan, on or off, by reason."""
    by_reason: dict[tuple[bool, str], list[str]] = {}
    for e in plan.effects:
        by_reason.setdefault((e.on, e.reason), []).append(e.name)
    console = verdict.console()
    console.print(f"engine {plan.engine}")
    for (on, reason), names in sorted(by_reason.items(), reverse=True):
        # Those that the scene does not name are all others.
        listed = f"{len(names)} effects" if reason == "not named" else ", ".join(names)
        console.print(f"{'on' if on else 'off'} ({reason}): {listed}")


def print_answer(plan: records.Plan) -> None:
    """Print which effects change codes, the engine that is enough for them and the time of a run, from a sample.

    The sample is run with each effect off in turn.
    """
    from dermis.engines import event  # compiled
    from dermis.report import ablate

    console, frames = verdict.console(), max(1, min(_SAMPLE, _SAMPLE_TAXELS // (plan.rows * plan.cols)))
    try:
        with progress.slots("effects compared", len(plan.on) + 1, "effects") as show:
            full, (_, *costs) = ablate.measure(plan.scene, "event", frames, 0, show)
        moving = [cost for cost in costs if cost.code_max_lsb]
        fewer = ablate.with_effects(plan.scene, {c.name: plan.on[c.name] for c in moving}, "event")
        fewer = fewer.part(full.first_frame, full.first_frame + full.frames)
        # The first run of a combination compiles its loops, which takes seconds.
        whole, part = (event.run(made).codes for made in (full, fewer))
        seconds = [cpu_seconds(lambda made=made: event.run(made)) for made in (full, fewer)]
    except DermisError as error:
        which = "this scene" if engines.refuses(plan, "event") else "this scene with an effect off"
        console.print(f"effects not compared, for engine event cannot do {which}: {error}")
        return
    together = int((whole != part).sum())
    enough = engines.cheapest(full if together else fewer) or plan.engine
    size = whole.size
    found = ", ".join(f"{c.name} ({round(c.moved * size)}, by up to {c.code_max_lsb})" for c in moving)
    of = f"of {size} in {counted(full.frames, 'frame', plan.frames)}"
    idle = ", ".join(cost.name for cost in costs if not cost.code_max_lsb)
    idle += f" alone, but {together} together" if together else ""
    times = (f"{s * plan.frames / full.frames:.2g} s" for s in seconds)
    console.print(f"effects that change codes ({of}): {found or 'none'}")
    console.print(f"effects that change none of them: {idle or 'none'}")
    words = f"engine {enough} is enough for those that change codes; engine event takes {next(times)} "
    console.print(f"{words}of processor time with all effects, {next(times)} with those")


def print_filter(plan: records.Plan, found: dict[str, Any]) -> None:
    """Print the result of the filter: the verdicts, and by effect its shifts and the cells walked for it."""
    from dermis.converter import injection  # compiled

    heads = ("effect", "largest shift / LSB", "largest possible / LSB", "cells walked for it")
    lines = [
        (name, *(v if isinstance(v, str) else f"{v:.2g}" for v in (caused, possible)), str(walked))
        for name, (caused, possible, walked) in found["effects"].items()
    ]
    console = verdict.print_table("", heads, lines, heads[1:])
    total = found["decided"] + found["level_1"] + found["everything"]
    words = f"of {total} cells {found['decided']} are decided by one solve, {found['level_1']} with their noise drawn, "
    words += f"{found['everything']} by engine event with everything on"
    console.print(words + (f": {found['reason']}" if found["reason"] else ""))
    margin = {n: float(c.max()) for n, c in injection.counts(plan).items() if c.max() > 0}
    if margin:
        counts = ", ".join(f"{', '.join(plan.effects_of_field(n))} {c:.2g}" for n, c in margin.items())
        console.print(f"charge that the filter and engine event leave out, in LSB: {counts}")


def print_rows(found: dict[str, Any]) -> None:
    """Print the rows that engine cosim solves in ngspice, and why."""
    console = verdict.console()
    words = f"of {found['rows_solved'] + found['rows_masked']} rows ngspice solves {found['rows_solved']}"
    if found["reason"]:
        console.print(f"{words}: {found['reason']}")
        return
    words += f", for {found['cells_open']} cells of which engine event is not certain"
    if found["rows_before"]:
        words += f"; {found['rows_before']} of them only because a later row remembers them"
    console.print(words)
    for frame, rows in list(found["rows"].items())[:_SAMPLE]:
        console.print(f"{frame}: rows {rows}")
    if (more := len(found["rows"]) - _SAMPLE) > 0:
        console.print(f"and rows of {more} more frames: summary.json, info.masked")


@click.command("plan")
@click.argument("scene")
@click.option(
    "--engine",
    help="closed, event, rtl or cosim; default: the scene's, or the cheapest with all its effects.",
)
@click.option("--auto", "chosen", is_flag=True, help="Let the plan choose effects: [effects] auto = {}.")
def plan_command(scene: str, engine: str | None, chosen: bool) -> int:
    """Show the effects of a scene and the verdicts of the filter for a sample, without a run."""
    world = scenes.load(scenes.find(scene))
    if chosen and world.table.effects.auto is None:
        world = scenes.with_auto(world)
    made = planning.make(world, engine)
    engines.check(made)
    print_plan(made)
    if made.filtered:
        sample = made.busiest(_SAMPLE)
        click.echo(f"filter, {counted(sample.frames, 'frame', made.frames)}:")
        if made.engine == "cosim":
            print_rows(masking.decide(sample).as_dict(sample.first_frame))
        else:
            print_filter(sample, engines.run(sample).info["filter"])
    if made.on:
        print_answer(made)
    return 0
