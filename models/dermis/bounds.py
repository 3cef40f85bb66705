# SPDX-License-Identifier: Apache-2.0
"""How far each effect can move what a converter decides on, in packets (= LSB): docs/auto.md derives every line.

A bound holds for every subset of the other effects of the plan, so the bounds of any effects that are left out
add up. Deterministic effects have true bounds; random ones have `sigma` times their rms at the end of the gate.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.array import settling
from dermis.array.settling import BRISK_CLOCKS
from dermis.converter import injection
from dermis.converter.vfc import W_PRESET, Y_MIN

Floats = NDArray[np.float64]

# Frames are bounded in at most this many blocks, each by the envelope of its frames: the cost of planning does
# not grow with the frames, only the pass that makes the envelopes does.
BLOCKS_MAX = 8

# Stands for a short: beyond it nothing changes in any bound, and products of it stay finite.
_G_MAX_S = 1e30
# Lag of an integrator's output in clocks beyond which counts no longer follow the order of levels: several packets are
# on their way at once, and a lower level may count less.
SLOW_CLOCKS = 1.0
# Duty, in packets of the size they are, beyond which a cell that may not be saturated is not trusted to be.
_X_CLIP = 0.75
# Time constants of a leak in a gate up to which counts follow levels (docs/auto.md, "The lemma").
_FORGETS = 3.0
# Ripple, relative, from which on a current all but stands still for a while.
_ALL_OF_IT = 0.999
# Voltage by which a line may be away from rest, relative to what sources reach (docs/auto.md, "A line's capacitance").
_SWITCHED = 4.0
# The effect by whose field capacitances push charge (displacement.counts).
_DISPLACES = {
    "ripple": "supply_ripple",
    "inv_gain_dc": "integrator_gain",
    "t_gbw_s": "integrator_bandwidth",
    "q_mirror_c": "mirror_lag",
}


@dataclass(frozen=True)
class Bound:
    """Packets by which an effect may move a decision, broadcastable to [blocks, rows, cols].

    `level` says that it moves levels and packets; otherwise it moves the current, and what it does to a cell
    that reads full scale anyway ends where full scale begins. `gauss` says that `lsb` is `sigma` standard
    deviations of a normal number, independent of those of other effects: such bounds add as squares.
    `rate` is for what moves the current for a part of the gate: so many packets in a whole gate at its fastest. It
    counts as a level, for what it withholds while packets come every second clock does not come back.
    `beside` says of some other effects how many packets come on top, of levels, as long as that one is kept: without
    it virtual grounds stand still, and lines have settled.
    """

    lsb: ArrayLike
    level: bool = False
    gauss: bool = False
    rate: ArrayLike | None = None
    beside: Mapping[str, ArrayLike] = field(default_factory=dict)

    @property
    def steady(self) -> bool:
        """Whether it moves the current alike in every clock of a gate, at most."""
        return not self.level and self.rate is None


class Extent:
    """What bounds are made of: envelopes of the conductances and records with every candidate on.

    Axes are B blocks of frames, R rows, C columns; a row index means "while this row is driven".

    Attributes
    ----------
    g, g_low : ndarray
        [B, R, C] largest and smallest conductance of a block, in siemens.
    s, a : ndarray
        [B, R] and [B, C] sums of `g` over a row and over a column.
    reach : ndarray
        [B, C] conductance through which the rows that are not driven pass a column's voltage on to the others:
        sum over rows of G min(1, R_row S).
    side : float
        2 rows g: the laterals of a column.
    p : ndarray
        [B, R, 1] highest voltage of any column line, relative to the bias.
    d : float
        Range of voltages that offsets and leaks alone can make, in V.
    t : ndarray
        [B, R, C] current of a column for 1 V on the driven row, in siemens, at most.
    i_up, x_up, x : ndarray
        [B, R, C] largest current in A, duty, and duty clipped where every cell is saturated.
    stray_a : ndarray
        [B, 1, C] most of a column current that does not follow the bias, in A.
    offset, rest : ndarray
        [C] and [B, 1, C] duty of offset currents alone, and of all that does not follow the bias, either way.
    per_a : ndarray
        [C] packets of a gate for 1 A of column current.
    packet_low, packet_high : ndarray
        [C] least and most that a packet takes, the ideal one and the noise of a slot among them.
    packet_least : ndarray
        [C] least that a packet of the size they are takes.
    late : ndarray or float
        [B, R, C] packets that come on top of x: what settles, and what a slow mirror is early by.
    unsettled : ndarray
        [B, 1, C] packets that lines which have not settled bring into a gate or keep from it, at most; infinite where
        nothing is known of them.
    brief : ndarray
        [B, 1, C] the same, nothing where it is infinite: the largest current holds that.
    displaced : dict
        Counts [C] at most that capacitances push into converters, by the effect that has them do it.
    """

    def __init__(self, plan: Any, sigma: float) -> None:
        self.plan, self.sigma = plan, sigma
        self.n = plan.timing.gate_clocks
        self.settle = plan.timing.settle_clocks - plan.timing.break_clocks  # with the row driven
        self.converter, self.drive = plan.converter, plan.drive
        net = plan.network(0)
        self.net = net
        self.rows, self.cols = plan.rows, plan.cols
        self.v = plan.v_bias_v * (1.0 + plan.drive.ripple)
        self.g, self.g_low, self.change = _envelopes(plan)
        self.s, self.a = self.g.sum(axis=2), self.g.sum(axis=1)
        c = plan.converter
        self.packet_v = c.packet_v()
        self.amplitude = 1.0 / (1.0 + c.inv_gain_dc)

        # Resistance of a whole line to its driver or to its virtual ground.
        self.r_row = max(net.r_row_driven_ohm, net.r_row_grounded_ohm) + self.cols * net.r_trace_row_ohm
        self.r_col = net.r_column_ohm + self.rows * net.r_trace_column_ohm
        self.side = 2.0 * self.rows * net.g_lateral_row_s if self.cols > 1 else 0.0
        self.reach = _reach(self.g, np.minimum(1.0, _times(self.r_row, self.s)))
        loop = (self.r_col * (self.reach + self.side)).max(axis=1)[:, None, None]
        self.damp = np.where(loop < 1.0, 1.0 - np.minimum(loop, 1.0), 0.0)
        rise = (self.r_col * self.g).max(axis=2, keepdims=True)
        self.p = np.minimum(1.0, _ratio(rise, self.damp))
        if net.r_trace_column_ohm == 0:
            self.p = np.minimum(self.p, rise / (1.0 + rise))

        offset = net.v_column_offset_v
        self.d_offset = float(max(offset.max(), 0.0) - min(offset.min(), 0.0))
        lift = net.r_column_ohm * net.i_leak_a
        self.d = self.d_offset + float(max(lift.max(), 0.0) - min(lift.min(), 0.0))
        leak = np.abs(net.i_leak_a) * np.minimum(1.0, net.r_column_ohm * (self.a + self.side))
        self.leak = np.abs(net.i_leak_a) + leak.sum(axis=1, keepdims=True) - leak  # [B, C]
        self.t = self.g + self.p * (self.reach + self.side)[:, None]
        self.stray_a = (self.d * (self.a + self.side) + self.leak)[:, None]
        self.i_up = self.v * self.t + self.stray_a

        gain = np.maximum(1.0, np.abs(c.gain))
        self.per_a = self.n * gain / (c.k * c.i0_a)
        self.unsettled = _unsettled(self)
        self.displaced = {_DISPLACES[name]: most for name, most in injection.counts(plan).items()}
        known = np.isfinite(self.unsettled)
        # No voltage of a line is further from rest than by two switchings, one at either end of a break.
        rush = np.where(known, 0.0, _SWITCHED * (self.v + self.d) * (self.a + self.side)[:, None])
        self.brief = np.where(known, self.unsettled, 0.0)
        self.i_up = self.i_up + rush + self.brief / self.per_a
        self.offset = np.abs(c.i_offset_a) / c.i0_a
        self.x_up = self.i_up * self.per_a / self.n + self.offset
        full = plan.timing.code_max
        self.clips = self.n >= 2 * full
        size, spread = 1.0 + c.packet_error, sigma * c.packet_flicker
        self.packet_least = np.maximum(size * (1.0 - spread), 1e-3)
        self.packet_low = np.minimum(self.packet_least, 1.0)
        self.packet_high = np.maximum(size * (1.0 + spread), 1.0)
        # A duty that goes anywhere in a gate may be above 1/2 for a while and leave charge for later: never clipped.
        self.moving = plan.drive.motion or not known.all()
        self.x_clip: ArrayLike = (
            math.inf if self.moving else (_X_CLIP if self.clips else 1.0) * self.packet_high
        )
        self.x = np.minimum(self.x_up, self.x_clip)
        self.rest = self.stray_a * self.per_a / self.n + self.offset
        # What packets may not have taken yet though the mean of the duty is one that they can take.
        self.pile = self.n * np.maximum(self.x_up - 0.5 * self.packet_low, 0.0)
        if not self.moving:
            for_now = np.asarray(supply_ripple(None, self).lsb) + self.unsettled + _early_mirror(self)
            self.pile = np.minimum(self.pile, for_now)
        self.x_sure: ArrayLike = self.x_clip
        self.lag_room = math.inf  # packets that may be left out in all where a slow mirror is
        self.lagging: ArrayLike = 0.0  # [B, R, C] packets by which a slow mirror may be early or late
        self.x_floor: ArrayLike = 0.0  # [B, R, C] smallest duty, before the offset current
        self.late: ArrayLike = 0.0
        # How far a trajectory may leave -packet .. 2 x for levels, starts and samples off their place.
        self.slack = (
            (np.abs(c.v_comp_offset_v) + c.v_hysteresis_v / 2 + np.abs(c.preset_error_v)) / self.packet_v
            + c.t_comp_delay_s * c.f_clk_hz
            + np.minimum(1.0, c.t_gbw_s * c.f_clk_hz)
            + (self.packet_high - 1.0)
            + sigma * (c.v_comp_noise_v + c.v_preset_noise_v) / self.packet_v
        )

        # What a moving input of the converter finds on it (direct: the column, and through the rows the others), and
        # the part of it that leads to the inputs of others.
        self.g_input: ArrayLike = 0.0
        self.g_others: ArrayLike = 0.0
        if plan.topology == "direct":
            self.g_input = _ground(self)[:, None]
            self.g_others = (self.reach + self.side)[:, None]

    def amperes(self, i: ArrayLike, own_s: Floats | None = None, others_s: Floats | None = None) -> Bound:
        """The bound of an effect that changes column currents by at most i, [B, R, C] or [B, 1, C], in A.

        `own_s` and `others_s` [B, C]: by how many siemens it changes what the virtual ground of a column sees of
        itself and of all others together; one number where both are alike.
        """
        beside = self.settles()
        if own_s is not None:
            beside |= _through_grounds(self, own_s, own_s if others_s is None else others_s)
        return Bound(np.asarray(i) * self.per_a, beside=beside)

    def settles(self) -> dict[str, ArrayLike]:
        """`Bound.beside` of what changes how lines settle, or from where."""
        return {"line_capacitance": 2.0 * self.unsettled} if self.unsettled.any() else {}

    def arrives(self, direct: Floats) -> Floats:
        """`spread` for 1 V: siemens [B, C] at virtual grounds, of a change of `direct` [B, C] at the taxels."""
        lift = _ratio((self.r_col * direct).max(axis=1, keepdims=True), self.damp[:, 0])
        return direct + np.minimum(lift, 1.0) * (self.reach + self.side)

    def spread(self, direct: Floats) -> Floats:
        """Currents of all columns when `direct` [B, R, C] A is pushed into each, from the rows' side."""
        lift = _ratio((self.r_col * direct).max(axis=2, keepdims=True), self.damp)
        return direct + np.minimum(lift, self.v + self.d) * (self.reach + self.side)[:, None]

    @property
    def x_mirror(self) -> Floats:
        """Duty [B, R, C] of the mirror, in front of an offset current that may take from it."""
        return np.minimum(self.x_up, self.x + self.offset)

    @property
    def ones(self) -> Floats:
        """Packets gone in a gate, at most: the charge that came or was there, and no more than every second clock.

        Worked out each time: `of_effects` changes `late`.
        """
        leak = _leak(self, self.converter.g_in_s + self.g_input)  # below zero it lifts the charge
        leak = leak + _from_others(
            self, self.n * _lost(self, 1.0) + self.converter.t_gbw_s / self.converter.c_int_f
        )
        came = self.n * self.x + 1.0 + self.slack + self.late + self.sigma * np.sqrt(_walk(self)) + leak
        most = (self.n + 1) / 2
        # A charge that stops at its lower limit does not miss what else was to go.
        low = _limits(self)[0]
        with np.errstate(invalid="ignore"):
            free = low <= -1.0 - _away(self)
        return np.where(np.isinf(low) | free, np.minimum(came / self.packet_least, most), most)

    @functools.cached_property
    def delay_tail(self) -> Floats:
        """What is left of the last packet for a comparator that is late, where the next decision may be open."""
        d = self.converter.t_comp_delay_s * self.converter.f_clk_hz
        return _unfinished(self, d) * d * _packet(self) if np.any(d) else np.zeros(self.x.shape)

    @functools.cached_property
    def bandwidth_tail(self) -> Floats:
        """What is left of the lag behind a packet where the next decision may be open."""
        tau = self.converter.t_gbw_s * self.converter.f_clk_hz
        tail = np.zeros(self.x.shape)
        if not np.any(tau):
            return tail
        if np.any(tau > SLOW_CLOCKS):
            return tail + np.where(tau > SLOW_CLOCKS, np.inf, 1.0)
        with np.errstate(divide="ignore", under="ignore"):
            for after in range(1, 60):
                fall = np.exp(-(after - 1) / np.where(tau > 0, tau, 1e-3))
                rest = np.minimum(1.0, tau) * _packet(self) * fall
                open_ = (after + 2) * self.x + self.slack + rest >= self.packet_low
                tail = np.maximum(tail, np.where(open_, rest, 0.0))
                # Packets: far below what certificates allow for rounding (auto.ROUNDING_LSB).
                if rest.max() < 1e-12:
                    break
            else:
                tail = np.maximum(tail, rest)
        return tail


