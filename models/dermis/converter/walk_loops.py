# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of the event engine: charge balance of many cells at once, clock by clock.

A loop is compiled for each combination of arguments that are None: noise, a lagging output, and what
makes a clock more than one step (a window of the comparator, a range of the charge). numba removes
what stands behind `is not None`, for arguments alone and not for fields of a record: hence their
number. Every other effect that is off has the number that does nothing.

Cells run side by side (the inner loop is over cells and becomes vector instructions), because a
cell by itself waits for the result of its own last clock. Cells in a special state (a decision
within noise of its level, a comparator inside its window, a charge at a limit) are marked there and
computed afterwards, one at a time.
"""

import math

import numba
import numpy as np

from dermis.converter.noise import COIN, EDGE, LEVEL, normal, span_of, uniform, walk_between, walk_grid

# Cells side by side: their state and coefficients (some 30 doubles a cell) stay in a 48 kB cache.
BLOCK = 128

# Rows of the arrays that `walk` takes; the rows of one array lie side by side in memory. mode: one exponential
# of the converter. The first is the charge, the second the part the output has not followed yet.
KEEP, GAIN, TAKE, START, RATE, DRIVE, WEIGHT, PACKET = range(8)
# early: the sample before the clock edge
KEEP_SLOW, KEEP_FAST, GAIN_EARLY, TAKE_EARLY, TAKE_EARLY_LAST, POINT = range(6)
# noise
SIGMA, WHITE, SLOPE, APERTURE = range(4)

# Places of the working array of `walk`, a value of BLOCK cells each. State: both parts of the output, now and a clock
# before; the last three decisions, newest first; ones so far; charge of the clock; the comparator, also before it.
(A, B, OLD_A, OLD_B, Q1, Q2, Q3, ONES, X, UP, WAS_UP) = range(0, 11 * BLOCK, BLOCK)
# Rows of `slow`, `fast`, `early`, `noise`, `latch` and `limits` in their own order.
(KEEP_A, GAIN_A, TAKE_A, START_A, RATE_A, DRIVE_A, WEIGHT_A, PACKET_A) = range(11 * BLOCK, 19 * BLOCK, BLOCK)
(KEEP_B, GAIN_B, TAKE_B, START_B, RATE_B, DRIVE_B, WEIGHT_B, PACKET_B) = range(19 * BLOCK, 27 * BLOCK, BLOCK)
(EARLY_A, EARLY_B, EARLY_X, EARLY_2, EARLY_1, AT) = range(27 * BLOCK, 33 * BLOCK, BLOCK)
(PATH, OF_LEVEL, OF_EDGE, COIN_AT) = range(33 * BLOCK, 37 * BLOCK, BLOCK)
(HALF_A, HALF_B, LOW, HIGH) = range(37 * BLOCK, 41 * BLOCK, BLOCK)
# Levels and lag; a charge outside NEAR_LOW..NEAR_HIGH is looked at closely. Eight deviations of a sample; the sample
# without noise; the path on its grid and its step a clock; outputs between which noise can decide, and the charge a
# clock up to which the next sample may be there as well.
(RISE, FALL, FOLLOWS, NEAR_LOW, NEAR_HIGH, LEAST, MOST) = range(41 * BLOCK, 48 * BLOCK, BLOCK)
(REST, SAMPLE, DRIFT, CREEP, LOWEST, HIGHEST, STAY, PLACES) = range(48 * BLOCK, 56 * BLOCK, BLOCK)

# Charge a clock up to which a limit is seen inside a clock too; more ends at the limit anyway.
SLOPE_MAX = 2.0
# A part of `walk`: numba puts it in before it looks at types, so that what is None falls away there as well.
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


@numba.njit(cache=True, error_model="numpy")
def _grow(rate, length):  # type: ignore
    """Integral of exp(rate t) over 0..length."""
    return length if rate == 0.0 else math.expm1(rate * length) / rate


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
def _mode(rows, i, rate, drive, weight, packet, late):  # type: ignore
    """Fill the rows of one exponential of cell i."""
    last = drive * _grow(rate, 1.0 - late)
    rows[KEEP, i], rows[GAIN, i] = math.exp(rate), drive * _grow(rate, 1.0)
    rows[TAKE, i] = packet * (rows[GAIN, i] - last)
    rows[RATE, i], rows[DRIVE, i], rows[WEIGHT, i], rows[PACKET, i] = rate, drive, weight, packet


@numba.njit(cache=True, error_model="numpy")
def modes(w0, packet, leak, across, delay, lag, late, slow, fast, latch, early):  # type: ignore
    """Fill `slow`, `fast`, `latch` and `early` as `walk` takes them, from what walk.Cells has of each
    cell; those that are off have no columns.
    """
    for i in range(w0.size):
        if fast.size > 0:
            loaded, leaks = across[i] * lag[i], leak[i] * lag[i]
            root = math.sqrt((loaded - 1.0) ** 2 + 4.0 * (loaded - leaks))
            total = 1.0 + loaded + root
            _mode(
                slow, i, -2.0 * leak[i] / total, 1.0 / root, 1.0 - 2.0 * leaks / total, packet[i], late
            )  # fmt: skip
            # 1 + rate lag without the difference of two near equals
            weight = (1.0 - loaded - root) / 2
            if loaded < 1.0:
                weight = -2.0 * (loaded - leaks) / (1.0 - loaded + root)
            _mode(fast, i, -total / (2.0 * lag[i]), -1.0 / root, weight, packet[i], late)
            fast[START, i] = -w0[i] * 2.0 * leaks / (total * root)
            slow[START, i] = w0[i] - fast[START, i]
        else:
            _mode(slow, i, -leak[i], 1.0, 1.0, packet[i], late)
            slow[START, i] = w0[i]
        other = fast if fast.size > 0 else slow
        for k in range(2):
            of = slow if k == 0 else other
            latch[k, i] = packet[i] * of[DRIVE, i] * _grow(of[RATE, i], 1.0 - late)
        sample = 1.0 - delay[i]
        behind = max(sample - late, 0.0)
        whole = slow[DRIVE, i] * _grow(slow[RATE, i], sample)
        last = slow[DRIVE, i] * _grow(slow[RATE, i], behind)
        if fast.size > 0:
            whole += fast[DRIVE, i] * _grow(fast[RATE, i], sample)
            last += fast[DRIVE, i] * _grow(fast[RATE, i], behind)
        early[KEEP_SLOW, i] = math.exp(slow[RATE, i] * sample)
        early[KEEP_FAST, i] = math.exp(other[RATE, i] * sample)
        early[GAIN_EARLY, i] = whole
        early[TAKE_EARLY, i] = packet[i] * (whole - last)
        early[TAKE_EARLY_LAST, i] = packet[i] * last
        early[POINT, i] = sample


@numba.njit(cache=True, error_model="numpy")
def _piece(slow, fast, a, b, lag, current, length, low, high):  # type: ignore
    """Return (a, b) after a piece of constant current, and the turning point of the output inside it, or nan.

    The charge stops at low and high. a + b is the output, (w - output) / lag its slope.
    """
    rate_a, drive_a, weight_a = slow
    rate_b, drive_b, weight_b = fast
    turn = math.nan
    if rate_b != 0.0:
        # A charge at its limit that is pushed further stays there.
        w = weight_a * a + weight_b * b
        push = weight_a * (rate_a * a + drive_a * current) + weight_b * (rate_b * b + drive_b * current)
        if (w >= high - AT_LIMIT and push > 0.0) or (w <= low + AT_LIMIT and push < 0.0):
            limit = high if push > 0.0 else low
            output = limit + (a + b - limit) * math.exp(-length / lag)
            end_a = (limit - weight_b * output) / (weight_a - weight_b)
            return end_a, output - end_a, turn
    end_a = math.exp(rate_a * length) * a + drive_a * current * _grow(rate_a, length)
    end_b = 0.0
    if rate_b != 0.0:
        end_b = math.exp(rate_b * length) * b + drive_b * current * _grow(rate_b, length)
    w_end = weight_a * end_a + weight_b * end_b
    if w_end > high or w_end < low:
        limit = high if w_end > high else low
        if rate_b == 0.0:
            return limit / weight_a, 0.0, turn
        # Beyond the limit the charge would go straight on: find when it gets there, then the output follows a
        # constant charge. The charge is nearly a straight line, so Newton's steps are few; halving
        # keeps them inside.
        left, right = 0.0, length
        if (w - limit) * (w_end - limit) >= 0.0:
            right = 0.0
        time = length * (limit - w) / (w_end - w) if right > 0.0 else 0.0
        for _ in range(60 if right > 0.0 else 0):
            fade_a, fade_b = math.exp(rate_a * time), math.exp(rate_b * time)
            miss = weight_a * (fade_a * a + drive_a * current * _grow(rate_a, time)) - limit
            miss += weight_b * (fade_b * b + drive_b * current * _grow(rate_b, time))
            slope = weight_a * fade_a * (rate_a * a + drive_a * current)
            slope += weight_b * fade_b * (rate_b * b + drive_b * current)
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
        right = time
        at_a = math.exp(rate_a * right) * a + drive_a * current * _grow(rate_a, right)
        at_b = math.exp(rate_b * right) * b + drive_b * current * _grow(rate_b, right)
        output = limit + (at_a + at_b - limit) * math.exp(-(length - right) / lag)
        end_a = (limit - weight_b * output) / (weight_a - weight_b)
        return end_a, output - end_a, turn
    if rate_b != 0.0:
        slope = rate_a * a + drive_a * current
        bend = rate_b * b + drive_b * current
        end_slope = math.exp(rate_a * length) * slope
        end_bend = math.exp(rate_b * length) * bend
        if (slope + bend) * (end_slope + end_bend) < 0.0:
            time = math.log(-bend / slope) / (rate_a - rate_b)
            turn = math.exp(rate_a * time) * a + drive_a * current * _grow(rate_a, time)
            turn += math.exp(rate_b * time) * b + drive_b * current * _grow(rate_b, time)
    return end_a, end_b, turn


@numba.njit(cache=True, error_model="numpy")
def _closely(  # type: ignore
    slow, fast, a, b, lag, x, packet, before, last, late, sample, rise, fall, shift, low, high, state
):
    """One clock of one cell, piece by piece: (seen, sampled output, state, a, b); `shift` moves the sample alone."""
    seen = state
    sampled = a + b
    now = 0.0
    for k in range(3):
        until = min(sample, late) if k == 0 else (max(sample, late) if k == 1 else 1.0)
        if until > now:
            current = x - packet * (before if until <= late else last)
            a, b, turn = _piece(slow, fast, a, b, lag, current, until - now, low, high)
            if turn >= rise:
                state = True
            elif turn < fall:
                state = False
            now = until
            if a + b >= rise:
                state = True
            elif a + b < fall:
                state = False
        if until == sample:
            seen = state
            sampled = a + b
            if shift != 0.0:
                if a + b + shift >= rise:
                    seen = True
                elif a + b + shift < fall:
                    seen = False
    return seen, sampled, state, a, b


@_part
def _copy(cells, place, c, rows, i):  # type: ignore
    for k in range(rows.shape[0]):
        cells[place + k * BLOCK + c] = rows[k, i]


@_part
def _load(cells, c, i, late, slow, fast, latch, early, rise, fall, limits, lag):  # type: ignore
    """Begin with cell i at place c.

    Inside a clock the charge may be farther out than at both edges: by less than lag times a slope where the
    output lags, and by a packet that begins there. A charge so near its range at an edge is looked at closely
    (NEAR_LOW, NEAR_HIGH). Where it goes one way through a clock, LEAST and MOST bound its end as its range does.
    """
    cells[Q1 + c] = cells[Q2 + c] = cells[Q3 + c] = cells[ONES + c] = 0.0
    _copy(cells, KEEP_A, c, slow, i)
    _copy(cells, HALF_A, c, latch, i)
    if early is not None:
        _copy(cells, EARLY_A, c, early, i)
    cells[A + c], cells[RISE + c], cells[FALL + c] = cells[START_A + c], rise[i], fall[i]
    output, inside = cells[A + c], 0.0
    if fast is not None:
        _copy(cells, KEEP_B, c, fast, i)
        cells[B + c] = cells[START_B + c]
        output += cells[B + c]
        cells[FOLLOWS + c] = lag[i]
        inside = lag[i] * (SLOPE_MAX + cells[PACKET_A + c])
    if limits is not None:
        _copy(cells, LOW, c, limits, i)
        cells[UP + c] = 1.0 if output >= rise[i] else 0.0
        cells[NEAR_LOW + c], cells[NEAR_HIGH + c] = limits[0, i] + inside, limits[1, i] - inside
        cells[LEAST + c], cells[MOST + c] = -np.inf, np.inf
        if late < 1.0:
            cells[NEAR_LOW + c] += SLOPE_MAX
            cells[NEAR_HIGH + c] -= cells[PACKET_A + c]
        elif fast is None:
            cells[LEAST + c], cells[MOST + c] = limits[0, i], limits[1, i]


@_part
def _load_noise(cells, c, i, late, fast, lag, noise, step):  # type: ignore
    """Load how far noise may move the output of a cell, on a path laid out every `step` clocks."""
    _copy(cells, PATH, c, noise, i)
    # Eight standard deviations: beyond them a decision is wrong once in 1e15.
    cells[REST + c] = 8.0 * math.hypot(noise[WHITE, i], noise[SLOPE, i]) + noise[APERTURE, i]
    reach = 4.0 * noise[SIGMA, i] * math.sqrt(step) + cells[REST + c]
    cells[HIGHEST + c], cells[LOWEST + c] = cells[RISE + c] + reach, cells[FALL + c] - reach
    # A clock takes the output farther than this, unless it follows late or a packet begins inside.
    cells[STAY + c] = 2.0 * (cells[HIGHEST + c] - cells[LOWEST + c]) / cells[AT + c]
    if late < 1.0:
        cells[STAY + c] = np.inf
    if fast is not None:
        if lag[i] > SWIFT:
            cells[STAY + c] = np.inf
    if cells[FALL + c] == cells[RISE + c]:  # a comparator without a window keeps no state
        cells[STAY + c] = -1.0


@_part
def _within(cells, c, value):  # type: ignore
    """Keep an output in its range."""
    value = value if value > cells[LEAST + c] else cells[LEAST + c]
    return value if value < cells[MOST + c] else cells[MOST + c]


@_part
def _charge(cells, c, a, b, fast):  # type: ignore
    """Return the charge that belongs to both parts of an output."""
    w = a
    if fast is not None:
        w = cells[WEIGHT_A + c] * a + cells[WEIGHT_B + c] * b
    return w


@_part
def _stays(cells, c):  # type: ignore
    """Return True if an output may still be near its level at the next sample."""
    return (abs(cells[X + c]) <= cells[STAY + c]) | (
        abs(cells[X + c] - cells[PACKET_A + c]) <= cells[STAY + c]
    )


@_part
def _marked(cells, c, sample, a, b, fast, noise):  # type: ignore
    """Return whether a clock must be decided again, its sample, and the output at its end.

    It must where noise, the window of the comparator or the range may change the decision. `a` and `b` are the
    parts of the output at the end of the clock; sample and output are returned with the noise on the grid.
    """
    w = _charge(cells, c, a, b, fast)
    mark = (w < cells[NEAR_LOW + c]) | (w > cells[NEAR_HIGH + c])
    if noise is None:
        low, high, end = cells[FALL + c], cells[RISE + c], a + b
        return mark | ((sample >= low) & (sample < high)) | ((end >= low) & (end < high)), sample, end
    low, high = cells[LOWEST + c], cells[HIGHEST + c]
    cells[SAMPLE + c] = sample
    cells[DRIFT + c] += cells[CREEP + c]
    moved, end = sample + cells[DRIFT + c], a + b + cells[DRIFT + c]
    # The comparator's state at the end of the clock matters where the next sample may be near.
    stays = _stays(cells, c)
    mark = mark | ((moved >= low) & (moved < high) & ((cells[Q1 + c] == 0.0) | stays))
    return mark | (stays & (end >= low) & (end < high)), moved, end


@_part
def _clock(cells, marks, c, fast, early, limits, noise):  # type: ignore
    """Take a cell through one clock; where its decision is not known for certain, mark it."""
    a, b, x, q1, q2 = cells[A + c], cells[B + c], cells[X + c], cells[Q1 + c], cells[Q2 + c]
    new_a = cells[KEEP_A + c] * a + cells[GAIN_A + c] * x - cells[TAKE_A + c] * q2 - cells[HALF_A + c] * q1
    new_b = 0.0
    if limits is not None:
        new_a = _within(cells, c, new_a)
    if fast is not None:
        new_b = (
            cells[KEEP_B + c] * b + cells[GAIN_B + c] * x - cells[TAKE_B + c] * q2 - cells[HALF_B + c] * q1
        )
    sample = new_a + new_b
    if early is not None:
        sample = (
            cells[EARLY_A + c] * a
            + cells[EARLY_X + c] * x
            - cells[EARLY_2 + c] * q2
            - cells[EARLY_1 + c] * q1
        )
        if fast is not None:
            sample += cells[EARLY_B + c] * b
    if limits is not None:
        sample = _within(cells, c, sample)
        marks[c], sample, end = _marked(cells, c, sample, new_a, new_b, fast, noise)
        cells[WAS_UP + c] = cells[UP + c]
        cells[UP + c] = 1.0 if end >= cells[RISE + c] else 0.0
        cells[OLD_A + c], cells[OLD_B + c], cells[Q3 + c] = a, b, q2
    one = (sample >= cells[RISE + c]) & (q1 == 0.0)
    cells[Q2 + c] = q1
    cells[Q1 + c] = 1.0 if one else 0.0
    cells[ONES + c] += cells[Q1 + c]
    cells[A + c] = new_a
    if fast is not None:
        cells[B + c] = new_b


@_part
def _noise_of(cells, grid, n, step, c, inside, key):  # type: ignore
    """Draw the noise of a marked clock: (that of the charge, that of the sample alone)."""
    top, bottom, rest = cells[RISE + c], cells[FALL + c], cells[REST + c]
    left = (n + 1) // step
    right = left if left * step == n + 1 else left + 1
    low = high = cells[SAMPLE + c]
    if _stays(cells, c):
        output = cells[A + c] + cells[B + c]
        low, high = min(low, output), max(high, output)
    if not inside:
        # A charge that stops at its range is not where it would be: what decides is not known yet.
        low, high = -np.inf, np.inf
    of_charge = cells[PATH + c] * walk_between(
        key, n + 1, left * step, right * step, grid[c, left], grid[c, right], cells[PATH + c],
        bottom - rest - high, top + rest - low,
    )  # fmt: skip
    of_sample, moved = 0.0, cells[SAMPLE + c] + of_charge
    if not inside or abs(moved - top) <= rest or abs(moved - bottom) <= rest:
        if cells[OF_LEVEL + c] > 0.0:
            of_sample = cells[OF_LEVEL + c] * normal(key, LEVEL, n + 1)
        if cells[OF_EDGE + c] > 0.0:
            of_sample += cells[OF_EDGE + c] * normal(key, EDGE, n + 1)
    return of_charge, of_sample


@_part
def _pieces(cells, late, c, of_charge, of_sample, state, fast):  # type: ignore
    """Take a cell through its last clock again, piece by piece, as `_closely` does."""
    part_b, slowness = (0.0, 0.0, 0.0), 1.0
    if fast is not None:
        part_b, slowness = (cells[RATE_B + c], cells[DRIVE_B + c], cells[WEIGHT_B + c]), cells[FOLLOWS + c]
    return _closely(
        (cells[RATE_A + c], cells[DRIVE_A + c], cells[WEIGHT_A + c]), part_b, cells[OLD_A + c], cells[OLD_B + c],
        slowness, cells[X + c], cells[PACKET_A + c], cells[Q3 + c], cells[Q2 + c], late, cells[AT + c],
        cells[RISE + c] - of_charge, cells[FALL + c] - of_charge, of_sample, cells[LOW + c], cells[HIGH + c], state,
    )  # fmt: skip


@_part
def _decide_again(cells, grid, n, step, late, c, i, fast, noise, keys):  # type: ignore
    """Decide a marked clock with its noise, its range and the state of its comparator."""
    clear, seen, of_charge, of_sample, moved = False, False, 0.0, 0.0, 0.0
    w = _charge(cells, c, cells[A + c], cells[B + c], fast)
    inside = cells[NEAR_LOW + c] <= w <= cells[NEAR_HIGH + c]
    state = cells[WAS_UP + c] != 0.0
    active = cells[FALL + c] if state else cells[RISE + c]
    if noise is not None:
        of_charge, of_sample = _noise_of(cells, grid, n, step, c, inside, keys[i])
        moved = cells[SAMPLE + c] + of_charge + of_sample
        end = cells[A + c] + cells[B + c] + of_charge
        seen = moved >= cells[RISE + c]
        clear = inside and (seen or moved < cells[FALL + c])
        if _stays(cells, c):
            clear = clear and (end >= cells[RISE + c] or end < cells[FALL + c])
        if clear:
            state = end >= cells[RISE + c]
    if not clear:
        seen, sampled, state, a, b = _pieces(cells, late, c, of_charge, of_sample, state, fast)
        moved = sampled + of_charge + of_sample
        if not inside:
            cells[A + c], cells[B + c] = a, b
    cells[UP + c] = 1.0 if state else 0.0
    if noise is not None:
        if abs(moved - active) < cells[COIN_AT + c]:
            seen = uniform(keys[i], COIN, n + 1) < 0.5
    bit = 1.0 if seen and cells[Q2 + c] == 0.0 else 0.0
    cells[ONES + c] += bit - cells[Q1 + c]
    cells[Q1 + c] = bit


@numba.njit(cache=True, error_model="numpy")
def walk(  # type: ignore
    clocks, late, x, slow, fast, latch, early, rise, fall, limits, lag, noise, keys, step, begin,
    stop, counts, end,
):  # fmt: skip
    """Count the ones of `clocks` decisions for every cell; the charge after the last one into `end`.

    Parameters
    ----------
    clocks, late : decisions, and clocks between a decision and the beginning of its packet
    x : [1 or clocks, stop - begin], charge of every clock, or the one charge of all clocks
    slow, fast : [8, n], the two exponentials (`fast` None: bandwidth is infinite)
    latch : [2, n], what the packet that begins inside a clock takes away in it
    early : [6, n] or None, the sample ahead of the clock edge (None: at the edge; without `limits` only)
    rise, fall : [n], levels of the comparator
    limits : [2, n] or None
        Range of the charge. None if there is none, no noise, and `fall` is `rise`.
    lag : [n], time constant of the output; read with `fast` only
    noise : [4, n], keys : [n], step : int, or all None
        What is random, and how far apart the Brownian path is laid out beforehand.
    begin, stop : which of the n cells
    counts, end : [n], results
    """
    # One array for all that the loop over cells touches: that its parts do not overlap is then plain to the
    # compiler, which otherwise gives up vector instructions rather than compare every pair of them.
    cells, marks = np.zeros(PLACES), np.zeros(BLOCK, dtype=np.uint8)
    marks8 = marks.view(np.uint64)
    grid = np.zeros((0, 0))
    if noise is not None:
        span = max(span_of(clocks), step)
        grid = np.zeros((BLOCK, span // step + 1))
    for first in range(begin, stop, BLOCK):
        wide = min(BLOCK, stop - first)
        marks[:] = 0
        for c in range(wide):
            i = first + c
            _load(cells, c, i, late, slow, fast, latch, early, rise, fall, limits, lag)
            if noise is not None:
                walk_grid(keys[i], span, step, grid[c])
                _load_noise(cells, c, i, late, fast, lag, noise, step)
        for n in range(clocks):
            if noise is not None:
                if n % step == 0:
                    for c in range(wide):
                        sigma, left = cells[PATH + c], grid[c, n // step]
                        cells[CREEP + c] = sigma * (grid[c, n // step + 1] - left) / step
                        cells[DRIFT + c] = sigma * left
            if n < len(x):
                for c in range(wide):
                    cells[X + c] = x[n, first - begin + c]
            for c in range(wide):
                _clock(cells, marks, c, fast, early, limits, noise)
            if limits is None:
                continue
            for word in range(BLOCK // 8):
                if marks8[word] == 0:
                    continue
                for c in range(8 * word, 8 * word + 8):
                    if marks[c] != 0:
                        _decide_again(cells, grid, n, step, late, c, first + c, fast, noise, keys)
        for c in range(wide):
            i = first + c
            counts[i], end[i] = int(cells[ONES + c]), _charge(cells, c, cells[A + c], cells[B + c], fast)
