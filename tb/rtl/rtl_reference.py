# SPDX-License-Identifier: Apache-2.0
"""Exact charge-balance arithmetic in integers: what the RTL must read, written without looking at the RTL.

A duty x is a pair of integers (p, q) for p/q packets a clock. The converter is
``q[n] = (w >= 0) and not q[n-1]; w += x - q[n]``, preset to w = -1/2 at t0, so that w at t1 is -1/2 + x.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import lcm

Duty = tuple[int, int]

# A short circuit has no finite duty; a million packets a clock leaves no doubt at any gate length in use.
SHORT: Duty = (10**6, 1)


def ones(x: Duty, gate_clocks: int, w_preset: Duty = (-1, 2)) -> list[int]:
    """Decisions of one gate, one a clock, by the recursion itself.

    Parameters
    ----------
    x : (int, int)
        Duty p/q, in packets a clock.
    gate_clocks : int
        Number of samples.
    w_preset : (int, int)
        Stored charge at t0, in packets.
    """
    packet = lcm(x[1], w_preset[1])
    step = x[0] * (packet // x[1])
    w = w_preset[0] * (packet // w_preset[1]) + step
    decisions: list[int] = []
    last = 0
    for _ in range(gate_clocks):
        last = int(w >= 0 and not last)
        decisions.append(last)
        w += step - last * packet
    return decisions


def code(x: Duty, gate_clocks: int, code_bits: int, w_preset: Duty = (-1, 2)) -> int:
    """Code of one taxel: the ones of the gate, saturated at full scale."""
    return min(2**code_bits - 1, sum(ones(x, gate_clocks, w_preset)))


def code_closed(x: Duty, gate_clocks: int, code_bits: int) -> int:
    """Code for x <= 1/2 by rounding: floor(N x + 1/2), saturated."""
    p, q = x
    if 2 * p > q:
        raise ValueError("the closed form holds for x <= 1/2")
    return min(2**code_bits - 1, (2 * gate_clocks * p + q) // (2 * q))


def duty_of_resistance(r_ohm: Duty) -> Duty:
    """Duty of a taxel in the paper's design: V_b / (k i0) is 250 ohm, so x = 250 / R."""
    return (250 * r_ohm[1], r_ohm[0])


class AnalogColumns:
    """Ideal integrators and comparators of all columns, advanced half a clock at a time in integers.

    Half clocks, because the flip-flop + latch form moves its charge edge at the falling clock edge.

    Parameters
    ----------
    x : [rows][cols] of (int, int)
        Duty of each taxel.
    w_preset : [cols] of (int, int), optional
        Stored charge the preset forces, in packets; -1/2 by default.
    """

    def __init__(self, x: Sequence[Sequence[Duty]], w_preset: Sequence[Duty] | None = None) -> None:
        cols = len(x[0])
        preset = list(w_preset) if w_preset is not None else [(-1, 2)] * cols
        self.half_packet: list[int] = []
        self.preset: list[int] = []
        self.half_step: list[list[int]] = [[0] * cols for _ in x]
        for c in range(cols):
            packet = 2 * lcm(preset[c][1], *(row[c][1] for row in x))
            self.half_packet.append(packet // 2)
            self.preset.append(preset[c][0] * (packet // preset[c][1]))
            for r, row in enumerate(x):
                self.half_step[r][c] = row[c][0] * (packet // 2 // row[c][1])
        self.rest = [0] * cols
        self.w = list(self.preset)

    def half_clock(self, row_select: int, preset: int, charge: int) -> None:
        """Advance half a clock with the switches as given (bit vectors; at most one row driven)."""
        if preset:
            self.w = list(self.preset)
            return
        step = self.half_step[row_select.bit_length() - 1] if row_select else self.rest
        self.w = [
            w + i - (h if charge >> c & 1 else 0)
            for c, (w, i, h) in enumerate(zip(self.w, step, self.half_packet, strict=True))
        ]

    def comparators(self) -> int:
        """Comparator levels as a bit vector, column 0 in bit 0."""
        return sum((w >= 0) << c for c, w in enumerate(self.w))