def _envelopes(plan: Any) -> tuple[Floats, Floats, Floats | None]:
    r = plan.resistance_ohm
    starts = np.unique(np.linspace(0, plan.frames, min(plan.frames, BLOCKS_MAX) + 1).astype(int)[:-1])
    low, high = np.minimum.reduceat(r, starts, axis=0), np.maximum.reduceat(r, starts, axis=0)
    change = None
    if plan.drive.motion:
        here, behind = np.minimum(plan.conductance_s(), _G_MAX_S), plan.next_conductance_s()
        behind = np.minimum(behind, _G_MAX_S)
        change = np.maximum.reduceat(np.abs(behind - here), starts, axis=0)
        g_high = np.maximum.reduceat(np.maximum(here, behind), starts, axis=0)
        return g_high, np.minimum.reduceat(np.minimum(here, behind), starts, axis=0), change
    with np.errstate(divide="ignore", over="ignore"):
        g_high, g_low = np.divide(1.0, low), np.divide(1.0, high)
    return np.minimum(g_high, _G_MAX_S), np.minimum(g_low, _G_MAX_S), change


def _times(r: ArrayLike, g: Floats) -> Floats:
    """r g, where an open line (inf) without a live taxel is at no voltage."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(g > 0, np.multiply(r, g), 0.0)


def _ratio(a: ArrayLike, b: ArrayLike) -> Floats:
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    return np.divide(a, b, out=np.where(a > 0, np.inf, 0.0), where=b > 0)


def _reach(g: Floats, share: Floats) -> Floats:
    return np.einsum("brc,br->bc", g, share)


# --- the network -------------------------------------------------------------------------------------------------


def lateral(_: Any, e: Extent) -> Bound:
    """Laterals carry at most rows g times the voltage between two columns, out of one and into the other."""
    volts = e.p * e.v + e.d
    through = e.side * volts
    lift = np.minimum(_ratio(e.r_col.max() * through, e.damp), volts)
    i = through + lift * e.reach[:, None]
    if e.net.r_trace_column_ohm:
        shunt = e.net.g_lateral_column_s * e.net.r_trace_column_ohm
        i = i + shunt * _trace_columns(e)
    # Between two virtual grounds directly; between the lines of others by as much as these rise.
    risen = _ratio(e.r_col.max() * e.reach, e.damp[:, 0])
    own, others = np.zeros(e.a.shape), np.zeros(e.a.shape)
    if e.side:
        own = e.side * (1.0 + risen)
        others = own + e.side * (np.minimum(1.0, e.r_col.max() * (e.reach + e.side)) + risen)
    if e.net.r_trace_column_ohm:
        along = e.rows * shunt * _ground(e)
        own, others = own + along, others + along
    return e.amperes(i, own, others)


def row_driver(_: Any, e: Extent) -> Bound:
    """The driven row droops by r I; the others lift by what the columns push into them."""
    q = _times(e.net.r_row_driven_ohm, e.s)
    droop = e.v * (q / (1.0 + q)) + e.d * np.minimum(1.0, q)
    lift = _reach(e.g, np.minimum(1.0, _times(e.net.r_row_grounded_ohm, e.s)))
    # A row lifts by no more than the columns where they give way, whether it is driven or not.
    largest = max(e.net.r_row_driven_ohm, e.net.r_row_grounded_ohm)
    lifts = _reach(e.g, np.minimum(1.0, _times(largest, e.s)))
    return e.amperes(droop[:, :, None] * e.t + e.spread((e.p * e.v + e.d) * lift[:, None]), e.arrives(lifts))


def column_input(_: Any, e: Extent) -> Bound:
    """Every column rises by r I: its own taxels see less, its neighbours pass it on."""
    rise = np.minimum(e.net.r_column_ohm * e.i_up, e.p * e.v + e.d)
    highest = rise.max(axis=2, keepdims=True)
    own = rise if e.net.r_trace_column_ohm == 0 and not e.side else highest
    loses, gains = own * (e.a + e.side)[:, None], highest * (e.reach + e.side)[:, None]
    # Without offsets and leaks every column rises, so losing and gaining take from each other.
    return e.amperes(loses + gains if e.d else np.maximum(loses, gains), _in_line(e, e.net.r_column_ohm))


def column_offset(_: Any, e: Extent) -> Bound:
    """Every element of the column sees at most the range of the offsets."""
    own = np.abs(e.net.v_column_offset_v) * (e.a + e.side) + e.d_offset * (e.reach + e.side)
    return e.amperes(np.minimum(own, e.d_offset * (e.a + e.side))[:, None])


def mux_leakage(_: Any, e: Extent) -> Bound:
    """What leaks into a column comes out of it; little goes on to the others."""
    return e.amperes(e.leak[:, None])


def _trace_columns(e: Extent) -> Floats:
    """Current by which the traces of the columns change column currents, at most, [B, R, C]."""
    r = e.net.r_trace_column_ohm
    back = (e.p * e.v + e.d) * (e.a + e.side)[:, None]  # in segments that do not lead from the driven row
    most = e.i_up + back
    below = e.rows - np.maximum.outer(np.arange(e.rows), np.arange(e.rows))  # [driven, other]
    i = r * (most * np.matmul(below.astype(float), e.g) + e.rows * back * e.a[:, None])
    highest = np.minimum(e.rows * r * (most + back).max(axis=2, keepdims=True), e.v + 2.0 * e.d)
    return i + highest * (e.reach + 2.0 * e.side)[:, None]


def trace(_: Any, e: Extent) -> Bound:
    """A line drops r times the current of all that lies behind each segment."""
    r = e.net.r_trace_row_ohm
    tail = np.cumsum(e.g[:, :, ::-1], axis=2)[:, :, ::-1]
    drop = r * np.cumsum(tail, axis=2)  # [B, R, C] relative to the voltage across the taxels
    farthest = drop[:, :, -1:]
    driven = np.maximum(drop, np.minimum(1.0, _times(e.net.r_row_driven_ohm, e.s))[:, :, None] * farthest)
    driven = np.minimum(driven, 1.0) * (e.v + e.d)
    ground = np.minimum(1.0, _times(e.net.r_row_grounded_ohm, e.s))[:, :, None]
    other = np.minimum(1.0, np.maximum(drop, ground * farthest))
    across = (e.g * other).sum(axis=1)[:, None]  # [B, 1, C]
    i = e.spread(e.g * driven) + e.spread((e.p * e.v + e.d) * across)
    if e.net.r_trace_column_ohm:
        i = i + _trace_columns(e)
    # A row's own traces keep it from its driver, and one end of it from the other.
    kept = _reach(e.g, np.minimum(2.0, _times(e.cols * r, e.s)))
    return e.amperes(i, e.arrives(kept) + _in_line(e, np.full(e.cols, e.rows * e.net.r_trace_column_ohm)))


def _slowest_clocks(e: Extent) -> float:
    if not math.isfinite(e.net.r_row_grounded_ohm):
        return math.inf
    return settling.slowest_s(e.net) * e.converter.f_clk_hz


def _unsettled(e: Extent) -> Floats:
    """`Extent.unsettled`: what starts away from rest has decayed when the gate opens, at the slowest rate there is.

    It holds whatever else is on, and for lines that lead onto their virtual grounds through no resistance.
    """
    net, c = e.net, e.converter
    nothing = np.zeros((len(e.g), 1, e.cols))
    if not (net.c_row_f or net.c_column_f or net.c_taxel_f):
        return nothing
    live = bool((e.g > 0).any())
    rows_tau = net.r_row_driven_ohm * (net.c_row_f + 2 * e.cols * net.c_taxel_f)
    if net.c_row_f or (net.c_taxel_f and live):
        rows_tau = max(rows_tau, net.r_row_grounded_ohm * (net.c_row_f + 2 * e.cols * net.c_taxel_f))
    rows_tau += net.r_trace_row_ohm * net.c_taxel_f * e.cols * (e.cols + 1)
    cols_tau = float(net.r_column_ohm.max()) * (net.c_column_f + 2 * e.rows * net.c_taxel_f)
    cols_tau += net.r_trace_column_ohm * net.c_taxel_f * e.rows * (e.rows + 1)
    tau = max(rows_tau, cols_tau)
    if tau == 0 and not e.drive.active_fields():
        return nothing
    rest = math.exp(-e.settle / c.f_clk_hz / tau) if tau else 0.0
    if not rest < 0.25:
        return nothing + np.inf
    volts = _SWITCHED * (e.v + e.d)
    farads = e.rows * net.c_row_f + e.cols * net.c_column_f + 4 * e.rows * e.cols * net.c_taxel_f
    stored = math.sqrt(farads) * volts  # norm of the state, sqrt(J)
    gate_s = e.n / c.f_clk_hz
    onto = np.sqrt(gate_s * (e.a + e.side) / 2.0)  # [B, C]
    charge = (onto + 2.0 * math.sqrt(e.rows * net.c_taxel_f)) * stored * rest
    if e.drive.active_fields():
        smallest = min(net.c_row_f, net.c_column_f)
        norm = math.sqrt(farads / smallest) if smallest else math.inf
        slope = 2.0 * math.pi * e.drive.f_ripple_hz * e.drive.ripple * e.v
        moves = 2.0 * e.drive.ripple * e.v
        if e.change is None:
            # Behind a ripple: what it lags by, summed up, is tau times what the voltages have changed by in all.
            late = tau * norm * 3.0 * moves if tau else 0.0
        else:
            # Behind a changing array: late by at most tau times the slope, all through the gate.
            pushed = e.r_row * e.change.sum(axis=2).max() + (e.r_col * e.change.sum(axis=1)).max()
            slope += float(_ratio(pushed * (e.v + e.d), e.drive.t_frame_s * e.damp.min()))
            moves = slope * gate_s
            late = gate_s * tau * norm * slope if tau and slope else 0.0
        # Through the taxels' own capacitance: what the voltages across them change by.
        shifts = 2.0 * e.rows * net.c_taxel_f * moves
        shifts += 2.0 * math.sqrt(e.rows * net.c_taxel_f * farads) * min(tau * slope, moves)
        seen = e.a + e.side
        charge = charge + np.where(seen > 0, seen, 1.0) * np.where(seen > 0, late, 0.0) + shifts
    return (charge * c.f_clk_hz * e.per_a / e.n)[:, None]


def line_capacitance(_: Any, e: Extent) -> Bound:
    """What has not settled, and what capacitances push into converters at any time."""
    # A slow mirror also keeps what has settled by then, unless lines are so brisk that event lets it pass.
    if e.converter.q_mirror_c.any() and _slowest_clocks(e) > BRISK_CLOCKS:
        return Bound(np.inf, rate=np.inf)
    whole = e.unsettled + sum(e.displaced.values())
    return Bound(whole, rate=whole)


# --- the current into the converter ------------------------------------------------------------------------------


def mirror_ratio(_: Any, e: Extent) -> Bound:
    """x |gain - 1|, up to where a smaller gain leaves a cell saturated."""
    gain = e.converter.gain
    duty = np.minimum(e.x_up, _ratio(e.x_clip + e.offset, np.clip(gain, 0.0, 1.0)))
    return Bound(e.n * duty * np.abs(gain - 1.0))


def offset_current(_: Any, e: Extent) -> Bound:
    """i / i0 packets a clock."""
    return Bound(e.n * np.abs(e.converter.i_offset_a) / e.converter.i0_a)


def range_switch(_: Any, e: Extent) -> Bound:
    """i - i / (1 + a i): bent towards more by what comes for a part of the gate, which is lost at most."""
    c = e.converter
    part = e.x_up * c.k * c.i0_a * c.inv_i_range_a
    brief = e.brief if c.inv_i_range_a.any() else 0.0
    return Bound(e.n * e.x_up * (1.0 - 1.0 / (1.0 + part)) + brief)


def mirror_lag(_: Any, e: Extent) -> Bound:
    """kappa ln(y at the end of the gate / y at its start), from the identity of the logistic equation."""
    c = e.converter
    kappa = c.q_mirror_c * c.f_clk_hz / c.i0_a
    settle = max(e.settle, 1)
    x = e.x_mirror
    some = np.where(kappa > 0, kappa, 1.0)
    slowest = np.maximum(e.x_floor, 0.0)
    # Late: a mirror that wakes up is latest at x = kappa / settle; early: one that falls to nothing.
    worst = np.clip(some / settle, slowest, np.maximum(x, slowest))
    with np.errstate(under="ignore"):
        late = kappa * np.log1p(worst / Y_MIN * np.exp(-settle * worst / some))
        left = np.maximum(settle * slowest / some, 1e-9)
        early = kappa * (np.log(-np.expm1(-left * (1.0 + e.n / settle))) - np.log(-np.expm1(-left)))
    if 0.0 < e.drive.ripple < _ALL_OF_IT:
        late = late + kappa * math.log((1.0 + e.drive.ripple) / (1.0 - e.drive.ripple))
        early = early + kappa * math.log((1.0 + e.drive.ripple) / (1.0 - e.drive.ripple))
    if _mirror_begins_anywhere(e):
        late = kappa * np.log(np.maximum(x, Y_MIN) / Y_MIN)
        early = _early_mirror(e)
    # It gives no negative current. That lifts dark cells to nothing, which no code shows as long as all else that
    # may lift them stays below half a packet: kept effects, and what is left out (Extent.lag_room).
    below = e.stray_a * e.per_a
    lifted = e.n * np.maximum(c.i_offset_a, 0.0) / c.i0_a + e.slack + e.sigma * np.sqrt(_walk(e))
    room = -W_PRESET - float(np.max(lifted))
    if e.moving or room < 0.05:
        nothing = below
    else:
        nothing = np.where(kappa > 0, e.n * Y_MIN, 0.0)
        if below.any():
            e.lag_room = room
    e.lagging = np.maximum(np.minimum(late, e.n * x), early)
    return Bound(e.lagging + nothing, rate=e.n * x, beside=_pushed(e, "mirror_lag"))


def _mirror_begins_anywhere(e: Extent) -> bool:
    """Whether the output of a slow mirror may be anything when the gate opens: its input was another until then."""
    slow_lines = e.converter.q_mirror_c.any() and e.unsettled.any() and _slowest_clocks(e) > BRISK_CLOCKS
    return e.moving or e.drive.ripple >= _ALL_OF_IT or bool(slow_lines)


def _early_mirror(e: Extent) -> Floats:
    """Packets, broadcastable to [B, R, C], at most by which a slow mirror is early."""
    kappa = e.converter.q_mirror_c * e.converter.f_clk_hz / e.converter.i0_a
    if not _mirror_begins_anywhere(e):
        return kappa * math.log1p(e.n / max(e.settle, 1))
    most = e.n * e.x_mirror.max(axis=1, keepdims=True)
    return kappa * np.log1p(np.divide(most, kappa, out=np.zeros(most.shape), where=kappa > 0))


def supply_ripple(_: Any, e: Extent) -> Bound:
    """A sine of amplitude a x adds at most a x f_clk / (pi f) packets up to any clock."""
    d = e.drive
    clocks = min(e.n, e.converter.f_clk_hz / (math.pi * d.f_ripple_hz)) if d.ripple else 0.0
    # What follows the bias: more than comes in all where offsets and leaks take from it.
    x = np.minimum(e.x_up, e.x + e.rest)
    beside = e.settles() if d.ripple else {}
    for name, pushed in _pushed(e, "supply_ripple").items():
        beside[name] = beside.get(name, 0.0) + pushed
    return Bound(d.ripple * clocks * x, rate=d.ripple * e.n * x, beside=beside)


def motion(_: Any, e: Extent) -> Bound:
    """What the conductances change by until the gate closes."""
    if e.change is None:
        return Bound(0.0)
    d = e.drive
    slot = e.plan.timing.slot_s
    share = np.minimum(1.0, (np.arange(e.rows) + 1.0) * slot / d.t_frame_s)[None, :, None]
    volts = e.p * e.v + e.d
    into = share * (e.v + e.d) * e.change
    row = np.minimum(_times(e.r_row, into.sum(axis=2)), e.v + e.d)[:, :, None]
    return e.amperes(e.spread(into + row * e.t + volts * share * e.change.sum(axis=1)[:, None]))


# --- levels, packets and the integrator --------------------------------------------------------------------------


def _lost(e: Extent, g_s: ArrayLike) -> Floats:
    """Part of the charge that g across the input takes in a clock."""
    c = e.converter
    return g_s * c.inv_gain_dc * e.amplitude / c.c_int_f / c.f_clk_hz


def _swing(e: Extent) -> Floats:
    """Packets by which a charge is away from zero while it counts: one packet and the slack."""
    return np.maximum(1.0, 2.0 * e.x) + e.pile + e.slack


def _leak(e: Extent, g_s: ArrayLike) -> Floats:
    """Packets lost in a gate through g across the input."""
    return e.n * _lost(e, g_s) * _swing(e)


def _drops(e: Extent, g_s: ArrayLike) -> Floats:
    """Packets lost in a gate through g across an input that moves with the slope of a slow output."""
    return e.converter.t_gbw_s * g_s / e.converter.c_int_f * _swing(e)


def _held_by_saturated(e: Extent) -> Floats:
    """Packets at most in any integrator of the row at the end of the gate, [B, R, 1]: what no packet took away.

    A cell beside it hangs on that, though what it does to the cell itself ends at full scale.
    """
    low, high = _limits(e)
    above = e.n * np.maximum(e.x_up - 0.5 * e.packet_low, 0.0)
    held = np.maximum(np.minimum(above, np.abs(high)), np.minimum(e.n * e.rest, np.abs(low)))
    return (np.maximum(1.0, 2.0 * e.x) + e.slack + held).max(axis=2, keepdims=True)


def _from_others(e: Extent, per_packet: ArrayLike, g_s: ArrayLike | None = None) -> Floats:
    """Packets of a gate from inputs of others through g: `per_packet` [C] for 1 S and a packet there.

    None is moved beyond the bias.
    """
    if e.plan.topology != "direct":  # no input of another is in reach
        return np.zeros(e.x.shape)
    most = (e.v + e.d) * e.per_a
    g_s = e.g_others if g_s is None else g_s
    return g_s * np.where(per_packet > 0, np.minimum(per_packet * _held_by_saturated(e), most), 0.0)


def _ground(e: Extent) -> Floats:
    """Siemens [B, C] that lie between a virtual ground and all else, either way it is looked at, at most."""
    return e.a + e.reach + 2.0 * e.side


def _in_line(e: Extent, r_ohm: Floats) -> Floats:
    """Siemens [B, C] that resistances r [C] between lines and their virtual grounds change between the grounds."""
    g = _ground(e)
    return g * np.minimum(1.0, _times(r_ohm, g)).max(axis=1, keepdims=True)


def _through_grounds(e: Extent, own_s: Floats, others_s: Floats) -> dict[str, Floats]:
    """Packets [B, R, C] by effect that makes virtual grounds give way: `Bound.beside` of so many siemens [B, C]."""
    found: dict[str, Floats] = {}
    if e.plan.topology != "direct":
        return found
    c = e.converter
    own, others = (np.minimum(g, _ground(e))[:, None] for g in (own_s, others_s))
    if c.inv_gain_dc.any():
        found["integrator_gain"] = _leak(e, own) + _from_others(e, e.n * _lost(e, 1.0), others)
    if c.t_gbw_s.any():
        found["integrator_bandwidth"] = _drops(e, own) + _from_others(e, c.t_gbw_s / c.c_int_f, others)
    return found


def _pushed(e: Extent, name: str) -> dict[str, ArrayLike]:
    """`Bound.beside` of an effect that has capacitances push charge."""
    return {"line_capacitance": e.displaced[name]} if name in e.displaced else {}


def integrator_gain(p: Any, e: Extent) -> Bound:
    """The charge leaks while the input gives way, and levels count from a smaller output."""
    c = e.converter
    level = (np.abs(c.v_comp_offset_v) + c.v_hysteresis_v / 2) / e.packet_v * c.inv_gain_dc
    late = c.t_gbw_s * c.f_clk_hz * c.inv_gain_dc * 2.0
    others = _from_others(e, e.n * _lost(e, 1.0))
    lsb = _leak(e, c.g_in_s + e.g_input) + others + level + late
    return Bound(lsb, level=True, beside=_pushed(e, "integrator_gain"))


def mirror_output(p: Any, e: Extent) -> Bound:
    """As integrator_gain, through its own resistance; behind a slow integrator also what the lag drops."""
    c = e.converter
    late = 2.0 * (1.0 + e.slack) * c.t_gbw_s / p.r_out_ohm / c.c_int_f
    return Bound(_leak(e, 1.0 / p.r_out_ohm) + late, level=True)


def _limits(e: Extent) -> Floats:
    """Lower and upper end of the charge in packets, [2, C]."""
    return e.converter.range_v() / (e.packet_v * e.amplitude)


def _away(e: Extent) -> Floats:
    """Packets by which a trajectory may leave -packet .. 2 x for all that moves, [B, R, C]."""
    moving = 2.0 * (np.asarray(supply_ripple(None, e).lsb) + e.lagging + e.unsettled)
    if e.drive.motion:
        moving = moving + e.n * e.rest
    return moving + e.sigma * np.sqrt(_walk(e)) + e.slack


def integrator_range(_: Any, e: Extent) -> Bound:
    """Nothing where no trajectory can reach the limits; else there is no bound worth having."""
    limits, moving = _limits(e), _away(e)
    x = e.x if e.moving else np.minimum(e.x, e.x_sure)
    inside = (limits[0] <= -1.0 - moving) & (limits[1] >= 2.0 * x + e.pile + moving)
    return Bound(np.where(inside, 0.0, np.inf), level=True)


def comparator_offset(_: Any, e: Extent) -> Bound:
    """Its voltage in packets."""
    return Bound(np.abs(e.converter.v_comp_offset_v) / (e.packet_v * e.amplitude), level=True)


def comparator_hysteresis(_: Any, e: Extent) -> Bound:
    """Half the window, either way."""
    return Bound(e.converter.v_hysteresis_v / 2 / (e.packet_v * e.amplitude), level=True)


def preset_error(_: Any, e: Extent) -> Bound:
    """Its voltage in packets."""
    return Bound(np.abs(e.converter.preset_error_v) / e.packet_v, level=True)


def _packet(e: Extent) -> Floats:
    return 1.0 + np.abs(e.converter.packet_error)


def _unfinished(e: Extent, after: float) -> Floats:
    """Where a decision `after` clocks behind a one may be open while that one's packet still is: 1, else 0."""
    return (3.0 * e.x + e.slack >= e.packet_low - after).astype(float)


