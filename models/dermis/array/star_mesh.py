# SPDX-License-Identifier: Apache-2.0
"""Star-mesh steps of the array solve, compiled: plain arrays in, changed in place.

A row of `work` [frames, n, n + 1 + m] is one node: its links to n nodes, its conductance to ground,
its currents. Links are symmetric and only those to the right of the diagonal are read or kept up.
"""

from __future__ import annotations

import numba
import numpy as np

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


@_compiled
def ladder(g, segment, pass_on, seen, through, to_driver):  # type: ignore
    """Row lines of segments of one conductance, [frames, rows, cols]: results as array._RowLines
    has them.
    """
    frames, rows, cols = g.shape
    for f in range(frames):
        for r in range(rows):
            total = 0.0
            for c in range(cols - 1, -1, -1):
                total = g[f, r, c] + segment * (total / (segment + total))
                pivot = segment + total
                pass_on[f, r, c], seen[f, r, c] = segment / pivot, 1.0 / pivot
            so_far = before = 0.0
            for c in range(cols):
                kept = pass_on[f, r, c]
                before = seen[f, r, c] + kept * kept * before
                so_far = so_far * kept if c else kept
                seen[f, r, c], through[f, r, c] = before, so_far
                to_driver[f, r, c] = g[f, r, c] * so_far


@_compiled
def sum_of_others(values, others):  # type: ignore
    """For every element of [frames, rows, cols] the sum of the other rows' in its column, without a
    subtraction.
    """
    frames, rows, cols = values.shape
    for f in range(frames):
        for c in range(cols):
            before = after = 0.0
            for r in range(rows):
                others[f, r, c] = before
                before += values[f, r, c]
            for r in range(rows - 1, -1, -1):
                others[f, r, c] += after
                after += values[f, r, c]


@_compiled
def _part_of(part, size):  # type: ignore
    """part * size for sizes of 0 or above; 0 for a size of 0, also if the part is infinite."""
    return part * size if size > 0.0 else 0.0


@_compiled
def _at(part, f, r, c):  # type: ignore
    """Element of relative errors [frames, rows, cols], one for all along axes of 1."""
    frames, rows, cols = part.shape
    return part[f if frames > 1 else 0, r if rows > 1 else 0, c if cols > 1 else 0]


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
def mesh_misses(between, ground, own, resistance, floor):  # type: ignore
    """Misses of a mesh [frames, cols, cols]: of what leaves the source of a column at 1 V, and of what
    two columns send each other.
    """
    frames, n = ground.shape
    left, right = np.empty(n), np.ones(n)
    away = apart = 0.0
    for f in range(frames):
        for c in range(n):
            left[c] = ground[f, c]
        for d in range(n):
            for c in range(n):
                left[c] += between[f, d, c]
            apart = max(apart, miss(between[f, d], between[f, :, d], floor))
        for c in range(n):
            left[c] = resistance[c] * left[c] + (own[f, c] if resistance[c] > 0.0 else 1.0)
        away = max(away, miss(left, right, floor))
    return away, apart


@_compiled
def held_currents(between, ground, own, parts, rounding, offset, leak, pushed, held, error):  # type: ignore
    """Fill `held` and `error` [frames, cols] as array._held_currents has them; `parts` are the
    relative errors of the first three.
    """
    frames, n = ground.shape
    of_between, of_ground, of_own = (
        parts  # [frames, cols, cols], [1, frames, cols] and [1, frames, cols] or less
    )
    for f in range(frames):
        for c in range(n):
            total = doubt = 0.0
            for d in range(n):
                apart = offset[d] - offset[c]
                total += between[f, c, d] * (apart + pushed[d])
                size = between[f, c, d] * (abs(apart) + abs(pushed[d]))
                doubt += _part_of(_at(of_between, f, c, d) + rounding, size)
            held[f, c] = total - ground[f, c] * offset[c] + own[f, c] * leak[c]
            doubt += _part_of(_at(of_ground, 0, f, c) + rounding, ground[f, c] * abs(offset[c]))
            error[f, c] = doubt + _part_of(_at(of_own, 0, f, c) + rounding, own[f, c] * abs(leak[c]))


