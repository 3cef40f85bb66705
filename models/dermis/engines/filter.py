# SPDX-License-Identifier: Apache-2.0
"""Everything on, at a fraction of the cost: one solve, a verdict a cell, engine event for the open cells alone.

The solved currents give every code and its distance to the next step. Bounds made from the same currents say which
codes can no longer change. The others are counted by engine event with everything on. The codes are those of engine
event, for random numbers depend on the cell alone (docs/auto.md).
"""

import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import bounds
from dermis.bounds import Bounding
from dermis.converter import course, injection, noise, walk
from dermis.converter import decide as loops
from dermis.converter.coupling import columns_in_gates, couples, on_columns
from dermis.converter.vfc import code_type
from dermis.effects import EFFECTS
from dermis.engines import Result, event
from dermis.ndarrays import Bools, Floats
from dermis.records import Plan

HONOURS, refuses = event.HONOURS, event.refuses

Cells = tuple[NDArray[np.intp], ...]

_VALUES_AT_ONCE = 1 << 15  # cells: what they need stays in a cache
_MEMORY = 60.0  # time constants after which a mirror that was anywhere is where it goes, to 1e-17


@dataclass
class Table:
    """Cells decided from the solved currents, decided once their noise was drawn, and walked; each effect's part.

    `tally` [bounds.COUNT, 4] is that of `decide.decide_cells`, `blamed` [bounds.COUNT] counts walked cells by the
    effect with the largest bound.
    """

    functions: dict[str, Bounding] = field(default_factory=dict)
    decided: int = 0
    drawn: int = 0
    walked: int = 0
    reason: str = ""
    looseness: list[float] = field(default_factory=list)
    tally: Floats = field(default_factory=lambda: np.zeros((bounds.COUNT, 4)))
    blamed: NDArray[np.intp] = field(default_factory=lambda: np.zeros(bounds.COUNT, dtype=np.intp))

    def as_dict(self) -> dict[str, Any]:
        """The table for summary.json: of each effect the largest shift, the largest error and its walked cells."""
        tally, blamed = self.tally.tolist(), self.blamed.tolist()
        return {
            "decided": self.decided,
            "level_1": self.drawn,
            "everything": self.walked,
            "reason": self.reason,
            "bound_over_shift": statistics.median(self.looseness or [0.0]),
            "effects": {
                name: [*map(_finite, tally[bound.number][:2]), blamed[bound.number]]
                for name, bound in self.functions.items()
            },
        }