def comparator_delay(_: Any, e: Extent) -> Bound:
    """A sample d clocks early misses d x; where ones come every second clock, the packet's end instead."""
    d = e.converter.t_comp_delay_s * e.converter.f_clk_hz
    return Bound(np.maximum(d * e.x, e.delay_tail - d * np.maximum(e.x_floor, 0.0)), level=True)


def charge_packet(p: Any, e: Extent) -> Bound:
    """Its relative error times the packets gone."""
    return Bound(np.abs(np.asarray(p.packet_error)) * e.ones, level=True)


def reference_drift(p: Any, e: Extent) -> Bound:
    """As charge_packet."""
    return Bound(abs(p.tc_per_k * p.delta_k) * e.ones, level=True)


def integrator_bandwidth(_: Any, e: Extent) -> Bound:
    """The output is late by tau x, by what is left of the last packet, and by what the moving input drops."""
    c = e.converter
    tau = c.t_gbw_s * c.f_clk_hz
    drops = _drops(e, c.g_in_s + e.g_input) + _from_others(e, c.t_gbw_s / c.c_int_f)
    lsb = np.maximum(tau * e.x, e.bandwidth_tail - tau * np.maximum(e.x_floor, 0.0)) + drops
    return Bound(lsb, level=True, beside=_pushed(e, "integrator_bandwidth"))


