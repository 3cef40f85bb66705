# SPDX-License-Identifier: Apache-2.0
"""Reads plans without the Verilog, in one process after the other.

A deck costs milliseconds to start this way instead of the two seconds of an HDL simulator, so that
every effect can have one. `test_a_deck_reads_the_same_without_the_verilog` ties this chip to the
real one.
"""

from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist
from dermis.lockstep.ngspice import Deck
from dermis.records import Plan
from tb.reference.deck_chip import levels_of, read_deck


def read_plan(plan: Plan, log: Path) -> NDArray[np.int64]:
    """Return the codes [frames, rows, cols] of a plan."""
    decks = (netlist.frame_deck(plan, frame, levels_of(plan)) for frame in range(plan.frames))
    return np.array([read_deck(deck, plan.timing, plan.cols, log) for deck in decks])


class DeckReader:
    """Reads plan after plan in a process of its own; ngspice keeps its circuit in global variables."""

    def __init__(self, executor: Executor, work: Path) -> None:
        self._executor, self._log = executor, work / "ngspice.log"

    def codes(self, plan: Plan) -> NDArray[np.int64]:
        """Return codes [frames, rows, cols]."""
        return self._executor.submit(read_plan, plan, self._log).result()

    def deck(self, deck: Deck, plan: Plan) -> NDArray[np.int64]:
        """Codes [rows, cols] of a deck written otherwise than a plan's own."""
        return self._executor.submit(read_deck, deck, plan.timing, plan.cols, self._log).result()
