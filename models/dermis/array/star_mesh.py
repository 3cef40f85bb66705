# SPDX-License-Identifier: Apache-2.0
"""Star-mesh steps of the array solve, compiled: plain arrays in, changed in place.

A row of `work` [frames, n, n + 1 + m] is one node: its links to n nodes, its conductance to ground,
its currents. Links are symmetric and only those to the right of the diagonal are read or kept up.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from dermis.ndarrays import Floats

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
def _join(row, beside, j, g, pass_on, seen):  # type: ignore
    """Add to `row` what a bent row line joins node j with the nodes before; `beside` [n] goes from node to node."""
    kept, own = pass_on[j], g[j]
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
            for j in range(n):
                _join(link[f, j], beside, j, lines.g[f, r], lines.pass_on[f, r], lines.seen[f, r])
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
def _sum(values):  # type: ignore
    """Sum in four parts, which do not wait for each other."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    whole = values.size - values.size % 4
    for j in range(0, whole, 4):
        s0 += values[j]
        s1 += values[j + 1]
        s2 += values[j + 2]
        s3 += values[j + 3]
    for j in range(whole, values.size):
        s0 += values[j]
    return (s0 + s1) + (s2 + s3)


COLUMNS = 256
"""Most columns of arrays with resistive column lines."""

# Nodes of a block come in whole eights, and so do the columns that a loop changes: the length of a vector.
# Loops may run into columns that nobody reads. One stride that the compiler knows spares it the question which of
# eight rows overlap.
_EIGHT = 8
_STRIDE = 2 * COLUMNS + 2 * _EIGHT


@_compiled
def _take_in(to, i, at, work, inverse, k, low, high):  # type: ignore
    """Rows i .. i + 3 of `to` take in nodes k .. k + 3 of `work`, by their links in columns at .. at + 3.

    Columns low .. high - 1 change; `inverse` has one over each pivot.
    """
    p0, p1, p2, p3 = inverse[k], inverse[k + 1], inverse[k + 2], inverse[k + 3]
    w = work[k * _STRIDE + at : (k + 3) * _STRIDE + at + 4]
    a0, a1, a2, a3 = w[0] * p0, w[_STRIDE] * p1, w[2 * _STRIDE] * p2, w[3 * _STRIDE] * p3
    b0, b1, b2, b3 = w[1] * p0, w[_STRIDE + 1] * p1, w[2 * _STRIDE + 1] * p2, w[3 * _STRIDE + 1] * p3
    c0, c1, c2, c3 = w[2] * p0, w[_STRIDE + 2] * p1, w[2 * _STRIDE + 2] * p2, w[3 * _STRIDE + 2] * p3
    d0, d1, d2, d3 = w[3] * p0, w[_STRIDE + 3] * p1, w[2 * _STRIDE + 3] * p2, w[3 * _STRIDE + 3] * p3
    t, w = (
        to[i * _STRIDE + low : (i + 3) * _STRIDE + high],
        work[k * _STRIDE + low : (k + 3) * _STRIDE + high],
    )
    for j in range(high - low):
        b, c, d = j + _STRIDE, j + 2 * _STRIDE, j + 3 * _STRIDE
        x0, x1, x2, x3 = w[j], w[b], w[c], w[d]
        t[j] = t[j] + a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
        t[b] = t[b] + b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
        t[c] = t[c] + c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3
        t[d] = t[d] + d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3


