# SPDX-License-Identifier: Apache-2.0
"""An exact analog half without a circuit simulator: ideal converters."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dermis.converter.vfc import W_PRESET
from dermis.lockstep.ngspice import Edge


class ExactHalf:
    """Ideal converters, integrated exactly, driven by the sources of a channel deck.

    Sources are ordered as in dermis.chip.netlist: rows, preset, charge. Charge is counted in
    packets, and an edge is the same linear ramp that ngspice sees, so that the two halves agree to
    the accuracy of ngspice.

    Parameters
    ----------
    duty : x of every taxel, [rows, cols]; infinite is legal
    levels : levels of the sources at time zero
    t_clk_s, t_edge_s : clock period and ramp time in seconds
    """

    def __init__(
        self, duty: NDArray[np.float64], levels: Sequence[float], *, t_clk_s: float, t_edge_s: float
    ) -> None:
        self._x = np.minimum(np.asarray(duty, dtype=float), 1e12)
        self._rows, self._cols = self._x.shape
        self._t_clk, self._t_edge = t_clk_s, t_edge_s
        self._now = 0.0
        self.w = np.full(self._cols, W_PRESET)
        self._row = np.array(levels[: self._rows])
        self._preset = levels[self._rows]
        self._charge = np.array(levels[self._rows + 1 :])

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to `to` seconds; return w [cols] in packets, high when > 0."""
        span = to - self._now
        ramp = 0.5 * self._t_edge
        x = self._row @ self._x if self._row.any() else np.zeros(self._cols)
        d_row = np.zeros(self._rows)
        packets = self._charge * span
        change = np.zeros(self._cols)
        for time, source, level in edges:
            left = to - time - ramp
            if source < self._rows:
                d_row[source] = (level - self._row[source]) * left
                self._row[source] = level
            elif source == self._rows:
                if level < self._preset:
                    self.w[:] = W_PRESET
                    # the preset ends at the start of its falling edge, as the switch in SPICE
                    span = to - time
                self._preset = level
            else:
                c = source - self._rows - 1
                packets[c] += (level - self._charge[c]) * left
                self._charge[c] = level
        if d_row.any():
            change = d_row @ self._x
        self.w += (x * span + change - packets) / self._t_clk
        self._now = to
        if self._preset > 0.0:
            self.w[:] = W_PRESET
        # A tie is high: w has summed up to a slot of clocks, each rounded to 1e-12 packet (seconds of 2 ms).
        return np.where(self.w >= -1e-9, 1.0, -1.0)

    def close(self) -> None:
        """Do nothing: there are no resources."""
