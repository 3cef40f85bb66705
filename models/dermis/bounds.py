# SPDX-License-Identifier: Apache-2.0
"""Error bounds of the filter: how far each effect moves a decision that `closed` made without it.

Everything is counted in packets and made from solved currents. docs/auto.md derives every line. An effect that engine
`closed` honours has no error here. One without a bound keeps every cell open.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.array.array import Network
from dermis.array.settling import BRISK_CLOCKS
from dermis.converter.vfc import W_PRESET, Converter
from dermis.timing import Timing

Floats = NDArray[np.float64]

# Engine event stops drawing where a decision is eight standard deviations away: it is wrong once in 1e15.
SIGMAS = 8.0
# Lag of an integrator's output in clocks beyond which counts do not follow the order of levels: several packets are
# under way at once, and a lower level may count less.
SLOW_CLOCKS = 1.0
# Voltage by which a line may be away from rest, relative to the sources: two switchings, one at either end of a break.
_SWITCHED = 4.0


class Bound(NamedTuple):
    """Error of an effect in packets, each broadcastable to [frames, rows, cols].

    In a quiet cell (`Solved.quiet`) the level at the last decision is off by `shift`, known to `rest`. In any cell no
    level is off by more than `whole`. `random` comes on top of both: SIGMAS standard deviations of a normal number that
    is independent of those of other effects, so that they add as squares. `drawn` takes its place in a quiet cell once
    the random numbers of the cell are drawn, `drawn_whole` in any cell; None changes nothing. `level` says that it
    moves levels; otherwise it moves the charge that comes, within the limits that `Solved.low` and `high` state.
    """

    shift: ArrayLike = 0.0
    rest: ArrayLike = 0.0
    whole: ArrayLike = 0.0
    random: ArrayLike = 0.0
    drawn: ArrayLike | None = None
    drawn_whole: ArrayLike | None = None
    level: bool = True


NONE = Bound()
OPEN = Bound(0.0, np.inf, np.inf)


@dataclass
class Solved:
    """Solved currents of some frames, in packets a clock, [frames, rows, cols] unless another shape is given.

    Attributes
    ----------
    network, converter, timing : Network, Converter, Timing
        What surrounds the taxels, the converters [cols] and the clocks.
    x : ndarray
        Mean charge a clock over the gate of what `closed` honours, clipped where every converter saturates.
    low, high : ndarray
        Least and largest charge in any clock of the gate.
    swing : ndarray or float
        Amplitude of the ripple on it, `swing_sum` [frames, rows, 1] the sum of its sine over the gate, `swing_reach`
        the largest sum over any part of it, `swing_bent` packets of second order.
    moved : ndarray or float
        Largest partial sum over a gate of what conductances in motion add to the mean.
    late, late_known : ndarray or float
        Packets by which a slow mirror is late over the gate, which `x` holds already, and how well that is known.
    g_column_s : ndarray
        [frames, 1, cols] conductance on each column.
    leak, across : ndarray or float
        Part of the charge that is lost a clock, and part of what an output has not followed yet, as in event.Cells.
    v_v : float
        Largest voltage of any source.
    slow_mirror : bool
        Whether any mirror is slow.
    error, levels : ndarray
        Sum of `whole` of the effects so far, and of those that move levels.
    """

    network: Network
    converter: Converter
    timing: Timing
    x: Floats
    low: Floats
    high: Floats
    g_column_s: Floats
    v_v: float
    swing: ArrayLike = 0.0
    swing_sum: ArrayLike = 0.0
    swing_reach: float = 0.0
    swing_bent: ArrayLike = 0.0
    moved: ArrayLike = 0.0
    late: ArrayLike = 0.0
    late_known: ArrayLike = 0.0
    leak: ArrayLike = 0.0
    across: ArrayLike = 0.0
    slow_mirror: bool = False
    error: ArrayLike = 0.0
    levels: ArrayLike = 0.0

    @property
    def clocks(self) -> int:
        """Decisions in a gate."""
        return self.timing.gate_clocks

    @property
    def packet(self) -> Floats:
        """Size of a packet [cols], in ideal ones."""
        return 1.0 + self.converter.packet_error

    @property
    def output_v(self) -> Floats:
        """Voltage of the integrator's output for one packet, [cols]."""
        return self.converter.packet_v() / (1.0 + self.converter.inv_gain_dc)

    @property
    def lag(self) -> Floats:
        """Clocks by which an integrator's output is late, [cols]."""
        c = self.converter
        return c.t_gbw_s * c.f_clk_hz / (1.0 + c.inv_gain_dc)

    @property
    def delay(self) -> Floats:
        """Clocks by which a comparator is late, [cols]."""
        return self.converter.t_comp_delay_s * self.converter.f_clk_hz

    def highest(self) -> Floats:
        """Highest charge of a converter that packets keep up with."""
        pile = self.clocks * np.maximum(self.x - 0.5 * self.packet, 0.0)
        # Packets keep up in every clock, or only on the whole: then what comes early piles up.
        early = np.where(2.0 * self.high > self.packet, self.error, 0.0)
        return 2.0 * self.high + self.levels + pile + early

    def lowest(self) -> Floats:
        """Lowest charge of a converter."""
        packet = self.packet * (1.0 + SIGMAS * self.converter.packet_flicker) - 2.0 * np.maximum(
            self.low, 0.0
        )
        preset = W_PRESET - np.abs(self.converter.preset_error_v) / self.converter.packet_v()
        return np.minimum(-packet, preset) - self.levels - self.clocks * np.maximum(-self.low, 0.0)

    def quiet(self) -> NDArray[np.bool_]:
        """Where the count is that of the charge up to the last decision (docs/auto.md, "The last decision").

        No clock takes charge away, and three clocks after a decision began no level is in reach again before all of
        its packet has gone.
        """
        window = self.converter.v_hysteresis_v / self.output_v
        reach = (
            3.0 * self.high + 2.0 * np.asarray(self.levels) + window + self.packet * (self.delay + self.lag)
        )
        return (self.low >= 0.0) & (reach < self.packet)


