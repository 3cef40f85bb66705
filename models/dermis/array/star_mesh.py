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
def _add_product(out, factor, a, b, first):  # type: ignore
    """out += factor * a b, in columns first onwards; four rows of b for two of out at once, so that
    both are touched less.
    """
    n, inner, last = a.shape[0], a.shape[1], b.shape[1]
    whole = inner - inner % 4
    spare = np.zeros(last if n % 2 else 0)
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
            for q in range(first, last):
                b0, b1, b2, b3 = b[k, q], b[k + 1, q], b[k + 2, q], b[k + 3, q]
                upper[q] += (a0 * b0 + a1 * b1) + (a2 * b2 + a3 * b3)
                lower[q] += (c0 * b0 + c1 * b1) + (c2 * b2 + c3 * b3)
        for k in range(whole, inner):
            a0, c0 = factor * a[i, k], factor * a[j, k]
            for q in range(first, last):
                upper[q] += a0 * b[k, q]
                lower[q] += c0 * b[k, q]


@_compiled
def _links(link, g, pass_on, seen, bent, to_driver, share, lateral):  # type: ignore
    """Compute the links of one row line and its laterals between columns, to the right of the
    diagonal.
    """
    n = g.shape[0]
    for i in range(n):
        left = g[i] * seen[i] if bent else 0.0
        for j in range(i + 1, n):
            link[i, j] = to_driver[i] * share[j]
            if bent:
                left *= pass_on[j]
                link[i, j] += left * g[j]
        if i + 1 < n:
            link[i, i + 1] += lateral


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
    for i in range(n - 1, -1, -1):
        for q in range(n):
            out[i, q] = work[i, n + 1 + q]
        whole = i + 1 + (n - i - 1) // 4 * 4
        for k in range(i + 1, whole, 4):
            w0, w1, w2, w3 = work[i, k], work[i, k + 1], work[i, k + 2], work[i, k + 3]
            for q in range(n):
                out[i, q] += (w0 * out[k, q] + w1 * out[k + 1, q]) + (w2 * out[k + 2, q] + w3 * out[k + 3, q])
        for k in range(whole, n):
            w0 = work[i, k]
            for q in range(n):
                out[i, q] += w0 * out[k, q]
        for q in range(n):
            out[i, q] /= pivot[i]


@_compiled
def _miss_of_row(  # type: ignore
    worst, most, v, r, out, to_driver, share, g, pass_on, seen, bent, lateral, step, end, came, beside, drives
):
    """Raise worst[q], for every drive q, to the miss of Kirchhoff's law in row r, in volt, and
    most[q] to its voltages.

    What a node gets through its own share of the row line is counted on both sides, so that a row
    line is one sum for all of its nodes. `came` [n, drives] and `beside` [drives] are room to work
    in; the last drive injects `out`.
    """
    rows, n, last = v.shape[0], v.shape[1], drives - 1
    for q in range(drives):
        beside[q] = 0.0
    for i in range(n):
        for q in range(drives):
            beside[q] += share[i] * v[r, i, q]
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
                beside[q] = pass_on[i + 1] * (g[i + 1] * v[r, i + 1, q] + beside[q])
                came[i, q] += left * beside[q]
        for q in range(drives):
            beside[q] = 0.0
        for i in range(1, n):
            left = g[i - 1] * seen[i - 1]
            for q in range(drives):
                beside[q] = pass_on[i] * (left * v[r, i - 1, q] + beside[q])
                came[i, q] += g[i] * beside[q]
    for i in range(n):
        came[i, last] += out[i]
        came[i, r] += to_driver[i]
        if r == rows - 1:
            for q in range(rows, last):
                if q - rows == i:
                    came[i, q] += end[i]
        if i > 0:
            for q in range(drives):
                came[i, q] += lateral * v[r, i - 1, q]
        if i + 1 < n:
            for q in range(drives):
                came[i, q] += lateral * v[r, i + 1, q]
        if r > 0:
            for q in range(drives):
                came[i, q] += step * v[r - 1, i, q]
        if r + 1 < rows:
            for q in range(drives):
                came[i, q] += step * v[r + 1, i, q]
        for q in range(drives):
            miss = abs(v[r, i, q] - came[i, q] / out[i])
            # a comparison with NaN is false
            worst[q] = miss if not miss <= worst[q] else worst[q]
            most[q] = max(most[q], v[r, i, q])


