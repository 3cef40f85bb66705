# SPDX-License-Identifier: Apache-2.0
"""The command `dermis plan`: effects that a plan keeps or leaves out, with reasons, bounds and costs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from dermis import auto, engines, records
from dermis import plan as planning
from dermis.effects import EFFECTS
from dermis.errors import InputError
from dermis.scene import scene as scenes


def print_plan(plan: records.Plan) -> None:
    """Print the effects of a plan: name, bound, in or out, reason, cost."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=130)
    table = Table(title=None, box=box.SIMPLE_HEAD)
    for heading in ("effect", "bound in LSB", "", "why", "cost in ns"):
        table.add_column(heading, justify="right" if " in " in heading else "left")
    for e in plan.effects:
        if e.bound_lsb is None and not e.on:
            continue
        bound = "" if e.bound_lsb is None else ("none" if e.bound_lsb > 1e300 else f"{e.bound_lsb:.3g}")
        cost = "" if e.cost_ns is None else f"{e.cost_ns:.0f}"
        table.add_row(e.name, bound, "in" if e.on else "out", e.reason, cost)
    console.print(table)
    aside = [e for e in plan.effects if e.bound_lsb is None and not e.on]
    if aside:
        console.print(
            "not considered: " + ", ".join(f"{e.name} ({e.reason})" for e in aside), highlight=False
        )
    margin = float(np.max(plan.margin_lsb))
    console.print(
        f"engine {plan.engine}; left out: {plan.left_out_lsb:.3g} LSB together; certified codes allow for "
        f"{margin:.3g} LSB either way",
        highlight=False,
    )


def measure_costs(frames: int = 32, repeats: int = 5) -> dict[str, float]:
    """Measure nanoseconds for a conversion: each engine alone, and the addition of each effect to the cheapest."""

    def world(effect: str | None, topology: str) -> scenes.Scene:
        stimulus = {"kind": "ramp", "force_n": [0.0, 12.0], "frames": frames}
        data = {
            "stimulus": stimulus,
            "interface": {"topology": topology},
            "effects": {effect: True} if effect else {},
        }
        return scenes.from_data(data, Path("costs"))

    def nanoseconds(scene_of: scenes.Scene, engine: str) -> float:
        plan = planning.whole(scene_of, engine)
        run = engines.runner(engine)
        run(plan)
        best = min(_timed(run, plan) for _ in range(repeats))
        return 1e9 * best / plan.resistance_ohm.size

    found = {name: nanoseconds(world(None, "conveyor_mirror"), name) for name in auto.ENGINE_COST_NS}
    for name, effect in EFFECTS.items():
        scene_of = world(name, effect.topologies[-1])
        made = planning.whole(scene_of, None)
        if not auto.fields_of(made, name):
            continue
        engine = engines.cheapest(made, auto.ENGINE_COST_NS) or "event"
        found[name] = nanoseconds(scene_of, engine) - found[engine]
    return found


def _timed(run: Any, plan: records.Plan) -> float:
    start = time.process_time()
    run(plan)
    return time.process_time() - start


@click.command("plan")
@click.argument("scene", required=False)
@click.option(
    "--engine",
    help="closed, event, rtl or cosim; default: that of the scene, or the cheapest that can do it.",
)
@click.option("--auto", "chosen", is_flag=True, help="Add [effects] auto = {} to the scene.")
@click.option("--costs", is_flag=True, help="Measure the costs and print them with those of the table.")
def plan_command(scene: str | None, engine: str | None, chosen: bool, costs: bool) -> int:
    """Show the effects that a scene's plan keeps and leaves out, with bounds and costs; nothing is run."""
    if costs:
        table = auto.ENGINE_COST_NS | {name: effect.cost_ns for name, effect in EFFECTS.items()}
        for name, value in measure_costs().items():
            click.echo(f"{name:24} {value:10.0f} ns measured {table[name]:10.0f} ns in the table")
        return 0
    if scene is None:
        raise InputError("command line", "SCENE", "nothing", "a scene, or --costs")
    world = scenes.load(scenes.find(scene))
    if chosen and world.table.effects.auto is None:
        world = auto.with_auto(world)
    made = planning.make(world, engine)
    engines.check(made)
    print_plan(made)
    return 0
