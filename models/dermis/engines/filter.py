# SPDX-License-Identifier: Apache-2.0
"""Everything on, at a fraction of the cost: one solve, a verdict a cell, engine event for the open cells alone.

The solved currents give every code and its distance to the next step. Bounds made from the same currents say which
codes can no longer change. The others are counted by engine event with everything on. The codes are those of engine
event, for random numbers depend on the cell alone (docs/auto.md).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import bounds
from dermis.array.array import column_currents
from dermis.bounds import Bound, Bounding, Solved
from dermis.converter import currents, loops, mirror, noise
from dermis.converter.coupling import G_ACROSS_S, couples
from dermis.converter.course import Course
from dermis.converter.vfc import W_PRESET, count
from dermis.effects import EFFECTS, AutoTable
from dermis.engines import Result, code_type, event
from dermis.records import Plan

HONOURS = event.HONOURS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Cells at once, as in engine event.
_VALUES_AT_ONCE = 1 << 14
# Duty beyond which a larger current changes no code: 1/2 is full scale.
_X_CLIP = 0.75
# Duty that replaces any larger one where the charge of a clock counts.
_X_LARGE = 1.0
# Packets that roundings of the two ways to a level may differ by: a sum of 510 clocks, and polynomials of a course.
_ROUNDING = 1e-7
# Rounding and approximation that certified codes allow for: 1e-9 of a current, 5e-5 packets in a course with motion.
ROUNDING_LSB = 1e-4
# Error in packets of a slow mirror's charge that is left of the rows before a chosen cell, and of lines that settle.
_FORGOTTEN = 1e-12
_SETTLED = 1e-10
# Time constants after which a mirror that was anywhere is where it goes, to 1e-17.
_MEMORY = 60.0
# Every n-th cell is sampled for the ratio of bound and shift.
_EACH = 7
# Effects whose bounds need the sum of the others, in this order.
_LAST = ("integrator_bandwidth", "integrator_gain", "integrator_range")


@dataclass
class Tally:
    """Influence of an effect in a run: its largest shift and bound in packets, and the cells walked because of it."""

    caused: float = 0.0
    possible: float = 0.0
    walked: int = 0


@dataclass
class Table:
    """Cells decided from the solved currents, decided once their noise was drawn, and walked; each effect's part."""

    decided: int = 0
    drawn: int = 0
    walked: int = 0
    reason: str = ""
    looseness: list[float] = field(default_factory=list)
    effects: dict[str, Tally] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """The table for summary.json."""
        effects = {n: [_finite(t.caused), _finite(t.possible), t.walked] for n, t in self.effects.items()}
        return {
            "decided": self.decided,
            "level_1": self.drawn,
            "everything": self.walked,
            "reason": self.reason,
            "bound_over_shift": statistics.median(self.looseness or [0.0]),
            "effects": effects,
        }


def _finite(value: float) -> float | str:
    return value if math.isfinite(value) else "none"


def merged(tables: list[dict[str, Any]]) -> dict[str, Any]:
    """The table of several parts of one run."""
    effects: dict[str, list[Any]] = {}
    for table in tables:
        for name, (caused, possible, walked) in table["effects"].items():
            one = effects.setdefault(name, [0.0, 0.0, 0])
            one[0] = max(one[0], caused)
            one[1] = (
                possible
                if isinstance(possible, str)
                else one[1]
                if isinstance(one[1], str)
                else max(one[1], possible)
            )
            one[2] += walked
    sums = {name: sum(t[name] for t in tables) for name in ("decided", "level_1", "everything")}
    looseness = statistics.median(t["bound_over_shift"] for t in tables)
    return sums | {"reason": tables[0]["reason"], "bound_over_shift": looseness, "effects": effects}


