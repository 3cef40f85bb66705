# SPDX-License-Identifier: Apache-2.0
"""Error bounds of the filter: how far each effect moves a decision that `closed` made without it.

Everything is counted in packets and made from solved currents, cell by cell in one compiled loop.
docs/auto_proofs.md derives every line.
"""

import math
from collections import namedtuple

import numba

from dermis.bounds import SIGMAS, SLOW_CLOCKS
from dermis.converter.vfc import W_PRESET

# A quotient by a common divisor may become a product: bounds need no last digit.
_compiled = numba.njit(cache=True, error_model="numpy", forceinline=True, fastmath={"contract", "arcp"})


class Bound(namedtuple("Bound", "shift rest whole random path climb drawn loose")):
    """Error of an effect in one cell, in packets.

    In a quiet cell (`quiet`) the level at the last decision is off by `shift`, known to `rest`. In
    any cell no level is off by more than `whole`. `random` comes on top of both: SIGMAS standard
    deviations of a normal number that is independent of those of other effects, so that they add as
    squares; `path` is as many of the end of a Brownian path. In a quiet cell a decision before the last
    one may see `climb` more, and two decisions within three clocks see levels that are `loose` twice
    apart at most.

    Once the random numbers of the cell are drawn, `random`, `path` and `climb` are known in a quiet
    cell; in any other one `drawn` takes the place of the first two.
    """

    __slots__ = ()


_CELL_FIELDS = (
    "clocks root x low high swing swing_sum swing_reach swing_bent moved late "
    "late_known leak across thermal packet window delay lag limit_low limit_high preset "
    "noise aperture jitter shot preset_noise flicker"
)


class Cell(namedtuple("Cell", _CELL_FIELDS)):
    """A solved cell in packets and clocks.

    `x` is the mean charge a clock of what `closed` honours, `low` and `high` the least and largest
    in any clock of the gate. `swing` is the amplitude of the ripple on it, `swing_sum` the sum of
    its sine over the gate, `swing_bent` packets of second order of ripple and motion; `moved` the
    largest partial sum of what motion adds to the mean. A slow mirror is `late` packets over the gate, which `x` holds
    already, known to `late_known`. `leak` of the charge is lost a clock, and `across` of what an output has not
    followed yet (as in walk.Cells). `thermal` is the variance of its noise a clock. The others are those of the
    converter. `root` is the deviation of a path of variance 1 at the end of the gate.
    """

    __slots__ = ()


@_compiled
def _highest(s, levels, error):  # type: ignore
    """Highest charge of a converter that packets keep up with."""
    pile = s.clocks * max(s.x - 0.5 * s.packet, 0.0)
    # Packets keep up in every clock, or only on the whole: then what comes early piles up.
    return 2.0 * s.high + levels + pile + (error if 2.0 * s.high > s.packet else 0.0)


@_compiled
def _lowest(s, levels):  # type: ignore
    """Lowest charge of a converter."""
    packet = s.packet * (1.0 + SIGMAS * s.flicker) - 2.0 * max(s.low, 0.0)
    return min(-packet, W_PRESET - s.preset) - levels - s.clocks * max(-s.low, 0.0)


@_compiled
def quiet(s, loose, levels):  # type: ignore
    """Return True if the count is that of the highest level, with a packet at each crossing
    (docs/auto_proofs.md, "The last decision").

    No clock takes charge away, two clocks bring less than a packet, and the start is below the
    level. `loose` is half of what levels of two decisions may be off against each other, without
    what is late of packets; `levels` what start and level are off.
    """
    high = s.high + s.leak * (s.packet + levels)
    served = 2.0 * (high + loose) < s.packet * (1.0 - SIGMAS * s.flicker)
    return s.low >= 0.0 and served and levels < -W_PRESET


