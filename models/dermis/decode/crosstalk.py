# SPDX-License-Identifier: Apache-2.0
"""Solve the array backwards: from column currents to the conductance of every taxel."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dermis.array.array import Network, column_currents

Floats = NDArray[np.float64]

TOLERANCE = 1e-13
"""Relative change of every conductance in a sweep that ends the sweeps; doubles resolve 2e-16."""
SWEEPS = 200
"""Most sweeps: at a contraction of 0.85 they reach the tolerance, and a real array is far below that."""
FLOOR = 1e-6
"""Conductances below this part of the largest are converged to the same absolute error as one of this size."""
LEAST_V = 1e-9
"""Voltage across a taxel, relative to the bias, below which no finite conductance explains its current."""
SHORT_S = 1e3
"""Conductance above which a taxel is a short: 1 mohm, the smallest resistance that a deck knows."""
SLACK = 1e-3
"""Relative room, in the voltages that a proof uses, for the distance to the true solution."""
REFINEMENTS = 60
"""Most corrections for trace resistance or a shared return."""
STALE = 3
"""Corrections in a row without a better solution that end the search."""


@dataclass(frozen=True)
class Solved:
    """Conductances of an array, and how good they are.

    Attributes
    ----------
    conductance_s : ndarray
        [frames, rows, cols] in siemens; inf for a short: above `SHORT_S`, or where the driver of
        the row cannot deliver the current that was read.
    error_s : ndarray
        [frames] proven bound of the sum of all errors in siemens, inf where the proof does not apply
        (docs/decode.md).
    residual : ndarray
        [frames] largest change of a last sweep, relative to the largest conductance of the frame. With trace
        resistance, the largest current that the solution misses, relative to the largest current.
    converged : ndarray of bool
        [frames] the stop test was met.
    sweeps : ndarray of int
        [frames] sweeps over the array.
    """

    conductance_s: Floats
    error_s: Floats
    residual: Floats
    converged: NDArray[np.bool_]
    sweeps: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def known_voltages(current, r_column, v_offset, i_leak, g_lateral, u, taken):
    """Fill in the column voltages `u` and the current `taken` out of the taxels of each column, [rows, cols].

    Both follow from the measured currents alone: the input of a column carries what was read.
    """
    rows, cols = current.shape
    for r in range(rows):
        for c in range(cols):
            u[r, c] = v_offset[c] + r_column[c] * current[r, c]
        for c in range(cols):
            out = current[r, c] - i_leak[c]
            if c > 0:
                out += g_lateral * (u[r, c] - u[r, c - 1])
            if c + 1 < cols:
                out += g_lateral * (u[r, c] - u[r, c + 1])
            taken[r, c] = out


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(g, out, total, u, taken, v_bias, r_driven, g_ground, through):
    """Make one sweep from conductances `g` [rows, cols] into `out`, which may be `g` itself (Gauss-Seidel).

    `total` [rows] holds the row sums of `g`, `through` [cols] is scratch. Returns the largest change, the sum of
    all changes and the largest conductance.
    """
    rows, cols = g.shape
    largest, change, change_sum = 0.0, 0.0, 0.0
    for r in range(rows):
        for c in range(cols):
            through[c] = taken[r, c]
        for i in range(rows):
            if i == r or total[i] == 0.0:
                continue
            drawn = 0.0
            for c in range(cols):
                drawn += g[i, c] * u[r, c]
            p = drawn / (total[i] + g_ground)
            for c in range(cols):
                through[c] += g[i, c] * (u[r, c] - p)
        row_current = 0.0
        for c in range(cols):
            row_current += through[c]
        p = v_bias - r_driven * row_current
        row_total = 0.0
        for c in range(cols):
            across = max(p - u[r, c], LEAST_V * v_bias)
            found = max(through[c] / across, 0.0)
            moved = abs(found - g[r, c])
            out[r, c] = found
            row_total += found
            change = max(change, moved / max(found, FLOOR * largest, 1e-300))
            change_sum += moved
            largest = max(largest, found)
        if out is g:
            total[r] = row_total
    return change, change_sum, largest


@njit(cache=True, nogil=True, error_model="numpy")
def contraction(g, total, u, taken, v_bias, r_driven, g_ground, through, radius):
    """Return a bound of the contraction factor of a sweep within `radius` siemens (1-norm) of `g`; inf without one."""
    rows, cols = g.shape
    worst = 0.0
    for r in range(rows):
        low, high = 0.0, 0.0
        row_current = 0.0
        for c in range(cols):
            low, high = min(low, u[r, c]), max(high, u[r, c])
            through[c] = taken[r, c]
        for i in range(rows):
            if i == r or total[i] == 0.0:
                continue
            drawn = 0.0
            for c in range(cols):
                drawn += g[i, c] * u[r, c]
            p = drawn / (total[i] + g_ground)
            for c in range(cols):
                through[c] += g[i, c] * (u[r, c] - p)
        for c in range(cols):
            row_current += through[c]
        p = v_bias - r_driven * row_current
        span = 2.0 * (high - low)
        across = (p - high) * (1.0 - SLACK)
        if across <= 0.0 or r_driven * span * radius > SLACK * (p - high):
            return np.inf
        lost = r_driven * abs(row_current) * (1.0 + SLACK)
        worst += span / across * (1.0 + lost / across)
    return worst


@njit(cache=True, nogil=True, error_model="numpy")
def solve_frame(current, v_bias, r_driven, g_ground, r_column, v_offset, i_leak, g_lateral, g, work, through):
    """Solve one frame without trace resistance: currents [rows, cols] in ampere into `g` [rows, cols] in siemens.

    `work` [3, rows, cols + 1] and `through` [cols] are scratch. Returns the number of sweeps, negative where the stop
    test was not met.
    """
    rows, cols = current.shape
    u, taken, total = work[0, :, :cols], work[1, :, :cols], work[2, :, cols]
    known_voltages(current, r_column, v_offset, i_leak, g_lateral, u, taken)
    for r in range(rows):
        for c in range(cols):
            g[r, c] = max(current[r, c], 0.0) / v_bias
    return converge(g, total, u, taken, v_bias, r_driven, g_ground, through, TOLERANCE)


@njit(cache=True, nogil=True, error_model="numpy")
def converge(g, total, u, taken, v_bias, r_driven, g_ground, through, tolerance):
    """Make sweeps from `g` until no conductance changes by more than `tolerance`; return as `solve_frame`."""
    rows, cols = g.shape
    for r in range(rows):
        total[r] = 0.0
        for c in range(cols):
            total[r] += g[r, c]
    for n in range(SWEEPS):
        change, _, _ = sweep(g, g, total, u, taken, v_bias, r_driven, g_ground, through)
        if change <= tolerance:
            return n + 1
    return -SWEEPS


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_frames(
    currents, v_bias, r_driven, g_ground, r_column, v_offset, i_leak, g_lateral, out, error, residual, sweeps
):
    frames, rows, cols = currents.shape
    work, through = np.empty((3, rows, cols + 1)), np.empty(cols)
    for n in range(frames):
        g = out[n]
        sweeps[n] = solve_frame(
            currents[n], v_bias, r_driven, g_ground, r_column, v_offset, i_leak, g_lateral, g, work, through
        )
        u, taken, total = work[0, :, :cols], work[1, :, :cols], work[2, :, cols]
        again = work[2, :, :cols]
        _, moved, largest = sweep(g, again, total, u, taken, v_bias, r_driven, g_ground, through)
        # Rounding of a sweep: no conductance is known better than its last digits.
        moved += 4.0 * (rows + cols) * 1.1e-16 * total.sum()
        residual[n] = 0.0
        for r in range(rows):
            for c in range(cols):
                residual[n] = max(residual[n], abs(again[r, c] - g[r, c]) / max(largest, 1e-300))
        error[n] = np.inf
        factor = contraction(g, total, u, taken, v_bias, r_driven, g_ground, through, 0.0)
        if factor < 1.0:
            radius = moved / (1.0 - factor)
            if contraction(g, total, u, taken, v_bias, r_driven, g_ground, through, radius) < 1.0:
                error[n] = radius
        for r in range(rows):
            for c in range(cols):
                if g[r, c] > SHORT_S:
                    out[n, r, c] = np.inf


def solve(network: Network, currents_a: ArrayLike) -> Solved:
    """Solve for the taxels of a network whose column currents are known.

    Parameters
    ----------
    network : Network
        What surrounds the taxels; its own conductances are not used.
    currents_a : array_like
        [frames, rows, cols] in ampere, as `array.column_currents` defines them.

    Notes
    -----
    A column's input carries the current that was read, so every column voltage is known in every row slot; only the
    rows' voltages depend on the taxels. A sweep takes the taxels of the other rows as they were found last, takes
    what they carry off the current of each column, and gets the driven row's voltage and taxels in closed form. It is
    exact at once where the columns are ideal; docs/decode.md proves when it contracts. Trace resistance is a defect
    correction around it: the currents that the whole network would make of the solution are compared with those read.

    Raises
    ------
    ValueError
        The wrong shape, or currents that are not finite.
    """
    currents = np.ascontiguousarray(currents_a, dtype=float)
    if currents.ndim != 3 or currents.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"currents_a must be [frames, {network.rows}, {network.cols}]")
    if not np.isfinite(currents).all():
        raise ValueError("currents_a must be finite")
    if not (network.r_trace_row_ohm or network.r_trace_column_ohm or network.r_return_ohm):
        return _lumped(network, currents)
    lumped = dataclasses.replace(network, r_trace_row_ohm=0.0, r_trace_column_ohm=0.0, r_return_ohm=0.0)
    size = np.maximum(np.abs(currents).max(axis=(1, 2), initial=0.0), 1e-300)
    seen = currents.copy()
    found = _lumped(lumped, seen)
    sweeps = found.sweeps.copy()
    open_frames, stale = np.arange(len(currents)), np.zeros(len(currents), dtype=int)
    conductance, residual = found.conductance_s.copy(), np.full(len(currents), np.inf)
    tried = conductance.copy()
    for _ in range(REFINEMENTS):
        g = np.minimum(tried[open_frames], SHORT_S)
        missed = currents[open_frames] - column_currents(network, g)
        # An open taxel cannot carry less: noise and rounding of codes ask for it.
        missed[(g == 0) & (missed < 0)] = 0.0
        worst = np.abs(missed).max(axis=(1, 2)) / size[open_frames]
        better = worst < residual[open_frames]
        kept = open_frames[better]
        conductance[kept], residual[kept] = tried[kept], worst[better]
        # A taxel that becomes open makes one correction worse; rounding, or traces that dominate, all that follow.
        stale[open_frames] = np.where(better, 0, stale[open_frames] + 1)
        going = (stale[open_frames] < STALE) & (worst > TOLERANCE)
        open_frames = open_frames[going]
        if not open_frames.size:
            break
        g, missed = g[going], missed[going]
        # An open taxel may have been asked for less than it can carry: what is missed counts from there.
        asked = np.where((g == 0) & (missed > 0), column_currents(lumped, g), seen[open_frames])
        seen[open_frames] = asked + missed
        found = _lumped(lumped, seen[open_frames])
        tried[open_frames] = found.conductance_s
        sweeps[open_frames] += np.abs(found.sweeps)
    # A millionth of what a count resolves (1 / 510), with 1000 times the rounding of the solve left.
    return Solved(conductance, np.full(len(currents), np.inf), residual, residual < 1e-9, sweeps)


def arguments(network: Network) -> tuple:
    """Return the arguments of `solve_frame` between the currents and `g`."""
    with np.errstate(divide="ignore"):
        g_ground = min(float(np.divide(1.0, network.r_row_grounded_ohm)), 1e60)
    g_lateral = network.rows * network.g_lateral_row_s
    sources = network.r_column_ohm, network.v_column_offset_v, network.i_leak_a
    return network.v_bias_v, network.r_row_driven_ohm, g_ground, *sources, g_lateral


def _lumped(network: Network, currents: Floats) -> Solved:
    frames = len(currents)
    out, error, residual = np.empty_like(currents), np.empty(frames), np.empty(frames)
    sweeps = np.empty(frames, dtype=np.int64)
    _solve_frames(currents, *arguments(network), out, error, residual, sweeps)
    return Solved(out, error, residual, sweeps > 0, np.abs(sweeps))


def solve_by_newton(network: Network, current_a: Floats, steps: int = 30) -> Floats:
    """Solve one frame [rows, cols] by Newton's method on the whole array, the slow and obvious reference.

    The derivative of every current by every conductance is taken by differences of the forward solve.
    """
    rows, cols = current_a.shape
    g = np.maximum(current_a, 0.0) / network.v_bias_v
    for _ in range(steps):
        step = np.maximum(1e-7 * g, 1e-12)
        moved = g + step.ravel()[:, None, None] * np.eye(g.size).reshape(-1, rows, cols)
        made = column_currents(network, np.concatenate([g[None], moved]))
        slope = ((made[1:] - made[0]) / step.ravel()[:, None, None]).reshape(g.size, -1).T
        change = np.linalg.solve(slope, (current_a - made[0]).ravel()).reshape(rows, cols)
        g = np.maximum(g + change, 0.0)
        # Newton has converged to the rounding of the solve, some 50 units in the last place.
        if np.abs(change).max() <= 1e-14 * g.max():
            break
    return g