def refuses(plan: Plan) -> Any:
    """Return the error of engine event for this plan, or None."""
    return event.refuses(plan)


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan; the codes are those of engine event.

    Returns
    -------
    Result
        codes [frames, rows, cols]; info["filter"] is the table of verdicts.
    """
    if couples(plan):
        result = event.run(plan, progress)
        table = Table(walked=result.codes.size, reason="columns of the direct interface move each other")
        result.info["filter"] = table.as_dict()
        return result
    functions = bounding(plan)
    table = Table(effects={name: Tally() for name in functions})
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(plan.timing.code_max))
    step = max(1, _VALUES_AT_ONCE // (plan.rows * plan.cols))
    for first in range(0, plan.frames, step):
        part = slice(first, min(first + step, plan.frames))
        codes[part] = _Part(plan, part, functions, table).codes()
        if progress is not None:
            progress(part.stop * plan.rows)
    return Result(codes, {"filter": table.as_dict()})


def bounding(plan: Plan) -> dict[str, Bounding]:
    """Bounds of the effects that are on and that engine closed does not honour, in the order they are taken."""
    found = {name: EFFECTS[name].bound for name in plan.on if EFFECTS[name].bound is not bounds.honoured}
    late = {name: found.pop(name) for name in _LAST if name in found}
    return found | late


class _Part:
    """Some frames of a plan: solved, bounded and counted."""

    def __init__(self, plan: Plan, part: slice, functions: dict[str, Bounding], table: Table) -> None:
        self.plan, self.part, self.table = plan, part, table
        self.g = plan.conductance_s(part)
        self.keys = None
        if plan.active_fields() & event.RANDOM:
            self.keys = noise.cell_keys(plan.seed, plan.first_frame + part.start, self.g.shape)
        self.outputs: mirror.Outputs | None = None
        self.phase = np.zeros(self.g.shape[:2])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            self.s = self._solve()
            self.found = self._bound(functions)
            self.quiet = self.s.quiet()

    def _solve(self) -> Solved:
        plan, c, timing, drive = self.plan, self.plan.converter, self.plan.timing, self.plan.drive
        self.ways = ways = currents.course(plan, self.part)
        per_a = c.gain / (c.k * c.i0_a)
        squeeze = c.inv_i_range_a * c.k * c.i0_a / np.maximum(np.abs(c.gain), 1e-30)
        top = 1e9 * c.k * c.i0_a
        follows = np.clip(ways.follows_begin, -top, top)
        rest = np.clip(ways.rest_begin, -top, top)
        moved: Floats | float = 0.0
        apart: Floats | float = 0.0
        if drive.motion:
            ends = [np.clip(i, -top, top) for i in (ways.follows_end, ways.rest_end)]
            bend = 0.0
            if ways.follows_bend is not None:
                bend = np.clip(ways.follows_bend + ways.rest_bend, -top, top)
            spread = np.abs(ends[0] + ends[1] - follows - rest)
            follows, rest = 0.5 * (follows + ends[0]), 0.5 * (rest + ends[1])
            if ways.follows_bend is not None:
                follows = follows + (2.0 / 3.0) * np.clip(ways.follows_bend, -top, top)
                rest = rest + (2.0 / 3.0) * np.clip(ways.rest_bend, -top, top)
            apart = (0.5 * spread + np.abs(bend)) * np.abs(per_a)
            moved = 0.25 * timing.gate_clocks * 2.0 * apart
        u = (follows + rest) * per_a
        bent: Floats | float = 0.0
        slope: Floats | float = 1.0
        swing: Floats | float = 0.0
        if drive.ripple:
            swing = drive.ripple * follows * per_a
            if drive.motion:
                bent = np.abs(drive.ripple) * timing.gate_clocks * apart
        if squeeze.any():
            bent = bent + timing.gate_clocks * squeeze * (np.abs(swing) + apart) ** 2
            slope = 1.0 / (1.0 + squeeze * np.abs(u))
            u = u * slope
            swing = swing * slope * slope
        away = np.abs(swing) + apart
        offset = c.i_offset_a / c.i0_a
        x = u + offset
        low, high = x - away, x + away
        s = Solved(
            network=plan.network(self.part.start),
            converter=c,
            timing=timing,
            x=x,
            low=low,
            high=high,
            g_column_s=np.minimum(self.g, G_ACROSS_S).sum(axis=1, keepdims=True),
            v_v=_largest_v(plan),
            swing=swing,
            swing_bent=bent,
            moved=moved,
            slow_mirror=bool(c.q_mirror_c.any()),
            # Levels away from zero move the range of the charge.
            levels=np.abs(c.v_comp_offset_v + plan.of_frames(plan.moved_lsb, self.part) * c.packet_v())
            / c.packet_v()
            + np.abs(c.preset_error_v) / c.packet_v(),
        )
        if drive.ripple:
            self.phase = currents.phases(plan, self.part)
            omega = 2.0 * math.pi * drive.f_ripple_hz / timing.f_clk_hz
            begin = self.phase[:, :, None] + omega * timing.settle_clocks
            s.swing_sum = (np.cos(begin) - np.cos(begin + omega * timing.gate_clocks)) / omega
            s.swing_reach = min(float(timing.gate_clocks), 2.0 / omega)
        if s.slow_mirror:
            self._follow_mirror(s, u, away, offset)
        if c.inv_gain_dc.any() or c.t_gbw_s.any():
            across = c.g_in_s
            if plan.topology == "direct":
                across = across + s.g_column_s
            s.across = np.minimum(across / c.c_int_f / c.f_clk_hz, 1e12)
            s.leak = s.across * c.inv_gain_dc / (1.0 + c.inv_gain_dc)
        clip = _X_CLIP * np.maximum(s.packet, 1.0)
        s.x = np.clip(s.x, -clip, clip)
        s.low = np.clip(s.low, -_X_LARGE, clip)
        s.high = np.clip(s.high, -_X_LARGE, _X_LARGE)
        return s

    def _follow_mirror(self, s: Solved, u: Floats, away: Floats | float, offset: Floats) -> None:
        """Replace x, low and high by those after slow mirrors, and set the delay of the mirrors."""
        plan, c, timing = self.plan, self.plan.converter, self.plan.timing
        kappa = c.q_mirror_c * timing.f_clk_hz / c.i0_a
        net, dark = s.network, np.zeros((u.shape[0], 1, u.shape[2]))
        if currents.glows(plan):
            # No line is further from the others than the sources of offsets and leaks, whatever is on.
            side = 2.0 * plan.rows * net.g_lateral_row_s
            volts = s.v_v - plan.v_bias_v * (1.0 + abs(plan.drive.ripple))
            amperes = np.abs(net.i_leak_a).sum() + volts * (s.g_column_s + side)
            dark = dark + amperes * np.abs(c.gain) / (c.k * c.i0_a)
        away = np.broadcast_to(np.asarray(away, dtype=float), u.shape)
        pause = timing.break_clocks
        self.outputs = found = mirror.outputs(u, away, dark, kappa, pause, timing.settle_clocks, s.clocks)
        floor = mirror.Y_MIN
        late = kappa * np.log(found.end[0] / found.begin[0])
        known = kappa * np.maximum(
            np.log(found.end[2] / found.end[0] * (found.begin[0] / found.begin[1])),
            np.log(found.end[0] / found.end[1] * (found.begin[2] / found.begin[0])),
        )
        # A mirror gives no negative current.
        known = known + np.where(u - away < floor, s.clocks * np.minimum(away, np.abs(u) + away), 0.0)
        s.late = late
        s.x = np.maximum(u, floor) - late / s.clocks + offset
        s.late_known = known
        s.low = np.minimum(np.maximum(u - away, floor), found.begin[1]) + offset
        s.high = np.maximum(np.maximum(u + away, floor), found.begin[2]) + offset

    def _bound(self, functions: dict[str, Bounding]) -> dict[str, Bound]:
        found = {}
        for name, function in functions.items():
            found[name] = bound = function(self.s)
            most = bound.whole + np.asarray(bound.random)
            self.s.error = self.s.error + most
            if bound.level:
                self.s.levels = self.s.levels + most
        return found

    def error(self) -> Floats:
        """Packets that the level at the decisions of each cell is known to, without random numbers drawn."""
        bounds_ = self.found.values()
        rest, whole = (sum((getattr(b, part) for b in bounds_), 0.0) for part in ("rest", "whole"))
        squares = sum((np.square(b.random) for b in bounds_ if np.any(b.random)), 0.0)
        return np.where(self.quiet, rest, whole) + np.sqrt(squares)

    def codes(self) -> NDArray[np.unsignedinteger]:
        """Codes of these frames."""
        plan, s, full = self.plan, self.s, self.plan.timing.code_max
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            shift = np.where(self.quiet, sum((b.shift for b in self.found.values()), 0.0), 0.0)
            rest = self.error() + _ROUNDING
            start, packet = self._start()
            codes, open_ = self._decide(s.x, shift, rest, start, packet, plan.budget_lsb)
            moved = np.abs(shift - s.late).ravel()[::_EACH]
            if (felt := moved > _ROUNDING).any():
                ratio = np.sort(rest.ravel()[::_EACH][felt] / moved[felt])
                self.table.looseness.append(float(ratio[ratio.size // 2]))
        self._tally()
        cells = np.nonzero(open_)
        self.table.decided += codes.size - cells[0].size
        if cells[0].size and self.keys is not None and plan.active_fields() & event.RANDOM:
            still = self._draw(cells, codes, shift[cells])
            self.table.drawn += cells[0].size - int(still.sum())
            cells = tuple(index[still] for index in cells)
        if cells[0].size:
            self.table.walked += cells[0].size
            self._blame(cells)
            codes[cells] = np.minimum(self._walk(cells), full)
        return codes

    def _start(self) -> tuple[Floats, Floats]:
        """Level above the preset charge that the first packet takes [cols], and the size of a packet [cols]."""
        plan, c, s = self.plan, self.plan.converter, self.s
        low, high = c.range_v() / s.output_v
        begin = np.clip(W_PRESET + c.preset_error_v / c.packet_v(), low, high)
        return (
            c.v_comp_offset_v + plan.of_frames(plan.moved_lsb, self.part) * c.packet_v()
        ) / s.output_v - begin, s.packet

    def _decide(
        self, x: Floats, shift: Floats, rest: Floats, start: Floats, packet: Floats, budget: float
    ) -> tuple[NDArray[np.unsignedinteger], Bools]:
        """Codes, and where they are open; `start`, `packet` as `_start` or one value a cell."""
        timing = self.plan.timing
        known = np.where(np.isfinite(rest), rest, 0.0)
        level = start - shift
        bound = np.stack([level + known, level - known])
        both = np.minimum(count(x, timing.gate_clocks, 0.0, packet, bound), timing.code_max)
        # More than the charge at which x is clipped changes a code only upwards.
        clipped = x >= _X_CLIP * np.maximum(packet, 1.0) * (1.0 - 1e-12)
        open_ = np.where(clipped, both[0] < timing.code_max, both[0] != both[1])
        codes = both[0].astype(code_type(timing.code_max))
        if budget > 0.0:
            middle = np.minimum(count(x, timing.gate_clocks, 0.0, packet, level), timing.code_max)
            within = known <= budget
            codes, open_ = np.where(within, middle, codes).astype(codes.dtype), open_ & ~within
        return codes, open_ | ~np.isfinite(rest)

    def _chosen(
        self, cells: tuple[NDArray[np.intp], ...], depth: NDArray[np.intp] | None = None
    ) -> event.Chosen:
        keys = None if self.keys is None else self.keys[cells]
        still = np.zeros(cells[0].size, dtype=np.intp) if depth is None else depth
        x = np.asarray(self.s.x[cells])
        dark = None if depth is None else self._night(cells)
        if depth is not None and not self.plan.active_fields() & currents.FIELDS - currents.CAPACITANCES:
            x = self._exact_x()[cells]
        output = None if self.outputs is None else self.outputs.end[0]
        return event.Chosen(self.part, self.g, *cells, x, keys, self.ways, dark, self.phase, output, still)

    def _exact_x(self) -> Floats:
        """Duties as engine event takes them where nothing changes within a gate."""
        return self.plan.converter.duty(column_currents(self.plan.network(self.part.start), self.g))

    def _draw(
        self,
        cells: tuple[NDArray[np.intp], ...],
        codes: NDArray[np.unsignedinteger],
        shift: Floats,
    ) -> Bools:
        """Decide open cells with the random numbers of their slots; where they stay open."""
        plan, s = self.plan, self.s
        shape = self.g.shape

        def at(value: Any) -> Floats:
            return np.broadcast_to(np.asarray(value, dtype=float), shape)[cells]

        quiet = self.quiet[cells]
        rest = np.full(cells[0].size, _ROUNDING)
        squares = np.zeros(cells[0].size)
        for bound in self.found.values():
            rest = rest + np.where(quiet, at(bound.rest), at(bound.whole))
            if np.any(bound.random):
                known = bound.random if bound.drawn is None else bound.drawn
                always = bound.random if bound.drawn_whole is None else bound.drawn_whole
                squares = squares + np.where(quiet, at(known), at(always)) ** 2
        rest = rest + np.sqrt(squares)
        chosen = self._chosen(cells)
        drawn, converter = event.cells_chosen(plan, chosen)
        variance = event.path_variance(converter, at(s.g_column_s))
        sigma = event.noise_rows(converter, at(s.x), variance)[loops.SIGMA]
        if sigma.any():
            span = int(noise.span_of(s.clocks))
            path = math.sqrt(span) * noise.normals(chosen.keys, noise.WALK, span) * (s.clocks / span)
            shift = shift + np.where(quiet, sigma * path, 0.0)
        level = 0.5 * (drawn.rise + drawn.fall) - drawn.w0
        with np.errstate(invalid="ignore", over="ignore"):
            codes[cells], still = self._decide(at(s.x), shift, rest, level, drawn.packet, plan.budget_lsb)
        return still

    def _walk(self, cells: tuple[NDArray[np.intp], ...]) -> NDArray[np.int64]:
        """Counts of open cells by engine event."""
        plan, part = self.plan, self.part
        counts = np.empty(cells[0].size, dtype=np.int64)
        slow = self._unsettled_frames(cells[0])
        for frame in slow:
            here = cells[0] == frame
            one = slice(part.start + int(frame), part.start + int(frame) + 1)
            for alike, slots in currents.groups(plan, one):
                found = event.count_frames(plan, alike, slots, self.keys is not None)[0]
                counts[here] = found[0][tuple(index[here] for index in cells[1:])]
        rest = ~np.isin(cells[0], slow)
        if rest.any():
            others = tuple(index[rest] for index in cells)
            counts[rest] = event.count_chosen(plan, self._chosen(others, self._depth(others)))
        return counts

    def _unsettled_frames(self, frames: NDArray[np.intp]) -> list[int]:
        """Frames in which lines that have not settled bring charge that engine event follows."""
        plan = self.plan
        if not plan.active_fields() & currents.CAPACITANCES:
            return []
        brisk = (
            not self.s.slow_mirror
            or bounds.settling_s(self.s.network) * plan.timing.f_clk_hz <= bounds.BRISK_CLOCKS
        )
        if brisk and np.all(np.asarray(bounds.unsettled(self.s)) < _SETTLED):
            return []
        return [int(f) for f in np.unique(frames)]

    def _depth(self, cells: tuple[NDArray[np.intp], ...]) -> NDArray[np.intp]:
        """Rows before each cell whose slow mirror its own still remembers."""
        frame, row, col = cells
        depth = np.zeros(row.size, dtype=np.intp)
        if self.outputs is None:
            return depth
        found = self.outputs
        known = np.log(found.end[2] / found.end[1]) + 1e-9
        left = found.keeps_begin[cells]
        for back in range(self.plan.rows):
            before = np.maximum(row - back - 1, 0)
            more = (row > back) & (depth == back) & (left * known[frame, before, col] > _FORGOTTEN)
            if not more.any():
                break
            depth[more] += 1
            left = left * found.keeps[frame, before, col]
        return depth

    def _night(self, cells: tuple[NDArray[np.intp], ...]) -> Course | None:
        """Currents while no row is driven, where the gates of chosen cells still remember them."""
        if self.outputs is None or not currents.glows(self.plan):
            return None
        slow = self.plan.converter.q_mirror_c * self.plan.timing.f_clk_hz / self.plan.converter.i0_a
        settle = self.plan.timing.settle_clocks - self.plan.timing.break_clocks
        least = np.maximum(self.s.low - self.plan.converter.i_offset_a / self.plan.converter.i0_a, 0.0)[cells]
        if np.all(least * settle > _MEMORY * slow[cells[2]]):
            return None
        return currents.course(self.plan, self.part, dark=True)

    def _tally(self) -> None:
        for name, bound in self.found.items():
            tally = self.table.effects[name]
            tally.caused = max(tally.caused, float(np.max(np.abs(bound.shift))))
            tally.possible = max(tally.possible, float(np.max(bound.whole + np.asarray(bound.random))))

    def _blame(self, cells: tuple[NDArray[np.intp], ...]) -> None:
        """Count each walked cell for the effect whose bound is the largest there."""
        shape, quiet, names = self.g.shape, self.quiet[cells], list(self.found)
        if not names:
            return
        parts = []
        for bound in self.found.values():
            rest, whole = (
                np.broadcast_to(np.asarray(v + np.asarray(bound.random), dtype=float), shape)[cells]
                for v in (bound.rest, bound.whole)
            )
            parts.append(np.where(quiet, rest, whole))
        for index, many in zip(*np.unique(np.argmax(parts, axis=0), return_counts=True), strict=True):
            self.table.effects[names[index]].walked += int(many)


def largest(plan: Plan) -> dict[str, float]:
    """Largest error in packets that each effect of a plan may cause in engine closed, 0 where that honours it."""
    functions = bounding(plan)
    part = _Part(plan, slice(0, plan.frames), functions, Table())
    found = {name: float(np.max(b.whole + np.asarray(b.random))) for name, b in part.found.items()}
    return dict.fromkeys(plan.on, 0.0) | found


def random_margin(plan: Plan, more_lsb: Floats | float = 0.0) -> Floats:
    """Packets [frames, rows, cols] by which other random numbers, and the budget, may move decisions.

    Hysteresis, a late comparator and a slow output keep a decision's own order only to their own size, which is added.
    `more_lsb` adds packets, one number or [frames, rows, cols], by which levels may be off for another reason.
    """
    margin = np.zeros(plan.resistance_ohm.shape)
    sigma = (plan.scene.table.effects.auto or AutoTable()).sigma
    names = [name for name in bounding(plan) if EFFECTS[name].random]
    if not names and not plan.budget_lsb and not np.any(more_lsb):
        return margin
    step = max(1, _VALUES_AT_ONCE // (plan.rows * plan.cols))
    for first in range(0, plan.frames, step):
        frames = slice(first, min(first + step, plan.frames))
        part = _Part(plan, frames, bounding(plan), Table())
        s, squares, linear = part.s, np.zeros(part.g.shape), part.error()
        # Cells with a larger error are walked.
        linear = np.where(linear <= plan.budget_lsb, linear, 0.0) + plan.of_frames(more_lsb, frames)
        for name in names:
            linear = linear + part.found[name].whole
            squares = squares + (np.asarray(part.found[name].random) * (sigma / bounds.SIGMAS)) ** 2
        window = s.converter.v_hysteresis_v / s.output_v
        kept = window + np.where(part.quiet, 0.0, (s.delay + s.lag) * s.packet)
        cells = linear + np.sqrt(squares)
        cells = np.where(cells > 0, cells + kept + ROUNDING_LSB, 0.0)
        margin[frames] = np.nan_to_num(cells, nan=np.inf)
    return margin


def _largest_v(plan: Plan) -> float:
    """Largest voltage between any two sources, with those that leaks make."""
    net = plan.network(0)
    offset, lift = net.v_column_offset_v, net.r_column_ohm * net.i_leak_a
    ranges = [max(float(v.max()), 0.0) - min(float(v.min()), 0.0) for v in (offset, lift)]
    return plan.v_bias_v * (1.0 + abs(plan.drive.ripple)) + sum(ranges)
