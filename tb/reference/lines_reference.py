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
        c_line = [network.c_row_f] * rows + [network.c_column_f] * cols
        held = [(k, "ground", exact(f) + exact("1e-28")) for k, f in enumerate(c_line)]
        taxels = itertools.product(range(rows), range(rows, n), [exact(network.c_taxel_f)])
        c = mpmath.matrix(nodal.kirchhoff([*held, *taxels], {"ground": 0}, {}, range(n))[0])
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
    exact = mpmath.mpf
    names = ("r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm")
    series = {name: np.maximum(getattr(network, name), 1e-13) for name in names}
    elements, held, injected = nodal.elements(dataclasses.replace(network, **series), driven)
    nodes = [("row", r) for r in range(network.rows)] + [("column", k) for k in range(network.cols)]
    g, push = map(mpmath.matrix, nodal.kirchhoff(elements, held, injected, nodes))
    for r in range(network.rows):
        g[r, r] += exact("1e-40")  # a floating row on which nothing hangs must rest somewhere
    ohm = [exact(float(r)) for r in series["r_column_ohm"]]
    return mpmath.lu_solve(g, push), -mpmath.inverse(c) * g, ohm