# --- random effects: sigma times the rms -------------------------------------------------------------------------


def comparator_noise(_: Any, e: Extent) -> Bound:
    """Every decision has a level of its own."""
    return Bound(e.sigma * e.converter.v_comp_noise_v / (e.packet_v * e.amplitude), level=True, gauss=True)


def metastability(_: Any, e: Extent) -> Bound:
    """Half the aperture times the slope; a bound, not a confidence."""
    return Bound(e.x * e.converter.t_meta_s * e.converter.f_clk_hz / 2, level=True)


def _jitter(e: Extent) -> Floats:
    return e.converter.t_jitter_s * e.converter.f_clk_hz


def clock_jitter(_: Any, e: Extent) -> Bound:
    """Two edges a packet, and the edge that samples."""
    return Bound(
        e.sigma * _jitter(e) * np.sqrt(2.0 * (e.n * e.x + 1.0) * _packet(e) ** 2 + e.x**2), level=True
    )


def _thermal(e: Extent) -> Floats:
    c = e.converter
    charge = c.i0_a / c.f_clk_hz
    # Without an error of the ratio, or with it.
    part = np.maximum(1.0, np.abs(c.gain)) / c.k
    return (e.n * 2.0 * c.kt_noise_j * e.a * part**2 / c.f_clk_hz / charge**2)[:, None]


