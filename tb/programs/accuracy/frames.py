# SPDX-License-Identifier: Apache-2.0
"""Whole frames: error of the codes against time a frame, for every engine.

Frames of 16 x 16 resistances over the sensor's range with eight effects; the reference has 50
digits (tb/reference/frame.py). Times are processor time, start of a process included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.effects import AutoTable
from dermis.engines import Result, cosim
from dermis.processes import cpu_time
from dermis.records import Plan
from tb.programs.accuracy import converter
from tb.programs.accuracy.points import Method, Outcome
from tb.programs.bench.measure import cpu_once, random_plan
from tb.reference import frame as reference

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
"""The effects of the reference, each with a value that changes codes."""

BUDGETS_LSB = (3.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
SOLVERS = {
    "trap, reltol 0.0001": cosim.Solver(),
    "trap, reltol 0.01": cosim.Solver(options=converter.tolerances(1e-2)),
    "gear of order 1": cosim.Solver(options=converter.tolerances(1e-4, method="gear", maxord="1")),
}
"""Settings of ngspice for a whole frame, the project's own first."""
_MANY = 64


class Frames:
    """Methods on frames whose codes [rows, cols] are known."""

    def __init__(self, work: Path) -> None:
        self.work = work

    @cached_property
    def truth(self) -> NDArray[Any]:
        """Codes of the reference; 50 digits take 0.1 s a conversion."""
        return reference.frame(random_plan(self.work, _MANY, "event", **EFFECTS)).codes

    def _outcome(self, result: Result, seconds: float) -> Outcome:
        off = np.abs(result.codes[0].astype(int) - self.truth)
        return Outcome(float(off.mean()), float(off.max()), seconds / len(result.codes), "LSB")

    def plain(self, made: Plan) -> Outcome:
        """Run closed or event; a run too short to time is repeated."""
        return self._outcome(engines.run(made), cpu_time.cpu_seconds(partial(engines.run, made)))

    def simulated(self, made: Plan, **options: Any) -> Outcome:
        """Run the Verilog in a simulator."""
        if made.engine == "rtl":
            engines.run(made.part(0, 1), **options)  # builds, so that it is not timed
        return self._outcome(*cpu_once(partial(engines.run, made, **options)))

    def methods(self, quick: bool) -> Iterator[Method]:
        """Yield every engine and setting."""
        many = random_plan(self.work, _MANY, "event", **EFFECTS)
        bare = random_plan(self.work, _MANY, "closed")
        yield Method("closed, effects out", "none of 8 in", partial(self.plain, bare))
        for budget in BUDGETS_LSB[1::2] if quick else BUDGETS_LSB:
            made = plan.make(many.scene, None, AutoTable(budget_lsb=budget))
            text = f"budget {budget:g} LSB, {made.engine}"
            yield Method("auto, by budget", text, partial(self.plain, made))
        yield Method("event", "8 of 8 in", partial(self.plain, many))
        for simulator, some in (("verilator", many), ("icarus", many.part(0, 2))):
            run = partial(self.simulated, replace(some, engine="rtl"), simulator=simulator)
            yield Method(f"rtl, {simulator}", "8 of 8 in", run, slow=True)
        one, every = replace(many.part(0, 1), engine="cosim"), list(SOLVERS.items())
        for simulator, some in (("icarus", every[:1]), ("verilator", every[:1] if quick else every)):
            for words, solver in some:
                run = partial(self.simulated, one, simulator=simulator, solver=solver)
                yield Method(f"cosim, {simulator}", f"8 of 8 in, {words}", run, slow=True)
