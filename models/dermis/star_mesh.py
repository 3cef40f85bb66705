# SPDX-License-Identifier: Apache-2.0
"""Star-mesh steps of the array solve, compiled: plain arrays in, changed in place.

A row of `work` [frames, n, n + 1 + m] is one node: its links to n nodes, its conductance to ground, its currents.
Links are symmetric and only those to the right of the diagonal are read or kept up.
"""

from __future__ import annotations

import numba


@numba.njit(cache=True, error_model="numpy")
def down(work, pivot, first, last):  # type: ignore
    """Eliminate nodes first .. last - 1, as far as these rows themselves go; pivots are sums to the right."""
    frames, n, width = work.shape
    for f in range(frames):
        rows = work[f]
        for k in range(first, last):
            total = 0.0
            for j in range(k + 1, n + 1):
                total += rows[k, j]
            pivot[f, k] = total
            for i in range(k + 1, last):
                weight = rows[k, i] / total
                for j in range(i + 1, width):
                    rows[i, j] += weight * rows[k, j]


@numba.njit(cache=True, error_model="numpy")
def up(work, pivot, first, last):  # type: ignore
    """Turn the currents of nodes first .. last - 1 into voltages; what later nodes add is there already."""
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
