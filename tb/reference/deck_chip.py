# SPDX-License-Identifier: Apache-2.0
"""Reads decks without the Verilog: a row scanner and synchronizers in Python with ngspice."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.chip.bridge import analog_s
from dermis.engines import cosim
from dermis.lockstep import ladder
from dermis.lockstep.ngspice import Deck, NgspiceHalf
from dermis.records import Plan, Timing
from tb.reference.chip import Synchronizer


def read_deck(
    deck: Deck, timing: Timing, cols: int, log: Path, level: ladder.Level = ladder.PLAIN
) -> NDArray[np.int64]:
    """Return the codes [rows, cols] of one frame's deck."""
    solver = cosim.Solver()
    half = NgspiceHalf(
        deck,
        t_edge_s=solver.t_edge_s,
        t_max_step_s=solver.t_max_step_s,
        t_stop_s=analog_s(timing),
        log=log,
        level=level,
    )
    rows, t_clk = timing.rows, 1.0 / timing.f_clk_hz
    counts = np.zeros((rows, cols), dtype=np.int64)
    low = np.zeros(cols, dtype=bool)
    flops = Synchronizer(low)
    edges: list[tuple[float, int, float]] = []
    half.advance(0.0, [])
    # The deck starts where row 0 is driven.
    for clock in range(timing.break_clocks + 1, rows * timing.slot_clocks + 1):
        now = (clock - timing.break_clocks) * t_clk
        comparator = half.advance(now, edges)[:cols] > 0.0
        row, at = divmod(clock - 1, timing.slot_clocks)
        counting = at >= timing.settle_clocks  # the preset has been let go before this edge
        before = flops.charge
        counts[row] += flops.clock(comparator if counting else low)
        changed = np.flatnonzero(flops.charge != before)
        edges = [(now, rows + 1 + int(c), float(flops.charge[c])) for c in changed]
        if at + 1 == timing.settle_clocks:
            edges.append((now, rows, 0.0))
        if at + 1 == timing.slot_clocks:
            edges += [(now, rows, 1.0), (now, row, 0.0)]
            at, row = -1, row + 1
        if at + 1 == timing.break_clocks and 0 < row < rows:
            edges.append((now, row, 1.0))
    half.close()
    return np.minimum(counts, timing.code_max)


def levels_of(plan: Plan) -> list[float]:
    """Return every source at a frame's first instant: row 0 driven, preset on, no packet."""
    return [1.0] + [0.0] * (plan.rows - 1) + [1.0] + [0.0] * plan.cols
