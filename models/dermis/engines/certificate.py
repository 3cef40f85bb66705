# SPDX-License-Identifier: Apache-2.0
"""Certified codes: a run again with its levels moved either way by as much as a decision may be off
(docs/auto.md).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from dermis import engines
from dermis.bounds import SLOW_CLOCKS
from dermis.converter import currents
from dermis.engines import Result, closed, event, filter
from dermis.processes import cpu_time
from dermis.records import Plan


def certified(plan: Plan, result: Result) -> tuple[NDArray[np.unsignedinteger], NDArray[np.unsignedinteger]]:
    """Return the bounds of the chip's codes: the plan without noise, with its levels moved by the
    margin both ways.
    """
    margin = filter.random_margin(plan) if plan.margin_lsb is None else plan.margin_lsb
    margin = np.broadcast_to(margin, plan.resistance_ohm.shape)
    result.info["margin_lsb"] = float(np.max(margin))
    if not margin.any():
        return result.codes, result.codes
    # Beyond this the level may be anywhere a gate of any code takes the charge, and a run at such a level says nothing:
    # a duty above 1/2 brings more than a packet every second clock and would still be seen to reach it. Nor does one
    # where counts do not follow the order of levels.
    slow = plan.converter.t_gbw_s * plan.converter.f_clk_hz > SLOW_CLOCKS
    unbounded = (margin > 2.0 * plan.timing.code_max) | (slow & (margin > 0))
    margin = np.where(unbounded, 0.0, margin)
    silent = dataclasses.replace(plan.converter, **dict.fromkeys(event.RANDOM, 0.0))
    steady = _steady(plan)
    x = result.info.get("x") if plan.engine == "closed" or steady else None
    ends = []
    for sign in (1.0, -1.0):
        end = dataclasses.replace(
            plan, converter=silent, moved_lsb=sign * margin, margin_lsb=0.0, engine="event"
        )
        if not engines.refused(end, "closed"):
            end = dataclasses.replace(end, engine="closed")
        if x is None:
            run = engines.run(end)
            x = run.info.get("x") if end.engine == "closed" or steady else None
            ends.append(run.codes)
        elif end.engine == "closed":
            ends.append(closed.codes_of(end, x))
        else:
            ends.append(event.codes_of(end, x))
    low, high = ends
    return np.where(unbounded, low.dtype.type(0), low), np.where(
        unbounded, low.dtype.type(plan.timing.code_max), high
    )


def _steady(plan: Plan) -> bool:
    """Return True if the duty is constant over the gate and independent of the converters, so that
    it can be reused.
    """
    return not plan.active_fields() & currents.FIELDS and plan.topology != "direct"


def certify(plan: Plan, result: Result) -> Result:
    """Fill in the lower and upper codes of a run: two more runs where something is random or left
    out.

    info["certify_cpu_s"] is the processor time that they took.
    """
    if result.low is None or result.high is None:
        begin = cpu_time.cpu_used_s()
        result.low, result.high = certified(plan, result)
        result.info["certify_cpu_s"] = cpu_time.cpu_used_s() - begin
    return result
