# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of the event engine: charge balance of many cells at once, clock by clock.

An effect that is off is passed as None. numba compiles a loop for each combination of types it
meets and removes what stands behind `is not None` before it looks at the rest, so no compiled loop
tests for an effect that is off, reads its parameters or draws its numbers.

Cells run side by side (the inner loop is over cells and becomes vector instructions), because a
cell by itself waits for the result of its own last clock. Cells in a special state (a decision
within noise of its level, a comparator inside its window, a charge at a limit) are marked there and
computed afterwards, one at a time.
"""

from __future__ import annotations

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

# Charge a clock up to which a limit is seen inside a clock too; more ends at the limit anyway.
SLOPE_MAX = 2.0
# Distance in packets from a limit up to which a charge counts as at the limit.
AT_LIMIT = 1e-14
# Clocks of lag up to which the output of a clock is that of its own charge to a fifth.
SWIFT = 0.1


@numba.njit(cache=True)
def plain(x, w0, packet, rise, clocks, charge_delay, counts, w_end):  # type: ignore
    """The ideal converter: n * x is rounded once and never summed up, so this is the closed formula
    to the last bit.

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
    """Return the cheapest grid of the Brownian paths in clocks; the paths themselves do not depend on
    it.

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
        if latch.size > 0:
            for k in range(2):
                of = slow if k == 0 else other
                latch[k, i] = packet[i] * of[DRIVE, i] * _grow(of[RATE, i], 1.0 - late)
        if early.size > 0:
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
    """Return (a, b) after a piece of constant current, and the turning point of the output inside
    it, or nan.

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
def _closely(
    slow, fast, a, b, lag, x, packet, before, last, late, sample, rise, fall, shift, low, high, state
):
    # type: ignore
    """One clock of one cell, piece by piece: (seen, sampled output, state, a, b); `shift` moves the
    sample alone.
    """
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