@_compiled
def driven_slots(  # type: ignore
    held,
    error_held,
    delivered,
    part,
    source,
    size,
    node,
    scale,
    change,
    scale_part,
    tolerance,
    rest,
    error,
    doubtful,
):
    """From all rows grounded to one driven, as array._rest has it; `doubtful` [frames, rows] are the
    slots that cancel.
    """
    frames, rows, n = delivered.shape
    for f in range(frames):
        for r in range(rows):
            below = node[f, r] * scale[f, r]
            per_volt = change / below if below > 0.0 else 0.0
            lift = whole = doubt = 0.0
            for c in range(n):
                lift += delivered[f, r, c] * source[c]
                whole += delivered[f, r, c] * size[c]
                doubt += _part_of(_at(part, f, r, c), delivered[f, r, c] * size[c])
            lift *= per_volt
            doubtful[f, r] = False
            for c in range(n):
                lifted = abs(per_volt) * delivered[f, r, c]
                rest[f, r, c] = held[f, c] - lift * delivered[f, r, c]
                both = _at(part, f, r, c) + _at(scale_part, f, r, c)
                off = lifted * doubt + _part_of(both, lifted * whole)
                off += error_held[f, c]
                # A bound that is NaN counts as infinite.
                error[f, r, c] = off if off == off else np.inf
                doubtful[f, r] |= lifted > 0.0 and error[f, r, c] > tolerance[c]


@_compiled
def slots(to_driver, g_ground, lift, away, delivered, r_driven, v_bias, floor, scale, driven):  # type: ignore
    """Currents of every slot: from all rows grounded to one driven, the source voltage and the
    resistance of one node change.

    Fills `scale` [frames, rows], the divisor, and `driven` [frames, rows, cols]; returns the largest
    miss of what enters a driver's node against what leaves it.
    """
    frames, rows, n = delivered.shape
    worst = 0.0
    for f in range(frames):
        for r in range(rows):
            into = 0.0
            for c in range(n):
                into += to_driver[f, r, c]
            out = away[f, r] + g_ground[r] * lift[f, r]
            worst = max(worst, _relative(into, out, floor))
            scale[f, r] = r_driven * away[f, r] + (1.0 + lift[f, r])
            volt = v_bias / scale[f, r]
            for c in range(n):
                driven[f, r, c] = volt * delivered[f, r, c]
    return worst


@_compiled
def worst_code(driven, rest, part, rest_error, reach, lsb):  # type: ignore
    """Largest error of currents [frames, rows, cols] in codes within `reach`, its row and its column;
    NaN counts as infinite. `part` is relative, of `driven`.
    """
    frames, rows, n = driven.shape
    worst, row, column = -1.0, 0, 0
    for f in range(frames):
        for r in range(rows):
            for c in range(n):
                total = driven[f, r, c] + rest[f, r, c]
                error = _part_of(_at(part, f, r, c), abs(driven[f, r, c])) + rest_error[f, r, c]
                low = min(max(total - error, -reach[c]), reach[c])
                high = min(max(total + error, -reach[c]), reach[c])
                off = (high - low) / 2 / lsb[c]
                # max and min of a NaN may drop it
                off = off if total == total and error == error else np.inf
                if off > worst:
                    worst, row, column = off, r, c
    return worst, row, column


@_compiled
def _add_product(out, factor, a, b):  # type: ignore
    """out += factor * a b; four rows of b for two of out at once, so that both are touched less."""
    n, inner, width = a.shape[0], a.shape[1], b.shape[1]
    whole = inner - inner % 4
    spare = np.zeros(width if n % 2 else 0)
    for i in range(0, n, 2):
        j = min(i + 1, n - 1)
        upper, lower = out[i], out[j] if j > i else spare
        for k in range(0, whole, 4):
            a0, a1, a2, a3 = (
                factor * a[i, k], factor * a[i, k + 1], factor * a[i, k + 2], factor * a[i, k + 3]
            )  # fmt: skip
            c0, c1, c2, c3 = (
                factor * a[j, k], factor * a[j, k + 1], factor * a[j, k + 2], factor * a[j, k + 3]
            )  # fmt: skip
            for q in range(width):
                b0, b1, b2, b3 = b[k, q], b[k + 1, q], b[k + 2, q], b[k + 3, q]
                upper[q] += (a0 * b0 + a1 * b1) + (a2 * b2 + a3 * b3)
                lower[q] += (c0 * b0 + c1 * b1) + (c2 * b2 + c3 * b3)
        for k in range(whole, inner):
            a0, c0 = factor * a[i, k], factor * a[j, k]
            for q in range(width):
                upper[q] += a0 * b[k, q]
                lower[q] += c0 * b[k, q]