def _finite(value: float) -> float | str:
    return value if math.isfinite(value) else "none"


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan; the codes are those of engine event.

    Returns codes [frames, rows, cols]; info["filter"] is the table of verdicts.
    """
    if reason := undecidable(plan):
        result = event.run(plan, progress)
        result.info["filter"] = Table(walked=result.codes.size, reason=reason).as_dict()
        return result
    injection.check_lines(plan)
    table = Table(bounding(plan))
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(plan.timing.code_max))
    for part in plan.parts(_VALUES_AT_ONCE):
        codes[part] = _Part(plan, part, table).codes()
        if progress is not None:
            progress(part.stop * plan.rows)
    return Result(codes, {"filter": table.as_dict()})


def undecidable(plan: Plan) -> str:
    """Return the reason why no cell of a plan has a verdict, or an empty string."""
    return "columns of the direct interface move each other" if couples(plan) else ""


def decide(plan: Plan, apart_lsb: Floats) -> tuple[NDArray[np.unsignedinteger], Bools]:
    """Return the codes of `run`, and the cells that are open where levels may be off by `apart_lsb` [cols] packets."""
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(plan.timing.code_max))
    open_ = np.empty(codes.shape, dtype=bool)
    for frames in plan.parts(_VALUES_AT_ONCE):
        part = _Part(plan, frames, Table(bounding(plan)), apart_lsb)
        codes[frames], open_[frames] = part.codes(), part.s.open
    return codes, open_


def bounding(plan: Plan) -> dict[str, Bounding]:
    """Bounds of the effects that are on and that engine closed does not honour."""
    return {name: b for name in plan.on if (b := EFFECTS[name].bound) is not bounds.honoured}


class _Part:
    """Some frames of a plan: solved, bounded and counted."""

    def __init__(self, plan: Plan, part: slice, table: Table, apart_lsb: Floats | float = 0.0) -> None:
        self.plan, self.part, self.table = plan, part, table
        self.g = plan.conductance_s(part)
        self.active = plan.active_fields()
        self.random = bool(self.active & walk.RANDOM)
        self.slow_mirror = "q_mirror_c" in self.active
        self.g_column_s = columns_in_gates(plan, part).copy()
        self.seed, self.first = np.uint64(plan.seed), plan.first_frame + part.start
        self._solve(np.broadcast_to(apart_lsb, plan.cols).astype(float))

    def _solve(self, apart_lsb: Floats) -> None:
        plan, c, timing, drive = self.plan, self.plan.converter, self.plan.timing, self.plan.drive
        frames, rows, cols = shape = self.g.shape
        self.gate_currents = course.solve_gate(plan, self.part)
        self.phase, swing_sum, reach = course.phases(plan, self.part), np.zeros((frames, rows)), 0.0
        if drive.ripple:
            omega = 2.0 * math.pi * drive.f_ripple_hz / timing.f_clk_hz
            begin = self.phase + omega * timing.settle_clocks
            swing_sum = (np.cos(begin) - np.cos(begin + omega * timing.gate_clocks)) / omega
            reach = min(float(timing.gate_clocks), 2.0 / omega)
        idle, network = np.zeros((frames, cols)), plan.network(0)
        if self.slow_mirror and course.has_idle_current(plan):
            # No line is further from the others than the sources of offsets and leaks, whatever is on.
            side = 2.0 * rows * network.g_lateral_row_s
            most_s = on_columns(self.g)[:, 0]
            if drive.motion:
                most_s = np.maximum(most_s, on_columns(plan.next_conductance_s(self.part))[:, 0])
            amperes = np.abs(network.i_leak_a).sum() + _largest_v(plan) * (most_s + side)
            idle = amperes * np.abs(c.gain) / (c.k * c.i0_a)
            if drive.motion:
                # Straight on from the gate, back to the start of the slot; a bend is at most three times the largest.
                back = timing.settle_clocks / timing.gate_clocks
                idle *= 1.0 + 2.0 * back + 12.0 * back * (1.0 + back)
        self.gate = loops.Gate(
            timing.gate_clocks, timing.settle_clocks, timing.break_clocks, timing.code_max, float(plan.budget_lsb),
            float(drive.ripple), reach, bool(drive.motion),
            self.slow_mirror, plan.topology == "direct", self.random,
        )  # fmt: skip
        on = np.zeros(bounds.COUNT)
        for bound in self.table.functions.values():
            on[bound.number] = bound.factor
        self.columns = bounds.columns(c)
        solved = loops.Run(
            self.gate_currents, self.g_column_s, idle, swing_sum, apart_lsb, self.seed, self.first
        )
        values = np.empty((3, *shape))
        open_, whole = np.empty(shape, dtype=bool), np.empty((2, *shape), dtype=np.int64)
        mirrors = np.empty((6, *shape) if self.slow_mirror else (6, 1, 1, 1))
        self.s = loops.Solved(values[0], mirrors[:2], mirrors[2], mirrors[3:], *values[1:], open_, *whole)
        ratios = np.empty(self.g.size // loops.EACH + 1)
        sampled, self.drawn = loops.decide_cells(
            self.gate, on, self.columns, solved, self.s, self.table.tally, ratios
        )
        if sampled:
            self.table.looseness.append(float(np.sort(ratios[:sampled])[sampled // 2]))

    def codes(self) -> NDArray[np.unsignedinteger]:
        """Codes of these frames."""
        s, full = self.s, self.plan.timing.code_max
        cells = np.nonzero(s.open)
        self.table.decided += s.codes.size - cells[0].size - self.drawn
        self.table.drawn += self.drawn
        if cells[0].size:
            self.table.walked += cells[0].size
            self.table.blamed += np.bincount(s.blame[cells], minlength=bounds.COUNT)
            s.codes[cells] = np.minimum(self._walk(cells), full)
        return s.codes

    def _walk(self, cells: Cells) -> NDArray[np.int64]:
        """Counts of open cells by engine event."""
        plan, depth = self.plan, self._depth(cells)
        # Alike side by side.
        order = np.argsort(2 * depth + (depth == cells[1]), kind="stable")
        cells = tuple(index[order] for index in cells)
        converter, x, blocks = walk.columns_of(plan.converter, cells[2]), np.zeros(order.size), None
        if self.active & course.FIELDS:
            output = self.s.end[0] if self.slow_mirror else None
            given = self.gate_currents, self._idle_course(cells), self.phase, output
            blocks = course.charges_of(plan, *given, cells, depth[order])
        else:
            # As engine event takes them where nothing changes within a gate.
            x = converter.duty(self.gate_currents[0, 0][cells] + self.gate_currents[1, 0][cells])
        keys = noise.chosen_keys(plan.seed, self.first, cells) if self.random else None
        counts = np.empty(order.size, dtype=np.int64)
        counts[order], *_ = walk.count(plan, converter, x, self.g_column_s[cells], keys, blocks)
        return counts

    def _depth(self, cells: Cells) -> NDArray[np.intp]:
        """Rows before each cell whose slow mirror its own still remembers."""
        depth = np.zeros(cells[0].size, dtype=np.intp)
        if self.slow_mirror:
            mirrors = self.s.passed, self.s.begin, self.s.end
            loops.remembered(self.gate, *mirrors, self.columns[bounds.KAPPA], *cells, depth)
        return depth

    def _idle_course(self, cells: Cells) -> Floats | None:
        """Currents while no row is driven, where the gates of chosen cells still remember them."""
        if not self.slow_mirror or not course.has_idle_current(self.plan):
            return None
        remembers = self.s.passed[(0, *cells)] <= _MEMORY * self.columns[bounds.KAPPA, cells[2]]
        if not remembers.any():
            return None
        return course.idle_currents(self.plan, self.part, self.gate_currents, np.unique(cells[0][remembers]))


def largest(plan: Plan) -> dict[str, float]:
    """Largest error in packets that each effect of a plan may cause in engine closed, 0 where that honours it."""
    table = Table(bounding(plan))
    _Part(plan, slice(0, plan.frames), table)
    found = {name: float(table.tally[bound.number, 1]) for name, bound in table.functions.items()}
    return dict.fromkeys(plan.on, 0.0) | found


def _largest_v(plan: Plan) -> float:
    """Largest voltage between any two sources but drivers, with those that leaks make."""
    net = plan.network(0)
    sources = net.v_column_offset_v.tolist(), (net.r_column_ohm * net.i_leak_a).tolist()
    return sum(max(*v, 0.0) - min(*v, 0.0) for v in sources)
