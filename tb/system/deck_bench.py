# SPDX-License-Identifier: Apache-2.0
"""Reads decks without the Verilog: a row scanner and synchronizers in a few lines of Python with
ngspice.

A deck costs milliseconds to start this way instead of the two seconds of an HDL simulator, so that
every effect can have one. `test_a_deck_reads_the_same_without_the_verilog` ties this chip to the
real one.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist
from dermis.chip.bridge import analog_s
from dermis.chip.ngspice import Deck, NgspiceHalf
from dermis.engines import cosim
from dermis.records import Plan, Timing
from tb.reference.chip import Synchronizer


def read_deck(deck: Deck, timing: Timing, cols: int, log: Path) -> NDArray[np.int64]:
    """Return the codes [rows, cols] of one frame's deck."""
    solver = cosim.Solver()
    half = NgspiceHalf(
        deck,
        t_edge_s=solver.t_edge_s,
        t_max_step_s=solver.t_max_step_s,
        t_stop_s=analog_s(timing),
        log=log,
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
    """Every source at a frame's first instant: row 0 driven, preset on, no packet."""
    return [1.0] + [0.0] * (plan.rows - 1) + [1.0] + [0.0] * plan.cols


def read_plan(plan: Plan, log: Path) -> NDArray[np.int64]:
    """Return the codes [frames, rows, cols] of a plan; in a process without a circuit that failed."""
    decks = (netlist.frame_deck(plan, frame, levels_of(plan)) for frame in range(plan.frames))
    return np.array([read_deck(deck, plan.timing, plan.cols, log) for deck in decks])


class DeckReader:
    """One process that reads plan after plan; ngspice keeps its circuit in global variables."""

    def __init__(self, work: Path) -> None:
        self._log = work / "ngspice.log"
        self._pool: ProcessPoolExecutor | None = None

    def codes(self, plan: Plan) -> NDArray[np.int64]:
        """Return codes [frames, rows, cols]; after an error of ngspice the next plan has a new process."""
        return self._in_process(read_plan, plan, self._log)

    def deck(self, deck: Deck, plan: Plan) -> NDArray[np.int64]:
        """Codes [rows, cols] of a deck written otherwise than a plan's own."""
        return self._in_process(read_deck, deck, plan.timing, plan.cols, self._log)

    def _in_process(self, function: Callable[..., Any], *arguments: Any) -> Any:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
        try:
            return self._pool.submit(function, *arguments).result()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the process."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None
