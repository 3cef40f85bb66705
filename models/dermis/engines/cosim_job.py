# SPDX-License-Identifier: Apache-2.0
"""Work of one child process of engine cosim: plain records, so that it loads neither scenes nor compiled loops."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dermis.lockstep.ngspice import Deck
from dermis.timing import Timing

JOB_VARIABLE = "DERMIS_COSIM_JOB"
STATISTICS = ("accepted", "rejected", "loads")
"""Counts of ngspice's time points, and of its evaluations of sources."""


@dataclass(frozen=True)
class Solver:
    """How ngspice steps: edges last t_edge_s, no step is longer than t_max_step_s.

    `options` is an `.options` line after the deck's own; ngspice takes the later of two values.
    """

    t_edge_s: float = 1e-9
    t_max_step_s: float = 1e-6
    options: str = ""


@dataclass(frozen=True)
class Block:
    """Adjacent rows of a frame, read in one scan, with their circuits.

    Attributes
    ----------
    frame : its number in the plan
    rows : numbers of the rows
    decks : decks by the columns that each has (netlist.parts); their levels are those of the chip's pins
    duty : [rows, cols] of the exact half, which has no decks
    """

    frame: int
    rows: range
    decks: Mapping[tuple[int, ...], Deck]
    duty: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Job:
    """Work of one child process; see dermis.engines.cosim_hdl.

    Attributes
    ----------
    timing, cols, sync_latch, record : as in dermis.chip.bridge.Bridge; `record` keeps waveforms
    ranges : range of each column's k, for which the decks are; none for the direct interface
    scans : runs of the chip from a reset: blocks of the same rows, read frame after frame
    solver : step control
    """

    timing: Timing
    cols: int
    ranges: tuple[int, ...]
    scans: tuple[tuple[Block, ...], ...]
    sync_latch: bool
    solver: Solver
    record: bool
