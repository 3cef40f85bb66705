# SPDX-License-Identifier: Apache-2.0
"""Rows that engine cosim has to solve in a scene with auto; the chip's own ROW_MASK leaves out the others.

A cell is decided if the filter of `auto` decides it with its bounds widened by what levels of
ngspice may differ, or if engine event gives the same code with its levels moved up and down by as
much. A row of decided cells needs no circuit simulator (docs/auto.md).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dermis import bounds, engines
from dermis.array.network import Network
from dermis.converter.vfc import Y_MIN, code_type
from dermis.ndarrays import Bools, Floats
from dermis.records import Plan

APART_LSB = 0.01
"""Packets by which levels of ngspice and engine event may differ: thrice what was measured (docs/cosimulation.md)."""

FORGOTTEN_LSB = 1e-3
"""Packets of an earlier row that may be left in an open cell: other steps of ngspice move a level as much."""

ROUNDING_LSB = 1e-4
"""Packets of rounding and approximation: 1e-9 of a current, 5e-5 packets in a course with motion."""

_SWITCHED_LSB = (
    4.0  # packets by which an integrator's output may be away from its preset when the preset begins
)
_FULL = 1e3  # duty that stands for any larger one


class Block(NamedTuple):
    """Adjacent rows of a frame of a plan, read in one scan."""

    frame: int
    rows: range


@dataclass(frozen=True)
class Verdict:
    """Codes [frames, rows, cols] of engine event, cells that stay open, and blocks of rows to be solved.

    `early` counts rows that are solved only because a later open row remembers them. `reason` says
    why all rows are solved; it is empty otherwise.
    """

    codes: NDArray[np.unsignedinteger]
    open: Bools
    blocks: tuple[Block, ...]
    early: int = 0
    reason: str = ""

    def with_solved(self, read: Iterable[NDArray[Any]]) -> NDArray[np.unsignedinteger] | None:
        """Codes with those of open rows from `read` [cols], row after row of the blocks.

        None if ngspice read a decided cell otherwise: then levels differ by more than APART_LSB.
        """
        codes, found = self.codes.copy(), self.codes.copy()
        cells = [(block.frame, row) for block in self.blocks for row in block.rows]
        for place, line in zip(cells, read, strict=True):
            found[place] = line
        rows = self.open.any(axis=2)
        codes[rows] = found[rows]
        return None if (codes != self.codes)[~self.open].any() else codes

    def as_dict(self, first_frame: int) -> dict[str, Any]:
        """The table for summary.json; rows are named by the frames of the whole run."""
        solved = sum(len(block.rows) for block in self.blocks)
        rows: dict[str, list[str]] = {}
        for block in self.blocks:
            last = f"-{block.rows[-1]}" if len(block.rows) > 1 else ""
            rows.setdefault(f"frame {first_frame + block.frame}", []).append(f"{block.rows[0]}{last}")
        return {
            "rows_solved": solved,
            "rows_masked": self.codes.shape[0] * self.codes.shape[1] - solved,
            "rows_before": self.early,
            "cells_open": int(self.open.sum()),
            "reason": self.reason,
            "rows": {frame: ", ".join(names) for frame, names in rows.items()},
        }


def everything(plan: Plan, reason: str = "") -> Verdict:
    """Return the verdict that every row has to be solved."""
    blocks = tuple(Block(frame, range(plan.rows)) for frame in range(plan.frames))
    codes = np.zeros(plan.resistance_ohm.shape, code_type(plan.timing.code_max))
    return Verdict(codes, np.ones(codes.shape, bool), blocks, reason=reason)


def decide(plan: Plan) -> Verdict:
    """Find the rows of a plan of engine cosim that have to be solved."""
    # Compiled: a run without auto does not load numba, 0.4 s in each of its processes.
    from dermis.converter import injection
    from dermis.engines import event, filter

    like = replace(plan, engine="event", auto=None)
    if plan.views.in_transistors(plan.topology):
        return everything(plan, "blocks of transistors have no error bounds")
    if lost := engines.refused(like, "event"):
        return everything(plan, f"engine event cannot do {', '.join(sorted(lost))}")
    if error := engines.refuses(like, "event"):
        return everything(plan, f"engine event refuses {error.key}")
    if reason := filter.undecidable(like):
        return everything(plan, reason)
    c = plan.converter
    lag = c.t_gbw_s * c.f_clk_hz
    settle = plan.timing.settle_clocks - plan.timing.break_clocks
    with np.errstate(divide="ignore"):
        slow = _SWITCHED_LSB * np.exp(-settle / lag) > FORGOTTEN_LSB
    apart = APART_LSB + sum(injection.counts(plan).values())
    unbounded = slow | (lag > bounds.SLOW_CLOCKS)
    codes, open_ = filter.decide(like, np.where(unbounded, np.inf, apart))
    if open_.any() and not unbounded.all():
        # Levels move codes in order but for the comparator's window and for what is late of a packet.
        delay = c.t_comp_delay_s * c.f_clk_hz + lag
        late = c.v_hysteresis_v / c.packet_v() + delay * (1.0 + c.packet_error)
        offset_v = (apart + ROUNDING_LSB + late) * c.packet_v()
        moved = (replace(c, v_comp_offset_v=c.v_comp_offset_v + v) for v in (offset_v, -offset_v))
        low, high = (event.run(replace(like, converter=converter)).codes for converter in moved)
        open_ &= unbounded | (low != high)
    return Verdict(codes, open_, *_blocks(open_, _memory(plan, open_)))


def _blocks(open_: Bools, memory: NDArray[np.intp]) -> tuple[tuple[Block, ...], int]:
    """Return blocks that hold every open row and the rows that it remembers, and the number of the latter."""
    wanted = open_.any(axis=2)
    solved = wanted.copy()
    for frame, row in zip(*np.nonzero(wanted), strict=True):
        solved[frame, row - memory[frame, row] : row] = True
    edges = np.diff(np.pad(solved, ((0, 0), (1, 1))).astype(int), axis=1)
    begins, ends = np.argwhere(edges > 0), np.argwhere(edges < 0)
    blocks = [Block(int(f), range(r, end)) for (f, r), (_, end) in zip(begins, ends, strict=True)]
    return tuple(blocks), int(solved.sum() - wanted.sum())


def _memory(plan: Plan, open_: Bools) -> NDArray[np.intp]:
    """Return the rows before each row [frames, rows] that its open cells remember when their gates begin.

    A block begins at the operating point of its first row, where lines and slow mirrors are
    settled. Row 0 of a whole scan begins so as well.
    """
    depth = np.zeros(open_.shape[:2], dtype=np.intp)
    for frame in np.flatnonzero(open_.any(axis=(1, 2))):
        network, g = plan.network(frame), plan.conductance_s(slice(frame, frame + 1))
        left = _mirrors(plan, network, g)
        kept = np.where(open_[frame], left, 0.0).max(axis=2) > FORGOTTEN_LSB
        # Row 0 needs no row before: the last entry that counts is that of the whole way back.
        depth[frame] = np.minimum(kept.argmin(axis=0), np.arange(plan.rows))
    return depth


def _mirrors(plan: Plan, network: Network, g: Floats) -> Floats:
    """Packets [rows + 1, rows, cols] by which slow mirrors differ, after no, one, ... rows before."""
    c, timing = plan.converter, plan.timing
    left = np.zeros((plan.rows + 1, plan.rows, plan.cols))
    if not c.q_mirror_c.any():
        return left
    from dermis.array.array import column_currents

    kappa = np.maximum(c.q_mirror_c * timing.f_clk_hz / c.i0_a, 1e-15)
    x = np.clip(c.duty(column_currents(network, g))[0] - c.i_offset_a / c.i0_a, Y_MIN, _FULL)

    def later(u: Floats, settled: Floats | float, clocks: int) -> Floats:
        """Return the inverse of an output after some clocks: kappa u' = 1 - x u (docs/auto_proofs.md)."""
        return 1.0 / settled + (u - 1.0 / settled) * np.exp(-settled * clocks / kappa)

    faded = np.exp(-x * (timing.settle_clocks - timing.break_clocks) / kappa)
    faded_slot = np.exp(-x * (timing.slot_clocks - timing.break_clocks) / kappa)
    # Inverses are linear in time: so is their distance from those of a scan that begins, settled, so many rows before.
    u, apart = 1.0 / x[0], np.zeros((plan.rows, plan.cols))
    for row in range(plan.rows):
        if row:
            u = later(u, Y_MIN, timing.break_clocks)
        u = later(u, x[row], timing.settle_clocks - timing.break_clocks)
        left[0, row] = np.expm1(np.abs(np.log(u * x[row])))
        left[1:, row] = apart * faded[row] / u
        u = later(u, x[row], timing.gate_clocks)
        apart = np.concatenate([[np.abs(u - 1.0 / x[row])], apart[:-1] * faded_slot[row]])
    # 2 d covers both signs of log(1 + d) up to d = 0.8.
    return kappa * np.log1p(2.0 * left)
