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
        self._level = np.array(levels, dtype=float)

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to `to` seconds; return w [cols] in packets, high when > 0."""
        preset, begin = self._rows, self._now
        for time, source, level in edges:
            if source == preset and level < self._level[preset]:
                # the preset ends at the start of its falling edge, as the switch in SPICE
                begin, self.w[:] = time, W_PRESET
        area = self._level * (to - begin)
        for time, source, level in edges:
            area[source] += (level - self._level[source]) * (to - time - 0.5 * self._t_edge)
            self._level[source] = level
        self.w += (area[:preset] @ self._x - area[preset + 1 :]) / self._t_clk
        self._now = to
        if self._level[preset] > 0.0:
            self.w[:] = W_PRESET
        # A tie is high: w has summed up to a slot of clocks, each rounded to 1e-12 packet (seconds of 2 ms).
        return np.where(self.w >= -1e-9, 1.0, -1.0)

    def close(self) -> None:
        """Do nothing: there are no resources."""