def _shot(e: Extent) -> Floats:
    c = e.converter
    return (2.0 * e.n * e.x + 1.0) * c.q_shot_c * c.f_clk_hz / c.i0_a


def _walk(e: Extent) -> Floats:
    """Variance in packets^2 that has come together at the end of the gate."""
    return _thermal(e) + _shot(e) + 2.0 * (e.n * e.x + 1.0) * (_jitter(e) * _packet(e)) ** 2


def thermal_noise(_: Any, e: Extent) -> Bound:
    """White current of every conductance on the column."""
    return Bound(e.sigma * np.sqrt(_thermal(e)), level=True, gauss=True)


def shot_noise(_: Any, e: Extent) -> Bound:
    """One electron's charge squared for each that comes, of the input and of the packets."""
    return Bound(e.sigma * np.sqrt(_shot(e)), level=True, gauss=True)


def ktc_noise(_: Any, e: Extent) -> Bound:
    """One draw at the start."""
    return Bound(e.sigma * e.converter.v_preset_noise_v / e.packet_v, level=True, gauss=True)


def flicker_noise(_: Any, e: Extent) -> Bound:
    """One draw for all packets of a slot, a part of the size they are."""
    c = e.converter
    return Bound(e.sigma * c.packet_flicker * (1.0 + c.packet_error) * e.ones, level=True, gauss=True)


