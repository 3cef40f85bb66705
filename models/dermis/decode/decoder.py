# SPDX-License-Identifier: Apache-2.0
"""Codes to newtons with an interval for every taxel: one compiled pass over the frames."""

from __future__ import annotations

import contextlib
import copy
import itertools
import threading
from collections import namedtuple
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dermis import machine_code
from dermis.array.array import Network
from dermis.converter.vfc import code_type
from dermis.decode import crosstalk
from dermis.decode.calibration import COVERAGE_SIGMA, UNKNOWN_PART, Calibration
from dermis.decode.law import force_of
from dermis.decode.memory import SheetMemory, check_out, undo_frame
from dermis.ndarrays import Bools, Floats, unmasked
from dermis.scene.sensor_loops import advance_creep

ZERO, SATURATED, SHORT, UNSOLVED, NEAR_SATURATED = 1, 2, 4, 8, 16
"""Bits of Forces.flags."""
WARMEST = 1.25
"""Factor of conductance that a temperature may make: 40 K of an ink of 0.6 % a kelvin."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces in newtons, each array [frames, rows, cols].

    Attributes
    ----------
    force_n, low_n, high_n : ndarray
        The estimate and the ends of its interval. A saturated taxel has the force of full scale and the upper end inf.
    flags : ndarray of uint8
        ZERO (no more than the code of no current, usually 0), SATURATED (full scale: the largest code that the
        column's start and packet reach), SHORT, UNSOLVED (the frame's solution did not converge, or a taxel of constant
        force conducts less than 1 / WARMEST or more than WARMEST times as calibrated; the interval is 0..inf),
        NEAR_SATURATED (in the row or the column of a saturated taxel, in a column beside, or moved by more than half a
        code if it is a short: the interval holds if it conducts no more than the calibration's g_max_s).
    """

    force_n: Floats
    low_n: Floats
    high_n: Floats
    flags: NDArray[np.uint8]

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> Forces:
        """Return arrays to fill, of a shape."""
        return cls(*np.empty((3, *shape)), np.empty(shape, np.uint8))

    def writable(self, shape: tuple[int, ...]) -> list[NDArray]:
        """Return the four arrays; ValueError unless a compiled loop may write results of this shape into them."""
        kinds = {"force_n": float, "low_n": float, "high_n": float, "flags": np.uint8}
        arrays = [check_out(getattr(self, n), shape, kind, f"out.{n}") for n, kind in kinds.items()]
        if any(np.may_share_memory(a, b) for a, b in itertools.combinations(arrays, 2)):
            raise ValueError("the arrays of out share memory: each needs its own")
        return arrays

    def holds(self, force_n: Floats) -> Bools:
        """Return True where a force in newtons lies in its interval."""
        # Bounds are computed in two steps of rounding, each far below 1e-9 of the force.
        slack = 1 + 1e-9
        return (self.low_n <= force_n * slack) & (force_n <= self.high_n * slack)


