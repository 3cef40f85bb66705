# SPDX-License-Identifier: Apache-2.0
"""Reads plans without the Verilog, in one process after the other.

A deck costs milliseconds to start this way instead of the two seconds of an HDL simulator, so that
every effect can have one. `test_a_deck_reads_the_same_without_the_verilog` ties this chip to the
real one.
"""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist
from dermis.lockstep.ngspice import Deck
from dermis.records import Plan
from tb.reference.deck_chip import levels_of, read_deck


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