# --- the sensor: conductances before any engine sees them --------------------------------------------------------


def sensor_hysteresis(p: Any, e: Extent) -> Bound:
    """Relative change of conductance; what it does to crosstalk is in the network's effects."""
    return Bound(e.n * e.x * p.relative / (1.0 - p.relative))


def sensor_creep(p: Any, e: Extent) -> Bound:
    """A decade of time for each factor of ten between the whole recording and where creep starts."""
    start_s = e.plan.scene.design.sensor.creep_start_s
    decades = math.log10(max(1.0, 1.0 + e.plan.frames * e.drive.t_frame_s / start_s))
    return Bound(e.n * e.x * p.per_decade * decades)


def sensor_temperature(p: Any, e: Extent) -> Bound:
    """Relative change of conductance."""
    change = abs(p.tc_per_k * p.delta_k)
    return Bound(e.n * e.x * change / max(1.0 - change, 1e-3))


def sensor_spread(p: Any, e: Extent) -> Bound:
    """Sigma times the standard deviation of conductance."""
    return Bound(e.n * e.x * e.sigma * p.relative)


# --- effects that are kept, where they break the order the lemma rests on ----------------------------------------


KEPT = ("comparator_hysteresis", "metastability", "comparator_delay", "integrator_bandwidth")


def kept(name: str, e: Extent) -> ArrayLike:
    """Packets that a kept effect adds to the margin once anything is left out, [B, R, C] or a number.

    Hysteresis and aperture: either run may stand on the other side of them. Delay and bandwidth: the run whose
    one came later has not yet lost all of that packet.
    """
    if name == "comparator_hysteresis":
        return 2.0 * np.asarray(comparator_hysteresis(None, e).lsb)
    if name == "metastability":
        return 2.0 * np.asarray(metastability(None, e).lsb)
    if name == "comparator_delay":
        return e.delay_tail
    if name == "integrator_bandwidth":
        return e.bandwidth_tail
    return 0.0


