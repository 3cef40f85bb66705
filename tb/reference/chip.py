# SPDX-License-Identifier: Apache-2.0
"""The analog half of the chip in plain Python: charge balance in integers, and the synchronizer.

Written from the paper, without looking at the RTL. A duty x is a pair of integers (p, q) for p/q
packets a clock. The converter is ``q[n] = (w >= 0) and not q[n-1]; w += x - q[n]``, preset to
w = -1/2 at t0, so that w at t1 is -1/2 + x.
"""

from collections.abc import Sequence
from math import lcm
from typing import Any

Duty = tuple[int, int]

# A short circuit has no finite duty; a million packets a clock saturates any gate in use.
SHORT: Duty = (10**6, 1)


class Synchronizer:
    """The two flip-flops of a column: a decision gates a packet one clock later, never twice in a row.

    `bit` and `charge` are the outputs of the first and the second one: bool, or an array, one a column.
    """

    def __init__(self, bit: Any = False) -> None:
        self.bit = self.charge = bit

    def clock(self, comparator: Any) -> Any:
        """Apply a rising clock edge and return the new decision."""
        self.bit, self.charge = comparator > self.bit, self.bit  # a > b of booleans: a and not b
        return self.bit


def ones(x: Duty, gate_clocks: int, w_preset: Duty = (-1, 2)) -> list[int]:
    """Return the decisions of one gate, by the recursion itself, from a charge `w_preset` in packets."""
    packet = lcm(x[1], w_preset[1])
    step = x[0] * (packet // x[1])
    w = w_preset[0] * (packet // w_preset[1]) + step
    decisions: list[int] = []
    flops = Synchronizer()
    for _ in range(gate_clocks):
        decisions.append(int(flops.clock(w >= 0)))
        w += step - decisions[-1] * packet
    return decisions


def count(x: Duty, gate_clocks: int, count_bits: int, w_preset: Duty = (-1, 2)) -> int:
    """Counter of one taxel: the ones of the gate, saturated at its width."""
    return min(2**count_bits - 1, sum(ones(x, gate_clocks, w_preset)))


FULL_SCALE: Duty = (1, 2)


class AnalogColumns:
    """Ideal integrators and comparators of all columns in integers, advanced half a clock at a time.

    The flip-flop + latch form moves its charge edge at the falling clock edge.

    Parameters
    ----------
    x : duties [rows][cols]
    w_preset : charge [cols] that the preset forces, in packets; -1/2 by default
    open_columns : columns whose currents do not arrive
    shorted_columns : pairs of columns that share their currents equally
    """

    def __init__(
        self,
        x: Sequence[Sequence[Duty]],
        w_preset: Sequence[Duty] | None = None,
        open_columns: Sequence[int] = (),
        shorted_columns: Sequence[tuple[int, int]] = (),
    ) -> None:
        preset = list(w_preset) if w_preset is not None else [(-1, 2)] * len(x[0])
        # A factor of two for half clocks, and one for currents that halve in shorted columns.
        packet = 4 * lcm(FULL_SCALE[1], *(q for duties in (*x, preset) for _, q in duties))
        self.half_packet = packet // 2
        self.half_full = FULL_SCALE[0] * (self.half_packet // FULL_SCALE[1])
        self.half_step = [[p * (self.half_packet // q) for p, q in row] for row in x]
        self.preset = [p * (packet // q) for p, q in preset]
        self.open_columns = list(open_columns)
        self.shorted_columns = list(shorted_columns)
        self.w = list(self.preset)

    def half_clock(self, row_select: int, preset: int, charge: int, test_current: int = 0) -> None:
        """Advance half a clock with switches as bit vectors; driven rows add their currents."""
        if preset:
            self.w = list(self.preset)
            return
        step = [self.half_full * (test_current >> c & 1) for c in range(len(self.w))]
        for r, own in enumerate(self.half_step):
            if row_select >> r & 1:
                step = [a + b for a, b in zip(step, own, strict=True)]
        for a, b in self.shorted_columns:
            step[a] = step[b] = (step[a] + step[b]) // 2
        for c in self.open_columns:
            step[c] = 0
        drawn = (self.half_packet * (charge >> c & 1) for c in range(len(self.w)))
        self.w = [w + i - out for w, i, out in zip(self.w, step, drawn, strict=True)]

    def comparators(self) -> int:
        """Comparator levels as a bit vector, column 0 in bit 0."""
        return sum((w >= 0) << c for c, w in enumerate(self.w))
