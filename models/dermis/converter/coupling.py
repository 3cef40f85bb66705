# SPDX-License-Identifier: Apache-2.0
"""Coupling of the columns of the direct interface through virtual grounds of finite gain.

Charge that stands in an integrator of finite gain lifts its virtual ground, and what the ground
gives way to flows through the array into the others. Engine event lets each column feel the mean of
the others' charge over a gate; what that leaves out is bounded in counts, and refused by name
beyond one (docs/event.md).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from dermis.array.array import Network, between_columns
from dermis.converter.vfc import W_PRESET
from dermis.errors import SimulatorError
from dermis.ndarrays import Bools, Floats
from dermis.records import Plan

# Conductance of a short across a virtual ground: any integrator loses all its charge through it.
G_ACROSS_S = 1e12
# Duty that no neighbour moves back into the range of codes.
_X_SATURATED = 0.6
# LSB to which the coupling of columns must have converged after the last repetition, and at which it has.
_SETTLED = 1.0
_REPEATS = 6
_UNMOVED = 0.01
# Largest part of a change of duties that may return to them unchecked: repetitions multiply a rounding by its powers,
# and some hundred times 1e-16 is far below a count.
_CLOSE = 2.0

# Fields that make the virtual ground of one column see the others.
COUPLING = frozenset(
    "r_row_driven_ohm r_row_grounded_ohm r_column_ohm g_lateral_row_s r_trace_row_ohm r_trace_column_ohm".split()
)


def seen_from_grounds(network: Network, g_frames_s: Floats) -> Floats:
    """Return the conductance matrix between the virtual grounds, as `array.between_columns` defines it."""
    return between_columns(network, np.minimum(g_frames_s, G_ACROSS_S))


def on_columns(g_frames_s: Floats) -> Floats:
    """Return the conductance of all taxels on each column, [frames, 1, cols], with shorts as in `seen_from_grounds`."""
    return np.minimum(g_frames_s, G_ACROSS_S).sum(axis=1, keepdims=True)


class DutyRange(NamedTuple):
    """Range of duties in a gate, `low` and `high` [frames, rows, cols], and the next frame's conductances, or None."""

    low: Floats
    high: Floats
    g_behind: Floats | None


@dataclass(frozen=True, eq=False)
class Coupling:
    """Coupling between the columns of some frames.

    `across_s` [frames, rows or 1, cols]: conductance that a column's own input sees. `x` [frames,
    rows, cols]: packets a clock from the others, each taken at the mean of its charge over the
    gate. `known` [frames, rows, 1]: counts in a gate by which the last repetition moved them, or
    may have, where columns hang so closely together, as by a short, that rounding may move `x` by
    as much, and so may their order; else 0.
    """

    across_s: Floats
    x: Floats
    known: Floats


def couples(plan: Plan) -> bool:
    """Return True if columns of a plan are coupled."""
    active = plan.active_fields()
    return plan.topology == "direct" and bool(active & COUPLING and active & {"inv_gain_dc", "t_gbw_s"})


def coupling(plan: Plan, g: Floats, x: Floats, duty_range: DutyRange | None = None) -> Coupling | None:
    """Return the coupling of frames of duties x [frames, rows, cols], also infinite ones; None if there is none.

    A count hangs on all the charge of a gate, so the mean of the others' charge over the gate is
    what matters. It is that of the count formula's machine at the duty that the coupling leaves,
    found by repetition; a plan where that has not settled to a count, or where what differs from that mean
    could move a code by more, is refused (InputError). `duty_range` is for duties that change within a gate; x is their
    mean then.
    """
    if not couples(plan):
        return None
    most_x = plan.converter.saturating_duty()
    x = np.clip(x, -most_x, most_x)
    low, high = (
        (x, x)
        if duty_range is None
        else (np.clip(v, -most_x, most_x) for v in (duty_range.low, duty_range.high))
    )
    columns = _Columns(plan, g, duty_range)
    settled = columns.settle(x)
    doubts = columns.doubts(settled, x, low, high)
    # Saturated and dark columns keep their codes for any codes of their neighbours.
    full = _X_SATURATED * np.maximum(1.0 + plan.converter.packet_error, 1.0)
    bright = columns.clocks * (settled.left + high - x) + doubts > columns.level - columns.start
    doubt = np.where((low <= full) & bright, doubts, 0.0).max()
    if doubt > _SETTLED:
        active = plan.active_fields()
        names = {name for field in COUPLING & active for name in plan.effects_of_field(field)}
        effect = "integrator_gain" if "inv_gain_dc" in active else "integrator_bandwidth"
        raise plan.unsure(effect, sorted(names), "column coupling that", _SETTLED, doubt)
    return Coupling(columns.across_s, settled.others, columns.known(settled))


