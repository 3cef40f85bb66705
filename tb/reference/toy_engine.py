# SPDX-License-Identifier: Apache-2.0
"""An engine to copy from: the charge balance of ideal converters, clock by clock for all taxels at once.

CONTRIBUTING.md explains it; tb/model/test_engine_contract.py holds it to what every engine owes.
"""

from collections.abc import Callable

import numpy as np

from dermis.array.array import column_currents
from dermis.converter.vfc import code_type
from dermis.engines import Result
from dermis.records import Plan

# Fields of the records that `run` reads. A scene that needs any other is refused before it gets here.
HONOURS = frozenset({"r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm"})


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan.

    Parameters
    ----------
    plan : Plan
        Not changed: its arrays are read-only.
    progress : callable, optional
        Called with the number of row slots done so far, at last with all of them.

    Returns
    -------
    Result
        codes [frames, rows, cols] of `code_type`; info["charge"] is left on the integrators, in packets.
    """
    timing = plan.timing
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(timing.code_max))
    charge = np.empty(plan.resistance_ohm.shape)
    for frame in range(plan.frames):
        network = plan.network(frame)
        x = plan.converter.duty(column_currents(network))
        # Half a packet from the preset, x more in each clock, one less for each pulse.
        w = np.full(x.shape, 0.5)
        count = np.zeros(x.shape, dtype=int)
        for _ in range(timing.gate_clocks):
            w = w + x
            pulse = w >= 1.0
            count += pulse
            w = w - pulse
        codes[frame] = np.minimum(count, timing.code_max)
        charge[frame] = w
        if progress is not None:
            progress((frame + 1) * plan.rows)
    return Result(codes, {"charge": charge})
