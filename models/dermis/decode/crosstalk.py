# SPDX-License-Identifier: Apache-2.0
"""Solve the array backwards: from column currents to the conductance of every taxel."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from dermis import fields
from dermis.array.array import Network, column_currents
from dermis.ndarrays import Bools, Floats

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
HEAVY = 0.4
"""Sum of a column's voltages in all slots, relative to the bias, from which on sweeps solve for sums of columns."""
HEAVY_TOLERANCE = 1e-9
"""Stop of these sweeps: sums that nearly cancel leave fewer digits, and a count of 16 bits is 1.5e-5."""
NEWTONS = 40
"""Most steps of `_newton`."""
STALE = 3
"""Corrections in a row without a better solution that end the search."""


@dataclass(frozen=True)
class Solved:
    """Conductances of an array, and how good they are.

    conductance_s : [frames, rows, cols] in siemens; inf for a short: above `SHORT_S`, or where the driver of the row
        cannot deliver the current that was read.
    error_s : [frames] proven bound of the sum of all errors in siemens, inf where the proof does not apply
        (docs/decode_proofs.md).
    residual : [frames] largest change of a last sweep, relative to the largest conductance of the frame. With trace
        resistance, the largest current that the solution misses, relative to the largest current.
    converged : [frames] the stop test was met.
    current_a : [frames, rows, cols] those that were given, or found where a reading is clipped, in ampere.
    """

    conductance_s: Floats
    error_s: Floats
    residual: Floats
    converged: Bools
    current_a: Floats


@njit(cache=True, nogil=True, error_model="numpy")
def known_voltages(current, network, u, taken):
    """Fill in the column voltages `u` and the current `taken` out of the taxels of each column, [rows, cols].

    Both follow from the measured currents alone: the input of a column carries what was read. `network` is that of
    `arguments`.
    """
    _, _, _, r_column, v_offset, i_leak, g_lateral = network
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
def _driven(r, g, total, u, taken, network, through):
    """Fill in the currents `through` the taxels of row r [cols]; return the voltage and the current of its line."""
    v_bias, r_driven, g_ground, _, _, _, _ = network
    row_current = 0.0
    for c in range(u.shape[1]):
        through[c] = taken[r, c]
    for i in range(u.shape[0]):
        if i == r or total[i] == 0.0:
            continue
        drawn = 0.0
        for c in range(u.shape[1]):
            drawn += g[i, c] * u[r, c]
        p = drawn / (total[i] + g_ground)
        for c in range(u.shape[1]):
            through[c] += g[i, c] * (u[r, c] - p)
    for c in range(u.shape[1]):
        row_current += through[c]
    return v_bias - r_driven * row_current, row_current


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(g, out, total, u, taken, network, through, current, most):
    """Make one sweep from conductances `g` [rows, cols] into `out`, which may be `g` itself (Gauss-Seidel).

    `total` [rows] holds the row sums of `g`, `through` [cols] is scratch. `most` [rows, cols] is the largest current of
    a clipped reading (code 0) and inf for any other; it is empty where there are none. A clipped taxel is open, and its
    entry of `current` becomes what the others leave for it, `most` at the highest; `u` and `taken` follow. Returns the
    largest change, the sum of all changes and the largest conductance.
    """
    v_bias, _, _, r_column, _, _, g_lateral = network
    rows, cols = g.shape
    largest, change, change_sum, adjusted = 0.0, 0.0, 0.0, 0.0
    for r in range(rows):
        p, _ = _driven(r, g, total, u, taken, network, through)
        row_total = 0.0
        for c in range(cols):
            across = max(p - u[r, c], LEAST_V * v_bias)
            found = max(through[c] / across, 0.0)
            if most.size and most[r, c] < np.inf:
                found, links, column = 0.0, (c > 0) + (c + 1 < cols), 0.0
                for i in range(rows):
                    column += g[i, c] if i != r else 0.0
                near = g_lateral * r_column[c]
                before = current[r, c]
                step = through[c] / (1.0 + links * near + r_column[c] * column)
                current[r, c] = min(before - step, most[r, c])
                step = current[r, c] - before
                u[r, c] += r_column[c] * step
                taken[r, c] += step * (1.0 + links * near)
                if c > 0:
                    taken[r, c - 1] -= near * step
                if c + 1 < cols:
                    taken[r, c + 1] -= near * step
                adjusted = max(adjusted, abs(step))
            moved = abs(found - g[r, c])
            out[r, c] = found
            row_total += found
            change = max(change, moved / max(found, FLOOR * largest, 1e-300))
            change_sum += moved
            largest = max(largest, found)
        if out is g:
            total[r] = row_total
    change = max(change, adjusted / (v_bias * max(largest, 1e-300)) if adjusted > 0.0 else 0.0)
    return change, change_sum, largest