@_compiled
def _invert(work, inverse, half, out):  # type: ignore
    """Inverse of one block of nodes, four at a time and the last ones first.

    Parameters
    ----------
    work : [m _STRIDE]
        Rows of a node each: one unit of current a node, filled in here; conductance to ground in column m; from
        column m + 8 the links to the nodes before. m are the nodes in whole eights.
    inverse, half : [m], [m _STRIDE]
        Room to work in.
    out : [n, n]
        The inverse.
    """
    n, m = out.shape[0], inverse.size
    links = m + _EIGHT
    weights, outside = np.empty((4, 4)), np.empty(4)
    for i in range(m):
        first = i * _STRIDE + i - i % _EIGHT
        work[first : i * _STRIDE + m] = 0.0
        work[i * _STRIDE + i] = 1.0
        half[first : i * _STRIDE + m] = 0.0
    for i in range(m - 4, -1, -4):
        for k in range(m - 4, i, -4):
            high = links + (i + 4 + _EIGHT - 1) // _EIGHT * _EIGHT
            _take_in(work, i, links + i, work, inverse, k, k - k % _EIGHT, high)
        # The four take in each other: links among them, and sums of what they have outside, which pivots need.
        for a in range(3, -1, -1):
            row = work[(i + a) * _STRIDE : (i + a + 1) * _STRIDE]
            total = row[m] + _sum(row[links : links + i])
            for k in range(3, a, -1):
                later = work[(i + k) * _STRIDE : (i + k + 1) * _STRIDE]
                weights[a, k] = later[links + i + a] * inverse[i + k]
                for j in range(links + i, links + i + a):
                    row[j] += weights[a, k] * later[j]
                total += weights[a, k] * outside[k]
            outside[a] = total
            for j in range(links + i, links + i + a):
                total += row[j]
            inverse[i + a] = 1.0 / total
        # Then all that is outside.
        w01, w02, w03, w12, w13, w23 = (
            weights[0, 1], weights[0, 2], weights[0, 3], weights[1, 2], weights[1, 3], weights[2, 3]
        )  # fmt: skip
        low, high = i - i % _EIGHT, links + i
        rows = work[i * _STRIDE + low : (i + 3) * _STRIDE + high]
        for j in range(high - low):
            b, c, d = j + _STRIDE, j + 2 * _STRIDE, j + 3 * _STRIDE
            x3 = rows[d]
            x2 = rows[c] + w23 * x3
            x1 = rows[b] + w12 * x2 + w13 * x3
            rows[j], rows[b], rows[c] = rows[j] + w01 * x1 + w02 * x2 + w03 * x3, x1, x2
    # The inverse is the units' own matrix once all nodes are gone.
    for i in range(0, m, 4):
        for k in range(0, i + 4, 4):
            _take_in(half, i, i, work, inverse, k, i - i % _EIGHT, m)
    for i in range(n):
        for j in range(i, n):
            out[i, j] = half[i * _STRIDE + j]
            out[j, i] = half[i * _STRIDE + j]


# Drives of `chain`: all rows at once, the measure of residuals, what each node leaks to ground, then one a row,
# then perhaps one a column's source.
TOGETHER, MEASURE, LEAKS, ROWS = 0, 1, 2, 3


@_compiled
def _misses(v, out, leak, lines, f, share, lateral, step, end, floor):  # type: ignore
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
                came[i, LEAKS] += leak[r, i]
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
def _leaves(away, v, leak, end):  # type: ignore
    """Compute what of every drive leaves to ground, as `chain` has it in `away`."""
    rows, drives, n = v.shape
    for q in range(drives):
        total = 0.0
        for r in range(rows):
            if q != ROWS + r:
                for i in range(n):
                    total += leak[r, i] * v[r, q, i]
        if q < ROWS + rows:
            for i in range(n):
                total += end[i] * v[rows - 1, q, i]
        away[q] = total


@_compiled
def _links(work, first, out, beside, lines, f, r, share, lateral):  # type: ignore
    """Write the links of row r to the nodes before each into `work`, from column `first`, and add their sums to
    `out`; `beside` [n] is room to work in.
    """
    to_driver = lines.to_driver[f, r]
    g, pass_on, seen = lines.g[f, r], lines.pass_on[f, r], lines.seen[f, r]
    for j in range(out.size):
        row = work[j * _STRIDE + first : j * _STRIDE + first + j]
        for i in range(j):
            row[i] = to_driver[i] * share[j]
        if lines.bent:
            _join(row, beside, j, g, pass_on, seen)
        if j > 0:
            row[j - 1] += lateral
        for i in range(j):
            out[i] += row[i]
        out[j] += _sum(row)


