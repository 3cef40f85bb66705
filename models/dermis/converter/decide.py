# SPDX-License-Identifier: Apache-2.0
"""Decide cells, compiled: from currents to levels and their error bounds to codes, or to cells that stay open."""

from __future__ import annotations

import math
from collections import namedtuple

import numba
import numpy as np

from dermis import bounds as of
from dermis.converter import noise
from dermis.converter.course import FAR, approach, log_of
from dermis.converter.vfc import Y_MIN, count_one

# Duty beyond which a larger current changes no code: 1/2 is full scale.
X_CLIP = 0.75
# Duty that replaces any larger one where the charge of a clock counts.
_X_LARGE = 1.0
# Packets that roundings of the two ways to a level may differ by: a sum of 510 clocks, and polynomials of a course.
ROUNDING = 1e-7
# Every n-th cell is sampled for the ratio of bound and shift.
EACH = 101
# Smallest time constant of a mirror times its output, in packets.
_KAPPA_MIN = 1e-15
# Error in packets of a slow mirror's charge that is left of the rows before a chosen cell.
_FORGOTTEN = 1e-12
# Duty beyond which a converter saturates whatever its noise is, as in engine event.
_X_NOISE_MAX = 1.0

_compiled = numba.njit(cache=True, error_model="numpy")


class Gate(
    namedtuple(
        "Gate",
        "clocks settle pause code_max budget ripple swing_reach motion slow_mirror direct random",
    )
):
    """Numbers that all cells of a run share.

    Clocks of a slot, the largest code, and the error that decides a cell all the same; the amplitude of the ripple and
    the largest sum of its sine; what there is of motion, slow mirrors and noise.
    """

    __slots__ = ()


class Solved(namedtuple("Solved", "x passed begin end shift error open codes blame")):
    """Results of `decide_cells`, [frames, rows, cols] each.

    `x` mean duty. Of slow mirrors: `passed` [2, ...] packets that pass at least from the
    start of a slot to its gate, and in the whole slot; `begin` the highest output where the gate begins; `end`
    [3, ...] the output after each gate: as solved, the lowest and the highest possible.
    `shift` and `error` of the level at the last decision in packets, before any noise is drawn. `blame` is the
    effect with the largest bound in an open cell.
    """

    __slots__ = ()