@njit(cache=True, nogil=True, error_model="numpy")
def contraction(g, total, u, taken, network, through, radius):
    """Return a bound of the contraction factor of a sweep within `radius` siemens (1-norm) of `g`; inf without one."""
    r_driven = network[1]
    rows, cols = g.shape
    worst = 0.0
    for r in range(rows):
        low, high = 0.0, 0.0
        for c in range(cols):
            low, high = min(low, u[r, c]), max(high, u[r, c])
        p, row_current = _driven(r, g, total, u, taken, network, through)
        span = 2.0 * (high - low)
        across = (p - high) * (1.0 - SLACK)
        if across <= 0.0 or r_driven * span * radius > SLACK * (p - high):
            return np.inf
        lost = r_driven * abs(row_current) * (1.0 + SLACK)
        worst += span / across * (1.0 + lost / across)
    return worst


@njit(cache=True, nogil=True, error_model="numpy")
def solve_frame(current, most, network, g, work, through):
    """Solve one frame without trace resistance: currents [rows, cols] in ampere into `g` [rows, cols] in siemens.

    `current` and `most` are those of `sweep`. `work` [3, rows, cols + 1] and `through` [cols] are scratch. Returns True
    if the stop test was met.
    """
    rows, cols = current.shape
    u, taken, total = work[0, :, :cols], work[1, :, :cols], work[2, :, cols]
    known_voltages(current, network, u, taken)
    for r in range(rows):
        for c in range(cols):
            g[r, c] = max(current[r, c], 0.0) / network[0]
            if most.size and most[r, c] < np.inf:
                g[r, c] = 0.0
    return converge(g, total, u, taken, network, through, current, most, TOLERANCE)