@_compiled
def late(s, loose, levels):  # type: ignore
    """Return the part of a packet, and of the window, that is outstanding at the next decision near the
    level, and what it may be off; `loose` and `levels` as in `quiet`.
    """
    lag, size = s.lag, SIGMAS * s.flicker * s.packet
    left = s.window + (s.packet + size) * (s.delay + lag)
    drift = s.leak * (s.packet + levels)
    high, low = s.high + drift, s.low - drift
    if 3.0 * high + 2.0 * loose + left < s.packet - size:
        return 0.0, 0.0
    # The comparator keeps its window: the packet before does not take the level below it.
    follows = 2.0 * (high + loose) + left < s.packet - size
    if not (follows and 3.0 * low - 2.0 * loose - left > s.packet + size):
        return 0.5 * left, 0.5 * left
    # Two clocks after a packet, the third one decides in any case.
    part = s.delay
    if lag > 0.0:
        part += lag * (1.0 - math.exp((s.delay - 1.0) / lag))
    return s.window + s.packet * part, part * size + s.across * lag * lag * s.packet


@_compiled
def _supply_ripple(s):  # type: ignore
    """The sum of a sine over the gate, in closed form; a compressed one is bent by a second-order rest."""
    whole = abs(s.swing) * s.swing_reach + s.swing_bent
    return Bound(s.swing * s.swing_sum, s.swing_bent, whole, 0.0, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _motion(s):  # type: ignore
    """The mean over the gate is solved, but for what compression bends; partial sums leave it."""
    return Bound(0.0, s.swing_bent, s.moved + s.swing_bent, 0.0, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _mirror_lag(s):  # type: ignore
    """The charge of y' = y (x - y) / kappa is that of x less kappa ln(y at the end / y at the beginning)."""
    return Bound(0.0, s.late_known, abs(s.late) + s.late_known, 0.0, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _comparator_hysteresis(s):  # type: ignore
    """A quiet converter leaves the window after every packet, so it decides at the upper level."""
    return Bound(-0.5 * s.window, 0.0, 1.5 * s.window, 0.0, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _comparator_delay(s):  # type: ignore
    """A sample d clocks early misses d times the charge of a clock; after a packet also d of that packet."""
    whole = s.delay * (abs(s.high) + 2.0 * s.packet)
    rest = 0.5 * s.delay * (s.high - s.low)
    return Bound(-0.5 * s.delay * (s.low + s.high), rest, whole, 0.0, 0.0, 0.0, 0.0, rest)


@_compiled
def _integrator_bandwidth(s, levels, error):  # type: ignore
    """The output is late by the lag times its slope, and drops charge through what lies across the input."""
    lag = s.lag
    if lag > SLOW_CLOCKS:
        return Bound(0.0, math.inf, math.inf, 0.0, 0.0, 0.0, 0.0, math.inf)
    drops = s.across * lag * (_highest(s, levels, error) - _lowest(s, levels)) if lag > 0.0 else 0.0
    # Two clocks behind a packet `late` has what is left of it; a quiet converter's next one comes no sooner.
    after = max(math.floor((s.packet - 2.0 * levels) / max(s.high, 1e-9)) - 2.0, 1.0)
    steps = (after - s.delay) / max(lag, 1e-3)
    tail = lag * s.packet * (math.exp(-max(steps, 0.0)) if steps < 60.0 else 1e-26)
    rest = 0.5 * lag * (s.high - s.low) + tail + drops
    whole = lag * (abs(s.high) + 2.0 * s.packet) + drops
    return Bound(-0.5 * lag * (s.low + s.high), rest, whole, 0.0, 0.0, 0.0, 0.0, rest)


@_compiled
def _integrator_gain(s, levels, error):  # type: ignore
    """A leak takes its part of the charge in every clock."""
    leak = s.clocks * s.leak
    lowest, highest = _lowest(s, levels), _highest(s, levels, error)
    low, high = max(lowest, s.limit_low), min(highest, s.limit_high)
    mean, off = 0.5 * (high + low), 0.5 * (high - low)
    saw, saw_off = _sawtooth(s, levels, error)
    if saw_off < off and low == lowest and high == highest:
        mean, off = saw, saw_off
    return Bound(-leak * mean, leak * off, leak * max(abs(low), abs(high)), 0.0, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _sawtooth(s, levels, error):  # type: ignore
    """Mean charge over the gate of a quiet converter, and what it may be off.

    From one decision to the next the charge goes from u - p to u', both u within the charge of a
    clock; a packet stays another half to one and a half clocks. The first tooth begins at W_PRESET,
    the last one may be cut anywhere.
    """
    came, p = s.clocks * s.x, s.packet
    least, most = s.low - s.leak * (p + levels), s.high + s.leak * (p + levels)
    if least <= 0.0 or came <= 4.0 * error:
        return 0.0, math.inf
    bent = (most - least) / (most + least)
    off = most + 0.5 * p * bent + levels + SIGMAS * s.flicker * p + p * (5.0 + s.lag) / s.clocks
    if came <= -W_PRESET:
        return W_PRESET + 0.5 * came, off + error / s.clocks
    first, last = -0.5 * W_PRESET * (p + W_PRESET), p * p / 16.0
    known = (first + last) * (most / least - 1.0 + error / came)
    return 1.5 * s.x - 0.5 * p + (first - last) / came, off + (last + known) / came


@_compiled
def _integrator_range(s, levels, error, factor):  # type: ignore
    """No error if the charge stays inside, or if a charge at the upper limit has a packet every second clock.

    Nor where no charge that a gate brings lifts one at the lower limit to a decision. `factor` is
    that of this effect: its bound is the reach of the charge.
    """
    below = s.limit_low <= factor * _lowest(s, levels)
    below = below or s.limit_low + factor * (s.clocks * max(s.high, 0.0) + error + levels) < 0.0
    inside = below and s.limit_high >= factor * _highest(s, levels, error)
    enough = s.low >= 0.5 * s.packet + s.leak * min(s.limit_high, 1e6)
    full = below and enough and s.limit_high >= s.packet + 2.0 * levels
    clips = 0.0 if inside or full else math.inf
    return Bound(0.0, clips, clips, 0.0, 0.0, 0.0, 0.0, clips)


@_compiled
def _path(s, variance, sample):  # type: ignore
    """A Brownian path of some variance a clock; a level `sample` beside.

    A level that the path reaches before the last decision is lower by the charge that came since:
    16 variance / x above the end of the path at most.
    """
    whole = SIGMAS * math.sqrt(variance) * s.root
    climbs = (SIGMAS**2 / 4.0) * variance / max(s.low, 1e-30)
    # The deviation grows a little with the current.
    climb = min(climbs, whole) + 0.02 * whole + sample
    near = whole * (math.sqrt(0.75) / s.root)
    return Bound(0.0, 0.0, sample, 0.0, whole, climb, whole, near + sample)


@_compiled
def _thermal_noise(s):  # type: ignore
    """White current of every conductance on the column."""
    return _path(s, s.thermal, 0.0)


@_compiled
def _shot_noise(s):  # type: ignore
    """An electron's charge squared for each that comes, of input and packets."""
    return _path(s, 2.0 * s.shot * max(abs(s.low), abs(s.high)), 0.0)


@_compiled
def _clock_jitter(s):  # type: ignore
    """Two edges a packet along the way, and the edge that samples."""
    most = max(abs(s.low), abs(s.high))
    return _path(s, 2.0 * s.jitter**2 * min(most, 0.5), SIGMAS * s.jitter * most)


@_compiled
def _comparator_noise(s):  # type: ignore
    """Every decision has its own level."""
    most = SIGMAS * s.noise
    return Bound(0.0, 0.0, 0.0, most, 0.0, 0.0, most, most)


@_compiled
def _metastability(s):  # type: ignore
    """Half the aperture times the slope: the decision there is random."""
    half = s.aperture * max(abs(s.low), abs(s.high))
    return Bound(0.0, half, 3.0 * half, 0.0, 0.0, 0.0, 0.0, 3.0 * half)


@_compiled
def _ktc_noise(s):  # type: ignore
    """One number at the start of the slot."""
    return Bound(0.0, 0.0, 0.0, SIGMAS * s.preset_noise, 0.0, 0.0, 0.0, 0.0)


@_compiled
def _flicker_noise(s, levels):  # type: ignore
    """One number for all packets of a slot: those of the charge that came and of the way to the level."""
    came = s.clocks * max(abs(s.low), abs(s.high)) + levels
    gone = min(came / s.packet + 1.0, 0.5 * (s.clocks + 1))
    return Bound(0.0, 0.0, 0.0, SIGMAS * s.flicker * s.packet * gone, 0.0, 0.0, 0.0, 0.0)


class _Sum(namedtuple("_Sum", "shift rest whole error levels squares paths climb drawn loose")):
    """Sums over the effects so far: those of Bound, all errors and those that move levels, squares, and `quiet`'s."""

    __slots__ = ()


@_compiled
def _add(sums, tally, factor, moves, b):  # type: ignore
    """Add the bound of an effect; `moves` if it moves levels and not the charge that comes.

    `tally` [4] keeps its largest shift and error, and what of it this cell is left with if it is
    quiet, and if not, once the random numbers are drawn. Without branches, or it takes most of the
    time.
    """
    rest, whole, random, path = factor * b.rest, factor * b.whole, factor * b.random, factor * b.path
    most = whole + random + path
    caused = factor * abs(b.shift)
    tally[0] = caused if caused > tally[0] else tally[0]
    tally[1] = most if most > tally[1] else tally[1]
    tally[2], tally[3] = rest, whole + factor * b.drawn
    return _Sum(
        sums.shift + factor * b.shift,
        sums.rest + rest,
        sums.whole + whole,
        sums.error + most,
        sums.levels + (most if moves else 0.0),
        sums.squares + random * random,
        sums.paths + path * path,
        sums.climb + factor * b.climb,
        sums.drawn + (factor * b.drawn) ** 2,
        sums.loose + factor * b.loose,
    )


@_compiled
def total(s, on, levels, tally):  # type: ignore
    """Sum of the bounds that are on; the last three take what the others add up to.

    `tally` [COUNT, 4] is as `_add` takes it.
    """
    a = _Sum(0.0, 0.0, 0.0, 0.0, levels, 0.0, 0.0, 0.0, 0.0, 0.0)
    if on[0] > 0.0:
        a = _add(a, tally[0], on[0], False, Bound(0.0, math.inf, math.inf, 0.0, 0.0, 0.0, 0.0, 0.0))
    if on[1] > 0.0:
        a = _add(a, tally[1], on[1], False, _supply_ripple(s))
    if on[2] > 0.0:
        a = _add(a, tally[2], on[2], False, _motion(s))
    if on[3] > 0.0:
        a = _add(a, tally[3], on[3], False, _mirror_lag(s))
    if on[4] > 0.0:
        a = _add(a, tally[4], on[4], True, _comparator_hysteresis(s))
    if on[5] > 0.0:
        a = _add(a, tally[5], on[5], True, _comparator_delay(s))
    if on[9] > 0.0:
        a = _add(a, tally[9], on[9], True, _thermal_noise(s))
    if on[10] > 0.0:
        a = _add(a, tally[10], on[10], True, _shot_noise(s))
    if on[11] > 0.0:
        a = _add(a, tally[11], on[11], True, _clock_jitter(s))
    if on[12] > 0.0:
        a = _add(a, tally[12], on[12], True, _comparator_noise(s))
    if on[13] > 0.0:
        a = _add(a, tally[13], on[13], True, _metastability(s))
    if on[14] > 0.0:
        a = _add(a, tally[14], on[14], True, _ktc_noise(s))
    if on[15] > 0.0:
        a = _add(a, tally[15], on[15], False, _flicker_noise(s, a.levels))
    if on[6] > 0.0:
        a = _add(a, tally[6], on[6], True, _integrator_bandwidth(s, a.levels, a.error))
    if on[7] > 0.0:
        a = _add(a, tally[7], on[7], False, _integrator_gain(s, a.levels, a.error))
    if on[8] > 0.0:
        a = _add(a, tally[8], on[8], True, _integrator_range(s, a.levels, a.error, on[8]))
    return a