def lag_slack(moved: Floats, e: Extent) -> Floats:
    """What a kept slow mirror adds when its input is off by `moved` [B, R, C] packets a gate, at its fastest.

    ln(y'/y) stays below ln(1 + dx/y_min): beyond that the faster of two mirrors no longer gains.
    """
    c = e.converter
    kappa = c.q_mirror_c * c.f_clk_hz / c.i0_a
    return np.broadcast_to(kappa * np.log1p(moved.max(axis=(0, 1)) / e.n / Y_MIN), (e.cols,))


def grown(on: Collection[str], bounds: Mapping[str, Bound], e: Extent) -> tuple[Floats, Floats]:
    """How far a level that is off may be off at the end of the gate, where `on` is kept: times and plus, [B, R, C].

    Charge that an integrator loses hangs on where its levels are. At a limit a packet a clock later loses as much as
    flows in a clock, and where the next begins at the limit again so do all that follow: however little the level is
    off. A leak takes its part of it in every clock; one that forgets within a gate does as a limit does. What a slow
    output drops hangs on where it ends, a packet apart. Certified codes need none of this (docs/auto.md).
    """
    c = e.converter
    seen_s = c.g_in_s + e.g_input + e.g_others
    leaks = np.zeros(e.g.shape)
    if "integrator_gain" in on:
        leaks = leaks + e.n * _lost(e, seen_s)
    factor = np.where(leaks > _FORGETS, np.inf, 1.0 + leaks)
    if "integrator_range" in on:
        factor = np.where(np.asarray(bounds["integrator_range"].lsb) > 0, np.inf, factor)
    drops = np.zeros(e.g.shape)
    if "integrator_bandwidth" in on:
        drops = drops + c.t_gbw_s * seen_s / c.c_int_f
    return factor, drops


