# SPDX-License-Identifier: Apache-2.0
"""The closed engine: one array solve a frame and the exact pulse-count formula."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dermis import fields
from dermis.array.array import column_currents
from dermis.converter import injection
from dermis.converter.vfc import W_PRESET, code, code_type
from dermis.engines import Result
from dermis.errors import InputError
from dermis.records import Plan

_NOT = {"q_mirror_c", "g_in_s"}
HONOURS = fields.of("array", "lines", "mirror", "packet") - _NOT | {"i_offset_a", "v_comp_offset_v"}

# Frames solved at once: 128 of 16x16 keep the elimination inside a 1 MB cache.
_VALUES_AT_ONCE = 1 << 15


def refuses(plan: Plan) -> InputError | None:
    """Return the error for lines that have not settled when a gate opens, or None."""
    try:
        injection.check_lines(plan)
    except InputError as error:
        return error
    return None


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan; `progress` is called with the number of row slots done so far.

    Returns codes [frames, rows, cols]; info["x"] is the duty that they count.
    """
    injection.check_lines(plan)
    base = plan.network(0)
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(plan.timing.code_max))
    x = np.empty(plan.resistance_ohm.shape)
    for part in plan.parts(_VALUES_AT_ONCE):
        x[part] = plan.converter.duty(column_currents(base, plan.conductance_s(part)))
        codes[part] = codes_of(plan, x[part])
        if progress is not None:
            progress(part.stop * plan.rows)
    return Result(codes, {"x": x})


def codes_of(plan: Plan, x: NDArray[np.float64]) -> NDArray[np.unsignedinteger]:
    """Codes of duties x [frames, rows, cols] by the formula."""
    c, timing = plan.converter, plan.timing
    w0, threshold = W_PRESET + c.preset_error_v / c.packet_v(), c.v_comp_offset_v / c.packet_v()
    start = {"w0": w0, "packet": 1.0 + c.packet_error, "threshold": threshold}
    return code(x, timing.gate_clocks, timing.code_max, **start).astype(code_type(timing.code_max))