class _Settled(NamedTuple):
    """Fixed point of the coupling, [frames, rows, cols] each.

    Packets a clock from the `others`, and one repetition `before`; the duty that it `left`, and the
    `mean` charge over the gate at that duty.
    """

    others: Floats
    before: Floats
    left: Floats
    mean: Floats


class _Columns:
    """Columns of some frames and the links between them, in packets and clocks.

    Parameters
    ----------
    g : taxels, [frames, rows, cols] in siemens
    duty_range : where duties change within a gate, or None
    """

    def __init__(self, plan: Plan, g: Floats, duty_range: DutyRange | None) -> None:
        self._plan, self._converter, self._moves = plan, plan.converter, duty_range is not None
        self.clocks = plan.timing.gate_clocks
        converter, network = plan.converter, plan.network(0)
        a_clock = 1.0 / (converter.c_int_f * converter.f_clk_hz)
        # Packets a clock through 1 S for a packet stored in the integrator, and packets through it for one by
        # which the output moves: with finite bandwidth the virtual ground is off by the slope of the output.
        self._per_clock = a_clock * converter.inv_gain_dc / (1.0 + converter.inv_gain_dc)
        self._per_swing = a_clock * converter.t_gbw_s * converter.f_clk_hz
        matrix = seen_from_grounds(network, g)
        own = np.arange(plan.cols)
        self.across_s = matrix[..., own, own].copy()
        # What a packet a clock more brings back, as long as it sends no packet away.
        slope = 0.5 * self.clocks * self._per_clock + self._per_swing
        self._closely = np.abs(matrix * slope).sum(axis=-1).max(axis=2)[..., np.newaxis] > _CLOSE
        # Counts by which what a column loses to its own taxels changes within the gate.
        self._drift = np.zeros(1)
        links = np.abs(matrix)
        if duty_range is not None and duty_range.g_behind is not None:
            behind = seen_from_grounds(network, duty_range.g_behind)
            # Until the gate is over a virtual ground may be anywhere within a packet.
            self._drift = (
                self.clocks * np.matmul(np.abs(behind - matrix), self._per_clock[:, np.newaxis])[..., 0]
            )
            links = np.maximum(links, np.abs(behind))
        matrix[..., own, own] = links[..., own, own] = 0.0
        shape = (*g.shape, plan.cols)
        self._matrix, self._links = np.broadcast_to(matrix, shape), np.broadcast_to(links, shape)
        # Limits of the charge in packets; infinite where none is reached.
        ends = converter.range_v() * (1.0 + converter.inv_gain_dc) / converter.packet_v()
        self._low, self._high = ends if converter.range_clips() else np.array([[-np.inf], [np.inf]])
        self.start = W_PRESET + converter.preset_error_v / converter.packet_v()
        self._held = np.clip(self.start, self._low, self._high)
        rise_v = converter.v_comp_offset_v + converter.v_hysteresis_v / 2
        self.level = rise_v * (1.0 + converter.inv_gain_dc) / converter.packet_v()
        self._most_ones = (self.clocks + 1) / 2

    def settle(self, x: Floats) -> _Settled:
        """Repeat until duties x no longer move each other.

        A frame that no longer moves is left as it is, so that its result does not depend on other
        frames.
        """
        # What is left to move grows where a range bites, see `doubts`.
        bites = self._converter.range_clips()
        unmoved = _UNMOVED / (1.0 + self._most_ones) if bites else _UNMOVED
        others, before = np.zeros_like(x), np.zeros_like(x)
        left, moves = x, np.ones((x.shape[0], 1, 1), dtype=bool)
        for _ in range(_REPEATS):
            mean, end = self._over_gate(left)
            given = mean * self._per_clock + (end - self._held) * self._per_swing / self.clocks
            before = np.where(moves, others, before)
            others = np.where(moves, -np.matmul(self._matrix, given[..., np.newaxis])[..., 0], others)
            left = np.where(moves, x + others - self.across_s * given, left)
            moves = moves & (self.clocks * np.abs(others - before).max(axis=(1, 2), keepdims=True) >= unmoved)
            if not moves.any():
                break
        return _Settled(others, before, left, mean)

    def known(self, settled: _Settled) -> Floats:
        """`Coupling.known`."""
        last = self.clocks * np.abs(settled.others - settled.before).max(axis=2, keepdims=True)
        return np.where(self._closely, np.maximum(last, _UNMOVED), 0.0)

    def doubts(self, settled: _Settled, x: Floats, low: Floats, high: Floats) -> Floats:
        """Return the error bound of a column in LSB, [frames, rows, cols], for duties x between `low` and `high`."""
        clocks, left = self.clocks, settled.left
        doubts = clocks * np.abs(settled.others - settled.before) + self._drift
        doubts = doubts + self._on_the_way(np.minimum(low, left))
        # How far means go with duties that are off by all that is allowed: near a simple ratio of whole numbers a
        # phase is constant for a gate, and so is the mean.
        least, most = left - _SETTLED / clocks, left + _SETTLED / clocks
        at_least, at_most = (self._over_gate(v)[0] for v in (least, most))
        moved = np.maximum(np.abs(at_least - settled.mean), np.abs(at_most - settled.mean))
        moved = moved + self._unsure(low, high)
        given = moved * self._per_clock + self._wound_up(least + (low - x), most + (high - x), settled.mean)
        doubts = doubts + clocks * np.matmul(self._links, given[..., np.newaxis])[..., 0]
        if self._converter.range_clips():
            # Where charge is lost every packet may lose as much again as it is off, as in `injection.counts`.
            ones = np.clip(clocks * left + 1.0, 1.0, self._most_ones)
            doubts = np.where(self._meets_range(left, doubts), doubts * (1.0 + ones), doubts)
        return doubts

    def _on_the_way(self, slower: Floats) -> Floats:
        """Return the variation in LSB of the current through links about its mean over a gate.

        The charge of a column swings by a packet in a period, of the duty `slower` at least, and
        the sum of what it gives is off by half a swing times a period: its own before it sends its
        next packet, or that of who takes it.
        """
        converter, clocks = self._converter, self.clocks
        duty = np.clip(slower, 0.0, 0.5)
        swing = np.minimum(clocks * duty, 1.0 + np.abs(converter.packet_error))
        start = (converter.preset_error_v - converter.v_comp_offset_v) / converter.packet_v() + W_PRESET
        away = np.maximum(np.abs(start) - 1.0, 0.0)  # it may take all of a gate to come back from there
        period = np.minimum(1.0 / np.maximum(duty, 1.0 / clocks), clocks)
        longer = np.maximum(period[..., np.newaxis], period[..., np.newaxis, :])
        course = 0.5 * np.matmul(self._links * longer, (swing * self._per_clock)[..., np.newaxis])[..., 0]
        swings = 0.5 * clocks * away * self._per_clock + (swing + away) * self._per_swing
        return course + np.matmul(self._links, swings[..., np.newaxis])[..., 0]

    def _unsure(self, low: Floats, high: Floats) -> Floats:
        """Return the error in packets of the mean charge of the walk over a gate.

        For packets of another size, noise at levels and starts, samples and outputs that are late,
        a window wider than a packet, and duties that move between `low` and `high`.
        """
        converter = self._converter
        noise = 3.0 * (converter.v_comp_noise_v + converter.v_preset_noise_v) / converter.packet_v()
        window = np.maximum(converter.v_hysteresis_v / converter.packet_v() - 1.0, 0.0)
        late = (converter.t_comp_delay_s + converter.t_gbw_s) * converter.f_clk_hz
        duty = np.clip(high, 0.0, 0.5)
        moves = np.minimum(self.clocks * (high - low), 1.0)
        return (
            np.abs(converter.packet_error) + noise + window + (0.5 + late) * duty + moves * 0.5 * (1.0 + duty)
        )

    def _wound_up(self, least: Floats, most: Floats, mean: Floats) -> Floats:
        """Packets a clock at most that come through 1 S from columns whose packets do not take all
        that comes, beyond what comes with the means of the walk, where duties are between `least`
        and `most`.

        What comes beyond a packet every second clock, or below nothing, stays in the integrator up
        to its range, and `_walk_over_gate` keeps none of it. No virtual ground moves further than
        the bias.
        """
        plan, converter, clocks = self._plan, self._converter, self.clocks
        taken = 0.5 * np.minimum(1.0 + converter.packet_error, 1.0)
        ends = converter.range_v() / converter.packet_v()
        given = np.zeros_like(mean)
        for end, beyond in zip(ends, (-least, most - taken), strict=True):
            pile, room = clocks * np.maximum(beyond, 0.0), np.abs(end - mean)
            through = np.minimum(0.5 * pile, room) * self._per_clock
            through = through + np.minimum(pile, room) * self._per_swing / clocks
            given = np.maximum(given, through)
        bias_v = plan.v_bias_v * (1.0 + abs(plan.drive.ripple))
        return np.minimum(given, bias_v / (converter.k * converter.i0_a))

    def _meets_range(self, x: Floats, doubts: Floats) -> Bools:
        """Return True where the charge may reach its limits, given the uncertainty in LSB over a gate."""
        converter = self._converter
        levels_v = np.abs(converter.v_comp_offset_v) + converter.v_hysteresis_v / 2
        slack = (
            levels_v * (1.0 + converter.inv_gain_dc) / converter.packet_v()
            + converter.t_comp_delay_s * converter.f_clk_hz
            + np.minimum(1.0, converter.t_gbw_s * converter.f_clk_hz)
            + np.abs(converter.packet_error)
        )
        # A packet has left two clocks after the decision.
        duty = np.clip(x, 0.0, 0.5)
        top, bottom = 2.0 * duty + slack, 2.0 * duty - 1.0 - slack
        off = doubts / self.clocks
        above = np.maximum(top, self._held) + off > self._high
        below = np.minimum(bottom, self._held) - off < self._low
        # The duty is another one later in the gate.
        return above | below | (x < 0.0) | self._moves

    def _over_gate(self, x: Floats) -> tuple[Floats, Floats]:
        """Return mean and end of the charge over a gate, for converters with a range and no other effect."""
        mean, end = np.empty_like(x), np.empty_like(x)
        ends = (self._held, self.level, self._low, self._high)
        start, level, low, high = (np.broadcast_to(v, x.shape[-1:]) + 0.0 for v in ends)
        _walk_over_gate(np.ascontiguousarray(x), start, level, low, high, self.clocks, mean, end)
        # Both loops divide by a duty or a current.
        if not (np.isfinite(mean).all() and np.isfinite(end).all()):
            raise SimulatorError("column coupling: the charge over a gate is not a finite number")
        return mean, end