Bounding = Callable[[Any, Extent], Bound]


def unknown(_: Any, e: Extent) -> Bound:
    """No bound is known: the effect is never left out."""
    return Bound(np.inf, level=True, gauss=True)


# Bounds that ask how small a duty can be, how many packets go, and where cells are sure to be saturated: after all
# others, in this order.
_LAST = (
    "mirror_lag", "comparator_delay", "integrator_bandwidth", "charge_packet", "reference_drift", "flicker_noise",
    "integrator_range",
)  # fmt: skip


def of_effects(on: Mapping[str, Any], functions: Mapping[str, Bounding], e: Extent) -> dict[str, Bound]:
    """The bound of every effect that is on."""
    found = {name: functions[name](p, e) for name, p in on.items() if name not in _LAST}
    late = [name for name in _LAST if name in on]
    if late:
        moved = sum((b.lsb for b in found.values() if not b.level), np.zeros(e.g.shape))
        c = e.converter
        with np.errstate(invalid="ignore"):
            floor = e.plan.v_bias_v * e.g_low / (c.k * c.i0_a) - np.asarray(moved) / e.n
        e.x_floor = np.minimum(np.nan_to_num(floor, nan=-np.inf), e.x)
    e.late = np.asarray(found["line_capacitance"].lsb) if "line_capacitance" in found else 0.0
    for name in late:
        if name == "integrator_range":
            levels = sums(e, found, {n: np.asarray(b.lsb) for n, b in found.items()})[1]
            e.x_sure = np.minimum(_sure(e, levels) / e.n, e.x_clip)
        found[name] = functions[name](on[name], e)
        if name == "mirror_lag":
            e.late = e.late + np.asarray(found[name].lsb)
    return {name: found[name] for name in on}


def sums(e: Extent, bounds: Mapping[str, Bound], lsb: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """Bounds of effects together: what moves currents, and what moves levels, [B, R, C] each."""
    inputs, levels, squares = np.zeros(e.g.shape), np.zeros(e.g.shape), np.zeros(e.g.shape)
    for name, bound in bounds.items():
        if bound.gauss:
            squares += lsb[name] * lsb[name]
        elif bound.steady:
            inputs += lsb[name]
        else:
            levels += lsb[name]
    return inputs, levels + np.sqrt(squares)


def _sure(e: Extent, levels: Floats) -> Floats:
    """N x in packets [C] above which a converter reads full scale with every effect on."""
    start = levels.max(axis=(0, 1)) - W_PRESET
    sure = np.maximum(start + e.plan.timing.code_max - 1, e.n * start / 2)
    # Below nothing more of a current is less.
    return np.where(e.clips & (sure <= e.n * e.x_clip) & (e.drive.ripple <= 1.0), sure, np.inf)


class Total:
    """Sums of bounds over effects that are left out, with what saturated and dark cells cannot feel taken off."""

    def __init__(self, e: Extent, bounds: dict[str, Bound]) -> None:
        self.e, self.bounds = e, bounds
        shape = e.g.shape
        self.lsb = {
            name: np.broadcast_to(np.asarray(b.lsb, dtype=float), shape) for name, b in bounds.items()
        }
        self.beside = {
            name: {by: np.broadcast_to(np.asarray(part, dtype=float), shape) for by, part in b.beside.items()}
            for name, b in bounds.items()
        }
        # What comes on top is part of the bound of what it comes on top beside.
        inputs, levels = sums(e, bounds, self.lsb)
        c = e.converter
        ideal = e.plan.v_bias_v * e.n / (c.k * c.i0_a)
        with np.errstate(invalid="ignore"):
            low = np.nan_to_num(ideal * e.g_low - inputs, nan=-np.inf)
        high = ideal * e.g + inputs
        self.sure = _sure(e, levels)
        with np.errstate(invalid="ignore"):
            self.cap = np.where(np.isinf(self.sure), np.inf, np.maximum(0.0, self.sure - low))
            if e.drive.motion:  # sure all through the gate, or not at all
                self.cap = np.where(self.cap > 0, np.inf, 0.0)
        self.felt = (self.cap > 0) & ~(high + levels.max(axis=(0, 1)) < -W_PRESET)
