# SPDX-License-Identifier: Apache-2.0
"""Lines with capacitance in many digits: the slow reference of incomplete settling."""

import dataclasses
import itertools

import mpmath
import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network
from dermis.records import Timing
from tb.reference import nodal


def charge_reference(network: Network, timing: Timing) -> NDArray[np.float64]:
    """Return the extra charge of every clock of a slot, [rows, cols, clocks], in 80 digits.

    Nothing is reduced or diagonalised: a source without resistance is taken as 1e-13 ohm and a node
    without capacitance as 1e-28 F, which moves charges by the same small part.
    """
    rows, cols = network.rows, network.cols
    n = rows + cols
    out = np.zeros((rows, cols, timing.slot_clocks))
    with mpmath.workdps(80):
        exact = mpmath.mpf
        c = mpmath.zeros(n, n)
        for k in range(n):
            c[k, k] += exact(network.c_row_f if k < rows else network.c_column_f) + exact("1e-28")
        for r, k in itertools.product(range(rows), range(cols)):
            stamp(c, r, rows + k, exact(network.c_taxel_f))
        clock, now = exact(1) / exact(timing.f_clk_hz), None
        for row in range(rows):
            dark, lit = range(timing.break_clocks), range(timing.break_clocks, timing.slot_clocks)
            for driven, ticks in ((None, dark), (row, lit)):
                if not ticks or (driven is None and now is None):
                    continue
                rest, rate, ohm = settles(network, driven, c)
                distance = (now - rest) if now is not None else mpmath.zeros(n, 1)
                per_clock, of_change = mpmath.expm(rate * clock, method="taylor"), mpmath.inverse(rate)
                for tick in ticks:
                    later = per_clock * distance
                    integral = of_change * (later - distance)
                    for k in range(cols):
                        # Current through the input resistance of column k is (v - offset) / r.
                        out[row, k, tick] = float(integral[rows + k] / ohm[k])
                    distance = later
                now = rest + distance
    return out


def settles(
    network: Network, driven: int | None, c: mpmath.matrix
) -> tuple[mpmath.matrix, mpmath.matrix, list[mpmath.mpf]]:
    """Return settled voltages, the matrix of their rate of change and the resistance of each column."""
    n, exact = network.rows + network.cols, mpmath.mpf
    names = ("r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm")
    series = {name: np.maximum(getattr(network, name), 1e-13) for name in names}
    elements, held, injected = nodal.elements(dataclasses.replace(network, **series), driven, exact)
    place = {("row", r): r for r in range(network.rows)}
    place |= {("column", k): network.rows + k for k in range(network.cols)}
    g, push = mpmath.zeros(n, n), mpmath.zeros(n, 1)
    for node, current in injected.items():
        push[place[node]] += current
    for a, b, value in elements:
        if b in place:
            stamp(g, place[a], place[b], value)
        else:
            g[place[a], place[a]] += value
            push[place[a]] += value * held[b]
    for r in range(network.rows):
        g[r, r] += exact("1e-40")  # a floating row on which nothing hangs must rest somewhere
    ohm = [exact(float(r)) for r in series["r_column_ohm"]]
    return mpmath.lu_solve(g, push), -mpmath.inverse(c) * g, ohm


def stamp(matrix: mpmath.matrix, a: int, b: int, value: mpmath.mpf) -> None:
    """Add a conductance, or a capacitance, between two nodes."""
    matrix[a, a] += value
    matrix[b, b] += value
    matrix[a, b] -= value
    matrix[b, a] -= value
