# SPDX-License-Identifier: Apache-2.0
"""The event engine: the charge balance of every taxel clock by clock, exact between clocks, no time step."""

from collections.abc import Callable

import numpy as np

from dermis import fields
from dermis.converter import course, injection, walk
from dermis.converter.coupling import couples
from dermis.converter.vfc import LONGEST_GATE, code_type
from dermis.engines import Result
from dermis.errors import InputError
from dermis.records import Plan

# Uncertainty in LSB up to which charge injected by capacitances is accepted.
_DISPLACED = 1.0

HONOURS = fields.of(*fields.FAMILIES)
"""Record fields that this engine simulates; a field that is not named here is refused."""

# Cells in numpy's hands at once; their arrays stay in a 1 MB cache.
_VALUES_AT_ONCE = 1 << 14


def refuses(plan: Plan) -> InputError | None:
    """Return the error for a plan that this engine cannot simulate, or None."""
    return (
        _refuses_long_gates(plan) or _refuses_return(plan) or course.refuses(plan) or _refuses_displaced(plan)
    )


def _refuses_long_gates(plan: Plan) -> InputError | None:
    """Refuse gates through which a charge that is summed up clock by clock rounds to a visible part of a packet."""
    clocks, allowed = plan.timing.gate_clocks, f"at most {LONGEST_GATE}, or engine closed"
    long = clocks > LONGEST_GATE
    return InputError(plan.scene.path, "timing.gate_clocks", clocks, allowed) if long else None


def _refuses_return(plan: Plan) -> InputError | None:
    """Refuse a shared return where more than settled currents depend on it: settling, coupled columns."""
    if not plan.network(0).r_return_ohm:
        return None
    active = plan.active_fields()
    asked = {
        "line_capacitance": bool(active & injection.CAPACITANCES),
        "mirror_lag": course.has_idle_current(plan),
    }
    if (name := next((name for name, on in asked.items() if on), couples(plan))) is None:
        return None
    allowed = f"without {name}, or engine cosim"
    return InputError(plan.scene.path, "effects.return", f"on together with {name}", allowed)


def _refuses_displaced(plan: Plan) -> InputError | None:
    if not plan.surrounding.keys() & injection.CAPACITANCES:
        return None
    for name, counts in injection.counts(plan).items():
        if (counts > _DISPLACED).any():
            beside = plan.effects_of_field(name)
            return plan.unsure("line_capacitance", beside, "injected charge that", _DISPLACED, counts.max())
    return None


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan; `progress` is called with the number of row slots done so far.

    Returns codes [frames, rows, cols]; info["x"] is their duty (mean over the gate), info["w_end"] the charge at the
    end of the gate in packets.

    InputError for the direct interface with finite gain and impedances that couple its columns too strongly.
    """
    shape = plan.resistance_ohm.shape
    codes = np.empty(shape, dtype=code_type(plan.timing.code_max))
    x, w_end = np.empty(shape), np.empty(shape)
    timing = plan.timing
    random = bool(plan.active_fields() & walk.RANDOM)
    injection.check_lines(plan)
    for part in plan.parts(_VALUES_AT_ONCE):
        counts, x[part], w_end[part] = walk.count_frames(plan, part, random)
        codes[part] = np.minimum(counts, timing.code_max)
        if progress is not None:
            progress(part.stop * plan.rows)
    return Result(codes, {"x": x, "w_end": w_end})
