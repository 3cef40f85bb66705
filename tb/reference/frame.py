# SPDX-License-Identifier: Apache-2.0
"""Codes of a frame with effects in 50 digits: the network by nodal.py, the converter clock by clock.

Slow and obvious on purpose; it shares only the records with the engines.
"""

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from dermis.records import Plan
from tb.reference import nodal

DIGITS = 50

HONOURS = frozenset(
    ("r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm", "gain", "i_offset_a", "packet_error",
     "preset_error_v", "v_comp_offset_v", "t_gbw_s")
)  # fmt: skip
"""Record fields it takes; any other is refused."""


def count(x: mpf, clocks: int, packet: mpf, start: mpf, level: mpf, lag: mpf) -> int:
    """Count ones in a gate; the output v follows the charge w.

    All in packets and clocks, `lag` is the time constant. A one decided at clock n draws its packet
    between the clocks n + 1 and n + 2. This is `converter_walk.walk_reference` without levels that
    lie apart, leaks and limits, and thirty times faster.
    """
    w = v = start
    decay = mp.exp(-1 / lag) if lag else mpf(0)
    ones, last, before = 0, False, False  # decided at this clock and at the one before
    for _ in range(clocks):
        current = x - (packet if before else 0)
        if lag:
            v = w + current * (1 - lag) + (v - w + current * lag) * decay
        w += current
        if not lag:
            v = w
        before, last = last, bool(v >= level) and not last
        ones += last
    return ones


@mp.workdps(DIGITS)
def codes(plan: Plan, number: int = 0) -> NDArray[np.int64]:
    """Return the codes [rows, cols] of a frame of a plan; ValueError if a field is on that is not in HONOURS."""
    if unknown := plan.active_fields() - HONOURS:
        raise ValueError(f"no reference for {', '.join(sorted(unknown))}")
    converter, found = plan.converter, np.zeros((plan.rows, plan.cols), dtype=np.int64)
    f_clk = mpf(converter.f_clk_hz)
    for row in range(plan.rows):
        for c, current in enumerate(nodal.slot_currents(plan.network(number), row)):
            own = {
                name: mpf(float(getattr(converter, name)[c]))
                for name in ("k", "i0_a", "c_int_f", "gain", *HONOURS & set(vars(converter)))
            }
            packet_v = own["i0_a"] / f_clk / own["c_int_f"]
            ones = count(
                (own["gain"] * current / own["k"] + own["i_offset_a"]) / own["i0_a"],
                plan.timing.gate_clocks,
                1 + own["packet_error"],
                mpf(-1) / 2 + own["preset_error_v"] / packet_v,
                own["v_comp_offset_v"] / packet_v,
                own["t_gbw_s"] * f_clk,
            )
            found[row, c] = min(ones, plan.timing.code_max)
    return found