@_compiled
def _scale(out, factor, v):  # type: ignore
    """Write factor * v into `out`, element by element: numba compiles an assignment of arrays for two seconds."""
    for q in range(v.shape[0]):
        for i in range(v.shape[1]):
            out[q, i] = factor * v[q, i]


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
    errors; LEAKS injects what a node's row lets to ground, and what of it goes down is what a node below
    sees of all rows above; from ROWS one a row; then of as many columns as `sources`, none or all, the
    source at 1 V.

    Parameters
    ----------
    g_ground : [rows]
        Conductance of every row's driver to ground.
    lateral, step : float
        Conductance between neighbouring columns in a row, and along a column from row to row.
    end : [cols]
        Conductance behind the last row.
    every : bool
        Solve every drive in all rows, and compute `volt`. Otherwise `away` is the difference between what a driver
        sends and what its own row takes.
    """
    frames, rows, n = lines.g.shape
    first = ROWS + rows
    drives = first + sources
    node, lift, largest = np.empty((frames, rows)), np.empty((frames, rows)), np.zeros(frames)
    away, last = np.zeros((frames, drives)), np.empty((frames, drives, n))
    volt = np.empty((frames if every else 0, drives))
    m = (n + _EIGHT - 1) // _EIGHT * _EIGHT
    links = m + _EIGHT
    work, half, inverse = np.zeros(m * _STRIDE), np.empty(m * _STRIDE), np.empty(m)
    # Part of a driver's node that each column sees, what it leaks to ground, what leaves a node at 1 V.
    share, leak, out = np.empty((rows, n)), np.empty((rows, n)), np.empty((rows, n))
    z, v = np.empty((rows, n, n)), np.zeros((rows, drives, n))
    current, added, room = np.zeros((drives, n)), np.empty((drives, n)), np.empty(n)
    power = np.empty(rows)
    worst = 0.0
    for f in range(frames):
        power[:] = 0.0
        # Downwards: block r with all above it folded in, inverted; currents folded into the row below.
        for r in range(rows):
            to_driver, known = lines.to_driver[f, r], ROWS + r + 1
            node[f, r] = g_ground[r] + _sum(to_driver)
            if r > 0:
                _scale(current, step, v[r - 1, :known])
            else:
                current[:known] = 0.0
            for i in range(n):
                share[r, i] = to_driver[i] / node[f, r] if node[f, r] > 0.0 else 0.0
                leak[r, i] = g_ground[r] * share[r, i]
                below = step if r < rows - 1 else end[i]
                out[r, i] = to_driver[i] * share[r, i] + leak[r, i] + (step if r > 0 else 0.0) + below
                current[LEAKS, i] += leak[r, i]
                work[i * _STRIDE + m] = current[LEAKS, i] + below
            for i in range(n, m):
                work[i * _STRIDE + m] = 1.0
            _links(work, links, out[r], room, lines, f, r, share[r], lateral)
            if r > 0:
                for i in range(n):
                    row, above = work[i * _STRIDE + links : i * _STRIDE + links + i], z[r - 1, i]
                    for j in range(i):
                        row[j] += step * above[j] * step
            _invert(work, inverse, half, z[r])
            for i in range(n):
                current[TOGETHER, i] += to_driver[i]
                current[MEASURE, i] += out[r, i]
                current[ROWS + r, i] = to_driver[i]
            np.dot(current[:known], z[r], v[r, :known])
            v[r, known:] = 0.0
            for q in range(0 if every else r + 1):
                for i in range(n):
                    room[i] = current[ROWS + q, i] * v[r, ROWS + q, i]
                power[q] += _sum(room)
        for q in range(sources):
            for i in range(n):
                v[rows - 1, first + q, i] = end[q] * z[rows - 1, q, i]
        # Upwards: what the rows below add.
        upwards = drives if every else MEASURE + 1
        for r in range(rows - 2, -1, -1):
            _scale(current, step, v[r + 1, :upwards])
            np.dot(current[:upwards], z[r], added[:upwards])
            for q in range(upwards):
                for i in range(n):
                    v[r, q, i] += added[q, i]
        for q in range(drives):
            for i in range(n):
                last[f, q, i] = v[rows - 1, q, i]
        if every:
            _leaves(away[f], v, leak, end)
        for r in range(rows):
            if every:
                for i in range(n):
                    room[i] = lines.to_driver[f, r, i] * v[r, ROWS + r, i]
                power[r] = _sum(room)
            lift[f, r] = power[r] / node[f, r] if node[f, r] > 0.0 else 0.0
            if not every:
                away[f, ROWS + r] = max(_sum(lines.to_driver[f, r]) - g_ground[r] * lift[f, r], 0.0)
            for i in range(n):
                largest[f] = max(largest[f], v[r, MEASURE, i])
        for q in range(0 if every else sources):
            for i in range(n):
                # What the last row sees of the rows above, and its own leak, is still there.
                away[f, first + q] += current[LEAKS, i] * last[f, first + q, i]
        missed, most, relative = _misses(
            v[:, : drives if every else 1], out, leak, lines, f, share, lateral, step, end, floor
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
