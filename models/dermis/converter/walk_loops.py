# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of the event engine: charge balance of many cells at once, clock by clock.

A loop is compiled for each combination of arguments that are None: noise, a lagging output, and what
makes a clock more than one step (a window of the comparator, a range of the charge). numba removes
what stands behind `is not None`, for arguments alone and not for fields of a record. Every other
effect that is off has the number that does nothing.

Cells run side by side (the inner loop is over cells and becomes vector instructions), because a
cell by itself waits for the result of its own last clock. Cells in a special state (a decision
within noise of its level, a comparator inside its window, a charge at a limit) are marked there and
computed afterwards, one at a time.
"""

import math
from collections import namedtuple

import numba
import numpy as np

from dermis.converter.noise import COIN, EDGE, LEVEL, normal, span_of, walk_between, walk_grid

# Cells side by side: their state and coefficients (some 30 doubles a cell) stay in a 48 kB cache.
BLOCK = 128

Flat = namedtuple("Flat", "x leak w0 packet rise fall low high delay lag across")
"""Fields of walk.Cells as `walk` takes them, [n] each, contiguous."""

# Rows of the noise that `walk` takes.
SIGMA, WHITE, SLOPE, APERTURE = range(4)

# Places of the working array of `walk`, a value of BLOCK cells each. State: both parts of the output, now and a clock
# before; the last three decisions, newest first; ones so far; charge of the clock; the comparator, also before it.
(A, B, OLD_A, OLD_B, Q1, Q2, Q3, ONES, X, UP, WAS_UP) = range(0, 11 * BLOCK, BLOCK)
# The two exponentials of a converter (`modes`): what a clock keeps of each, what charge gives, what the packet of a
# clock takes away and one that begins inside it.
(KEEP_A, GAIN_A, TAKE_A, HALF_A, RATE_A, DRIVE_A, WEIGHT_A) = range(11 * BLOCK, 18 * BLOCK, BLOCK)
(KEEP_B, GAIN_B, TAKE_B, HALF_B, RATE_B, DRIVE_B, WEIGHT_B) = range(18 * BLOCK, 25 * BLOCK, BLOCK)
# The same of the sample before the clock edge, and where that is; rows of the noise.
(EARLY_A, EARLY_B, EARLY_X, EARLY_2, EARLY_1, AT) = range(25 * BLOCK, 31 * BLOCK, BLOCK)
(PATH, OF_LEVEL, OF_EDGE, COIN_AT) = range(31 * BLOCK, 35 * BLOCK, BLOCK)
# Packet, levels, lag and range; a charge outside NEAR_LOW..NEAR_HIGH is looked at closely. Eight deviations of a
# sample; the sample without noise; the path on its grid and its step a clock; outputs between which noise can decide,
# and the charge a clock up to which the next sample may be there as well.
(PACKET, RISE, FALL, FOLLOWS, LOW, HIGH, NEAR_LOW, NEAR_HIGH, LEAST, MOST) = range(
    35 * BLOCK, 45 * BLOCK, BLOCK
)
(REST, SAMPLE, DRIFT, CREEP, LOWEST, HIGHEST, STAY) = range(45 * BLOCK, 52 * BLOCK, BLOCK)
# Of coupled columns: the charge of the clock without the others, the part of an output by which its virtual ground
# is off, how far it is off on the mean of the clock, what the others give in the clock, and the sum of that.
(ALONE, SHARE, GROUND, GIVES, GIVEN, PLACES) = range(52 * BLOCK, 58 * BLOCK, BLOCK)

# Charge a clock up to which a limit is seen inside a clock too; more ends at the limit anyway.
SLOPE_MAX = 2.0
_compiled = numba.njit(cache=True, error_model="numpy")
# A part of every clock of every cell: numba puts it in before it looks at types, so that what is None falls away there
# as well. Parts that run seldom are calls: put in, they would be compiled with every kind of `walk`.
_part = numba.njit(inline="always", error_model="numpy")
# Distance in packets from a limit up to which a charge counts as at the limit.
AT_LIMIT = 1e-14
# Clocks of lag up to which the output of a clock is that of its own charge to a fifth.
SWIFT = 0.1


@numba.njit(cache=True)
def plain(x, w0, packet, rise, clocks, charge_delay, counts, w_end):  # type: ignore
    """The ideal converter: n * x is rounded once and never summed up, so this is the closed formula to the last bit.

    Whenever a decision is open, every packet before it is complete, so the delay of the charge does
    not enter.
    """
    for i in range(x.size):
        start = rise[i] - w0[i]
        level = start
        ones = 0
        last = False
        before = False
        for n in range(1, clocks + 1):
            before = last
            last = not last and n * x[i] >= level
            if last:
                ones += 1
                level = start + ones * packet[i]
        counts[i] = ones
        gone = ones - last - before * charge_delay
        w_end[i] = w0[i] + (clocks * x[i] - gone * packet[i])


@_compiled
def _grow(rate, length):  # type: ignore
    """Integral of exp(rate t) over 0..length."""
    return length if rate == 0.0 else math.expm1(rate * length) / rate


@_compiled
def grid_step(sigma, clocks):  # type: ignore
    """Return the cheapest grid of the Brownian paths in clocks; the paths themselves do not depend on it.

    A number costs about 20 ns; a decision looked at closely, 100 ns; it is where the level is
    within 8 sigma of what the grid leaves open, sqrt(step) / 2.
    """
    span, typical = span_of(clocks), sigma.mean()
    best, least = 8, np.inf
    for power in range(3, 13):
        step = 1 << power
        cost = 20.0 * span / step + 100.0 * clocks * min(1.0, 8.0 * typical * math.sqrt(step))
        if cost < least:
            best, least = step, cost
    return min(best, span)


@_compiled
def modes(w0, leak, across, lag):  # type: ignore
    """(rate, drive, weight, start) of both exponentials; nothing of the second where the output does not lag.

    The charge w and the output v (both in packets, v = w when settled) obey w' = i - across (w - v)
    - leak v and v' = (w - v) / lag. Their matrix always has two distinct real eigenvalues: the one
    near -leak carries the charge, the one beyond -1 / lag the part that the output still lags
    behind. The states here are the two parts of v, v = a + b, and w = weight_a a + weight_b b.
    """
    if lag == 0.0:
        return (-leak, 1.0, 1.0, w0), (0.0, 0.0, 0.0, 0.0)
    loaded, leaks = across * lag, leak * lag
    root = math.sqrt((loaded - 1.0) ** 2 + 4.0 * (loaded - leaks))
    total = 1.0 + loaded + root
    # 1 + rate lag without the difference of two near equals
    weight = (1.0 - loaded - root) / 2
    if loaded < 1.0:
        weight = -2.0 * (loaded - leaks) / (1.0 - loaded + root)
    start = -w0 * 2.0 * leaks / (total * root)
    slow = -2.0 * leak / total, 1.0 / root, 1.0 - 2.0 * leaks / total, w0 - start
    return slow, (-total / (2.0 * lag), -1.0 / root, weight, start)


@_compiled
def modes_of(cells):  # type: ignore
    """Return `modes` of all cells of a Flat, [2, 4, n]."""
    out = np.empty((2, 4, cells.w0.size))
    for i in range(cells.w0.size):
        slow, fast = modes(cells.w0[i], cells.leak[i], cells.across[i], cells.lag[i])
        for k in range(4):
            out[0, k, i], out[1, k, i] = slow[k], fast[k]
    return out


@_compiled
def _after(mode, start, current, time):  # type: ignore
    """A part of the output after some time of constant current."""
    rate, drive, _ = mode
    return math.exp(rate * time) * start + drive * current * _grow(rate, time)


@_compiled
def _slope(mode, start, current, time):  # type: ignore
    """Slope of `_after`."""
    rate, drive, _ = mode
    return math.exp(rate * time) * (rate * start + drive * current)


@_compiled
def _piece(slow, fast, a, b, lag, current, length, low, high):  # type: ignore
    """Return (a, b) after a piece of constant current, and the turning point of the output inside it, or nan.

    The charge stops at low and high. a + b is the output, (w - output) / lag its slope.
    """
    weight_a, weight_b = slow[2], fast[2]
    lags, turn = fast[0] != 0.0, math.nan
    w = weight_a * a + weight_b * b
    if lags:
        # A charge at its limit that is pushed further stays there.
        push = weight_a * _slope(slow, a, current, 0.0) + weight_b * _slope(fast, b, current, 0.0)
        if (w >= high - AT_LIMIT and push > 0.0) or (w <= low + AT_LIMIT and push < 0.0):
            limit = high if push > 0.0 else low
            output = limit + (a + b - limit) * math.exp(-length / lag)
            end_a = (limit - weight_b * output) / (weight_a - weight_b)
            return end_a, output - end_a, turn
    end_a, end_b = _after(slow, a, current, length), _after(fast, b, current, length)
    w_end = weight_a * end_a + weight_b * end_b
    if w_end > high or w_end < low:
        limit = high if w_end > high else low
        if not lags:
            return limit / weight_a, 0.0, turn
        # Beyond the limit the charge would go straight on: find when it gets there, then the output follows a
        # constant charge. The charge is nearly a straight line, so Newton's steps are few; halving
        # keeps them inside.
        left, right = 0.0, length
        if (w - limit) * (w_end - limit) >= 0.0:
            right = 0.0
        time = length * (limit - w) / (w_end - w) if right > 0.0 else 0.0
        for _ in range(60 if right > 0.0 else 0):
            miss = weight_a * _after(slow, a, current, time) - limit
            miss += weight_b * _after(fast, b, current, time)
            slope = weight_a * _slope(slow, a, current, time) + weight_b * _slope(fast, b, current, time)
            if miss * (w_end - limit) >= 0.0:
                right = time
            else:
                left = time
            step = -miss / slope if slope != 0.0 else 0.0
            after = time + step
            if not left <= after <= right:
                after = 0.5 * (left + right)
            # Four roundings of the time: Newton cannot move it any more.
            if abs(after - time) <= 1e-15 * length:
                break
            time = after
        output = _after(slow, a, current, time) + _after(fast, b, current, time)
        output = limit + (output - limit) * math.exp(-(length - time) / lag)
        end_a = (limit - weight_b * output) / (weight_a - weight_b)
        return end_a, output - end_a, turn
    if lags:
        slope, bend = _slope(slow, a, current, 0.0), _slope(fast, b, current, 0.0)
        if (slope + bend) * (_slope(slow, a, current, length) + _slope(fast, b, current, length)) < 0.0:
            time = math.log(-bend / slope) / (slow[0] - fast[0])
            turn = _after(slow, a, current, time) + _after(fast, b, current, time)
    return end_a, end_b, turn


@_compiled
def _is_high(value, rise, fall, state):  # type: ignore
    """State of the comparator at an output; where that is nan, the one before."""
    return value >= rise or (state and not value < fall)


@_compiled
def _closely(  # type: ignore
    slow, fast, a, b, lag, x, packet, before, last, late, sample, rise, fall, shift, low, high, state
):
    """One clock of one cell, piece by piece: (seen, sampled output, state, a, b); `shift` moves the sample alone."""
    seen, sampled, now = state, a + b, 0.0
    for k in range(3):
        until = min(sample, late) if k == 0 else (max(sample, late) if k == 1 else 1.0)
        if until > now:
            current = x - packet * (before if until <= late else last)
            a, b, turn = _piece(slow, fast, a, b, lag, current, until - now, low, high)
            state = _is_high(a + b, rise, fall, _is_high(turn, rise, fall, state))
            now = until
        if until == sample:
            sampled = a + b
            seen = state if shift == 0.0 else _is_high(sampled + shift, rise, fall, state)
    return seen, sampled, state, a, b


@_compiled
def _load_mode(own, keep, c, mode, packet, late):  # type: ignore
    """Load one exponential into the places from `keep` on."""
    rate, drive, weight, _ = mode
    gain, last = drive * _grow(rate, 1.0), drive * _grow(rate, 1.0 - late)
    taken, begun = packet * (gain - last), packet * drive * _grow(rate, 1.0 - late)
    for k, value in enumerate((math.exp(rate), gain, taken, begun, rate, drive, weight)):
        own[keep + k * BLOCK + c] = value


@_compiled
def _load(own, c, cells, i, late, lags, early, limits):  # type: ignore
    """Begin with cell i at place c.

    Inside a clock the charge may be farther out than at both edges: by less than lag times a slope where the
    output lags, and by a packet that begins there. A charge so near its range at an edge is looked at closely
    (NEAR_LOW, NEAR_HIGH). Where it goes one way through a clock, LEAST and MOST bound its end as its range does.
    """
    own[Q1 + c] = own[Q2 + c] = own[Q3 + c] = own[ONES + c] = 0.0
    packet, lag = cells.packet[i], cells.lag[i]
    slow, fast = modes(cells.w0[i], cells.leak[i], cells.across[i], lag)
    _load_mode(own, KEEP_A, c, slow, packet, late)
    own[A + c], own[PACKET + c], own[RISE + c], own[FALL + c] = slow[3], packet, cells.rise[i], cells.fall[i]
    if lags is not None:
        _load_mode(own, KEEP_B, c, fast, packet, late)
        own[B + c], own[FOLLOWS + c] = fast[3], lag
    if early is not None:
        sample = 1.0 - cells.delay[i]
        behind = max(sample - late, 0.0)
        whole = slow[1] * _grow(slow[0], sample) + fast[1] * _grow(fast[0], sample)
        last = slow[1] * _grow(slow[0], behind) + fast[1] * _grow(fast[0], behind)
        own[EARLY_A + c], own[EARLY_B + c] = math.exp(slow[0] * sample), math.exp(fast[0] * sample)
        own[EARLY_X + c], own[EARLY_2 + c], own[EARLY_1 + c] = whole, packet * (whole - last), packet * last
        own[AT + c] = sample
    if limits is not None:
        low, high, inside = cells.low[i], cells.high[i], lag * (SLOPE_MAX + packet)
        own[UP + c] = 1.0 if slow[3] + fast[3] >= cells.rise[i] else 0.0
        own[LOW + c], own[HIGH + c], own[NEAR_LOW + c], own[NEAR_HIGH + c] = (
            low,
            high,
            low + inside,
            high - inside,
        )
        own[LEAST + c], own[MOST + c] = -np.inf, np.inf
        if late < 1.0:
            own[NEAR_LOW + c] += SLOPE_MAX
            own[NEAR_HIGH + c] -= packet
        elif lags is None:
            own[LEAST + c], own[MOST + c] = low, high


@_compiled
def _load_noise(own, c, i, late, noise, step):  # type: ignore
    """Load how far noise may move the output of a cell, on a path laid out every `step` clocks."""
    for k in range(4):
        own[PATH + k * BLOCK + c] = noise[k, i]
    # Eight standard deviations: beyond them a decision is wrong once in 1e15.
    own[REST + c] = 8.0 * math.hypot(noise[WHITE, i], noise[SLOPE, i]) + noise[APERTURE, i]
    reach = 4.0 * noise[SIGMA, i] * math.sqrt(step) + own[REST + c]
    own[HIGHEST + c], own[LOWEST + c] = own[RISE + c] + reach, own[FALL + c] - reach
    # A clock takes the output farther than this, unless it follows late or a packet begins inside. What leaks away
    # brings it back.
    back = (1.0 - own[KEEP_A + c]) * max(abs(own[HIGHEST + c]), abs(own[LOWEST + c]))
    own[STAY + c] = (2.0 * (own[HIGHEST + c] - own[LOWEST + c]) / own[AT + c] + back) / own[GAIN_A + c]
    if late < 1.0 or own[FOLLOWS + c] > SWIFT:
        own[STAY + c] = np.inf
    if own[FALL + c] == own[RISE + c]:  # a comparator without a window keeps no state
        own[STAY + c] = -1.0


@_part
def _within(own, c, value):  # type: ignore
    """Keep an output in its range."""
    value = value if value > own[LEAST + c] else own[LEAST + c]
    return value if value < own[MOST + c] else own[MOST + c]


@_part
def _charge(own, c, a, b, lags):  # type: ignore
    """Return the charge that belongs to both parts of an output."""
    w = a
    if lags is not None:
        w = own[WEIGHT_A + c] * a + own[WEIGHT_B + c] * b
    return w


@_part
def _stays(own, c):  # type: ignore
    """Return True if an output may still be near its level at the next sample."""
    return (abs(own[X + c]) <= own[STAY + c]) | (abs(own[X + c] - own[PACKET + c]) <= own[STAY + c])


@_part
def _marked(own, c, sample, a, b, lags, noise):  # type: ignore
    """Return whether a clock must be decided again, its sample, and the output at its end.

    It must where noise, the window of the comparator or the range may change the decision. `a` and `b` are the
    parts of the output at the end of the clock; sample and output are returned with the noise on the grid.
    """
    w = _charge(own, c, a, b, lags)
    mark = (w < own[NEAR_LOW + c]) | (w > own[NEAR_HIGH + c])
    if noise is None:
        low, high, end = own[FALL + c], own[RISE + c], a + b
        return mark | ((sample >= low) & (sample < high)) | ((end >= low) & (end < high)), sample, end
    low, high = own[LOWEST + c], own[HIGHEST + c]
    own[SAMPLE + c] = sample
    own[DRIFT + c] += own[CREEP + c]
    moved, end = sample + own[DRIFT + c], a + b + own[DRIFT + c]
    # The comparator's state at the end of the clock matters where the next sample may be near.
    stays = _stays(own, c)
    mark = mark | ((moved >= low) & (moved < high) & ((own[Q1 + c] == 0.0) | stays))
    return mark | (stays & (end >= low) & (end < high)), moved, end


@_part
def _ahead(own, c, lags, limits):  # type: ignore
    """Return both parts of the output at the end of a clock."""
    a, b, x, q1, q2 = own[A + c], own[B + c], own[X + c], own[Q1 + c], own[Q2 + c]
    new_a = own[KEEP_A + c] * a + own[GAIN_A + c] * x - own[TAKE_A + c] * q2 - own[HALF_A + c] * q1
    new_b = 0.0
    if limits is not None:
        new_a = _within(own, c, new_a)
    if lags is not None:
        new_b = own[KEEP_B + c] * b + own[GAIN_B + c] * x - own[TAKE_B + c] * q2 - own[HALF_B + c] * q1
    return new_a, new_b


@_compiled
def _by_pieces(own, c, a, b, before, last, late, of_charge, of_sample, state):  # type: ignore
    """Take a cell through a clock from both parts of its output piece by piece; return as `_closely`."""
    slow = own[RATE_A + c], own[DRIVE_A + c], own[WEIGHT_A + c]
    fast = own[RATE_B + c], own[DRIVE_B + c], own[WEIGHT_B + c]
    return _closely(
        slow, fast, a, b, own[FOLLOWS + c], own[X + c], own[PACKET + c], before, last, late, own[AT + c],
        own[RISE + c] - of_charge, own[FALL + c] - of_charge, of_sample, own[LOW + c], own[HIGH + c], state,
    )  # fmt: skip


@_compiled
def _couple(own, wide, links, time, late, lags, limits):  # type: ignore
    """Add to the charge of a clock what other columns of the row give way to.

    A virtual ground is off by what the output lags behind the charge, whose integral over a clock is the lag times the
    change of the output, and by its share of the output. The end of the clock is taken from the charge that the others
    gave in the clock before, piece by piece near the range. `time` runs from -1/2 to 1/2 over the gate.
    """
    cols = links.shape[2]
    for c in range(wide):
        own[X + c] = own[ALONE + c] + own[GIVES + c]
        a, b = _ahead(own, c, lags, limits)
        before, end = own[A + c] + own[B + c], a + b
        w = _charge(own, c, a, b, lags)
        if w > own[NEAR_HIGH + c] or w < own[NEAR_LOW + c]:
            _, _, _, a, b = _by_pieces(
                own, c, own[A + c], own[B + c], own[Q2 + c], own[Q1 + c], late, 0.0, 0.0, True
            )
            end = a + b
        own[GROUND + c] = own[FOLLOWS + c] * (end - before) + own[SHARE + c] * 0.5 * (before + end)
    for c in range(wide):
        gives, row, first = 0.0, links[c], c - c % cols
        for d in range(cols):
            gives += (row[0, d] + time * row[1, d]) * own[GROUND + first + d]
        own[X + c], own[GIVES + c] = own[ALONE + c] + gives, gives
        own[GIVEN + c] += gives


@_part
def _clock(own, marks, c, lags, early, limits, noise):  # type: ignore
    """Take a cell through one clock; where its decision is not known for certain, mark it."""
    a, b, x, q1, q2 = own[A + c], own[B + c], own[X + c], own[Q1 + c], own[Q2 + c]
    new_a, new_b = _ahead(own, c, lags, limits)
    sample = new_a + new_b
    if early is not None:
        sample = own[EARLY_A + c] * a + own[EARLY_X + c] * x - own[EARLY_2 + c] * q2 - own[EARLY_1 + c] * q1
        if lags is not None:
            sample += own[EARLY_B + c] * b
    if limits is not None:
        sample = _within(own, c, sample)
        marks[c], sample, end = _marked(own, c, sample, new_a, new_b, lags, noise)
        own[WAS_UP + c] = own[UP + c]
        own[UP + c] = 1.0 if end >= own[RISE + c] else 0.0
        own[OLD_A + c], own[OLD_B + c], own[Q3 + c] = a, b, q2
    one = (sample >= own[RISE + c]) & (q1 == 0.0)
    own[Q2 + c] = q1
    own[Q1 + c] = 1.0 if one else 0.0
    own[ONES + c] += own[Q1 + c]
    own[A + c] = new_a
    if lags is not None:
        own[B + c] = new_b


@_compiled
def _noise_of(own, grid, n, step, c, inside, key):  # type: ignore
    """Draw the noise of a marked clock: (that of the charge, that of the sample alone)."""
    top, bottom, rest = own[RISE + c], own[FALL + c], own[REST + c]
    left = (n + 1) // step
    right = left if left * step == n + 1 else left + 1
    low = high = own[SAMPLE + c]
    if _stays(own, c):
        output = own[A + c] + own[B + c]
        low, high = min(low, output), max(high, output)
    if not inside:
        # A charge that stops at its range is not where it would be: what decides is not known yet.
        low, high = -np.inf, np.inf
    of_charge = own[PATH + c] * walk_between(
        key, n + 1, left * step, right * step, grid[c, left], grid[c, right], own[PATH + c],
        bottom - rest - high, top + rest - low,
    )  # fmt: skip
    of_sample, moved = 0.0, own[SAMPLE + c] + of_charge
    if not inside or abs(moved - top) <= rest or abs(moved - bottom) <= rest:
        if own[OF_LEVEL + c] > 0.0:
            of_sample = own[OF_LEVEL + c] * normal(key, LEVEL, n + 1)
        if own[OF_EDGE + c] > 0.0:
            of_sample += own[OF_EDGE + c] * normal(key, EDGE, n + 1)
    return of_charge, of_sample


@_compiled
def _decide_again(own, grid, n, step, late, c, i, lags, noise, keys):  # type: ignore
    """Decide a marked clock with its noise, its range and the state of its comparator."""
    clear, seen, of_charge, of_sample, moved = False, False, 0.0, 0.0, 0.0
    w = _charge(own, c, own[A + c], own[B + c], lags)
    inside = own[NEAR_LOW + c] <= w <= own[NEAR_HIGH + c]
    state = own[WAS_UP + c] != 0.0
    active = own[FALL + c] if state else own[RISE + c]
    if noise is not None:
        of_charge, of_sample = _noise_of(own, grid, n, step, c, inside, keys[i])
        moved = own[SAMPLE + c] + of_charge + of_sample
        end = own[A + c] + own[B + c] + of_charge
        seen = moved >= own[RISE + c]
        clear = inside and (seen or moved < own[FALL + c])
        if _stays(own, c):
            clear = clear and (end >= own[RISE + c] or end < own[FALL + c])
        if clear:
            state = end >= own[RISE + c]
    if not clear:
        seen, sampled, state, a, b = _by_pieces(
            own,
            c,
            own[OLD_A + c],
            own[OLD_B + c],
            own[Q3 + c],
            own[Q2 + c],
            late,
            of_charge,
            of_sample,
            state,
        )
        moved = sampled + of_charge + of_sample
        if not inside:
            own[A + c], own[B + c] = a, b
    own[UP + c] = 1.0 if state else 0.0
    if noise is not None:
        if abs(moved - active) < own[COIN_AT + c]:
            seen = normal(keys[i], COIN, n + 1) < 0.0
    bit = 1.0 if seen and own[Q2 + c] == 0.0 else 0.0
    own[ONES + c] += bit - own[Q1 + c]
    own[Q1 + c] = bit


@_compiled
def walk(  # type: ignore
    clocks, late, x, cells, lags, early, limits, noise, keys, step, links, begin, stop, counts, end, given
):
    """Count the ones of `clocks` decisions for every cell; the charge after the last one into `end`.

    Parameters
    ----------
    clocks, late : decisions, and clocks between a decision and the beginning of its packet
    x : [1 or clocks, stop - begin], charge of every clock, or the one charge of all clocks
    cells : Flat
    lags : True, or None if no output lags
    early : True, or None if all samples are at the clock edge; without `limits` only
    limits : True, or None if there is no range, no noise, and `fall` is `rise`
    noise : [4, n], keys : [n], step : int, or all None
        What is random, and how far apart the Brownian path is laid out beforehand.
    links : [stop - begin, 2, cols], or None
        Of cells that are whole rows of coupled columns, the charge a clock that each gets while the virtual ground of a
        column is off by a packet, in the middle of the gate, and by how much that changes over the gate.
    begin, stop : which of the n cells
    counts, end, given : [n], results; `given` [n or 0] is the mean charge a clock from the others
    """
    # One array for all that the loop over cells touches: that its parts do not overlap is then plain to the
    # compiler, which otherwise gives up vector instructions rather than compare every pair of them.
    own, marks = np.zeros(PLACES), np.zeros(BLOCK, dtype=np.uint8)
    marks8 = marks.view(np.uint64)
    grid = np.zeros((0, 0))
    if noise is not None:
        span = max(span_of(clocks), step)
        grid = np.zeros((BLOCK, span // step + 1))
    at_once = BLOCK if links is None else BLOCK // links.shape[2] * links.shape[2]
    for first in range(begin, stop, at_once):
        wide = min(at_once, stop - first)
        marks[:] = 0
        for c in range(wide):
            i = first + c
            _load(own, c, cells, i, late, lags, early, limits)
            if noise is not None:
                walk_grid(keys[i], span, step, grid[c])
                _load_noise(own, c, i, late, noise, step)
            if links is not None:
                across = cells.across[i]
                own[SHARE + c] = cells.leak[i] / across if across > 0.0 else 0.0
                own[GIVES + c] = own[GIVEN + c] = 0.0
        for n in range(clocks):
            if noise is not None:
                if n % step == 0:
                    for c in range(wide):
                        sigma, left = own[PATH + c], grid[c, n // step]
                        own[CREEP + c] = sigma * (grid[c, n // step + 1] - left) / step
                        own[DRIFT + c] = sigma * left
            if n < len(x):
                to = X
                if links is not None:
                    to = ALONE
                for c in range(wide):
                    own[to + c] = x[n, first - begin + c]
            if links is not None:
                time = (n + 0.5) / clocks - 0.5
                _couple(own, wide, links[first - begin : first - begin + wide], time, late, lags, limits)
            for c in range(wide):
                _clock(own, marks, c, lags, early, limits, noise)
            if limits is None:
                continue
            for word in range(BLOCK // 8):
                if marks8[word] == 0:
                    continue
                for c in range(8 * word, 8 * word + 8):
                    if marks[c] != 0:
                        _decide_again(own, grid, n, step, late, c, first + c, lags, noise, keys)
        for c in range(wide):
            i = first + c
            counts[i], end[i] = int(own[ONES + c]), _charge(own, c, own[A + c], own[B + c], lags)
            if links is not None:
                given[i] = own[GIVEN + c] / clocks