Bounding = Callable[[Solved], Bound]


def honoured(_: Solved) -> Bound:
    """Engine closed does all of it."""
    return NONE


def unknown(_: Solved) -> Bound:
    """Keep every cell open: nothing is known."""
    return OPEN


# --- what moves the current within a gate ------------------------------------------------------------------------


def supply_ripple(s: Solved) -> Bound:
    """The sum of a sine over the gate, in closed form; a compressed one is bent by a second-order rest."""
    swing = np.asarray(s.swing)
    return Bound(swing * s.swing_sum, s.swing_bent, np.abs(swing) * s.swing_reach + s.swing_bent, level=False)


def motion(s: Solved) -> Bound:
    """The mean over the gate is solved; partial sums leave it."""
    return Bound(whole=s.moved, level=False)


def mirror_lag(s: Solved) -> Bound:
    """The charge of y' = y (x - y) / kappa is that of x less kappa ln(y at the end / y at the beginning)."""
    return Bound(0.0, s.late_known, np.abs(s.late) + s.late_known, level=False)


def settling_s(network: Network) -> float:
    """Time constant that no line's settling exceeds, in s; inf where grounded rows float."""
    n, (rows, cols) = network, network.g_taxel_s.shape
    largest = max(n.r_row_driven_ohm, n.r_row_grounded_ohm)
    along = float(n.r_column_ohm.max()) * (n.c_column_f + 2 * rows * n.c_taxel_f)
    along += n.r_trace_column_ohm * n.c_taxel_f * rows * (rows + 1)
    row_f = n.c_row_f + 2 * cols * n.c_taxel_f
    across = largest * row_f if row_f else 0.0
    return max(across + n.r_trace_row_ohm * n.c_taxel_f * cols * (cols + 1), along)


