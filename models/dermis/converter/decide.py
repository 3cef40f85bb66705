# SPDX-License-Identifier: Apache-2.0
"""Decide cells, compiled: from currents to levels and their error bounds to codes, or to cells that stay open."""

import math
from collections import namedtuple

import numba
import numpy as np

from dermis import bounds as of
from dermis.converter import bound_loops as loops
from dermis.converter import noise
from dermis.converter.course import FAR, approach, log_of
from dermis.converter.vfc import Y_MIN
from dermis.converter.vfc_loops import count_one

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
# A part of `decide_cells`, put in as if it were written there.
_part = numba.njit(inline="always", error_model="numpy")


class Gate(
    namedtuple(
        "Gate", "clocks settle pause code_max budget ripple swing_reach motion slow_mirror direct random"
    )
):
    """Numbers that all cells of a run share.

    Clocks of a slot, the largest code, and the error that decides a cell all the same; the amplitude of the ripple and
    the largest sum of its sine; what there is of motion, slow mirrors and noise.
    """

    __slots__ = ()


class Solved(namedtuple("Solved", "x passed begin end shift error open codes blame")):
    """Results of `decide_cells`, [frames, rows, cols] each.

    `x` mean duty. Of slow mirrors: `passed` [2, ...] packets that pass at least from the start of a slot to its gate,
    and in the whole slot; `begin` the highest output where the gate begins; `end` [3, ...] the output after each gate:
    as solved, the lowest and the highest possible.
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


class Run(namedtuple("Run", "currents g_column idle swing_sum apart_lsb seed first")):
    """Input of `decide_cells`, the same for all of its cells or an array over them.

    `currents` are those of `course.solve_gate`. `g_column` [frames, rows, cols] conductance on each column in
    the gate of each row, `idle` [frames, cols] most of a settled mirror while no row is driven. `swing_sum`
    [frames, rows] sum of the sine of the ripple over the gate. `apart_lsb` [cols] packets by which levels may
    differ for a reason outside the model. `seed` of the random numbers, and the number of frame 0 in the whole
    run (`first`).
    """

    __slots__ = ()


# Inputs of the converters of one row [INPUTS, cols], as in SlotInput; `MOVES` packets of motion alone. Of slow mirrors
# three each, as solved, the lowest and the highest: input where the first row begins, before the gate and in the gate;
# 1 over the output, and the output where the gate begins and ends.
MEAN, AWAY, SWING, MOVES, BENT = range(5)
START, BEFORE, DURING, INVERSE, BEGIN, END, INPUTS = range(5, 26, 3)


@_part
def _finite(table, run, part, instant, f, r, c):  # type: ignore
    """Current of a cell, an infinite one as a large one."""
    top = table[of.TOP, c]
    return min(max(run.currents[part, instant, f, r, c], -top), top)


@_part
def _inputs_of_row(gate, table, run, row, f, r, passed):  # type: ignore
    """Fill the inputs of `row`, and `passed` of Solved."""
    # Start of the slot's settling in gates: motion goes on straight there, out of the range that it has in the gate.
    ahead, per_clock = (gate.settle - gate.pause) / gate.clocks, 1.0 / gate.clocks
    for c in range(row.shape[1]):
        driven = later = _finite(table, run, 0, 0, f, r, c)
        other = other_later = _finite(table, run, 1, 0, f, r, c)
        bend = other_bend = 0.0
        if gate.motion:
            later, other_later = _finite(table, run, 0, 1, f, r, c), _finite(table, run, 1, 1, f, r, c)
        if run.currents.shape[1] > 2:
            bend, other_bend = _finite(table, run, 0, 2, f, r, c), _finite(table, run, 1, 2, f, r, c)
        given = _slot_input(
            gate, ahead, table[of.PER_A, c], table[of.SQUEEZE, c], driven, later, bend, other, other_later, other_bend
        )  # fmt: skip
        row[MEAN, c], row[AWAY, c], row[SWING, c] = given.mean, given.away, given.swing
        row[MOVES, c], row[BENT, c] = 0.25 * gate.clocks * given.apart, given.bent
        if gate.slow_mirror:
            row[START, c], row[START + 1, c], row[START + 2, c] = given.start, given.least, given.largest
            row[BEFORE, c], row[BEFORE + 1, c], row[BEFORE + 2, c] = given.middle, given.least, given.largest
            row[DURING, c] = given.mean
            row[DURING + 1, c], row[DURING + 2, c] = given.mean - given.away, given.mean + given.away
            settling = max(given.least, Y_MIN) * (gate.settle - gate.pause)
            off = (abs(given.swing) * gate.swing_reach + given.bent) * per_clock
            passed[0, f, r, c] = settling
            passed[1, f, r, c] = settling + max(given.mean - off, Y_MIN) * gate.clocks


@_part
def _through_mirror(gate, kappa, row, c):  # type: ignore
    """Return (mean, lowest, highest) output of a slow mirror in a gate, the packets that it is late, and the error of
    these.
    """
    mean, away, begin, end = row[MEAN, c], row[AWAY, c], row[BEGIN, c], row[END, c]
    apart = (end - begin) / (end + begin)
    late = kappa * (log_of(apart) if abs(apart) < FAR else math.log(end / begin))
    more = row[END + 2, c] * begin / (end * row[BEGIN + 1, c])
    more = max(more, end * row[BEGIN + 2, c] / (row[END + 1, c] * begin)) - 1.0
    # ln(1 + t) is t at most.
    known = kappa * (more if more < FAR else math.log(1.0 + more))
    if mean - away < Y_MIN:
        # A mirror gives no negative current.
        known += gate.clocks * min(away, abs(mean) + away)
    low = min(max(mean - away, Y_MIN), row[BEGIN + 1, c])
    high = max(max(mean + away, Y_MIN), row[BEGIN + 2, c])
    return max(mean, Y_MIN) - late / gate.clocks, low, high, late, known


@_part
def _cell(gate, table, row, kappa, g_column, swing_sum, c):  # type: ignore
    """Return the cell as bounds take it, and whether its duty is clipped."""
    x, low, high = row[MEAN, c], row[MEAN, c] - row[AWAY, c], row[MEAN, c] + row[AWAY, c]
    late = known = 0.0
    if gate.slow_mirror:
        x, low, high, late, known = _through_mirror(gate, kappa, row, c)
    x, low, high = x + table[of.OFFSET, c], low + table[of.OFFSET, c], high + table[of.OFFSET, c]
    packet = table[of.PACKET, c]
    clip = X_CLIP * max(packet, 1.0)
    across = table[of.G_IN, c]
    if gate.direct:
        across += g_column
    across = min(across * table[of.CROSS, c], 1e12)
    return loops.Cell(
        1.0 * gate.clocks, math.sqrt(gate.clocks), min(max(x, -clip), clip), min(max(low, -_X_LARGE), clip),
        min(max(high, -_X_LARGE), _X_LARGE), row[SWING, c], swing_sum, gate.swing_reach, row[BENT, c], row[MOVES, c],
        late, known, across * table[of.LEAK, c], across, table[of.THERMAL, c] * g_column, packet,
        table[of.WINDOW, c], table[of.DELAY, c], table[of.LAG, c], table[of.LOW, c], table[of.HIGH, c],
        table[of.PRESET, c], table[of.NOISE, c], table[of.APERTURE, c], table[of.JITTER, c], table[of.SHOT, c],
        table[of.PRESET_NOISE, c], table[of.FLICKER, c],
    ), x >= clip  # fmt: skip


@_part
def _bound_cell(on, table, s, apart, c, tally):  # type: ignore
    """Bound what moves the level of a cell, its own random numbers aside.

    Returns (sums over effects, shift, the part of the error that always holds, what grows with the path, whether the
    cell is quiet, whether a comparator with a window holds the packet before).
    """
    a = loops.total(s, on, abs(table[of.AWAY, c]) + table[of.PRESET, c], tally)
    left, doubtful = loops.late(s, a.loose, a.levels)
    if loops.quiet(s, a.loose, a.levels):
        return a, a.shift + left, a.rest + doubtful + ROUNDING + apart, a.climb, True, left > doubtful
    return a, 0.0, a.whole + ROUNDING + apart, 0.0, False, False


@_part
def _decide_cell(gate, on, table, s, clipped, g_column, apart, key, c, sample, tally):  # type: ignore
    """Decide a cell by the bound that holds for any random numbers but the end of its path, then by its own.

    Returns (code, whether it is open, shift, error, bound over the shift that happened or 0, whether its random numbers
    decided it, whether it is quiet).
    """
    a, shift, steady, climb, calm, held = _bound_cell(on, table, s, apart, c, tally)
    bound = error = steady + climb + math.sqrt(a.squares + a.paths)
    level = table[of.LEVEL, c] - table[of.BEGIN, c] - shift
    mean = s.x + s.swing * s.swing_sum / gate.clocks
    doubt = (s.swing_bent + s.late_known + ROUNDING) / gate.clocks
    path = 0.0
    if calm and a.paths > 0.0 and doubt <= 0.02 * mean:
        # Part of a path's end that the end of its grid tells, and part of its variance that it does not; `climb`
        # holds two hundredths of the path.
        span = int(noise.span_of(gate.clocks))
        told = gate.clocks / math.sqrt(span)
        path = _sigma(table, g_column, mean, c) * noise.normal(key, noise.WALK, span) * told
        bound = steady + climb + math.sqrt(a.squares + a.paths * ((span - gate.clocks) / span))
    code, open_ = _decide(s.x, clipped, level - path, bound, s.packet, gate)
    happened, drawn = abs(shift - s.late), False
    if (open_ or sample) and gate.random:
        start, size = _slot(table, c, key)
        end, error_drawn = 0.0, steady + math.sqrt(a.drawn)
        if calm:
            end, above = _last(gate, table, g_column, mean, doubt, s.low, held, c, key)
            error_drawn = steady + above
        moved = start - table[of.BEGIN, c]
        happened = abs(shift - s.late + end + moved - (size - s.packet) * gate.clocks * s.x / s.packet)
        if open_:
            code, open_ = _decide(s.x, clipped, level - moved - end, error_drawn, size, gate)
            drawn = not open_
    ratio = bound / happened if sample and happened > ROUNDING else 0.0
    return code, open_, shift, error, ratio, drawn, calm


@_compiled
def decide_cells(gate, on, table, run, out, tally, ratios):  # type: ignore
    """Fill `out` and `tally`; returns how many `ratios` of bound and shift were sampled, and how many
    cells were decided by the random numbers of their slots.

    Parameters
    ----------
    gate, run, out : Gate, Run, Solved
    on : [bounds.COUNT], factor on each bound; 0 is off
    table : [25, cols], bounds.columns
    """
    frames, rows, cols = run.currents.shape[2:]
    row, still, kappas = np.empty((INPUTS, cols)), np.zeros(cols), np.maximum(table[of.KAPPA], _KAPPA_MIN)
    sampled = drawn = number = 0
    for f in range(frames):
        for r in range(rows):
            _inputs_of_row(gate, table, run, row, f, r, out.passed)
            if gate.slow_mirror:
                for way in range(3):
                    _mirrors(
                        gate, r == 0, row[START + way], row[BEFORE + way], row[DURING + way],
                        run.idle[f] if way == 2 else still, kappas, row[INVERSE + way], row[BEGIN + way],
                        row[END + way],
                    )  # fmt: skip
                for c in range(cols):
                    for way in range(3):
                        out.end[way, f, r, c] = row[END + way, c]
                    out.begin[f, r, c] = row[BEGIN + 2, c]
            of_row, swing_sum = noise.row_key(run.seed, run.first + f, r), run.swing_sum[f, r]
            for c in range(cols):
                g_column, apart, key = run.g_column[f, r, c], run.apart_lsb[c], noise.key_in_row(of_row, c)
                s, clipped = _cell(gate, table, row, kappas[c], g_column, swing_sum, c)
                code, open_, shift, error, ratio, by_numbers, calm = _decide_cell(
                    gate, on, table, s, clipped, g_column, apart, key, c, number % EACH == 0, tally
                )
                out.x[f, r, c], out.shift[f, r, c], out.error[f, r, c] = s.x, shift, error
                out.open[f, r, c], out.codes[f, r, c] = open_, code
                if open_:
                    out.blame[f, r, c] = np.argmax(tally[:, 2 if calm else 3])
                if ratio > 0.0:
                    ratios[sampled] = ratio
                    sampled += 1
                drawn += by_numbers
                number += 1
    return sampled, drawn