@njit(cache=True, nogil=True, error_model="numpy")
def converge(g, total, u, taken, network, through, current, most, tolerance):
    """Make sweeps from `g` until no conductance changes by more than `tolerance`; return as `solve_frame`."""
    v_bias, g_ground = network[0], network[2]
    rows, cols = g.shape
    for r in range(rows):
        total[r] = 0.0
        for c in range(cols):
            total[r] += g[r, c]
    heavy = False
    for c in range(cols):
        lifted = 0.0
        for r in range(rows):
            lifted += u[r, c] / v_bias
        heavy = heavy or lifted > HEAVY
    if heavy and g_ground == 0.0:
        return False  # open rows float with the columns: `_newton` has to do it
    out = np.empty_like(g) if heavy else g
    stop = max(tolerance, HEAVY_TOLERANCE) if heavy else tolerance
    for _ in range(SWEEPS):
        change = sweep(g, out, total, u, taken, network, through, current, most)[0]
        if change <= stop and not (heavy and not np.isfinite(out.sum())):
            return True
        if heavy:
            _lift(g, out, u, v_bias, total)
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _lift(g, out, u, v_bias, total):
    """Move `g` on from a sweep `out` with the sum of every column solved for; fill in the row sums `total`.

    A taxel by the sweep is (known + u (sum - g)) / (v - u), so the sum of a column is a linear equation in itself.
    """
    rows, cols = g.shape
    total[:] = 0.0
    for c in range(cols):
        moved, slope = 0.0, 0.0
        for r in range(rows):
            part = u[r, c] / v_bias
            if out[r, c] > 0.0:
                out[r, c] += part * (g[r, c] - out[r, c])
                slope += part
            moved += out[r, c] - g[r, c]
        moved /= max(1.0 - slope, 1e-4)
        for r in range(rows):
            g[r, c] = max(out[r, c] + moved * u[r, c] / v_bias, 0.0) if out[r, c] > 0.0 else 0.0
            total[r] += g[r, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_frames(currents, most, network, out, error, residual, converged):
    frames, rows, cols = currents.shape
    work, through, nothing = np.empty((3, rows, cols + 1)), np.empty(cols), np.empty((0, 0))
    u, taken, total, again = work[0, :, :cols], work[1, :, :cols], work[2, :, cols], work[2, :, :cols]
    for n in range(frames):
        g = out[n]
        converged[n] = solve_frame(currents[n], most[n] if most.size else nothing, network, g, work, through)
        _, moved, largest = sweep(g, again, total, u, taken, network, through, currents[n], nothing)
        # Rounding of a sweep: no conductance is known better than its last digits.
        moved += 4.0 * (rows + cols) * 1.1e-16 * total.sum()
        residual[n] = 0.0
        for r in range(rows):
            for c in range(cols):
                residual[n] = max(residual[n], abs(again[r, c] - g[r, c]) / max(largest, 1e-300))
        error[n] = np.inf
        factor = contraction(g, total, u, taken, network, through, 0.0)
        if factor < 1.0:
            radius = moved / (1.0 - factor)
            if contraction(g, total, u, taken, network, through, radius) < 1.0:
                error[n] = radius


def solve(
    network: Network, currents_a: ArrayLike, most_a: Floats | None = None, slow: bool = False
) -> Solved:
    """Solve for the taxels of a network whose column currents are known.

    network : what surrounds the taxels; its own conductances are not used.
    currents_a : [frames, rows, cols] in ampere, as `array.column_currents` defines them.
    most_a : [frames, rows, cols] largest current in ampere where a reading is clipped (code 0), inf elsewhere. Such a
        taxel is open: its current is what the others leave for it, `most_a` at the highest.
    slow : solve frames whose sweeps did not converge by Newton's method, some 0.1 s each: for columns with dividers.

    A column's input carries the current that was read, so every column voltage is known in every row slot; only the
    rows' voltages depend on the taxels. A sweep takes the taxels of the other rows as they were found last, takes
    what they carry off the current of each column, and gets the driven row's voltage and taxels in closed form. It is
    exact at once where the columns are ideal; docs/decode_proofs.md proves when it contracts. Trace resistance is a
    defect correction around it: the currents that the whole network would make of the solution are compared with those
    read. ValueError for a wrong shape, or currents that are not finite.
    """
    currents = np.array(currents_a, dtype=float, order="C")
    if currents.ndim != 3 or currents.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"currents_a must be [frames, {network.rows}, {network.cols}]")
    if not np.isfinite(currents).all():
        raise ValueError("currents_a must be finite")
    most = np.empty((0, 0, 0)) if most_a is None else np.ascontiguousarray(most_a, dtype=float)
    if most.size and (most.shape != currents.shape or np.isnan(most).any()):
        raise ValueError(f"most_a must be {list(currents.shape)} numbers, as currents_a")
    clipped = most < np.inf if most.size else np.zeros(currents.shape, dtype=bool)
    if lumped(network):
        return _lumped(network, currents, most, slow)
    around = dataclasses.replace(network, **dict.fromkeys(CORRECTED, 0.0))
    if not lumped(around):
        raise ValueError(f"no inverse for {', '.join(sorted(around.active_fields() - CARRIED))}")
    size = np.maximum(np.abs(currents).max(axis=(1, 2), initial=0.0), 1e-300)
    seen = currents.copy()
    found = _lumped(around, seen, most, slow)
    open_frames, stale = np.arange(len(currents)), np.zeros(len(currents), dtype=int)
    conductance, residual = found.conductance_s.copy(), np.full(len(currents), np.inf)
    tried = conductance.copy()
    for _ in range(REFINEMENTS):
        g = np.minimum(tried[open_frames], SHORT_S)
        made = column_currents(network, g)
        missed = currents[open_frames] - made
        if most.size:
            held = clipped[open_frames]
            asked = np.where(held, np.minimum(made, most[open_frames]), currents[open_frames])
            currents[open_frames], missed = asked, np.where(held, 0.0, missed)
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
        asked = np.where((g == 0) & (missed > 0), column_currents(around, g), seen[open_frames])
        seen[open_frames] = asked + missed
        found = _lumped(around, seen[open_frames], most[open_frames] if most.size else most, slow)
        tried[open_frames] = found.conductance_s
    # A millionth of what a count resolves (1 / 510), with 1000 times the rounding of the solve left.
    return Solved(conductance, np.full(len(currents), np.inf), residual, residual < 1e-9, currents)


CORRECTED = frozenset({"r_trace_row_ohm", "r_trace_column_ohm", "r_return_ohm"})
"""Fields of Network that `solve` corrects for."""
# Without traces columns of laterals carry no current, and pads and settled capacitances are no elements of their own.
CARRIED = fields.of("array", "lines") - CORRECTED
"""Fields of Network that `arguments` hands to the compiled solves."""