def unsettled(s: Solved) -> Floats | float:
    """Packets [frames, 1, cols] that lines which have not settled bring into a gate, at most; inf where unknown."""
    net, c = s.network, s.converter
    rows, cols = net.g_taxel_s.shape
    tau = settling_s(net)
    if tau == 0.0:
        return 0.0
    settle = s.timing.settle_clocks - s.timing.break_clocks
    rest = math.exp(-settle / c.f_clk_hz / tau) if tau < math.inf else 1.0
    if not rest < 0.25:
        return np.inf
    farads = rows * net.c_row_f + cols * net.c_column_f + 4 * rows * cols * net.c_taxel_f
    stored = math.sqrt(farads) * _SWITCHED * s.v_v
    side = 2.0 * rows * net.g_lateral_row_s if cols > 1 else 0.0
    onto = np.sqrt(s.clocks / c.f_clk_hz * (s.g_column_s + side) / 2.0)
    charge = (onto + 2.0 * math.sqrt(rows * net.c_taxel_f)) * stored * rest
    return charge * c.f_clk_hz * np.maximum(1.0, np.abs(c.gain)) / (c.k * c.i0_a)


def line_capacitance(s: Solved) -> Bound:
    """Charge of lines that have not settled; a slow mirror would keep what it saw before the gate."""
    if s.slow_mirror and settling_s(s.network) * s.converter.f_clk_hz > BRISK_CLOCKS:
        return OPEN
    found = unsettled(s)
    return Bound(0.0, found, found, level=False)


# --- levels ------------------------------------------------------------------------------------------------------


def comparator_hysteresis(s: Solved) -> Bound:
    """A quiet converter leaves the window after every packet, so it decides at the upper level."""
    window = s.converter.v_hysteresis_v / s.output_v
    return Bound(-0.5 * window, 0.0, 1.5 * window)


def comparator_delay(s: Solved) -> Bound:
    """A sample d clocks early misses d times the charge of a clock; after a packet also d of that packet."""
    d = s.delay
    middle = 0.5 * (s.low + s.high)
    return Bound(-d * middle, 0.5 * d * (s.high - s.low), d * (np.abs(s.high) + 2.0 * s.packet))


def integrator_bandwidth(s: Solved) -> Bound:
    """The output is late by the lag times its slope, and drops charge through what lies across the input."""
    lag = s.lag
    if np.any(lag > SLOW_CLOCKS):
        return OPEN
    drops = np.asarray(s.across) * lag * (s.highest() - s.lowest())
    with np.errstate(under="ignore", divide="ignore", over="ignore"):
        after = np.maximum(
            np.floor((s.packet - 2.0 * np.asarray(s.levels)) / np.maximum(s.high, 1e-9)) - 2.0, 0.0
        )
        tail = lag * s.packet * np.exp(-(after - s.delay) / np.where(lag > 0, lag, 1e-3))
    middle = 0.5 * (s.low + s.high)
    rest = 0.5 * lag * (s.high - s.low) + np.minimum(tail, lag * s.packet) + drops
    return Bound(-lag * middle, rest, lag * (np.abs(s.high) + 2.0 * s.packet) + drops)


def integrator_gain(s: Solved) -> Bound:
    """A leak takes its part of the charge in every clock."""
    leak = s.clocks * np.asarray(s.leak)
    limit = s.converter.range_v() / s.output_v
    low, high = np.maximum(s.lowest(), limit[0]), np.minimum(s.highest(), limit[1])
    rest = 0.5 * leak * (high - low)
    return Bound(-0.5 * leak * (high + low), rest, leak * np.maximum(np.abs(low), np.abs(high)), level=False)


