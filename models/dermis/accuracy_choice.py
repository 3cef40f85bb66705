# SPDX-License-Identifier: Apache-2.0
"""`[run] accuracy_lsb` and `time_s`: the setting for an accuracy, or for a time, from a measured curve.

A setting is a budget of [effects] auto: what of the effects that the scene names may be left out, and with it which
engine is enough. The budget bounds by how much any decision may move; what codes then miss on average is less.
models/accuracy.json holds the largest error that scenes of the curve had with each budget, the ratio of the two that
these scenes and others held, and what engines' time is over the cost that auto reckons. `dermis accuracy --table`
measures and writes it. A run that misses what was asked all the same goes on with the next finer setting.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from dermis import auto as chooser
from dermis import engines, plan
from dermis.effects import AutoTable
from dermis.engines import Result
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.processes import cpu_time
from dermis.records import Chosen, Plan
from dermis.report import verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from dermis.scene import scene
from dermis.scene.design import ROOT
from dermis.scene.scene import Scene
from dermis.scene.schema import SIZE_MAX

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
"""What the curve is drawn with, every effect on that auto considers."""
HELD_OUT_SCENES = (
    "cylindrical_indenter",
    "heavy_load",
    "round_punch",
    "slipping_cylinder",
    "spherical_fingertip",
)
"""What the curve's promise is then tried on, before it is made; tb/model/test_accuracy.py has others still."""
ASKED_LSB = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
# A promise that is missed is tightened by so much at a time: two are less than from one budget to the next.
_TIGHTER = 1.5

_FRAMES = 12
_JUDGED = 1 << 14  # conversions of a run that are compared with everything on
_PIECES = 8  # of a recording with more than that


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


def reached_lsb(made: Plan, result: Result) -> float:
    """Mean |code - code with everything on| of the worst frame of those that are judged.

    Raises
    ------
    InputError
        Engine event cannot do everything.
    """
    everything = plan.whole(made.scene, "event")
    engines.check(everything)
    return max(
        error_lsb(result.codes[part], engines.run(everything.part(part.start, part.stop)).codes)
        for part in _judged(made)
    )


