# SPDX-License-Identifier: Apache-2.0
"""Star-mesh steps of the array solve, compiled: plain arrays in, changed in place.

A row of `work` [frames, n, n + 1 + m] is one node: its links to n nodes, its conductance to ground,
its currents. Links are symmetric and only those to the right of the diagonal are read or kept up.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Products may be fused with the sum they go into: one rounding less. Nothing is reordered.
_compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract"})


@_compiled
def down(work, pivot, first, last, own):  # type: ignore
    """Eliminate nodes first .. last - 1, as far as these rows themselves go; pivots are sums to the
    right.

    The last `own` currents, n or none, go into one node each: a node has none of those that go into
    later ones.
    """
    frames, n, width = work.shape
    for f in range(frames):
        rows = work[f]
        for k in range(first, last):
            total = 0.0
            for j in range(k + 1, n + 1):
                total += rows[k, j]
            pivot[f, k] = total
            there = width - own + k + 1 if own > 0 else width
            for i in range(k + 1, last):
                weight = rows[k, i] / total
                for j in range(i + 1, there):
                    rows[i, j] += weight * rows[k, j]


@_compiled
def up(work, pivot, first, last):  # type: ignore
    """Turn the currents of nodes first .. last - 1 into voltages; what later nodes add is there
    already.
    """
    frames, n, width = work.shape
    for f in range(frames):
        rows = work[f]
        for k in range(last - 1, first - 1, -1):
            for j in range(k + 1, last):
                link = rows[k, j]
                for q in range(n + 1, width):
                    rows[k, q] += link * rows[j, q]
            for q in range(n + 1, width):
                rows[k, q] /= pivot[f, k]


class Lines(NamedTuple):
    """Row lines without their drivers, seen from the column lines: [frames, rows, cols].

    `to_driver` is the conductance from the driver's node to a column line. A line with resistance
    (`bent`) is a ladder and joins column lines as well: `pass_on` is the part of a current into node c
    that goes towards the driver, with only the nodes before c connected; `seen` the resistance at
    node c with the driver's node and all column lines grounded.
    """

    g: Floats
    to_driver: Floats
    pass_on: Floats
    seen: Floats
    bent: bool


@_compiled
def ladder(g, segment, to_driver, pass_on, seen):  # type: ignore
    """Fill the fields of Lines for row lines of segments of one conductance."""
    frames, rows, cols = g.shape
    for f in range(frames):
        for r in range(rows):
            total = 0.0
            for c in range(cols - 1, -1, -1):
                total = g[f, r, c] + segment * (total / (segment + total))
                pivot = segment + total
                pass_on[f, r, c], seen[f, r, c] = segment / pivot, 1.0 / pivot
            so_far, before = 1.0, 0.0
            for c in range(cols):
                kept = pass_on[f, r, c]
                before = seen[f, r, c] + kept * kept * before
                so_far *= kept
                seen[f, r, c], to_driver[f, r, c] = before, g[f, r, c] * so_far


@_compiled
def _add_between(link, g, pass_on, seen, beside):  # type: ignore
    """Add what a bent row line joins to the lower triangle of `link`; `beside` [n] is room to work in."""
    for j in range(g.size):
        row, kept, own = link[j], pass_on[j], g[j]
        for i in range(j):
            beside[i] *= kept
            row[i] += beside[i] * own
        beside[j] = own * seen[j]


@_compiled
def add_between(link, lines):  # type: ignore
    """Add what all bent row lines join to `link` [frames, cols, cols]."""
    frames, rows, n = lines.g.shape
    beside = np.empty(n)
    for f in range(frames):
        for r in range(rows):
            _add_between(link[f], lines.g[f, r], lines.pass_on[f, r], lines.seen[f, r], beside)
        for j in range(n):
            for i in range(j):
                link[f, i, j] = link[f, j, i]


@_compiled
def sum_of_others(values):  # type: ignore
    """For every element of [frames, rows, cols] the sum of the other rows' in its column, without a
    subtraction.
    """
    frames, rows, cols = values.shape
    others, after = np.zeros(values.shape), np.empty(cols)
    for f in range(frames):
        after[:] = 0.0
        for r in range(1, rows):
            for c in range(cols):
                others[f, r, c] = others[f, r - 1, c] + values[f, r - 1, c]
        for r in range(rows - 1, -1, -1):
            for c in range(cols):
                others[f, r, c] += after[c]
                after[c] += values[f, r, c]
    return others


@_compiled
def worst_code(total, error, reach, lsb):  # type: ignore
    """Largest error of currents [frames, rows, cols] in codes within `reach`, its row and its column;
    NaN counts as infinite.
    """
    frames, rows, n = total.shape
    worst, row, column = -1.0, 0, 0
    for f in range(frames):
        for r in range(rows):
            for c in range(n):
                low = min(max(total[f, r, c] - error[f, r, c], -reach[c]), reach[c])
                high = min(max(total[f, r, c] + error[f, r, c], -reach[c]), reach[c])
                # max and min of a NaN may drop it
                known = total[f, r, c] + error[f, r, c] == total[f, r, c] + error[f, r, c]
                off = (high - low) / 2 / lsb[c] if known else np.inf
                if off > worst:
                    worst, row, column = off, r, c
    return worst, row, column


@_compiled
def _relative(left, right, floor):  # type: ignore
    """Relative miss between two sums of 0 or above; inf for what is no number."""
    miss = abs(left - right) / (left + right + floor)
    return miss if miss >= 0.0 else np.inf


@_compiled
def miss(left, right, floor):  # type: ignore
    """Largest relative miss between sums of currents of 0 or above, flat; NaN counts as infinite."""
    worst = 0.0
    for i in range(left.size):
        worst = max(worst, _relative(left[i], right[i], floor))
    return worst


@_compiled
def _add_product(out, factor, a, b):  # type: ignore
    """out += factor * a b; four rows of b at once, so that `out` is touched less."""
    inner = a.shape[1]
    whole = inner - inner % 4
    for i in range(a.shape[0]):
        row = out[i]
        for k in range(0, whole, 4):
            a0, a1, a2, a3 = (
                factor * a[i, k], factor * a[i, k + 1], factor * a[i, k + 2], factor * a[i, k + 3]
            )  # fmt: skip
            for q in range(row.size):
                row[q] += (a0 * b[k, q] + a1 * b[k + 1, q]) + (a2 * b[k + 2, q] + a3 * b[k + 3, q])
        for k in range(whole, inner):
            a0 = factor * a[i, k]
            for q in range(row.size):
                row[q] += a0 * b[k, q]


@_compiled
def _invert(work, pivot, weights, out):  # type: ignore
    """Inverse of one block: `work` [n, n + 1 + n] holds links, ground, and one unit of current a
    node.

    Row i takes in all nodes before it at once, four at a time, and of their units only those there
    are.
    """
    n = out.shape[0]
    for i in range(n):
        for k in range(i):
            weights[k] = work[k, i] / pivot[k]
        whole = i - i % 4
        last = n + 1 + i
        for k in range(0, whole, 4):
            w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
            for j in range(i + 1, last):
                work[i, j] += (w0 * work[k, j] + w1 * work[k + 1, j]) + (
                    w2 * work[k + 2, j] + w3 * work[k + 3, j]
                )
        for k in range(whole, i):
            w0 = weights[k]
            for j in range(i + 1, last):
                work[i, j] += w0 * work[k, j]
        total = 0.0
        for j in range(i + 1, n + 1):
            total += work[i, j]
        pivot[i] = total
    # The inverse is symmetric: what is to the right of the diagonal is known from the rows below.
    for i in range(n - 1, -1, -1):
        known = i + 1
        for q in range(known):
            out[i, q] = work[i, n + 1 + q]
        whole = i + 1 + (n - i - 1) // 4 * 4
        for k in range(i + 1, whole, 4):
            w0, w1, w2, w3 = work[i, k], work[i, k + 1], work[i, k + 2], work[i, k + 3]
            for q in range(known):
                out[i, q] += (w0 * out[k, q] + w1 * out[k + 1, q]) + (w2 * out[k + 2, q] + w3 * out[k + 3, q])
        for k in range(whole, n):
            w0 = work[i, k]
            for q in range(known):
                out[i, q] += w0 * out[k, q]
        for q in range(known):
            out[i, q] /= pivot[i]
        for q in range(i):
            out[q, i] = out[i, q]


# Drives of `chain`: all rows at once, the measure of residuals, then one a row, then perhaps one a column's source.
TOGETHER, MEASURE, ROWS = 0, 1, 2


@_compiled
def _misses(v, out, lines, f, share, lateral, step, end, floor):  # type: ignore
    """Check Kirchhoff's law at every node under the drives of `v` [rows, drives, n].

    Returns of every drive the largest miss in volt and the largest voltage, and of TOGETHER the
    largest relative miss. What a node gets through its own share of the row line is counted on both
    sides, so that a row line is one sum for all of its nodes.
    """
    rows, drives, n = v.shape
    g, pass_on, seen = lines.g[f], lines.pass_on[f], lines.seen[f]
    missed, most, worst = np.zeros(drives), np.zeros(drives), 0.0
    # Voltages of three rows, zeros around the array; drives last, so that loops over them are vectors.
    turned, came, beside = np.zeros((3, n + 2, drives)), np.empty((n, drives)), np.empty(drives)
    for r in range(-1, rows):
        above, at, below = turned[(r - 1) % 3], turned[r % 3], turned[(r + 1) % 3]
        for q in range(drives):
            for i in range(n):
                below[i + 1, q] = v[r + 1, q, i] if r + 1 < rows else 0.0
        if r < 0:
            continue
        to_driver = lines.to_driver[f, r]
        beside[:] = 0.0
        for i in range(n):
            for q in range(drives):
                beside[q] += share[r, i] * at[i + 1, q]
        for i in range(n):
            for q in range(drives):
                came[i, q] = to_driver[i] * beside[q] + lateral * (at[i, q] + at[i + 2, q])
                came[i, q] += step * (above[i + 1, q] + below[i + 1, q])
        if lines.bent:
            # Nodes further out, then those nearer the driver, each step past one segment.
            beside[:] = 0.0
            for i in range(n - 2, -1, -1):
                left = g[r, i] * seen[r, i]
                for q in range(drives):
                    beside[q] = pass_on[r, i + 1] * (g[r, i + 1] * at[i + 2, q] + beside[q])
                    came[i, q] += left * beside[q]
            beside[:] = 0.0
            for i in range(1, n):
                left = g[r, i - 1] * seen[r, i - 1]
                for q in range(drives):
                    beside[q] = pass_on[r, i] * (left * at[i, q] + beside[q])
                    came[i, q] += g[r, i] * beside[q]
        for i in range(n):
            came[i, TOGETHER] += to_driver[i]
            if drives > ROWS:
                came[i, MEASURE] += out[r, i]
                came[i, ROWS + r] += to_driver[i]
            if drives > ROWS + rows and r == rows - 1:
                came[i, ROWS + rows + i] += end[i]
            left = at[i + 1, TOGETHER] * out[r, i]
            worst = max(worst, _relative(left, came[i, TOGETHER], floor))
            for q in range(drives):
                miss = abs(at[i + 1, q] - came[i, q] / out[r, i])
                # a comparison with NaN is false
                missed[q] = miss if not miss <= missed[q] else missed[q]
                most[q] = max(most[q], at[i + 1, q])
    return missed, most, worst


@_compiled
def _leaves(away, v, above, leak, end, every):  # type: ignore
    """Compute what of every drive leaves to ground, as `chain` has it in `away`."""
    rows, drives, n = v.shape
    flow = np.empty(n)
    for q in range(drives):
        # Rows above a driven one are solved only if `every`; what leaves there, `above` knows as well.
        first = 0 if every or q < ROWS else min(q - ROWS, rows - 1)
        for i in range(n):
            flow[i] = above[first, i] * v[first, q, i]
        for r in range(first, rows):
            if q != ROWS + r:
                for i in range(n):
                    flow[i] += leak[r, i] * v[r, q, i]
        if q < ROWS + rows:
            for i in range(n):
                flow[i] += end[i] * v[rows - 1, q, i]
        away[q] = flow.sum()


class Chain(NamedTuple):
    """Solution of `chain`: conductance of every driver's node, and its lift above 1 V under its own
    drive, [frames, rows]; what of a drive leaves, but through the own driver of a row and for a
    column's source but through inputs, [frames, drives]; voltages of the last row under every drive,
    [frames, drives, cols]; the largest voltage under MEASURE [frames]; `volt` [frames, drives], 0
    frames if not asked for: voltages under a drive are known to this times those under MEASURE; the
    largest relative violation of Kirchhoff's law.
    """

    node: Floats
    lift: Floats
    away: Floats
    last: Floats
    largest: Floats
    volt: Floats
    missed: float


@_compiled
def chain(lines, g_ground, lateral, step, end, sources, every, floor):  # type: ignore
    """Solve all slots of arrays with resistive column lines.

    Drives come in this order: TOGETHER is the sum of all rows and checks them; MEASURE injects into
    every node what it would pass on at 1 V, all that leaves it, and its voltages turn residuals into
    errors; from ROWS one a row; then of as many columns as `sources`, none or all, the source
    at 1 V.

    Parameters
    ----------
    g_ground : [rows]
        Conductance of every row's driver to ground.
    lateral, step : float
        Conductance between neighbouring columns in a row, and along a column from row to row.
    end : [cols]
        Conductance behind the last row.
    every : bool
        Solve every drive in all rows, and compute `volt`.
    """
    frames, rows, n = lines.g.shape
    first = ROWS + rows
    drives = first + sources
    node, lift, largest = np.empty((frames, rows)), np.empty((frames, rows)), np.zeros(frames)
    away, last = np.empty((frames, drives)), np.empty((frames, drives, n))
    volt = np.empty((frames if every else 0, drives))
    link, beside = np.empty((n, n)), np.empty(n)
    # Part of a driver's node that each column sees, and what it leaks to ground.
    share, leak = np.empty((rows, n)), np.empty((rows, n))
    work, pivot, weights = np.empty((n, 2 * n + 1)), np.empty(n), np.empty(n)
    z, v, out = np.empty((rows, n, n)), np.empty((rows, drives, n)), np.empty((rows, n))
    # Conductance to ground of all that lies above each row.
    above = np.zeros((rows + 1, n))
    # What a row adds: the first two drives', and what its conductance to ground takes.
    fresh, here = np.empty((ROWS + 1, n)), np.empty((ROWS + 1, n))
    worst = 0.0
    for f in range(frames):
        # Downwards: block r with all above it folded in, inverted; currents folded into the row below.
        for r in range(rows):
            to_driver = lines.to_driver[f, r]
            node[f, r] = g_ground[r] + to_driver.sum()
            for j in range(n):
                share[r, j] = to_driver[j] / node[f, r] if node[f, r] > 0.0 else 0.0
                leak[r, j] = g_ground[r] * share[r, j]
                for i in range(j):
                    link[j, i] = to_driver[i] * share[r, j]
            if lines.bent:
                _add_between(link, lines.g[f, r], lines.pass_on[f, r], lines.seen[f, r], beside)
            for j in range(n):
                below = step if r < rows - 1 else end[j]
                fresh[ROWS, j] = leak[r, j] + above[r, j]
                out[r, j] = to_driver[j] * share[r, j] + leak[r, j] + (step if r > 0 else 0.0) + below
                work[j, n] = fresh[ROWS, j] + below
                link[j, j] = 0.0
                if j > 0:
                    link[j, j - 1] += lateral
                for i in range(j):
                    link[i, j] = link[j, i]
            for i in range(n):
                for j in range(n):
                    out[r, j] += link[i, j]
                    work[i, j] = link[i, j] + (step * z[r - 1, i, j] * step if r > 0 else 0.0)
                    work[i, n + 1 + j] = 0.0
                work[i, n + 1 + i] = 1.0
            _invert(work, pivot, weights, z[r])
            # Element by element, here and below: numba compiles an assignment of arrays for two seconds.
            for i in range(n):
                fresh[MEASURE, i], fresh[TOGETHER, i] = out[r, i], to_driver[i]
            here[:] = 0.0
            _add_product(here, 1.0, fresh, z[r])
            v[r, : drives if every else ROWS + r] = 0.0
            if r > 0:
                _add_product(v[r, : ROWS + r], step, v[r - 1, : ROWS + r], z[r])
            for i in range(n):
                v[r, MEASURE, i] += here[MEASURE, i]
                v[r, TOGETHER, i] += here[TOGETHER, i]
                v[r, ROWS + r, i] = here[TOGETHER, i]
                above[r + 1, i] = step * here[ROWS, i]
        for q in range(sources):
            for i in range(n):
                v[rows - 1, first + q, i] = end[q] * z[rows - 1, q, i]
        # Upwards: what the rows below add; to rows above a driven one only where residuals are asked for.
        for r in range(rows - 2, -1, -1):
            known = drives if every else ROWS + r + 1
            _add_product(v[r, :known], step, v[r + 1, :known], z[r])
        for r in range(rows):
            total = 0.0
            for i in range(n):
                largest[f] = max(largest[f], v[r, MEASURE, i])
                total += lines.to_driver[f, r, i] * v[r, ROWS + r, i]
            lift[f, r] = total / node[f, r] if node[f, r] > 0.0 else 0.0
        for q in range(drives):
            for i in range(n):
                last[f, q, i] = v[rows - 1, q, i]
        _leaves(away[f], v, above, leak, end, every)
        missed, most, relative = _misses(
            v[:, : drives if every else 1], out, lines, f, share, lateral, step, end, floor
        )
        worst = max(worst, relative)
        for i in range(n):
            worst = max(worst, _relative(last[f, ROWS:first, i].sum(), last[f, TOGETHER, i], floor))
        if every:
            # Rounding error: sums of n terms, products along a row line of up to n of them, u = 1.1e-16 each.
            rounding = (8 * n + 64) * 1.2e-16
            # MEASURE is its own: its true voltages are at most its own over 1 - what it misses.
            sure = 1.0 - (missed[MEASURE] + rounding * most[MEASURE])
            for q in range(drives):
                volt[f, q] = (missed[q] + rounding * most[q]) / sure if sure > 0.5 else np.inf
    return Chain(node, lift, away, last, largest, volt, worst)