def integrator_range(s: Solved) -> Bound:
    """Nothing where the charge stays inside, or where one at the upper limit has a packet every second clock."""
    c = s.converter
    low, high = c.range_v() / s.output_v
    error = np.asarray(s.levels)
    inside = (low <= s.lowest()) & (high >= s.highest())
    full = (
        (s.low >= 0.5 * s.packet + s.leak * np.minimum(high, 1e6))
        & (high >= s.packet + 2.0 * error)
        & (low <= s.lowest())
    )
    return Bound(0.0, np.where(inside | full, 0.0, np.inf), np.where(inside | full, 0.0, np.inf))


# --- random numbers ----------------------------------------------------------------------------------------------


def _drawn_once(sd: ArrayLike) -> Bound:
    """An error that is one normal number of the slot."""
    most = SIGMAS * np.asarray(sd)
    return Bound(random=most, drawn=0.0, drawn_whole=0.0)


def _path(s: Solved, variance: ArrayLike) -> Bound:
    """A Brownian path of some variance a clock: known at the end of its grid once it is drawn.

    A level that the path reaches before the last decision is lower by the charge that came since: 16 variance / x
    above the end of the path at most.
    """
    n = s.clocks
    span = 1 << (n - 1).bit_length()
    variance = np.asarray(variance)
    sigma = np.sqrt(variance)
    whole = SIGMAS * math.sqrt(n) * sigma
    bridge = SIGMAS * sigma * math.sqrt(n * (span - n) / span)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        climbs = np.where(variance > 0, (SIGMAS**2 / 4.0) * variance / np.maximum(s.low, 1e-30), 0.0)
    # The deviation grows a little with the current.
    return Bound(rest=np.minimum(climbs, whole) + 0.02 * whole, random=whole, drawn=bridge)


def thermal_noise(s: Solved) -> Bound:
    """White current of every conductance on the column."""
    c = s.converter
    packet_c = c.i0_a / c.f_clk_hz
    return _path(s, 2.0 * c.kt_noise_j * s.g_column_s * (c.gain / c.k) ** 2 / (c.f_clk_hz * packet_c**2))


def shot_noise(s: Solved) -> Bound:
    """An electron's charge squared for each that comes, of input and packets."""
    c = s.converter
    return _path(s, (c.q_shot_c * c.f_clk_hz / c.i0_a) * 2.0 * np.maximum(np.abs(s.low), np.abs(s.high)))


def clock_jitter(s: Solved) -> Bound:
    """Two edges a packet along the way, and the edge that samples."""
    jitter = s.converter.t_jitter_s * s.converter.f_clk_hz
    rate = np.minimum(np.maximum(np.abs(s.low), np.abs(s.high)), 0.5)
    path = _path(s, 2.0 * jitter**2 * rate)
    sample = SIGMAS * jitter * np.maximum(np.abs(s.low), np.abs(s.high))
    return path._replace(rest=path.rest + sample, whole=sample)


def comparator_noise(s: Solved) -> Bound:
    """Every decision has a level of its own."""
    most = SIGMAS * s.converter.v_comp_noise_v / s.output_v
    return Bound(random=most)


def metastability(s: Solved) -> Bound:
    """Half the aperture times the slope: a coin decides there."""
    half = 0.5 * s.converter.t_meta_s * s.converter.f_clk_hz * np.maximum(np.abs(s.low), np.abs(s.high))
    return Bound(0.0, half, 3.0 * half)


def ktc_noise(s: Solved) -> Bound:
    """One number at the start of the slot."""
    return _drawn_once(s.converter.v_preset_noise_v / s.converter.packet_v())


def flicker_noise(s: Solved) -> Bound:
    """One number for all packets of a slot, of the charge that came."""
    begins = np.abs(s.converter.preset_error_v) / s.converter.packet_v()
    came = s.clocks * np.maximum(np.abs(s.low), np.abs(s.high)) + begins
    gone = np.minimum(came / s.packet + 1.0, (s.clocks + 1) / 2)
    return _drawn_once(s.converter.packet_flicker * s.packet * gone)._replace(level=False)