@_compiled
def _decide(x, clipped, level, error, packet, gate):  # type: ignore
    """Code of a cell whose level is known to `error`, and whether it is open.

    A `clipped` duty may be larger.
    """
    if not (math.isfinite(error) and math.isfinite(level)):
        return 0, True
    if 0.0 <= 2.0 * x <= packet and not clipped and gate.budget <= 0.0:
        # As `count_one` at either end, to roundings that `error` holds.
        top = 1.0 * min((gate.clocks + 1) // 2, gate.code_max)
        reach, part = gate.clocks * x - level, 1.0 / packet
        low = min(max(math.floor((reach - error) * part) + 1.0, 0.0), top)
        return int(low), low != min(max(math.floor((reach + error) * part) + 1.0, 0.0), top)
    least = min(count_one(x, gate.clocks, level + error, packet), gate.code_max)
    if clipped:
        # More charge than that at which x is clipped changes a code only upwards.
        open_ = least < gate.code_max
    else:
        open_ = least != min(count_one(x, gate.clocks, level - error, packet), gate.code_max)
    if error <= gate.budget and gate.budget > 0.0:
        return min(count_one(x, gate.clocks, level, packet), gate.code_max), False
    return least, open_


class SlotInput(namedtuple("SlotInput", "mean away swing bent apart start middle least largest")):
    """Input of a converter through a slot, in packets a clock.

    `mean` over the gate, and how far any clock of it is `away`; `swing` the amplitude of the ripple, `bent` packets of
    second order over the gate, `apart` how far motion alone is from the mean. From where the row is driven to the gate
    the input begins at `start`, is `middle` on the way, and stays between `least` and `largest`.
    """

    __slots__ = ()


@_compiled
def _parabola(begin, end, bend, t):  # type: ignore
    """Value at time t in gates of what runs from `begin` to `end` with 4 `bend` t (1 - t) on top."""
    return begin + t * (end - begin + 4.0 * (1.0 - t) * bend)


@_compiled
def _slot_input(gate, ahead, per_a, squeeze, driven, later, bend, other, other_later, other_bend):  # type: ignore
    """SlotInput of a slot that begins `ahead` gates before its gate, from column currents in ampere.

    `driven` follows the bias, `other` does not. Motion runs straight on before the gate.
    """
    size, ripple = abs(per_a), abs(gate.ripple * per_a)
    begin, end, curve = driven + other, later + other_later, bend + other_bend
    apart = (0.5 * abs(end - begin) + abs(curve)) * size
    mean_driven = 0.5 * (driven + later) + (2.0 / 3.0) * bend
    mean = (mean_driven + 0.5 * (other + other_later) + (2.0 / 3.0) * other_bend) * per_a
    swing, bent = gate.ripple * mean_driven * per_a, abs(gate.ripple) * gate.clocks * apart
    reach = ripple * (max(abs(driven), abs(later)) + abs(bend)) + apart
    low, high = mean - reach, mean + reach
    # What a parabola leaves its chord before the gate.
    bow = ahead * ahead
    before = max(abs(driven), abs(_parabola(driven, later, bend, -ahead))) + bow * abs(bend)
    spread = ripple * before + bow * abs(curve) * size
    begin, start = begin * per_a, _parabola(begin, end, curve, -ahead) * per_a
    middle, least, largest = 0.5 * (begin + start), min(begin, start) - spread, max(begin, start) + spread
    if squeeze > 0.0:
        bent += gate.clocks * squeeze * reach**2
        low, high = low / (1.0 + squeeze * abs(low)), high / (1.0 + squeeze * abs(high))
        start, middle = start / (1.0 + squeeze * abs(start)), middle / (1.0 + squeeze * abs(middle))
        least, largest = least / (1.0 + squeeze * abs(least)), largest / (1.0 + squeeze * abs(largest))
        slope = 1.0 / (1.0 + squeeze * abs(mean))
        mean, swing = mean * slope, swing * slope * slope
    return SlotInput(mean, max(mean - low, high - mean), swing, bent, apart, start, middle, least, largest)


@_compiled
def _mirrors(gate, first, start, before, during, idle, kappa, inverse, begin, end):  # type: ignore
    """Outputs of the slow mirrors of one row where its gate begins and where it ends, [cols] each.

    `start` is the current where the first row of a frame begins settled, `before` the one from there to the gate,
    `during` the one in the gate: nominal, or the lowest or highest of each. The output y follows its settled value x
    by y' = y (x - y) / kappa. Its inverse is linear in time, kappa u' = 1 - x u, so a constant x takes no steps.
    `inverse` is carried from row to row.
    """
    for c in range(start.size):
        here, resting = max(before[c], Y_MIN), max(idle[c], Y_MIN)
        if first:
            u = 1.0 / max(start[c], Y_MIN)
        else:
            u = approach(inverse[c], 1.0 / resting, resting * gate.pause / kappa[c])
        u = approach(u, 1.0 / here, here * (gate.settle - gate.pause) / kappa[c])
        begin[c] = 1.0 / u
        here = max(during[c], Y_MIN)
        u = approach(u, 1.0 / here, here * gate.clocks / kappa[c])
        inverse[c], end[c] = u, 1.0 / u


@_compiled
def remembered(gate, passed, begin, end, kappa, frame, row, col, depth):  # type: ignore
    """Fill `depth` [n] with the number of rows before each chosen cell that its slow mirror remembers.

    `passed`, `begin` and `end` are those of Solved, `kappa` [cols] the mirror's time constant times its output in
    packets.
    """
    floor = Y_MIN * gate.pause
    for i in range(depth.size):
        f, c, at = frame[i], col[i], row[i]
        lag, begins = max(kappa[c], _KAPPA_MIN), begin[f, at, c]
        charge = passed[0, f, at, c] + floor
        while at > 0:
            at -= 1
            # The inverse of the output is known to the difference of both ends, and to roundings of a slot. What is
            # left of it where the gate begins moves the charge by lag times the relative change of the output.
            known = 1.0 / end[1, f, at, c] - 1.0 / end[2, f, at, c] + 1e-9 / end[0, f, at, c]
            if not lag * begins * known * math.exp(-charge / lag) > _FORGOTTEN:
                break
            depth[i] += 1
            charge += passed[1, f, at, c] + floor


@_compiled
def _slot(table, c, key):  # type: ignore
    """Numbers of a slot: the start, and the size of the packet."""
    begin, packet = table[of.BEGIN, c], table[of.PACKET, c]
    if table[of.PRESET_NOISE, c] > 0.0:
        begin += table[of.PRESET_NOISE, c] * noise.normal(key, noise.PRESET, 0)
        begin = min(max(begin, table[of.LOW, c]), table[of.HIGH, c])
    if table[of.FLICKER, c] > 0.0:
        packet *= 1.0 + table[of.FLICKER, c] * noise.normal(key, noise.FLICKER, 0)
    return begin, packet


@_compiled
def _sigma(table, g_column, mean, c):  # type: ignore
    """Deviation a clock of the Brownian path at a mean charge a clock, as walk.noise_rows has it."""
    most = min(abs(mean), _X_NOISE_MAX)
    rate = min(most, 0.5)
    variance = table[of.THERMAL, c] * g_column + table[of.SHOT, c] * (most + rate)
    return math.sqrt(variance + 2.0 * table[of.JITTER, c] ** 2 * rate)


@_compiled
def _last(gate, table, g_column, mean, doubt, low, held, c, key):  # type: ignore
    """Noise of the last decision of a quiet cell, and how far the highest one is above it at most.

    `mean` is the charge a clock, known to `doubt`; `low` the least. With `held` a comparator with a
    window still holds the packet before.
    """
    # A part of `doubt` in the mean is at most as much in the noise.
    most, sigma = min(abs(mean), _X_NOISE_MAX), _sigma(table, g_column, mean, c)
    white, slope = table[of.NOISE, c], most * table[of.JITTER, c]
    if sigma == 0.0 and white == 0.0:
        return 0.0, 0.0
    if not doubt <= 0.1 * most:
        return 0.0, np.inf
    own = 0.0
    if white > 0.0:
        own += white * noise.normal(key, noise.LEVEL, gate.clocks)
    if slope > 0.0:
        own += slope * noise.normal(key, noise.EDGE, gate.clocks)
    lost = 0.0
    if table[of.WINDOW, c] > 0.0 and (own > 0.0 if held else own < 0.0):
        # A comparator with a window has seen the level already, or lost it; only what is beyond the window counts,
        # and a coin that is thrown where sample and noise together are at the level.
        lost = abs(own) if table[of.APERTURE, c] > 0.0 or abs(own) > 0.5 * table[of.WINDOW, c] else 0.0
        own = 0.0
    end, above = noise.walk_end(key, gate.clocks, sigma, low)
    sample = of.SIGMAS * math.hypot(white, slope)
    largest = of.SIGMAS * sigma * math.sqrt(1.0 * gate.clocks) + sample
    return end + own, max(above + sample - own, 0.0) + lost + 2.0 * largest * doubt / most


@_compiled
def _worst(s, on, calm):  # type: ignore
    """Number of the effect that leaves the most of a cell open."""
    left = np.zeros((of.COUNT, 2))
    of.total(s, on, 0.0, None, left)
    return np.argmax(left[:, 0 if calm else 1])


@_compiled
def decide_cells(  # type: ignore
    gate, on, table, g_column, idle, swing_sum, apart_lsb,
    follows, rest, follows_end, rest_end, follows_bend, rest_bend, seed, first, out, tally, ratios
):  # fmt: skip
    """Fill `out` and `tally`; returns how many `ratios` of bound and shift were sampled, and how many
    cells were decided by the random numbers of their slots.

    Parameters
    ----------
    gate : Gate
    on : [bounds.COUNT]
        Factor on each bound; 0 is off.
    table : [25, cols]
        bounds.columns.
    g_column, idle : [frames, cols]
        Conductance on each column; most of a settled mirror while no row is driven.
    swing_sum : [frames, rows]
        Sum of the sine of the ripple over the gate.
    seed, first : of the random numbers, and the number of frame 0 in the whole run.
    apart_lsb : [cols]
        Packets by which levels may differ for a reason outside the model.
    follows, rest : [frames, rows, cols]
        Column currents, with the bias and without it; `_end` and `_bend` of them with motion.
    """
    frames, rows, cols = follows.shape
    # Each of its own, or loops over them become no vector instructions.
    settled, away, swings, moves = np.empty(cols), np.empty(cols), np.empty(cols), np.empty(cols)
    bends, inverse, begins = np.empty(cols), np.empty((3, cols)), np.empty((3, cols))
    # As solved, the lowest and the highest: where the first row begins, before the gate, in the gate, in the break.
    starts, befores, durings = np.empty((3, cols)), np.empty((3, cols)), np.empty((3, cols))
    idles = np.zeros((3, cols))
    # Start of the slot's settling in gates: motion goes on straight there, out of the range that it has in the gate.
    ahead = (gate.settle - gate.pause) / gate.clocks
    kappas = np.maximum(table[of.KAPPA], _KAPPA_MIN)
    sampled = drawn = number = 0
    root, span = math.sqrt(gate.clocks), int(noise.span_of(gate.clocks))
    per_clock = 1.0 / gate.clocks
    # Part of a path's end that the end of its grid tells, and part of its variance that it does not.
    ended, bridge = gate.clocks / math.sqrt(span), (span - gate.clocks) / span
    for f in range(frames):
        for r in range(rows):
            for c in range(cols):
                top = table[of.TOP, c]
                driven = later = min(max(follows[f, r, c], -top), top)
                other = other_later = min(max(rest[f, r, c], -top), top)
                bend = other_bend = 0.0
                if gate.motion:
                    later = min(max(follows_end[f, r, c], -top), top)
                    other_later = min(max(rest_end[f, r, c], -top), top)
                    bend = min(max(follows_bend[f, r, c], -top), top)
                    other_bend = min(max(rest_bend[f, r, c], -top), top)
                inputs = _slot_input(
                    gate, ahead, table[of.PER_A, c], table[of.SQUEEZE, c], driven, later, bend, other, other_later,
                    other_bend,
                )  # fmt: skip
                settled[c], away[c], swings[c] = inputs.mean, inputs.away, inputs.swing
                moves[c], bends[c] = 0.25 * gate.clocks * inputs.apart, inputs.bent
                if gate.slow_mirror:
                    starts[0, c], starts[1, c], starts[2, c] = inputs.start, inputs.least, inputs.largest
                    befores[0, c], befores[1, c], befores[2, c] = inputs.middle, inputs.least, inputs.largest
                    durings[0, c] = inputs.mean
                    durings[1, c], durings[2, c] = inputs.mean - inputs.away, inputs.mean + inputs.away
                    idles[2, c] = idle[f, c]
                    settling = max(inputs.least, Y_MIN) * (gate.settle - gate.pause)
                    off = (abs(inputs.swing) * gate.swing_reach + inputs.bent) * per_clock
                    out.passed[0, f, r, c] = settling
                    out.passed[1, f, r, c] = settling + max(inputs.mean - off, Y_MIN) * gate.clocks
            if gate.slow_mirror:
                for way in range(3):
                    _mirrors(
                        gate, r == 0, starts[way], befores[way], durings[way], idles[way], kappas, inverse[way],
                        begins[way], out.end[way, f, r],
                    )  # fmt: skip
                for c in range(cols):
                    out.begin[f, r, c] = begins[2, c]
            of_row = noise.row_key(seed, first + f, r)
            for c in range(cols):
                u, offset = settled[c], table[of.OFFSET, c]
                late = known = 0.0
                x = u + offset
                low, high = x - away[c], x + away[c]
                if gate.slow_mirror:
                    begin, end = begins[0, c], out.end[0, f, r, c]
                    apart = (end - begin) / (end + begin)
                    late = kappas[c] * (log_of(apart) if abs(apart) < FAR else math.log(end / begin))
                    more = out.end[2, f, r, c] * begin / (end * begins[1, c])
                    more = max(more, end * begins[2, c] / (out.end[1, f, r, c] * begin)) - 1.0
                    # ln(1 + t) is t at most.
                    known = kappas[c] * (more if more < FAR else math.log(1.0 + more))
                    if u - away[c] < Y_MIN:
                        # A mirror gives no negative current.
                        known += gate.clocks * min(away[c], abs(u) + away[c])
                    x = max(u, Y_MIN) - late * per_clock + offset
                    low = min(max(u - away[c], Y_MIN), begins[1, c]) + offset
                    high = max(max(u + away[c], Y_MIN), begins[2, c]) + offset
                packet = table[of.PACKET, c]
                clip = X_CLIP * max(packet, 1.0)
                clipped = x >= clip
                x = min(max(x, -clip), clip)
                low = min(max(low, -_X_LARGE), clip)
                high = min(max(high, -_X_LARGE), _X_LARGE)
                across = table[of.G_IN, c]
                if gate.direct:
                    across += g_column[f, c]
                across = min(across * table[of.CROSS, c], 1e12)
                s = of.Cell(
                    1.0 * gate.clocks, root, x, low, high, swings[c], swing_sum[f, r],
                    gate.swing_reach, bends[c], moves[c], late, known,
                    across * table[of.LEAK, c], across, table[of.THERMAL, c] * g_column[f, c], packet,
                    table[of.WINDOW, c], table[of.DELAY, c],
                    table[of.LAG, c], table[of.LOW, c], table[of.HIGH, c], table[of.PRESET, c], table[of.NOISE, c],
                    table[of.APERTURE, c], table[of.JITTER, c], table[of.SHOT, c], table[of.PRESET_NOISE, c],
                    table[of.FLICKER, c],
                )  # fmt: skip
                base = abs(table[of.AWAY, c]) + table[of.PRESET, c]
                a = of.total(s, on, base, tally, None)
                calm = of.quiet(s, a.loose, a.levels)
                left, doubtful = of.late(s, a.loose, a.levels)
                shift = a.shift + left if calm else 0.0
                steady = (a.rest + doubtful if calm else a.whole) + ROUNDING + apart_lsb[c]
                climb = a.climb if calm else 0.0
                spread = math.sqrt(a.squares + a.paths)
                error = steady + climb + spread
                level = table[of.LEVEL, c] - table[of.BEGIN, c] - shift
                mean = x + swings[c] * swing_sum[f, r] * per_clock
                doubt = (bends[c] + known + ROUNDING) * per_clock
                key, path, bound = noise.key_in_row(of_row, c), 0.0, error
                if calm and a.paths > 0.0 and doubt <= 0.02 * mean:
                    # `climb` holds two hundredths of the path.
                    path = (
                        _sigma(table, g_column[f, c], mean, c) * noise.normal(key, noise.WALK, span) * ended
                    )
                    bound = steady + climb + math.sqrt(a.squares + a.paths * bridge)
                code, open_ = _decide(x, clipped, level - path, bound, packet, gate)
                sample, happened = number % EACH == 0, 0.0
                if (open_ or sample) and gate.random:
                    start, size = _slot(table, c, key)
                    end, error_drawn = 0.0, steady + math.sqrt(a.drawn)
                    if calm:
                        held = left > doubtful
                        end, above = _last(gate, table, g_column[f, c], mean, doubt, low, held, c, key)
                        error_drawn = steady + above
                    moved_start = start - table[of.BEGIN, c]
                    if sample:
                        happened = abs(
                            shift - late + end + moved_start - (size - packet) * gate.clocks * x / packet
                        )
                    if open_:
                        code, open_ = _decide(x, clipped, level - moved_start - end, error_drawn, size, gate)
                        drawn += not open_
                elif sample:
                    happened = abs(shift - late)
                if sample and happened > ROUNDING:
                    ratios[sampled] = bound / happened
                    sampled += 1
                out.x[f, r, c], out.shift[f, r, c], out.error[f, r, c] = x, shift, error
                out.open[f, r, c], out.codes[f, r, c] = open_, code
                if open_:
                    out.blame[f, r, c] = _worst(s, on, calm)
                number += 1
    return sampled, drawn