def lumped(network: Network) -> bool:
    """Return True if `arguments` carries all of a network; any other needs `solve` or `array.column_currents`."""
    return network.active_fields() <= CARRIED


def arguments(network: Network) -> tuple:
    """Return what the compiled solves take of a network, in volt, ohm, siemens and ampere.

    These are v_bias, r_driven, g_ground, r_column, v_offset, i_leak and g_lateral, the sum of laterals over the rows.
    """
    with np.errstate(divide="ignore"):
        g_ground = min(float(np.divide(1.0, network.r_row_grounded_ohm)), 1e60)
    g_lateral = network.rows * network.g_lateral_row_s
    # Copies, so that none is read-only: the loops would be compiled again for a pickled network, which is not.
    sources = map(np.array, (network.r_column_ohm, network.v_column_offset_v, network.i_leak_a))
    return network.v_bias_v, network.r_row_driven_ohm, g_ground, *sources, g_lateral


def _lumped(network: Network, currents: Floats, most: Floats, slow: bool) -> Solved:
    """Solve a network whose fields `arguments` carries; `currents` is changed where `most` is finite."""
    out, (error, residual) = np.empty_like(currents), np.empty((2, len(currents)))
    converged = np.empty(len(currents), dtype=np.bool_)
    _solve_frames(currents, most, arguments(network), out, error, residual, converged)
    out[out > SHORT_S] = np.inf
    # The matrix of a sheet of 64 x 64 has 130 MB.
    for n in np.flatnonzero(~converged & slow & (network.rows * network.cols <= 4096)):
        found, off = _newton(network, currents[n], most[n] if most.size else np.full(out.shape[1:], np.inf))
        if off < HEAVY_TOLERANCE:
            out[n], error[n], residual[n], converged[n] = found, np.inf, off, True
    return Solved(out, error, residual, converged, currents)


def _newton(network: Network, currents: Floats, most: Floats) -> tuple[Floats, float]:
    """Solve one frame [rows, cols] by Newton's method, with all taxels in one matrix; slow, for what sweeps do not do.

    The equations are those of a sweep. A clipped taxel, and one whose equation asks for less than 0, is open. Returns
    conductances in siemens, and the largest current that they miss, relative to the largest of the frame.
    """
    v_bias, r_driven, g_ground, *_ = around = arguments(network)
    rows, cols = currents.shape
    u, taken = np.empty((2, rows, cols))
    known_voltages(currents, around, u, taken)
    g = np.where(most < np.inf, 0.0, np.maximum(currents, 0.0) / np.maximum(v_bias - u, LEAST_V))
    best, least = g, np.inf
    row, col = np.arange(rows), np.arange(cols)
    for _ in range(NEWTONS):
        total = g.sum(axis=1)
        # Slot, row: the voltage of every row line in every slot, the driven one on the diagonal.
        p = u @ g.T / np.maximum(total + g_ground, 1e-300)
        droop = r_driven / (1.0 + r_driven * total)
        p[row, row] = (v_bias + r_driven * (g * u).sum(axis=1)) / (1.0 + r_driven * total)
        across = p[:, :, None] - u[:, None, :]
        off = np.einsum("ic,sic->sc", g, across) - taken
        held = (most < np.inf) | ((g == 0.0) & (off > 0.0))
        worst = float(np.abs(np.where(held, 0.0, off)).max() / max(np.abs(taken).max(), 1e-300))
        if worst < least:
            best, least = g, worst
        if worst < 0.1 * HEAVY_TOLERANCE:
            break
        # Of the current in (slot, column) by the conductance in (row, column), over the voltage of the row line.
        weight = np.broadcast_to(1.0 / np.maximum(total + g_ground, 1e-300), (rows, rows)).copy()
        weight[row, row] = droop
        matrix = np.einsum("ic,si,sik->scik", g, -weight, across)
        matrix[:, col, :, col] += across.transpose(2, 0, 1)
        free = ~held.ravel()
        matrix = matrix.reshape(g.size, g.size)[np.ix_(free, free)]
        step = np.zeros(g.size)
        try:
            step[free] = np.linalg.solve(matrix, -off.ravel()[free])
        except np.linalg.LinAlgError:
            break
        g = np.maximum(g + step.reshape(g.shape), 0.0)
    return best, least