@numba.njit(cache=True, error_model="numpy")
def walk(  # type: ignore
    clocks,
    late,
    x,
    vary,
    slow,
    fast,
    latch,
    early,
    rise,
    window,
    limits,
    lag,
    noise,
    keys,
    step,
    begin,
    stop,
    counts,
    end,
):
    """Count the ones of `clocks` decisions for every cell; the charge after the last one into
    `end`.

    Parameters
    ----------
    clocks, late : int, float
        Decisions, and clocks between a decision and the beginning of its packet.
    x : [n] or None
        Charge a clock, where it is constant.
    vary : [clocks, stop - begin] or None
        Charge of every clock, where it is not.
    slow, fast : [8, n]
        The two exponentials (`fast` None: bandwidth is infinite).
    latch : [2, n] or None
        What the packet that begins inside a clock takes away in it (None: packets begin at clock edges).
    early : [6, n] or None
        The sample ahead of the clock edge.
    rise : [n]
        Level of the comparator.
    window : [n] or None
        Level at which it falls again (None: at the same).
    limits : [2, n] or None
        Range of the charge.
    noise : [4, n], keys : [n], step : int, or all None
        What is random, and how far apart the Brownian path is laid out beforehand.
    lag : [n] or None
        Time constant of the output; with `fast` only.
    begin, stop : int
        Which of the n cells.
    counts, end : [n]
        Results.
    """
    size = BLOCK
    words = size // 8
    # One array for all that the loop over cells touches: that its parts do not overlap is then plain to the
    # compiler, which otherwise gives up vector instructions rather than compare every pair of them.
    own = np.zeros(35 * size)
    state_a, old_a = own[0 * size : 1 * size], own[1 * size : 2 * size]
    q1, q2, q3 = own[2 * size : 3 * size], own[3 * size : 4 * size], own[4 * size : 5 * size]
    ones, x_c = own[5 * size : 6 * size], own[6 * size : 7 * size]
    keep_a, gain_a, take_a = own[7 * size : 8 * size], own[8 * size : 9 * size], own[9 * size : 10 * size]
    rise_c = own[10 * size : 11 * size]
    marks = np.zeros(size, dtype=np.uint8)
    marks8 = marks.view(np.uint64)
    if fast is not None:
        state_b, old_b = own[11 * size : 12 * size], own[12 * size : 13 * size]
        keep_b, gain_b, take_b = (
            own[13 * size : 14 * size],
            own[14 * size : 15 * size],
            own[15 * size : 16 * size],
        )
    if latch is not None:
        half_a, half_b = own[16 * size : 17 * size], own[17 * size : 18 * size]
    if early is not None:
        early_a, early_b = own[18 * size : 19 * size], own[19 * size : 20 * size]
        early_x, early_2 = own[20 * size : 21 * size], own[21 * size : 22 * size]
        early_1 = own[22 * size : 23 * size]
    if window is not None:
        fall_c = own[23 * size : 24 * size]
        up, was_up = np.zeros(size, dtype=np.uint8), np.zeros(size, dtype=np.uint8)
    if limits is not None:
        low_c, high_c = own[24 * size : 25 * size], own[25 * size : 26 * size]
        weight_a, weight_b = own[26 * size : 27 * size], own[27 * size : 28 * size]
    if noise is not None:
        level = own[28 * size : 29 * size]
        drift, creep = own[29 * size : 30 * size], own[30 * size : 31 * size]
        lowest, highest = own[31 * size : 32 * size], own[32 * size : 33 * size]
        stay, packet_c = own[33 * size : 34 * size], own[34 * size : 35 * size]
        span = max(span_of(clocks), step)
        grid = np.zeros((size, span // step + 1))
    for first in range(begin, stop, size):
        wide = min(size, stop - first)
        marks[:] = 0
        for c in range(wide):
            i = first + c
            state_a[c] = slow[START, i]
            q1[c] = q2[c] = q3[c] = ones[c] = 0.0
            keep_a[c], gain_a[c], take_a[c] = slow[KEEP, i], slow[GAIN, i], slow[TAKE, i]
            rise_c[c] = rise[i]
            if x is not None:
                x_c[c] = x[i]
            if fast is not None:
                state_b[c] = fast[START, i]
                keep_b[c], gain_b[c], take_b[c] = fast[KEEP, i], fast[GAIN, i], fast[TAKE, i]
            if latch is not None:
                half_a[c], half_b[c] = latch[0, i], latch[1, i]
            if early is not None:
                early_a[c], early_b[c] = early[KEEP_SLOW, i], early[KEEP_FAST, i]
                early_x[c], early_2[c], early_1[c] = (
                    early[GAIN_EARLY, i],
                    early[TAKE_EARLY, i],
                    early[TAKE_EARLY_LAST, i],
                )
            if window is not None:
                fall_c[c] = window[i]
                output = state_a[c]
                if fast is not None:
                    output += state_b[c]
                up[c] = output >= rise_c[c]
            if limits is not None:
                weight_a[c] = slow[WEIGHT, i]
                # Marked from here on. The charge may turn between two points by less than lag times a slope,
                # and be farther out where a packet begins inside a clock than at either edge.
                inside = 0.0
                if fast is not None:
                    weight_b[c] = fast[WEIGHT, i]
                    inside = lag[i] * (SLOPE_MAX + slow[PACKET, i])
                low_c[c], high_c[c] = limits[0, i] + inside, limits[1, i] - inside
                if latch is not None:
                    low_c[c] += SLOPE_MAX
                    high_c[c] -= slow[PACKET, i]
            if noise is not None:
                walk_grid(keys[i], span, step, grid[c])
                reach = 4.0 * noise[SIGMA, i] * math.sqrt(step)
                reach += 8.0 * math.hypot(noise[WHITE, i], noise[SLOPE, i]) + noise[APERTURE, i]
                highest[c] = rise_c[c] + reach
                lowest[c] = rise_c[c] - reach
                if window is not None:
                    lowest[c] = fall_c[c] - reach
                    # A clock takes the output farther than this, unless it follows late or a packet begins inside.
                    packet_c[c] = slow[PACKET, i]
                    stay[c] = 2.0 * (highest[c] - lowest[c])
                    if early is not None:
                        stay[c] /= early[POINT, i]
                    if fast is not None:
                        if lag[i] > SWIFT:
                            stay[c] = np.inf
                    if latch is not None:
                        stay[c] = np.inf

        for n in range(clocks):
            if noise is not None and n % step == 0:
                for c in range(wide):
                    sigma = noise[SIGMA, first + c]
                    left = grid[c, n // step]
                    creep[c] = sigma * (grid[c, n // step + 1] - left) / step
                    drift[c] = sigma * left
            if vary is not None:
                charge = vary[n]
                for c in range(wide):
                    x_c[c] = charge[first - begin + c]

            for c in range(wide):
                a = state_a[c]
                new_a = keep_a[c] * a + gain_a[c] * x_c[c] - take_a[c] * q2[c]
                if latch is not None:
                    new_a -= half_a[c] * q1[c]
                if limits is not None:
                    if fast is None:
                        if latch is None:
                            # The charge goes one way through a clock, so what it is at its end is bounded alike.
                            new_a = new_a if new_a > low_c[c] else low_c[c]
                            new_a = new_a if new_a < high_c[c] else high_c[c]
                output = new_a
                if fast is not None:
                    b = state_b[c]
                    new_b = keep_b[c] * b + gain_b[c] * x_c[c] - take_b[c] * q2[c]
                    if latch is not None:
                        new_b -= half_b[c] * q1[c]
                    output = new_a + new_b
                sample = output
                if early is not None:
                    sample = early_a[c] * a + early_x[c] * x_c[c] - early_2[c] * q2[c]
                    if latch is not None:
                        sample -= early_1[c] * q1[c]
                    if fast is not None:
                        sample += early_b[c] * b
                    if limits is not None:
                        if fast is None:
                            if latch is None:
                                sample = sample if sample > low_c[c] else low_c[c]
                                sample = sample if sample < high_c[c] else high_c[c]
                mark = False
                if noise is not None:
                    level[c] = sample
                    drift[c] += creep[c]
                    moved = sample + drift[c]
                    mark = (moved >= lowest[c]) & (moved < highest[c])
                    if window is None:
                        mark = mark & (q1[c] == 0.0)
                    else:
                        # The comparator's state at the end of the clock matters where the next sample may be near.
                        stays = (abs(x_c[c]) <= stay[c]) | (abs(x_c[c] - packet_c[c]) <= stay[c])
                        mark = mark & ((q1[c] == 0.0) | stays)
                        if early is not None:
                            moved_end = output + drift[c]
                            mark = mark | (stays & (moved_end >= lowest[c]) & (moved_end < highest[c]))
                    one = (moved >= rise_c[c]) & (q1[c] == 0.0)
                else:
                    one = (sample >= rise_c[c]) & (q1[c] == 0.0)
                    if window is not None:
                        mark = (sample >= fall_c[c]) & (sample < rise_c[c])
                        if early is not None:
                            mark = mark | ((output >= fall_c[c]) & (output < rise_c[c]))
                if window is not None:
                    was_up[c] = up[c]
                    if noise is not None:
                        up[c] = output + drift[c] >= rise_c[c]
                    else:
                        up[c] = output >= rise_c[c]
                    old_a[c] = a
                    q3[c] = q2[c]
                    if fast is not None:
                        old_b[c] = b
                if limits is not None:
                    w = weight_a[c] * new_a
                    if fast is not None:
                        w += weight_b[c] * new_b
                    mark = mark | (w < low_c[c]) | (w > high_c[c])
                    old_a[c] = a
                    q3[c] = q2[c]
                    if fast is not None:
                        old_b[c] = b
                q2[c] = q1[c]
                q1[c] = 1.0 if one else 0.0
                ones[c] += q1[c]
                state_a[c] = new_a
                if fast is not None:
                    state_b[c] = new_b
                if noise is not None:
                    marks[c] = mark
                elif window is not None:
                    marks[c] = mark
                elif limits is not None:
                    marks[c] = mark

            if noise is not None or window is not None or limits is not None:
                for word in range(words):
                    if marks8[word] == 0:
                        continue
                    for c in range(8 * word, 8 * word + 8):
                        if marks[c] == 0:
                            continue
                        i = first + c
                        a, b = state_a[c], 0.0
                        if fast is not None:
                            b = state_b[c]
                        top = rise_c[c]
                        bottom = top
                        if window is not None:
                            bottom = fall_c[c]
                        free = True
                        if limits is not None:
                            w = weight_a[c] * a
                            if fast is not None:
                                w += weight_b[c] * b
                            free = low_c[c] <= w <= high_c[c]
                        slow_noise, white_noise = 0.0, 0.0
                        if noise is not None:
                            sigma = noise[SIGMA, i]
                            # Eight standard deviations: beyond them a decision is wrong once in 1e15.
                            rest = 8.0 * math.hypot(noise[WHITE, i], noise[SLOPE, i]) + noise[APERTURE, i]
                            left = (n + 1) // step
                            right = left if left * step == n + 1 else left + 1
                            low = high = level[c]
                            stays_near = False
                            if window is not None:
                                stays_near = abs(x_c[c]) <= stay[c] or abs(x_c[c] - packet_c[c]) <= stay[c]
                            if early is not None and stays_near:
                                low, high = min(low, a + b), max(high, a + b)
                            if not free:
                                # A charge that stops at its range is not at `level`: what decides is not known yet.
                                low, high = -np.inf, np.inf
                            slow_noise = sigma * walk_between(
                                keys[i], n + 1, left * step, right * step, grid[c, left], grid[c, right],
                                sigma, bottom - rest - high, top + rest - low,
                            )  # fmt: skip
                            moved = level[c] + slow_noise
                            if not free or abs(moved - top) <= rest or abs(moved - bottom) <= rest:
                                if noise[WHITE, i] > 0.0:
                                    white_noise = noise[WHITE, i] * normal(keys[i], LEVEL, n + 1)
                                if noise[SLOPE, i] > 0.0:
                                    white_noise += noise[SLOPE, i] * normal(keys[i], EDGE, n + 1)
                            moved += white_noise
                            seen = moved >= top
                        if window is not None or limits is not None:
                            state = False
                            if window is not None:
                                state = was_up[c] != 0
                            active = bottom if state else top
                            clear = False
                            if noise is not None and free:
                                behind_it = a + b + slow_noise
                                clear = moved >= top or moved < bottom
                                if stays_near:
                                    clear = clear and (behind_it >= top or behind_it < bottom)
                                if clear:
                                    state = behind_it >= top
                            if not clear:
                                part_b = (0.0, 0.0, 0.0)
                                from_b, slowness = 0.0, 1.0
                                if fast is not None:
                                    part_b = (fast[RATE, i], fast[DRIVE, i], fast[WEIGHT, i])
                                    from_b, slowness = old_b[c], lag[i]
                                low, high = -np.inf, np.inf
                                if limits is not None:
                                    low, high = limits[0, i], limits[1, i]
                                point = 1.0
                                if early is not None:
                                    point = early[POINT, i]
                                seen, sampled, state, a, b = _closely(
                                    (slow[RATE, i], slow[DRIVE, i], slow[WEIGHT, i]), part_b, old_a[c], from_b,
                                    slowness, x_c[c], slow[PACKET, i], q3[c], q2[c], late, point, top -
                                    slow_noise, bottom - slow_noise, white_noise, low, high, state,
                                )  # fmt: skip
                                if limits is not None:
                                    if not free:
                                        state_a[c] = a
                                        if fast is not None:
                                            state_b[c] = b
                                if noise is not None:
                                    moved = sampled + slow_noise + white_noise
                            if window is not None:
                                up[c] = state
                        else:
                            active = top
                        if noise is not None:
                            if abs(moved - active) < noise[APERTURE, i]:
                                seen = uniform(keys[i], COIN, n + 1) < 0.5
                        bit = 1.0 if seen and q2[c] == 0.0 else 0.0
                        ones[c] += bit - q1[c]
                        q1[c] = bit

        for c in range(wide):
            i = first + c
            counts[i] = int(ones[c])
            end[i] = slow[WEIGHT, i] * state_a[c]
            if fast is not None:
                end[i] += fast[WEIGHT, i] * state_b[c]