@_compiled
def _links(link, g, pass_on, seen, bent, to_driver, share, lateral, beside):  # type: ignore
    """Compute the links of one row line and its laterals between columns; the diagonal is 0.
    `beside` [n] is room to work in.
    """
    n = g.shape[0]
    for j in range(n):
        for i in range(j):
            link[j, i] = to_driver[i] * share[j]
        if bent:
            for i in range(j):
                beside[i] *= pass_on[j]
                link[j, i] += beside[i] * g[j]
            beside[j] = g[j] * seen[j]
        if j > 0:
            link[j, j - 1] += lateral
        link[j, j] = 0.0
        for i in range(j):
            link[i, j] = link[j, i]


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


# Drives of `chain`: the measure of residuals, all rows at once, then one a row, then perhaps one a column's source.
MEASURE, TOGETHER, ROWS = 0, 1, 2


@_compiled
def _miss_of_row(  # type: ignore
    missed,
    most,
    turned,
    r,
    rows,
    out,
    to_driver,
    share,
    g,
    pass_on,
    seen,
    bent,
    lateral,
    step,
    end,
    came,
    beside,
):
    """Raise missed[q], for every drive q, to the miss of Kirchhoff's law in row r, in volt, and
    most[q] to its voltages.

    `turned` [3, n, drives] holds the voltages of row r at r % 3, beside those of its neighbours.
    What a node gets through its own share of the row line is counted on both sides, so that a row
    line is one sum for all of its nodes. `came` [n, drives] and `beside` [drives] are room to work
    in.
    """
    n, drives = came.shape
    sources = ROWS + rows
    above, v, below = turned[(r - 1) % 3], turned[r % 3], turned[(r + 1) % 3]
    for q in range(drives):
        beside[q] = 0.0
    for i in range(n):
        for q in range(drives):
            beside[q] += share[i] * v[i, q]
    for i in range(n):
        for q in range(drives):
            came[i, q] = to_driver[i] * beside[q]
    if bent:
        # Nodes further out, then those nearer the driver, each step past one segment.
        for q in range(drives):
            beside[q] = 0.0
        for i in range(n - 2, -1, -1):
            left = g[i] * seen[i]
            for q in range(drives):
                beside[q] = pass_on[i + 1] * (g[i + 1] * v[i + 1, q] + beside[q])
                came[i, q] += left * beside[q]
        for q in range(drives):
            beside[q] = 0.0
        for i in range(1, n):
            left = g[i - 1] * seen[i - 1]
            for q in range(drives):
                beside[q] = pass_on[i] * (left * v[i - 1, q] + beside[q])
                came[i, q] += g[i] * beside[q]
    for i in range(n):
        came[i, MEASURE] += out[i]
        came[i, TOGETHER] += to_driver[i]
        came[i, ROWS + r] += to_driver[i]
        if r == rows - 1 and drives > sources:
            came[i, sources + i] += end[i]
        if i > 0:
            for q in range(drives):
                came[i, q] += lateral * v[i - 1, q]
        if i + 1 < n:
            for q in range(drives):
                came[i, q] += lateral * v[i + 1, q]
        if r > 0:
            for q in range(drives):
                came[i, q] += step * above[i, q]
        if r + 1 < rows:
            for q in range(drives):
                came[i, q] += step * below[i, q]
        for q in range(drives):
            miss = abs(v[i, q] - came[i, q] / out[i])
            # a comparison with NaN is false
            missed[q] = miss if not miss <= missed[q] else missed[q]
            most[q] = max(most[q], v[i, q])


