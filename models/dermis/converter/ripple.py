# SPDX-License-Identifier: Apache-2.0
"""Bound of the error that engine event makes by taking the mean of a ripple over each clock (converter.course)."""

import math

import numpy as np

from dermis.converter.vfc import X_INFINITE
from dermis.ndarrays import Floats
from dermis.records import Plan

# Counts by which a course within a clock may move a code beyond what its mean does.
BENT = 1.0
# Counts of a ripple's swing within its clocks, at a duty of 1, below which `refuses` does not solve a frame to ask.
_ASKED = 0.1
# Packets a clock from which on a converter is at full scale whatever it is short of: twice what it takes.
FULL = 1.0


def _within(plan: Plan) -> tuple[float, float]:
    """Of a sine of amplitude 1 and the ripple's frequency: the most that variances within clocks
    sum up to over a gate, and the largest mean over a clock.

    In a clock of angle w around phase p the variance is (1 - sinc w) / 2 + (sinc w - sinc^2 (w /
    2)) sin^2 p, and the sum of cos 2 p over N clocks is at most sin (N w) / sin w.
    """
    clocks, angle = plan.timing.gate_clocks, 2.0 * math.pi * plan.drive.f_ripple_hz / plan.timing.f_clk_hz
    whole, half = math.sin(angle) / angle, math.sin(angle / 2.0) / (angle / 2.0)
    turn = abs(math.sin(angle))
    # So slow a beat has no digits of its own, and all phases of a gate are near one.
    beat = abs(math.sin(clocks * angle)) / turn if clocks * turn > 1.0 else float(clocks)
    return clocks * (1.0 - half**2) / 2.0 + abs(whole - half**2) / 2.0 * beat, abs(half)


def may_bend(plan: Plan) -> bool:
    """Return True if a fast and large ripple meets a non-linear effect, so that `bent` must be evaluated."""
    if not plan.drive.ripple or not bends_courses(plan):
        return False
    clocks = plan.timing.gate_clocks
    return abs(plan.drive.ripple) * math.sqrt(clocks * _within(plan)[0]) > _ASKED


def bends_courses(plan: Plan) -> bool:
    """Return True if the waveform of a current within a clock may move a code beyond its mean."""
    converter = plan.converter
    return bool(converter.inv_i_range_a.any() or converter.q_mirror_c.any() or converter.range_clips())


def bent(plan: Plan, gate_currents: Floats) -> dict[str, Floats]:
    """Return the largest shift of codes [frames, rows, cols] by a ripple's course within clocks,
    beyond its mean, by the field that does it; `gate_currents` of `course.solve_gate`.

    `inv_i_range_a`: s(x) = x / (1 + h |x|) of a mean is not the mean of s. With p = 1 + h x, E[1 /
    p] - 1 / E[p] is E[(p - E p)^2 / p] / (E p)^2: what is missing in a clock is at most h var / ((1
    + h x) (1 + h mean)^2), both x and mean at their lowest in the gate; where x changes its sign, h
    var, since |s''| is 2 h at most.

    `q_mirror_c`: the mirror knows no negative input, and of max(x, 0) the mean is off by half a
    standard deviation at most. That is all: charge that a slow mirror gives is q ln(1 + y / q times
    the integral of exp(charge / q)), so what comes early or late within a clock moves it by no more
    than itself, less than a count wherever one is open. What rows before were off by it may carry
    on.

    `v_int_max_v`: at a limit charge is lost by the highest point of its course. That is an end of
    the clock, as on the straight line, unless the current passes 0 or a packet a clock there, or a
    packet begins within a clock: then it is off by a quarter of what the current changes by within
    a clock at most. Each packet may lose as much again as all else is off.
    """
    converter, ripple, clocks = plan.converter, abs(plan.drive.ripple), plan.timing.gate_clocks
    variance, kept = _within(plan)
    limit_a = X_INFINITE * converter.k * converter.i0_a
    per_a = np.abs(converter.gain) / (converter.k * converter.i0_a)

    def reach(course: Floats) -> tuple[Floats, Floats]:
        finite = np.clip(course, -limit_a, limit_a) * per_a
        ends, bend = finite[:2], finite[2:].sum(axis=0)
        return ends.min(axis=0) + np.minimum(bend, 0.0), ends.max(axis=0) + np.maximum(bend, 0.0)

    follows, rest = map(reach, gate_currents)
    most = np.maximum(np.abs(follows[0]), np.abs(follows[1]))

    def swung(part: float) -> tuple[Floats, Floats]:
        low = np.minimum(follows[0] * (1.0 - part), follows[0] * (1.0 + part)) + rest[0]
        return low, np.maximum(follows[1] * (1.0 - part), follows[1] * (1.0 + part)) + rest[1]

    low, high = swung(ripple)
    mean_low, mean_high = swung(ripple * kept)
    size = 1.0 + converter.packet_error
    least = np.maximum(np.maximum(low, -high), 0.0)
    mean_least = np.maximum(np.maximum(mean_low, -mean_high), 0.0)
    found = {}
    squeeze = np.zeros(plan.cols)
    if converter.gain.all():
        squeeze = converter.inv_i_range_a / per_a
    with np.errstate(over="ignore", under="ignore"):
        if squeeze.any():
            gap = squeeze * variance * (ripple * most) ** 2
            gap = gap / (1.0 + squeeze * least) / (1.0 + squeeze * mean_least) ** 2
            found["inv_i_range_a"] = gap
        slow = converter.q_mirror_c.any()
        if slow:
            cut = 0.5 * math.sqrt(clocks * variance) * ripple * most
            found["q_mirror_c"] = np.where((low < 0.0) & (high > 0.0), cut, 0.0)
            found = {
                name: np.broadcast_to(c.max(axis=1, keepdims=True), c.shape) for name, c in found.items()
            }
        else:
            full = low / (1.0 + squeeze * least) >= FULL * np.maximum(size, 1.0)
            found = {name: np.where(full, 0.0, counts) for name, counts in found.items()}
        if converter.range_clips():
            angle = 2.0 * math.pi * plan.drive.f_ripple_hz / plan.timing.f_clk_hz
            found = {name: counts * (1.0 + (clocks + 1) / 2) for name, counts in found.items()}
            highest = high / (1.0 + squeeze * np.abs(high))
            turns = (low < 0.0) | (highest > size)
            turns = turns | bool(plan.timing.charge_delay_clocks % 1.0)
            if not slow:
                turns = turns & ~full
            lost = clocks * ripple * most * min(angle, 2.0) / 4.0 / (1.0 + squeeze * least)
            found["v_int_max_v"] = np.where(turns, lost, 0.0)
    return {name: np.minimum(counts / size, plan.timing.code_max) for name, counts in found.items()}


def check(plan: Plan, gate_currents: Floats) -> None:
    """Raise InputError where the waveform of a ripple within clocks may move a code by more than 1 LSB."""
    if not bends_courses(plan):
        return
    for name, counts in bent(plan, gate_currents).items():
        if (counts > BENT).any():
            beside, what = plan.effects_of_field(name), "a ripple whose waveform within a clock"
            raise plan.unsure("supply_ripple", beside, what, BENT, counts.max())
