# SPDX-License-Identifier: Apache-2.0
"""Whole frames: error of the codes against time a frame, every engine with effects in or out.

The work is frames of 16 x 16 resistances over the sensor's range with eight effects; the reference is 50 digits
(exact.py). Times are processor time, start of a process included where an engine starts one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis import cpu_time, engines, plan
from dermis.accuracy import exact
from dermis.accuracy.converter import step_words
from dermis.accuracy.point import Point
from dermis.bench_engines import random_plan
from dermis.effects import AutoTable
from dermis.engines import cosim
from dermis.errors import SimulatorError
from dermis.plan import Plan

WORK = "frames, eight effects"
EFFECTS = {
    "row_driver": True,
    "column_input": True,
    "mirror_ratio": {"ratio_error": 0.004},
    "offset_current": True,
    "integrator_bandwidth": {"gbw_hz": 5e6},
    "comparator_offset": True,
    "charge_packet": True,
    "preset_error": {"v_v": 2e-3},
}
"""All that the reference knows; values that make each of them count, or the design's."""

BUDGETS_LSB = (3.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
_MANY = 64


@dataclass(frozen=True)
class Method:
    """A way to get codes: `run` returns those of frame 0, and processor seconds a frame; a slow one runs once."""

    name: str
    setting: str
    run: Callable[[], tuple[NDArray[np.int64], float]]
    slow: bool = False


def _timed(made: Plan, **options: object) -> tuple[NDArray[np.int64], float]:
    """Codes of frame 0 and seconds a frame of one run, in processes of its own or not."""
    begin = cpu_time.cpu_used_s()
    codes = engines.run(made, **options).codes
    return codes[0].astype(np.int64), (cpu_time.cpu_used_s() - begin) / made.frames


def _repeated(made: Plan) -> tuple[NDArray[np.int64], float]:
    """The same for an engine so fast that a run is too short to time."""
    codes = engines.run(made).codes[0].astype(np.int64)
    return codes, cpu_time.cpu_seconds(partial(engines.run, made)) / made.frames


def methods(work: Path, quick: bool) -> Iterator[Method]:
    """Every engine and setting."""
    many = random_plan(work, _MANY, "event", **EFFECTS)
    few = many.part(0, 2)
    yield Method(
        "closed, effects out", "none of 8 in", partial(_repeated, random_plan(work, _MANY, "closed"))
    )
    for budget in BUDGETS_LSB[1::2] if quick else BUDGETS_LSB:
        made = plan.make(replace(many.scene), None, AutoTable(budget_lsb=budget))
        text = f"budget {budget:g} LSB: {len(made.on)} of 8 in, {made.engine}"
        yield Method("auto, by budget", text, partial(_repeated, made))
    yield Method("event", "8 of 8 in", partial(_repeated, many))
    yield Method(
        "rtl, verilator", "8 of 8 in", partial(_timed, replace(many, engine="rtl"), simulator="verilator")
    )
    yield Method("rtl, icarus", "8 of 8 in", partial(_timed, replace(few, engine="rtl"), simulator="icarus"))
    one = replace(many.part(0, 1), engine="cosim")
    # Steps as long as a clock with both simulators; a shorter one shows that the codes stay.
    settings = [("verilator", 1e-6), ("icarus", 1e-6), ("icarus", 1e-7)]
    for simulator, step in settings[:1] if quick else settings:
        run = partial(_timed, one, simulator=simulator, solver=cosim.Solver(t_max_step_s=step))
        yield Method(f"cosim, {simulator}", f"8 of 8 in, step {step_words(step)}", run, slow=True)


def measure(work: Path, repeat: int, quick: bool, tell: Callable[[str], None]) -> list[Point]:
    """Every method `repeat` times in turns, against the reference."""
    work.mkdir(parents=True, exist_ok=True)
    tell("reference in 50 digits")
    expected = exact.codes(random_plan(work, _MANY, "event", **EFFECTS), 1)[0]
    chosen = list(methods(work, quick))
    times: list[list[float]] = [[] for _ in chosen]
    errors: list[tuple[float, float] | None] = [None] * len(chosen)
    for turn in range(repeat):
        for i, method in enumerate(chosen):
            if turn and method.slow:
                continue
            tell(f"{WORK}, {method.name}, {method.setting}, {turn + 1} of {repeat}")
            try:
                codes, seconds = method.run()
            except SimulatorError as failure:
                tell(f"{method.name}, {method.setting}: {failure}")
                continue
            difference = np.abs(codes - expected)
            errors[i] = float(difference.mean()), float(difference.max())
            times[i].append(seconds)
    return [
        Point(WORK, method.name, method.setting, error[0], "LSB", error[1], tuple(taken))
        for method, error, taken in zip(chosen, errors, times, strict=True)
        if error is not None
    ]