@numba.njit(cache=True, error_model="numpy")
def _walk_in_range(x, start, level, low, high, clocks):  # type: ignore
    """Return mean and end of the charge over a gate, for a converter whose charge stops at low and high."""
    w, total, now, before = start, 0.0, False, False
    for _ in range(clocks):
        # The packet of the decision two edges ago is flowing in this clock.
        current = x - 1.0 if before else x
        then = w + current
        stop = min(max(then, low), high)
        # Part of the clock until it stops. Compiled code divides in either case: never nothing by nothing.
        part = abs(stop - w) / max(abs(current), 1e-300)
        part = part if stop != then else 1.0
        total += 0.5 * (w + stop) * part + stop * (1.0 - part)
        # Roundings of a sum of charges do not decide.
        w, before, now = stop, now, stop >= level - 1e-9 and not now
    return total / clocks, w


@numba.njit(cache=True, error_model="numpy")
def _walk_over_gate(x, start, level, low, high, clocks, mean, end):  # type: ignore
    """Return mean and end of the charge over a gate, for converters with a range low .. high and no other effect.

    Where the range may be met, it is walked clock by clock. Elsewhere one m is decided at clock
    t = ceil((level - start + m) / x), where that is two clocks or more behind the one before, and its packet is gone
    from t + 1 to t + 2. What a duty above 1/2 brings beyond that is not kept.
    """
    for f in range(x.shape[0]):
        for r in range(x.shape[1]):
            for c in range(x.shape[2]):
                fast = max(x[f, r, c], 1e-9)
                duty = min(fast, 0.5)
                wound = fast > 0.5 or x[f, r, c] < 0.0
                if high[c] < (np.inf if wound else level[c] + 2.0 * fast) or low[c] > (
                    -np.inf if wound else level[c] + 2.0 * fast - 1.0
                ):
                    total, w = _walk_in_range(x[f, r, c], start[c], level[c], low[c], high[c], clocks)
                    mean[f, r, c], end[f, r, c] = total, w
                    continue
                total, at_end = start[c] + 0.5 * clocks * duty, start[c] + clocks * duty
                period, wait = 1.0 / fast, (level[c] - start[c]) / fast - 1e-9
                for m in range(clocks // 2 + 1):
                    after = clocks - max(math.ceil(min(max(wait + m * period, 0.0), clocks + 1.0)), 2 * m + 1)
                    if after <= 1:
                        break
                    total -= (after - 1.5) / clocks
                    at_end -= 1.0
                mean[f, r, c], end[f, r, c] = total, at_end