@_compiled
def _misses(missed, most, v, out, to_driver, share, g, pass_on, seen, bent, lateral, step, end):  # type: ignore
    """Compute, for every drive, the largest miss of Kirchhoff's law at a node, in volt, and the
    largest voltage; `v` is [rows, drives, n].
    """
    rows, drives, n = v.shape
    turned, came, beside = np.empty((3, n, drives)), np.empty((n, drives)), np.empty(drives)
    missed[:] = 0.0
    most[:] = 0.0
    for r in range(rows + 1):
        if r < rows:
            for q in range(drives):
                for i in range(n):
                    turned[r % 3, i, q] = v[r, q, i]
        if r > 0:
            _miss_of_row(
                missed, most, turned, r - 1, rows, out[r - 1], to_driver[r - 1], share[r - 1], g[r - 1],
                pass_on[r - 1], seen[r - 1], bent, lateral, step, end, came, beside,
            )  # fmt: skip


@_compiled
def _apart(left, right):  # type: ignore
    """Relative miss between two sums of currents or voltages; inf for what is no number."""
    # where no electron flows, products of doubles lose their digits to underflow
    if left + right <= 1e-100:
        return 0.0
    return _relative(left, right, 0.0)


@_compiled
def _fold(link, work, out, ground, to_driver, share, leak, above, z_above, step_above, step_below):  # type: ignore
    """Fill `work` for `_invert` with the block of one row, with all above it folded in, `out` with
    what leaves each node at 1 V and `ground` with what of it leaves to ground through this row and
    those above.
    """
    n = link.shape[0]
    for i in range(n):
        out[i] = to_driver[i] * share[i] + leak[i] + step_above + step_below[i]
        ground[i] = leak[i] + above[i]
        work[i, n] = ground[i] + step_below[i]
    for i in range(n):
        for j in range(n):
            out[j] += link[i, j]
            work[i, j] = link[i, j] + step_above * z_above[i, j] * step_above
        for q in range(n):
            work[i, n + 1 + q] = 0.0
        work[i, n + 1 + i] = 1.0


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


@_compiled
def _miss_together(links, v, to_driver, leak, step, end):  # type: ignore
    """Return the largest relative miss of Kirchhoff's law at a node under TOGETHER, and of the sum
    of all rows against it in the last row.
    """
    rows, n = to_driver.shape
    total, came = np.empty(n), np.empty(n)
    worst = 0.0
    for r in range(rows):
        link, at = links[r], v[r, TOGETHER]
        for i in range(n):
            total[i] = leak[r, i] + (step if r > 0 else 0.0) + (step if r < rows - 1 else end[i])
            came[i] = to_driver[r, i]
            if r > 0:
                came[i] += step * v[r - 1, TOGETHER, i]
            if r < rows - 1:
                came[i] += step * v[r + 1, TOGETHER, i]
        for i in range(n):
            for j in range(n):
                total[j] += link[i, j]
                came[j] += link[i, j] * at[i]
        for i in range(n):
            worst = max(worst, _apart(total[i] * at[i], came[i]))
    for i in range(n):
        flow = 0.0
        for q in range(ROWS, ROWS + rows):
            flow += v[rows - 1, q, i]
        worst = max(worst, _apart(flow, v[rows - 1, TOGETHER, i]))
    return worst