@_compiled
def chain(  # type: ignore
    g, pass_on, seen, bent, to_driver, share, leak, lateral, step, end, moved, away, last, largest, volt
):
    """Solve all slots of arrays with resistive column lines; return the largest violation of
    Kirchhoff's law at a node.

    Drives come in this order: one a row; maybe one a column, its source at 1 V; and one that
    injects into every node what it would pass on at 1 V, all that leaves it. The voltages under the
    last one turn residuals into errors.

    Parameters
    ----------
    g, pass_on, seen, to_driver, share, leak : [frames, rows, cols]
        Taxels; row lines as array._RowLines has them (the first three count if `bent`); the part of a driver's
        node that each column sees and what it leaks to ground.
    lateral, step : float
        Conductance between neighbouring columns in a row, and along a column from row to row.
    end : [cols]
        Conductance behind the last row.
    moved, away, last : [frames, rows, cols], [frames, drives], [frames, cols, drives]
        Results: voltages of row r under its own drive; what of a drive leaves, but through the own driver of a row
        and for a column's source but through inputs; voltages of the last row under every drive.
    largest : [frames]
        Result: the largest voltage under the last drive.
    volt : [frames, drives] or [0, 0]
        Result: voltages under a drive are known to this times those under the last one; not asked for without frames.
    """
    frames, rows, n = to_driver.shape
    drives = last.shape[2]
    shape = drives - 1
    link = np.empty((n, n))
    z = np.empty((rows, n, n))
    v = np.empty((rows, n, drives))
    carry = np.empty((n, drives))
    work = np.empty((n, 2 * n + 1))
    out = np.empty((rows, n))
    pivot, weights, below, ground, total, came, size = (
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty((rows, n))
    )  # fmt: skip
    beside, most = np.empty(drives), np.empty(drives)
    worst = 0.0
    for f in range(frames):
        # Upwards: block r with all below it folded in, inverted; currents folded into the row above.
        for i in range(n):
            below[i] = end[i]
        for r in range(rows - 1, -1, -1):
            _links(link, g[f, r], pass_on[f, r], seen[f, r], bent, to_driver[f, r], share[f, r], lateral)
            for i in range(n):
                out[r, i] = (
                    to_driver[f, r, i] * share[f, r, i]
                    + leak[f, r, i]
                    + (step if r > 0 else 0.0)
                    + (step if r < rows - 1 else end[i])
                )
            for i in range(n):
                for j in range(i + 1, n):
                    out[r, i] += link[i, j]
                    out[r, j] += link[i, j]
                    work[i, j] = link[i, j]
                if r < rows - 1:
                    for j in range(i + 1, n):
                        work[i, j] += step * z[r + 1, i, j] * step
                ground[i] = leak[f, r, i] + below[i]
                work[i, n] = ground[i] + (step if r > 0 else 0.0)
                for q in range(n):
                    work[i, n + 1 + q] = 0.0
                work[i, n + 1 + i] = 1.0
            _invert(work, pivot, weights, z[r])
            for i in range(n):
                for q in range(r + 1, rows):
                    carry[i, q] = step * v[r + 1, i, q]
                carry[i, r] = to_driver[f, r, i]
                if r < rows - 1:
                    for q in range(rows, drives):
                        carry[i, q] = step * v[r + 1, i, q]
                else:
                    for q in range(rows, shape):
                        carry[i, q] = end[i] if q - rows == i else 0.0
                    carry[i, shape] = 0.0
                carry[i, shape] += out[r, i]
            for i in range(n):
                for q in range(drives):
                    v[r, i, q] = 0.0
            _add_product(v[r], 1.0, z[r], carry, r)
            for i in range(n):
                flow = 0.0
                for k in range(n):
                    flow += z[r, i, k] * ground[k]
                below[i] = step * flow
        # Downwards: what the rows above add.
        for q in range(drives):
            away[f, q] = 0.0
        largest[f] = 0.0
        for r in range(rows):
            if r > 0:
                _add_product(v[r], step, z[r], v[r - 1], 0)
            for i in range(n):
                moved[f, r, i] = v[r, i, r]
                largest[f] = max(largest[f], v[r, i, shape])
                for q in range(drives):
                    if q != r:
                        away[f, q] += leak[f, r, i] * v[r, i, q]
        for i in range(n):
            for q in range(drives):
                last[f, i, q] = v[rows - 1, i, q]
            for q in range(rows):
                away[f, q] += end[i] * v[rows - 1, i, q]
            away[f, shape] += end[i] * v[rows - 1, i, shape]
        # Kirchhoff's law at every node, all rows' drives together.
        for r in range(rows):
            for i in range(n):
                flow = 0.0
                for q in range(rows):
                    flow += v[r, i, q]
                size[r, i] = flow
        for r in range(rows):
            _links(link, g[f, r], pass_on[f, r], seen[f, r], bent, to_driver[f, r], share[f, r], lateral)
            for i in range(n):
                total[i] = leak[f, r, i] + (step if r > 0 else 0.0) + (step if r < rows - 1 else end[i])
                came[i] = to_driver[f, r, i]
                if r > 0:
                    came[i] += step * size[r - 1, i]
                if r < rows - 1:
                    came[i] += step * size[r + 1, i]
            for i in range(n):
                for j in range(i + 1, n):
                    total[i] += link[i, j]
                    total[j] += link[i, j]
                    came[i] += link[i, j] * size[r, j]
                    came[j] += link[i, j] * size[r, i]
            for i in range(n):
                flow = total[i] * size[r, i]
                # where no electron flows, products of doubles lose their digits to underflow
                if not flow + came[i] <= 1e-100:
                    miss = abs(flow - came[i]) / (flow + came[i])
                    worst = max(worst, miss) if miss >= 0.0 else np.inf
        if volt.shape[0] > 0:
            for q in range(drives):
                volt[f, q] = most[q] = 0.0
            for r in range(rows):
                _miss_of_row(
                    volt[f], most, v, r, out[r], to_driver[f, r], share[f, r], g[f, r], pass_on[f, r], seen[f, r],
                    bent, lateral, step, end, carry, beside, drives,
                )  # fmt: skip
            # Rounding error: sums of n terms, products along a row line of up to n of them, u = 1.1e-16 each.
            for q in range(drives):
                volt[f, q] += (8 * n + 64) * 1.2e-16 * most[q]
            # The last drive is its own measure: its true voltages are at most its own over 1 - volt.
            sure = 1.0 - volt[f, shape]
            for q in range(drives):
                volt[f, q] = volt[f, q] / sure if sure > 0.5 else np.inf
    return worst