def _judged(made: Plan) -> list[slice]:
    """Frames that are judged: all, or some pieces spread over the recording, and the fullest frame."""
    frames = max(1, _JUDGED // (made.rows * made.cols))
    if made.frames <= frames:
        return [slice(0, made.frames)]
    pieces = min(frames, _PIECES)
    length = frames // pieces
    starts = np.linspace(0, made.frames - length, pieces).astype(int)
    starts[np.argmin(np.abs(starts - made.fullest_frame()))] = min(made.fullest_frame(), made.frames - length)
    return [slice(int(first), int(first) + length) for first in np.unique(starts)]


def finer(made: Plan, found_lsb: float) -> Plan | None:
    """The plan of the next smaller budget with less left out, where this one reached `found_lsb`.

    Where no budget leaves out less it is the one that leaves out nothing, whatever the bounds say; behind that None.
    """
    chosen = made.accuracy
    assert chosen is not None
    missed = (*chosen.missed, (chosen.budget_lsb, found_lsb))

    def finer_ones() -> Iterator[tuple[float, Plan]]:
        for budget in sorted((b for b in BUDGETS_LSB if b < chosen.budget_lsb), reverse=True):
            yield budget, with_budget(made.scene, budget)
        nothing_out = plan.whole(made.scene, "event")
        yield 0.0, replace(nothing_out, margin_lsb=chooser.random_margin(nothing_out))

    for budget, again in finer_ones():
        if set(again.on) != set(made.on):
            expected = min(budget, again.left_out_lsb) / table()["budget_over_error"]
            setting = replace(
                chosen,
                budget_lsb=budget,
                expected_lsb=expected,
                expected_s=expected_s(again),
                missed=missed,
            )
            return replace(again, accuracy=setting)
    return None


def settled(made: Plan, result: Result, run: Callable[[Plan], Result]) -> tuple[Plan, Result]:
    """A run, or, where it misses the accuracy that was asked for, the next finer setting's, until one does not.

    The last setting leaves nothing out. A time that was asked for is never exceeded for accuracy.
    """
    while made.accuracy is not None and made.accuracy.wanted_lsb is not None:
        try:
            found = reached_lsb(made, result)
        except InputError:
            break  # nothing to judge by; `reached` says so
        again = finer(made, found) if found > made.accuracy.wanted_lsb else None
        if again is None:
            break
        made, result = again, run(again)
    return made, result


def reached(made: Plan, result: Result, seconds: float, name: str) -> list[Row]:
    """What a run reached: mean |code - code with everything on| in the worst of some frames, and its processor time.

    An accuracy that was asked for is judged. A time is stated only: it is the machine's.
    """
    chosen = made.accuracy
    assert chosen is not None
    on = f"{len(made.on)} of {len(made.scene.effects)} effects in, engine {made.engine}"
    on += f", left out {made.left_out_lsb:.2g} of {chosen.budget_lsb:.3g} LSB"
    on += "".join(f"; before, a budget of {b:.3g} LSB reached {e:.2g}" for b, e in chosen.missed)
    rows = []
    try:
        found = reached_lsb(made, result)
    except InputError as error:
        rows.append(
            verdict.skip(f"run.reached_lsb.{name}", f"engine event cannot do everything: {error}", "LSB")
        )
    else:
        frames = sum(part.stop - part.start for part in _judged(made))
        note = f"mean |difference| from everything on, worst of {frames} frames; {on}"
        note += f"; expected {chosen.expected_lsb:.2g}"
        rows.append(verdict.within(f"run.reached_lsb.{name}", found, "LSB", None, chosen.wanted_lsb, note))
    asked = "" if chosen.allowed_s is None else f", {chosen.allowed_s:g} s allowed"
    note = f"processor time of the run with its certified codes; {chosen.expected_s:.2g} s expected{asked}"
    return [*rows, verdict.report(f"run.reached_s.{name}", seconds, "s", note)]


def error_lsb(codes: Any, full: Any) -> float:
    """Mean |difference| in LSB of the worst frame."""
    difference = np.abs(np.asarray(codes, dtype=int) - np.asarray(full, dtype=int))
    return float(difference.mean(axis=(1, 2)).max())


def _everything_on(name: str) -> tuple[scene.Scene, int, Any]:
    """A scene with all that auto considers, how many of its frames are looked at, and their codes with all of it on."""
    world = chooser.with_auto(scene.load(scene.find(name)))
    whole = plan.whole(world, "event")
    frames = min(whole.frames, _FRAMES)
    return world, frames, engines.run(whole.part(0, frames)).codes


def measure(tell: Callable[[str], None]) -> dict[str, Any]:
    """Draw the curve, every budget on every scene of CURVE_SCENES with all that auto considers; try it on others."""
    errors: dict[float, list[float]] = {budget: [] for budget in BUDGETS_LSB}
    costs, times = [], []
    for name in CURVE_SCENES:
        world, frames, full = _everything_on(name)
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
    held_out = []
    while True:
        found = promised(loose, tell)
        misses = [entry for entry in found if entry["reached_lsb"] > entry["asked_lsb"]]
        held_out.append({"budget_over_error": round(float(loose), 3), "misses": misses})
        if not misses:
            break
        loose /= _TIGHTER
    return {
        "made_by": "dermis accuracy --table",
        "machine": machine_line(),
        "scenes": list(CURVE_SCENES),
        "error_lsb": "mean |code - code with everything on| of the worst frame of all scenes",
        "over_cost": "processor time over the cost that auto reckons, 0.9 quantile of the larger half of the runs",
        "settings": [
            {"budget_lsb": budget, "error_lsb": round(float(error), 6)} for budget, error in worst.items()
        ],
        "held_out": {"scenes": list(HELD_OUT_SCENES), "tried": held_out, "reached": found},
        "budget_over_error": round(float(loose), 3),
        "time": {"over_cost": round(factor, 3), "start_s": round(float(np.quantile(rest, 0.9)), 5)},
    }


def promised(loose: float, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """What HELD_OUT_SCENES reach at worst for each of ASKED_LSB, with budgets of `loose` times as much."""
    found = dict.fromkeys(ASKED_LSB, (0.0, ""))
    for name in HELD_OUT_SCENES:
        world, frames, full = _everything_on(name)
        for asked in ASKED_LSB:
            made = with_budget(world, min(asked * loose, SIZE_MAX)).part(0, frames)
            error = error_lsb(engines.run(made).codes, full)
            found[asked] = max(found[asked], (error, name))
            tell(f"held out, {name}: {asked:g} LSB asked, {error:.4f} reached, budget {asked * loose:.3g}")
    return [
        {"asked_lsb": asked, "reached_lsb": round(error, 6), "scene": name}
        for asked, (error, name) in found.items()
    ]


def write(tell: Callable[[str], None]) -> None:
    """Measure the curve and write models/accuracy.json."""
    write_atomic(TABLE, json.dumps(measure(tell), indent=1) + "\n")
    table.cache_clear()
