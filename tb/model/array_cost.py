# SPDX-License-Identifier: Apache-2.0
"""Measures time, memory and accuracy of the array solve over size; prints the tables of docs/array.md.

Run it as ``.venv/bin/python tb/model/array_cost.py`` on a quiet machine, ``--quick`` to leave out 256x256 with
traces; OPENBLAS_NUM_THREADS=1 for one core.
"""

from __future__ import annotations

import sys
import time
import tracemalloc
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dermis.array.array import Network, column_currents

SERIES: dict[str, Any] = {
    "r_row_driven_ohm": 1.0,
    "r_row_grounded_ohm": 1.0,
    "r_column_ohm": 0.5,
    "g_lateral_row_s": 1e-3,
    "g_lateral_column_s": 1e-3,
}
KINDS: dict[str, dict[str, Any]] = {
    "lateral, row_driver, column_input": SERIES,
    "and trace along the rows": SERIES | {"r_trace_row_ohm": 0.1},
    "and trace along both": SERIES | {"r_trace_row_ohm": 0.1, "r_trace_column_ohm": 0.1},
}
SIZES = (16, 32, 64, 128, 256)


def frames_of(size: int) -> int:
    """As many frames as the solver takes at once."""
    return max(1, (1 << 15) // size**2)


def seconds(network: Network, g: np.ndarray) -> float:
    """Processor time a frame: the best of five, or of one where one takes long."""
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        column_currents(network, g)
        best = min(best, time.process_time() - begin)
        if best > 1:
            break
    return best / len(g)


def peak_mb(network: Network, g: np.ndarray) -> float:
    """Memory that one call takes beyond its input."""
    tracemalloc.start()
    column_currents(network, g)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def sparse_solve(g: np.ndarray, kind: dict[str, Any]) -> tuple[np.ndarray, float]:
    """All slots of one frame with traces along both by SuperLU, and its processor time without the assembly."""
    rows, cols = g.shape
    r, c = np.mgrid[0:rows, 0:cols]
    u, v = r * cols + c, (rows + r) * cols + c
    segment_row, segment_column = 1 / kind["r_trace_row_ohm"], 1 / kind["r_trace_column_ohm"]
    parts = [
        (u, v, g),
        (u[:, 1:], u[:, :-1], segment_row),
        (v[1:], v[:-1], segment_column + kind["g_lateral_column_s"]),
        (v[:, 1:], v[:, :-1], kind["g_lateral_row_s"]),
    ]
    a, b, value = (
        np.concatenate(x)
        for x in zip(*((p.ravel(), q.ravel(), (x + 0.0 * p).ravel()) for p, q, x in parts), strict=True)
    )
    n = 2 * rows * cols
    g_driver = 1 / (kind["r_row_driven_ohm"] + kind["r_trace_row_ohm"])
    g_input = 1 / (kind["r_column_ohm"] + kind["r_trace_column_ohm"])
    diagonal = np.bincount(a, value, n) + np.bincount(b, value, n)
    diagonal[u[:, 0]] += g_driver
    diagonal[v[-1]] += g_input
    each = np.arange(n)
    entries = np.concatenate([-value, -value, diagonal])
    places = (np.concatenate([a, b, each]), np.concatenate([b, a, each]))
    matrix = sparse.csc_matrix((entries, places), shape=(n, n))
    right = np.zeros((n, rows))
    right[u[:, 0], np.arange(rows)] = 0.5 * g_driver
    begin = time.process_time()
    # The matrix is symmetric and dominated by its diagonal: without pivoting it stays twice as sparse.
    options = {"SymmetricMode": True}
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    parts_of_right = np.array_split(right, max(1, rows // 32), axis=1)
    voltage = np.concatenate([solver.solve(part) for part in parts_of_right], axis=1)
    taken = time.process_time() - begin
    return g_input * voltage[v[-1]].T, taken


def main() -> None:
    """Print one table a kind of network."""
    quick = "--quick" in sys.argv
    rng = np.random.default_rng(0)
    for name, kind in KINDS.items():
        traces = "r_trace_column_ohm" in kind
        print(
            f"\n{name}\n| array | ms a frame | frames/s | peak MB | one frame, peak MB | SuperLU ms | apart |"
        )
        print("|---|---|---|---|---|---|---|")
        taken: dict[int, float] = {}
        for size in SIZES:
            if traces and size == 256 and quick:
                continue
            g = 1 / rng.uniform(500, 64250, (frames_of(size), size, size))
            network = Network(g[0], 0.5, **kind)
            taken[size] = seconds(network, g)
            peak, peak_one = peak_mb(network, g), peak_mb(network, g[:1])
            theirs, apart = "", ""
            if traces:
                currents, other = sparse_solve(g[0], kind)
                theirs = f"{1e3 * other:.3g}"
                apart = f"{np.abs(column_currents(network) / currents - 1).max():.0e}"
            print(
                f"| {size}x{size} | {1e3 * taken[size]:.3g} | {1 / taken[size]:.3g} | {peak:.3g} | {peak_one:.3g} "
                f"| {theirs} | {apart} |",
                flush=True,
            )
        for low, high in ((16, max(taken)), (64, max(taken))):
            exponent = np.log(taken[high] / taken[low]) / np.log((high / low) ** 2)
            print(f"exponent in the number of taxels, {low}x{low} to {high}x{high}: {exponent:.2f}")


if __name__ == "__main__":
    main()