class Threaded:
    """Base of objects that threads share: a copy or a pickle has a lock and values of each thread of its own."""

    def __init__(self) -> None:
        self._lock, self._local = threading.Lock(), threading.local()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("_local", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        Threaded.__init__(self)

    def __copy__(self) -> Threaded:
        return copy.deepcopy(self)


_compiled = njit(cache=True, nogil=True, error_model="numpy")

# Values of a calibration as the compiled loops take them, in the units of `Calibration`.
_Known = namedtuple(
    "_Known",
    # Columns: codes of none and of the largest current, ampere a code, code of no current, errors of both.
    "zero_code full_code step start inv_range step_part start_sigma offset_v2 "
    # Half the width of a code, and of a taxel the largest conductance and that of full scale.
    "half g_max g_full "
    # `crosstalk.arguments`, and with the ends of traces: no compiled solve has those.
    "v_bias r_driven g_ground r_column v_offset i_leak g_lateral r_driven_far r_column_far r_return traced "
    # Taxels: number of the law [rows, cols], all laws, factor with its error, errors of all, constant taxels.
    "which logarithmic knots coefficients g_open force_on factor factor_part law_part uncorrected reference "
    # Hysteresis and creep.
    "radius weight per_decade",
)


@_compiled
def _spread(k, g, e_down, e_up, u, total, full, hidden, down, up, through, doubt):
    """Fill in how far conductances `g` may lie below and above, [rows, cols], for errors of the currents.

    First order in the errors, and an upper bound in the signs (docs/decode.md). Traces count in full. In a row with
    a saturated taxel (`full` [rows]), which may be a short, the line may be anywhere between ground and the highest
    column, and any other taxel may conduct `g_full`; `hidden` is the current of every row that its column may take
    past its input. `doubt` [rows, cols] is how far that may move a current.
    """
    rows, cols = g.shape
    v_bias, r_driven, r_column, g_lateral = k.v_bias, k.r_driven_far, k.r_column_far, k.g_lateral
    lifts, part = np.empty(rows), np.empty(rows)
    for r in range(rows):
        part[r] = k.g_ground / (total[r] + k.g_ground) if total[r] + k.g_ground > 0.0 else 0.0
        for c in range(cols):
            down[r, c], up[r, c] = e_down[r, c] / v_bias, e_up[r, c] / v_bias
    for side in range(2):
        e, other, d = (e_down, e_up, down) if side == 0 else (e_up, e_down, up)
        for r in range(rows):
            low, high = 0.0, 0.0
            for c in range(cols):
                doubt[r, c] = g[r, c] * r_driven * hidden
                low, high = min(low, u[r, c]), max(high, u[r, c])
                # A neighbour's voltage takes current away.
                through[c] = e[r, c] * (1.0 + 2.0 * g_lateral * r_column[c])
                if c > 0:
                    through[c] += g_lateral * r_column[c - 1] * other[r, c - 1]
                if c + 1 < cols:
                    through[c] += g_lateral * r_column[c + 1] * other[r, c + 1]
            # So do the taxels of other rows: by their own error, and by those of the voltages at both ends.
            come, leave = 0.0, 0.0
            for i in range(rows):
                lifts[i] = 0.0
                if i == r or total[i] + k.g_ground == 0.0:
                    continue
                lift = 0.0
                for c in range(cols):
                    both = (high - low) * (e_down[i, c] + e_up[i, c]) / v_bias
                    lift += g[i, c] * r_column[c] * other[r, c] + both
                lifts[i] = lift / (total[i] + k.g_ground)
                come += part[i] * lift
                leave += part[i] * total[i]
            # The shared return lifts them all.
            node, shorted = come * k.r_return / (1.0 + k.r_return * leave), False
            for i in range(rows):
                shorted = shorted or (full[i] and i != r and k.r_return > 0.0)
            if shorted:
                node = high - low
            for i in range(rows):
                if i == r or total[i] == 0.0:
                    continue
                if full[i]:
                    for c in range(cols):
                        doubt[r, c] += (high - low) * k.g_full
                        through[c] += (high - low) * max(k.g_full, g[i, c]) + g[i, c] * r_column[c] * e[r, c]
                    continue
                lift = lifts[i] + part[i] * node
                for c in range(cols):
                    doubt[r, c] += g[i, c] * part[i] * node if shorted else 0.0
                    through[c] += g[i, c] * (lift + r_column[c] * e[r, c]) + (high - low) * d[i, c]
            row_error, row_current = hidden, 0.0
            for c in range(cols):
                row_error += through[c]
                row_current += g[r, c] * (v_bias - u[r, c])
            p = v_bias - r_driven * row_current / (1.0 + r_driven * total[r])
            for c in range(cols):
                lost = r_driven * row_error + r_column[c] * e[r, c]
                across = p - u[r, c] - (lost if side == 1 else 0.0)
                d[r, c] = (through[c] + g[r, c] * lost) / across if across > 0.0 else np.inf
        for c in range(cols):
            # Errors of a column add up in its voltages, which move all of its taxels again; one without an end is a
            # short, which `full` rows allow for.
            again, below, lifted = 0.0, 0.0, 0.0
            for r in range(rows):
                again += d[r, c] if d[r, c] < np.inf else 0.0
                lifted += max(u[r, c], 0.0) / v_bias
            again *= lifted / (1.0 - lifted) if lifted < 1.0 else np.inf
            for r in range(rows - 1, -1, -1):
                before = d[r, c]
                if lifted > 0.0:
                    d[r, c] += max(u[r, c], 0.0) / v_bias * (again + below)
                below += before - e[r, c] / v_bias if before < np.inf else 0.0


@_compiled
def _constant(k, c, code):
    """Return the part of an error in codes that is the same in every frame: gain and start."""
    return COVERAGE_SIGMA * (k.start_sigma[c] + k.step_part[c] * abs(code - k.start[c]))


@_compiled
def currents_of(k, codes, out, down, up, most):
    """Currents in ampere [rows, cols] of the middles of codes, and how far they may lie below and above.

    `most` is the upper end where a code is no more than that of no current, and inf elsewhere: a counter does not run
    backwards, so the current may be any smaller one.
    """
    rows, cols = codes.shape
    for r in range(rows):
        for c in range(cols):
            code = codes[r, c]
            middle = k.step[c] * (code - k.start[c])
            width = k.step[c] * (k.half + _constant(k, c, code))
            # Compression stretches currents and errors; it is undone at the middle.
            squeeze = max(1.0 - abs(middle) * k.inv_range[c], 1e-9)
            out[r, c] = middle / squeeze
            down[r, c] = up[r, c] = width / (squeeze * squeeze)
            most[r, c] = out[r, c] + up[r, c] if code <= k.zero_code[c] else np.inf
            if code >= k.full_code[c]:
                up[r, c] = max(up[r, c], k.v_bias * k.g_max - out[r, c])


@_compiled
def _mark_full(k, codes, g, full_row, full_column):
    """Mark rows and columns with a saturated taxel or a short; return the current that their columns may hide."""
    rows, cols = codes.shape
    full_row[:], full_column[:] = False, False
    for r in range(rows):
        for c in range(cols):
            # A short between weak drivers reads less than full scale; its solution tells.
            if codes[r, c] >= k.full_code[c] or g[r, c] > k.g_max:
                full_row[r] = full_column[c] = True
    hidden = 0.0
    for c in range(cols):
        if full_column[c] and (k.r_column_far[c] > 0.0 or k.v_offset[c] != 0.0):
            hidden += k.g_full * k.v_bias
    return hidden


@_compiled
def _widen(k, current, ceiling, g, e_down, e_up, offset_a):
    """Add to the errors of currents what clipped readings hide, and `offset_a` [cols] of the offset voltages."""
    rows, cols = g.shape
    for r in range(rows):
        for c in range(cols):
            if ceiling[r, c] < np.inf:
                e_up[r, c] = max(e_up[r, c], ceiling[r, c] - current[r, c])
    v2 = k.offset_v2
    for c in range(cols):
        # An offset voltage drives current through all taxels of its column, and to its neighbours.
        before, after = k.g_lateral * (c > 0), k.g_lateral * (c + 1 < cols)
        carried = before + after
        for r in range(rows):
            carried += min(g[r, c], k.g_max)
        variance = carried**2 * v2[0, c]
        if c > 0:
            variance += before**2 * v2[0, c - 1] - 2.0 * before * carried * v2[1, c - 1]
        if c + 1 < cols:
            variance += after**2 * v2[0, c + 1] - 2.0 * after * carried * v2[1, c]
        if 0 < c < cols - 1:
            variance += 2.0 * before * after * v2[2, c - 1]
        offset_a[c] = COVERAGE_SIGMA * np.sqrt(max(variance, 0.0))
        for r in range(rows):
            e_down[r, c] += offset_a[c]
            e_up[r, c] += offset_a[c]


@_compiled
def _copy(out, values):
    """Element by element: numba compiles an assignment of arrays for two seconds."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] = values[r, c]


@_compiled
def _mode_variance(k, modes, solved_off, n, g, current, ceiling, u, taken, total, through, other, spread):
    """Fill in the variance of conductances by the errors of the network, `modes`."""
    networks, factors = modes
    driven, ground, column, offset, leak, lateral = networks
    rows, cols = g.shape
    spread[:] = 0.0
    for m in range(factors.shape[0]):
        if solved_off.size:
            _copy(other, solved_off[m, n, 0])
        else:
            # A part of 1e-4 of the difference that counts: it is some per cent of the conductance.
            moved = current.copy()
            _copy(other, g)
            network = k.v_bias, driven[m], ground[m], column[m], offset[m], leak[m], lateral[m]
            crosstalk.known_voltages(moved, network, u, taken)
            crosstalk.converge(other, total, u, taken, network, through, moved, ceiling, 1e-6)
        for r in range(rows):
            for c in range(cols):
                spread[r, c] += (other[r, c] / (1.0 + factors[m, r, c]) - g[r, c]) ** 2


@_compiled
def _warmth(k, g, down, up):
    """Return how much more than known the constant taxels conduct, as a factor with its error, and if it can be so.

    Below 1 / WARMEST and above WARMEST a constant taxel is loose, or was pressed: the factor is then 1.
    """
    warm, part, steady = 1.0, 0.0, True
    for m in range(k.reference.shape[0]):
        r, c = int(k.reference[m, 0]), int(k.reference[m, 1])
        share, ratio = 1.0 / k.reference.shape[0], g[r, c] / k.reference[m, 2]
        steady = steady and 1.0 / WARMEST <= ratio <= WARMEST
        warm += share * (ratio - 1.0)
        part += share * max(up[r, c], down[r, c]) / k.reference[m, 2]
    return (warm if steady else 1.0, part), steady


@_compiled
def _flags(k, codes, g, good, doubt, full_row, full_column, flags):
    rows, cols = codes.shape
    # Series resistance and traces tie a saturated taxel to its row, to its column, and with laterals to the next.
    # Along a trace a shorted row saturates its first taxels only, and ties the others to every column.
    rows_tied, everywhere = k.r_driven_far + k.r_column_far.max() > 0.0, k.traced and full_row.any()
    for r in range(rows):
        for c in range(cols):
            bits = 0
            if codes[r, c] <= k.zero_code[c]:
                bits |= ZERO
            if codes[r, c] >= k.full_code[c]:
                bits |= SATURATED
            near = (full_row[r] and rows_tied) or doubt[r, c] > 0.5 * k.step[c] or everywhere
            if k.r_column_far[c] > 0.0 or k.v_offset[c] != 0.0:
                near = near or full_column[c]
                if k.g_lateral > 0.0:
                    near = near or (c > 0 and full_column[c - 1]) or (c + 1 < cols and full_column[c + 1])
            if near:
                bits |= NEAR_SATURATED
            if g[r, c] > crosstalk.SHORT_S:
                bits |= SHORT
            if not good:
                bits |= UNSOLVED
            flags[r, c] = bits


@_compiled
def _by_factor(k, codes, g, down, up, spread, offset_a, flags, warmth, force, low, high, near_low, near_high):
    """Turn conductances with errors into those by the law: estimate, ends, and ends without constant errors."""
    rows, cols = codes.shape
    warm, warm_part = warmth
    for r in range(rows):
        for c in range(cols):
            by_law = 1.0 / (k.factor[r, c] * warm)
            part = COVERAGE_SIGMA * k.factor_part[r, c] + k.uncorrected + warm_part / warm
            by_network = COVERAGE_SIGMA * np.sqrt(spread[r, c])
            low[r, c] = max(g[r, c] - down[r, c] - by_network, 0.0) * by_law * max(1.0 - part, 0.0)
            high[r, c] = (g[r, c] + up[r, c] + by_network) * by_law * (1.0 + part)
            force[r, c] = g[r, c] * by_law
            # Gain and offset are the same in every frame; quantisation and noise are not.
            share = k.half / (k.half + _constant(k, c, codes[r, c]) + offset_a[c] / k.step[c])
            near_low[r, c] = max(g[r, c] - share * down[r, c], 0.0) * by_law
            near_high[r, c] = min(g[r, c] + share * up[r, c], 1e300) * by_law
            if flags[r, c] & ZERO:
                # A counter does not go below 0: offsets may hide any smaller current.
                low[r, c] = near_low[r, c] = force[r, c] = 0.0


@_compiled
def _forces(k, flags, force, low, high):
    """Turn conductances by the law and their ends into forces, in place."""
    rows, cols = force.shape
    part = COVERAGE_SIGMA * k.law_part
    for r in range(rows):
        for c in range(cols):
            m = k.which[r, c]
            at, pieces = k.knots[m], k.coefficients[m]
            force[r, c] = force_of(force[r, c], k.logarithmic, at, pieces, k.g_open, k.force_on)
            least = force_of(low[r, c], k.logarithmic, at, pieces, k.g_open, k.force_on)
            most = force_of(high[r, c], k.logarithmic, at, pieces, k.g_open, k.force_on)
            low[r, c], high[r, c] = least * (1.0 - part), most * (1.0 + part)
            if flags[r, c] & (SATURATED | SHORT | UNSOLVED) or k.factor_part[r, c] >= UNKNOWN_PART:
                high[r, c] = np.inf
            if flags[r, c] & UNSOLVED:
                low[r, c] = 0.0


@_compiled
def _decode_frames(k, codes, missing, dt_s, modes, solved, solved_off, memory, results):
    """Decode codes [frames, rows, cols] into `results`; `solved` is empty where `solve_frame` can do the network.

    `missing` [frames, rows, cols], or empty where none is, hides codes from hysteresis and creep.
    """
    frames, rows, cols = codes.shape
    z, past, moved, band, creep, loaded, gone, frame, fresh, rate, rate_weight = memory
    work, through, offset_a = np.empty((12, rows, cols)), np.empty(cols), np.empty(cols)
    current, ceiling, down, up, e_down, e_up = work[0], work[1], work[2], work[3], work[4], work[5]
    g, near_low, near_high, spread, other, doubt = work[6], work[7], work[8], work[9], work[10], work[11]
    scratch = np.empty((3, rows, cols + 1))
    u, taken, total = scratch[0, :, :cols], scratch[1, :, :cols], scratch[2, :, cols]
    full_row, full_column, gained = np.empty(rows, np.bool_), np.empty(cols, np.bool_), np.zeros(rate.size)
    network = k.v_bias, k.r_driven, k.g_ground, k.r_column, k.v_offset, k.i_leak, k.g_lateral
    for n in range(frames):
        force, low, high, flags = results[0][n], results[1][n], results[2][n], results[3][n]
        currents_of(k, codes[n], current, e_down, e_up, ceiling)
        if solved.size:
            _copy(g, solved[n, 0])
            _copy(current, solved[n, 1])
            good = not np.isnan(g[0, 0])
            crosstalk.known_voltages(current, network, u, taken)
            for r in range(rows):
                total[r] = g[r].sum()
        else:
            good = crosstalk.solve_frame(current, ceiling, network, g, scratch, through)
        hidden = _mark_full(k, codes[n], g, full_row, full_column)
        _widen(k, current, ceiling, g, e_down, e_up, offset_a)
        _spread(k, g, e_down, e_up, u, total, full_row, hidden, down, up, through, doubt)
        _mode_variance(k, modes, solved_off, n, g, current, ceiling, u, taken, total, through, other, spread)
        warmth, steady = _warmth(k, g, down, up)
        _flags(k, codes[n], g, good and steady, doubt, full_row, full_column, flags)
        _by_factor(
            k, codes[n], g, down, up, spread, offset_a, flags, warmth, force, low, high, near_low, near_high
        )
        if k.radius.size > 0 or k.per_decade != 0.0:
            for end in range(2 if k.per_decade != 0.0 and not fresh else 0):  # the least and the most
                gained = advance_creep(creep[end], loaded[end], rate, rate_weight, dt_s[n])
            for r in range(rows if missing.size else 0):
                for c in range(cols):
                    if missing[n, r, c]:
                        low[r, c], high[r, c] = 0.0, np.inf
            flat = low.reshape(-1), force.reshape(-1), high.reshape(-1)
            near = near_low.reshape(-1), near_high.reshape(-1)
            state, law = (z, past, moved, band, creep, loaded, gone), (k.radius, k.weight, k.per_decade)
            undo_frame(flat, near, state, frame, dt_s[n], gained, fresh, k.g_open, law)
            frame += 1
            fresh = False
        _forces(k, flags, force, low, high)


def numbers(values: ArrayLike, name: str) -> Floats:
    """Return real numbers as a contiguous array of doubles; ValueError for any other kind, or hidden by a mask."""
    array = unmasked(values, name)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be real numbers, not {array.dtype}")
    return np.ascontiguousarray(array, dtype=float)


def times(t_frame_s: ArrayLike, frames: int, sheets: int = 0) -> Floats:
    """Return the time before each frame in seconds, [frames], or of each of some sheets, [frames * sheets].

    ValueError if a time is not finite or below 0.
    """
    # An array of its own: a broadcast one has other strides, and the loops would be compiled again for it.
    dt_s = np.empty((frames, sheets) if sheets else frames)
    try:
        dt_s[:] = numbers(t_frame_s, "t_frame_s")
    except ValueError:
        wanted = f"[{sheets}] or [{frames}, {sheets}]" if sheets else f"{frames}"
        raise ValueError(f"t_frame_s must be a number of seconds, or {wanted} of them") from None
    if not (np.isfinite(dt_s).all() and (dt_s >= 0).all()):
        raise ValueError("t_frame_s must be finite and 0 or above: time does not run backwards")
    return dt_s.reshape(-1)


def _stacked(cal: Calibration) -> tuple:
    """Return the number of each taxel's law [rows, cols], and all laws as arrays; number 0 is the shared one."""
    curves = [cal.curve, *cal.own.values()]
    pieces = max(curve.knots.size for curve in curves)
    # No conductance reaches a knot at infinity.
    knots, coefficients = np.full((len(curves), pieces), np.inf), np.zeros((len(curves), pieces, 4))
    which = np.zeros((cal.rows, cal.cols), dtype=np.int64)
    for n, curve in enumerate(curves):
        knots[n, : curve.knots.size], coefficients[n, : curve.knots.size] = curve.knots, curve.coefficients
    for n, place in enumerate(cal.own, 1):
        which[place] = n
    return which, cal.curve.logarithmic, knots, coefficients, cal.curve.g_open_s, cal.curve.force_on_n


class Decoder(Threaded):
    """Codes of one sheet to newtons.

    Without hysteresis and creep a decoder has no state and may be called from several threads at once. With them it
    is one stream: frames in order of time, one call at a time (others wait), `save` and `load` for its state.

    Parameters
    ----------
    calibration : Calibration
    t_frame_s : float
        Time from frame to frame where `decode` is given no other.
    """

    def __init__(self, calibration: Calibration, t_frame_s: float) -> None:
        super().__init__()
        machine_code.announce()
        self.calibration = cal = calibration
        self.t_frame_s = float(t_frame_s)
        self._network = network = cal.array()
        self._off = [cal.array(mode) for mode in cal.modes]
        self._least = cal.least_code()
        self._lumped = crosstalk.lumped(network) and not cal.divider
        v_bias_v, r_driven_ohm, *others = crosstalk.arguments(network)
        row_end, column_end = cal.cols * network.r_trace_row_ohm, cal.rows * network.r_trace_column_ohm
        self._known = _Known(
            *(cal.zero_code, cal.full_code, cal.step_a, cal.start_code, cal.inv_i_range_a),
            *(cal.step_part, cal.start_sigma_code, cal.offset_v2),
            *(cal.half_width_code(), float(cal.g_max_s), cal.g_full_s()),
            *(v_bias_v, r_driven_ohm, *others, float(r_driven_ohm + row_end), others[1] + column_end),
            *(float(network.r_return_ohm), bool(row_end > 0 or column_end > 0)),
            *(*_stacked(cal), cal.factor, cal.factor_part, float(cal.law_part), float(cal.uncorrected_part)),
            np.array(cal.reference, dtype=float).reshape(-1, 3),
            *(cal.memory.radius, cal.memory.weight, float(cal.memory.creep_per_decade)),
        )
        places = [crosstalk.arguments(one)[1:] for one in self._off] or [crosstalk.arguments(network)[1:]]
        self._modes = (
            tuple(np.array(column, dtype=float) for column in zip(*places, strict=True)),
            np.array([mode.factor_part for mode in cal.modes]).reshape(-1, cal.rows, cal.cols),
        )
        self.reset()

    def reset(self) -> None:
        """Forget the stream: the next frame is the first."""
        self.memory = self.fresh()

    def fresh(self) -> SheetMemory:
        """Return the state of a stream before its first frame."""
        cal = self.calibration
        return SheetMemory(cal.memory, cal.rows * cal.cols, cal.curve.g_open_s)

    def decode(
        self,
        codes: ArrayLike,
        t_frame_s: float | ArrayLike | None = None,
        out: Forces | None = None,
        missing: Bools | None = None,
    ) -> Forces:
        """Decode codes [frames, rows, cols] or [rows, cols].

        Parameters
        ----------
        codes : array_like of int
            0..code_max.
        t_frame_s : float or array_like, optional
            Time in seconds since the frame before, for all frames or for each.
        out : Forces, optional
            Arrays of the shape of the codes to fill, so that nothing is allocated.
        missing : ndarray of bool, optional
            Codes that no reading made, shaped as they: their forces are NaN in 0..inf, and the intervals of all others
            hold for any code there. Hysteresis and creep may have been anywhere; the next call goes on from the codes
            as they are given.

        Raises
        ------
        ValueError
            Codes of a wrong shape, kind or range, times that run backwards, or other arrays of another shape or type.
        """
        cal = self.calibration
        codes = unmasked(codes, "codes")
        fits = codes.ndim in (2, 3) and codes.shape[-2:] == (cal.rows, cal.cols)
        if not fits or codes.dtype.kind not in "iu":
            raise ValueError(f"codes must be integers [frames, {cal.rows}, {cal.cols}]")
        if codes.size and not (0 <= codes.min() and codes.max() <= cal.code_max):
            raise ValueError(f"codes must be 0..{cal.code_max}")
        frames = cal.rising(codes).reshape(-1, cal.rows, cal.cols)
        frames = np.ascontiguousarray(frames, code_type(cal.code_max))  # the loops are compiled for each type
        dt_s = times(self.t_frame_s if t_frame_s is None else t_frame_s, len(frames))
        out = Forces.empty(codes.shape) if out is None else out
        results = tuple(array.reshape(frames.shape) for array in out.writable(codes.shape))
        hidden = np.zeros((0, *frames.shape[1:]), np.bool_)
        fits = isinstance(missing, np.ndarray) and missing.dtype == np.bool_ and missing.shape == codes.shape
        if missing is not None and not fits:
            raise ValueError(f"missing must be a bool array of the shape of the codes, {list(codes.shape)}")
        if missing is not None and missing.any():
            hidden = np.ascontiguousarray(missing.reshape(frames.shape))
        with self._lock if cal.memory.active else contextlib.nullcontext():
            before = copy.deepcopy(self.memory) if hidden.size else self.memory
            self._decode(self.memory, frames, hidden, dt_s, results)
            if hidden.size:
                force, low, high, _ = results
                # The ends of its range; at full scale it would be a short, which opens all intervals of its row.
                for end in (0, cal.code_max - 1):
                    filled = np.where(hidden, end, frames).astype(frames.dtype)
                    other = tuple(map(np.empty_like, results))
                    self._decode(copy.deepcopy(before), filled, hidden, dt_s, other)
                    np.minimum(low, other[1], out=low)
                    np.maximum(high, other[2], out=high)
                force[hidden], low[hidden], high[hidden] = np.nan, 0.0, np.inf
        if (self._least > 0).any():  # of an amplifier; the chip and dividers read no less than 0
            out.high_n[(frames < self._least).reshape(codes.shape)] = np.inf
        return out

    def _decode(
        self, memory: SheetMemory, frames: NDArray, hidden: Bools, dt_s: Floats, results: tuple[NDArray, ...]
    ) -> None:
        """Decode rising codes [frames, rows, cols] and go on with a stream; `hidden` may be empty."""
        solved, solved_off = np.empty((0, 2, *frames.shape[1:])), np.empty((0, 0, 2, *frames.shape[1:]))
        if not self._lumped:
            solved = self.conductances(frames, self._network)
            if self._off:
                solved_off = np.array([self.conductances(frames, network) for network in self._off])
        state = memory.arrays()
        _decode_frames(self._known, frames, hidden, dt_s, self._modes, solved, solved_off, state, results)
        memory.passed(len(frames))

    def conductances(self, codes: NDArray, network: Network) -> Floats:
        """Solve codes [frames, rows, cols] by `crosstalk.solve`.

        Returns [frames, 2, rows, cols]: conductances in siemens, NaN in a frame that did not converge, and currents in
        ampere.
        """
        if codes.ndim != 3 or codes.shape[1:] != (self.calibration.rows, self.calibration.cols):
            raise ValueError(f"codes must be [frames, {self.calibration.rows}, {self.calibration.cols}]")
        down, up = np.empty((2, *codes.shape[1:]))
        currents, most = np.empty((2, *codes.shape))
        for n, frame in enumerate(codes):
            currents_of(self._known, frame, currents[n], down, up, most[n])
        part = self.calibration.current_part(network)
        found = crosstalk.solve(network, currents * part, most * part, self.calibration.divider)
        g = np.where(found.converged[:, None, None], found.conductance_s, np.nan)
        return np.stack([g, found.current_a], axis=1)

    def save(self, path: Path) -> None:
        """Write the state of the stream."""
        self.memory.save(path)

    def load(self, path: Path) -> None:
        """Go on with a stream whose state was saved; InputError if it is that of another sheet."""
        self.memory.load(path)