@_compiled
def chain(  # type: ignore
    g, pass_on, seen, bent, to_driver, g_ground, lateral, step, end, node, lift, away, last, largest, volt
):
    """Solve all slots of arrays with resistive column lines; return the largest violation of
    Kirchhoff's law at a node.

    Drives come in this order: MEASURE injects into every node what it would pass on at 1 V, all
    that leaves it, and its voltages turn residuals into errors; TOGETHER is the sum of all rows and
    checks them; from ROWS one a row; maybe one a column, its source at 1 V.

    Parameters
    ----------
    g, pass_on, seen, to_driver : [frames, rows, cols]
        Taxels; row lines as array._RowLines has them (the first three count if `bent`).
    g_ground : [rows]
        Conductance of every row's driver to ground.
    lateral, step : float
        Conductance between neighbouring columns in a row, and along a column from row to row.
    end : [cols]
        Conductance behind the last row.
    node, lift, away, last : [frames, rows], [frames, rows], [frames, drives], [frames, drives, cols]
        Results: conductance of every driver's node, and its lift above 1 V under its own drive; what of a drive
        leaves, but through the own driver of a row and for a column's source but through inputs; voltages of the
        last row under every drive.
    largest : [frames]
        Result: the largest voltage under MEASURE.
    volt : [frames, drives] or [0, 0]
        Result: voltages under a drive are known to this times those under MEASURE; not asked for without frames.
    """
    frames, rows, n = to_driver.shape
    drives = last.shape[1]
    sources = ROWS + rows
    every = volt.shape[0] > 0
    links, beside = np.empty((rows, n, n)), np.empty(n)
    # Part of a driver's node that each column sees, and what it leaks to ground.
    share, leak = np.empty((rows, n)), np.empty((rows, n))
    work, pivot, weights = np.empty((n, 2 * n + 1)), np.empty(n), np.empty(n)
    z, v, out = np.empty((rows, n, n)), np.empty((rows, drives, n)), np.empty((rows, n))
    # Conductance to ground of all that lies above each row, and of the row with it.
    above, ground = np.zeros((rows + 1, n)), np.empty(n)
    # What a row adds: the first two drives', and what its conductance to ground takes.
    fresh, here = np.empty((ROWS + 1, n)), np.empty((ROWS + 1, n))
    nothing, along = np.zeros((n, n)), np.full(n, step)
    missed, most = np.empty(drives), np.empty(drives)
    worst = 0.0
    for f in range(frames):
        # Downwards: block r with all above it folded in, inverted; currents folded into the row below.
        for r in range(rows):
            total = 0.0
            for i in range(n):
                total += to_driver[f, r, i]
            node[f, r] = total + g_ground[r]
            for i in range(n):
                share[r, i] = to_driver[f, r, i] / node[f, r] if node[f, r] > 0.0 else 0.0
                leak[r, i] = g_ground[r] * share[r, i]
            _links(
                links[r], g[f, r], pass_on[f, r], seen[f, r], bent, to_driver[f, r], share[r], lateral, beside
            )  # fmt: skip
            _fold(
                links[r], work, out[r], ground, to_driver[f, r], share[r], leak[r], above[r],
                z[r - 1] if r > 0 else nothing, step if r > 0 else 0.0, along if r < rows - 1 else end,
            )  # fmt: skip
            _invert(work, pivot, weights, z[r])
            fresh[MEASURE], fresh[TOGETHER], fresh[ROWS] = out[r], to_driver[f, r], ground
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
        for q in range(drives - sources):
            for i in range(n):
                v[rows - 1, sources + q, i] = end[q] * z[rows - 1, q, i]
        # Upwards: what the rows below add; to rows above a driven one only where residuals are asked for.
        for r in range(rows - 2, -1, -1):
            known = drives if every else ROWS + r + 1
            _add_product(v[r, :known], step, v[r + 1, :known], z[r])
        largest[f] = 0.0
        for r in range(rows):
            for i in range(n):
                largest[f] = max(largest[f], v[r, MEASURE, i])
            total = 0.0
            for i in range(n):
                total += to_driver[f, r, i] * v[r, ROWS + r, i]
            lift[f, r] = total / node[f, r] if node[f, r] > 0.0 else 0.0
        for q in range(drives):
            for i in range(n):
                last[f, q, i] = v[rows - 1, q, i]
        _leaves(away[f], v, above, leak, end, every)
        worst = max(worst, _miss_together(links, v, to_driver[f], leak, step, end))
        if every:
            _misses(
                missed, most, v, out, to_driver[f], share, g[f], pass_on[f], seen[f], bent, lateral, step, end
            )  # fmt: skip
            # Rounding error: sums of n terms, products along a row line of up to n of them, u = 1.1e-16 each.
            rounding = (8 * n + 64) * 1.2e-16
            # MEASURE is its own: its true voltages are at most its own over 1 - what it misses.
            sure = 1.0 - (missed[MEASURE] + rounding * most[MEASURE])
            for q in range(drives):
                volt[f, q] = (missed[q] + rounding * most[q]) / sure if sure > 0.5 else np.inf
    return worst
