# SPDX-License-Identifier: Apache-2.0
"""`[run] accuracy_lsb` and `time_s`: the setting for an accuracy, or for a time, from a measured curve.

A setting is a budget of [effects] auto: what of the effects that the scene names may be left out, and with it which
engine is enough. The budget bounds by how much any decision may move; what codes then miss on average is less.
models/accuracy.json holds the largest error that scenes of the curve had with each budget, the least ratio of the two,
and what engines' time is over the cost that auto reckons. `dermis accuracy --table` measures and writes it.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dermis import auto as chooser
from dermis import bench, cpu_time, engines, plan, scene, verdict
from dermis.design import ROOT
from dermis.effects import AutoTable
from dermis.engines import Result
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.plan import Plan
from dermis.scene import Scene
from dermis.schema import SIZE_MAX
from dermis.verdict import Row

TABLE = ROOT / "models" / "accuracy.json"
BUDGETS_LSB = (0.0, 0.003, 0.01, 0.03, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
CURVE_SCENES = (
    "flat_indenter",
    "nonideal_channel",
    "recorded_touch",
    "single_touch",
    "tapping_finger",
    "two_fingers",
)
"""What the curve is drawn with, every effect on that auto considers; tb/model/test_accuracy.py checks on others."""

_FRAMES = 12
_JUDGED = 1 << 14  # conversions of a run that are compared with everything on


@dataclass(frozen=True)
class Chosen:
    """What was asked for, and the setting: its budget, and error and processor time as the curve has them."""

    wanted_lsb: float | None
    allowed_s: float | None
    budget_lsb: float
    expected_lsb: float
    expected_s: float


@functools.cache
def table() -> dict[str, Any]:
    """The curve, settings in the order of their budgets."""
    return json.loads(TABLE.read_text())


def _cost_s(made: Plan) -> float:
    """What auto reckons a plan costs."""
    return 1e-9 * chooser.cost_ns(made.engine, set(made.on)) * made.frames * made.rows * made.cols


def expected_s(made: Plan) -> float:
    """Processor time of a plan on the machine of the curve."""
    time = table()["time"]
    return time["start_s"] + time["over_cost"] * _cost_s(made)


def with_budget(world: Scene, budget_lsb: float) -> Plan:
    """The plan that leaves out what fits a budget of the effects that the scene names."""
    return plan.make(world, None, AutoTable(budget_lsb=budget_lsb))


def choose(world: Scene) -> tuple[Plan, Chosen]:
    """The plan for what [run] asks.

    Raises
    ------
    InputError
        No setting is so fast.
    """
    run, loose = world.table.run, table()["budget_over_error"]
    if run.accuracy_lsb is not None:
        budget = min(run.accuracy_lsb * loose, SIZE_MAX)  # the largest that a scene may name
        made = with_budget(world, budget)
        taken = expected_s(made)
    else:
        fastest = np.inf
        for budget in BUDGETS_LSB:
            made = with_budget(world, budget)
            taken = expected_s(made)
            if taken <= run.time_s:
                break
            fastest = min(fastest, taken)
        else:
            allowed = f"at least {fastest:.2g} s, which the fastest setting is expected to take"
            raise InputError(world.path, "run.time_s", run.time_s, allowed)
    # What is left out may bound the decisions closer than the budget does.
    expected = min(budget, made.left_out_lsb) / loose
    chosen = Chosen(run.accuracy_lsb, run.time_s, budget, expected, taken)
    return made, chosen


def reached(made: Plan, result: Result, seconds: float, name: str) -> list[Row]:
    """What a run reached: mean |code - code with everything on| over its first frames, and its time.

    An accuracy that was asked for is judged. A time is stated only: it is the machine's.
    """
    chosen = made.accuracy
    assert chosen is not None
    frames = min(made.frames, max(1, _JUDGED // (made.rows * made.cols)))
    on = f"{len(made.on)} of {len(made.scene.effects)} effects in, engine {made.engine}"
    on += f", left out {made.left_out_lsb:.2g} of {chosen.budget_lsb:.3g} LSB"
    rows = []
    everything = plan.whole(made.scene, "event").part(0, frames)
    try:
        engines.check(everything)
        full = engines.run(everything).codes
    except InputError as error:
        rows.append(
            verdict.skip(f"run.reached_lsb.{name}", f"engine event cannot do everything: {error}", "LSB")
        )
    else:
        found = error_lsb(result.codes[:frames], full)
        note = (
            f"mean |difference| from everything on, {frames} frames; {on}; expected {chosen.expected_lsb:.2g}"
        )
        rows.append(verdict.within(f"run.reached_lsb.{name}", found, "LSB", None, chosen.wanted_lsb, note))
    asked = "" if chosen.allowed_s is None else f", {chosen.allowed_s:g} s allowed"
    note = f"the engine's run; {chosen.expected_s:.2g} s expected{asked}"
    return [*rows, verdict.report(f"run.reached_s.{name}", seconds, "s", note)]


def error_lsb(codes: Any, full: Any) -> float:
    """Mean |difference| in LSB of the worst frame."""
    difference = np.abs(np.asarray(codes, dtype=int) - np.asarray(full, dtype=int))
    return float(difference.mean(axis=(1, 2)).max())


def measure(tell: Callable[[str], None]) -> dict[str, Any]:
    """Draw the curve: every budget on every scene of CURVE_SCENES with all effects that auto considers."""
    errors: dict[float, list[float]] = {budget: [] for budget in BUDGETS_LSB}
    costs, times = [], []
    for name in CURVE_SCENES:
        world = chooser.with_auto(scene.load(scene.find(name)))
        whole = plan.whole(world, "event")
        frames = min(whole.frames, _FRAMES)
        full = engines.run(whole.part(0, frames)).codes
        for budget in BUDGETS_LSB:
            made = with_budget(world, budget).part(0, frames)
            found = error_lsb(engines.run(made).codes, full)
            errors[budget].append(found)
            run = functools.partial(engines.run, made)
            costs.append(_cost_s(made))
            times.append(cpu_time.cpu_seconds(run))
            tell(f"{name}: budget {budget:g}, {made.engine}, {found:.4f} LSB, {times[-1]:.4f} s")
    over = np.array(times) / np.array(costs)
    large = np.array(costs) >= np.median(costs)
    factor = float(np.quantile(over[large], 0.9))
    rest = np.maximum(np.array(times) - factor * np.array(costs), 0.0)
    worst = {budget: max(errors[budget]) for budget in BUDGETS_LSB}
    loose = min(budget / error for budget, error in worst.items() if error > 0)
    return {
        "made_by": "dermis accuracy --table",
        "machine": bench.machine_line(),
        "scenes": list(CURVE_SCENES),
        "error_lsb": "mean |code - code with everything on| of the worst frame of all scenes",
        "over_cost": "processor time over the cost that auto reckons, 0.9 quantile of the larger half of the runs",
        "settings": [
            {"budget_lsb": budget, "error_lsb": round(float(error), 6)} for budget, error in worst.items()
        ],
        "budget_over_error": round(float(loose), 3),
        "time": {"over_cost": round(factor, 3), "start_s": round(float(np.quantile(rest, 0.9)), 5)},
    }


def write(tell: Callable[[str], None]) -> None:
    """Measure the curve and write models/accuracy.json."""
    write_atomic(TABLE, json.dumps(measure(tell), indent=1) + "\n")
    table.cache_clear()
