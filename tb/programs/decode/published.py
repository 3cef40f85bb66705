# SPDX-License-Identifier: Apache-2.0
"""Published corrections: Hidalgo-Lopez et al., J. Sensors 2018, 9735741, table 6."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents
from dermis.decode import crosstalk

Floats = NDArray[np.float64]

TAXEL_OHM = (100.0, 500.0, 2000.0, 5000.0, 7500.0, 10_000.0)
OTHERS_OHM = 2000.0
SERIES_OHM = 5.0
"""Not in the stored text; 5 ohm meets all 24 cells of part (a). It reads Rns as the resistance of all other taxels."""
CLASSICAL = {
    4: (11.60, 3.53, 2.01, 1.71, 1.64, 1.60),
    8: (13.72, 5.56, 4.02, 3.67, 3.57, 3.50),
    12: (15.86, 7.62, 6.02, 5.61, 5.45, 5.33),
    16: (18.02, 9.68, 8.02, 7.51, 7.27, 7.07),
}
WU = {
    4: (10.77, 2.76, 1.25, 0.95, 0.88, 0.84),
    8: (11.77, 3.75, 2.23, 1.89, 1.79, 1.73),
    12: (12.77, 4.74, 3.19, 2.79, 2.63, 2.52),
    16: (13.77, 5.73, 4.13, 3.63, 3.41, 3.21),
}
FIRST_STEP = {
    4: (0.61, 0.08, 0.05, 0.04, 0.05, 0.05),
    8: (0.87, 0.22, 0.15, 0.15, 0.15, 0.15),
    12: (1.18, 0.42, 0.33, 0.31, 0.30, 0.30),
    16: (0.07, 0.68, 0.56, 0.52, 0.50, 0.48),
}
WORST = (16, 100.0)
"""Size and taxel of the cell with 0.07 % after one step and 1.56 % after two."""


def case(size: int, taxel_ohm: float) -> tuple[Network, Floats, Floats]:
    """Return the network, the conductances [size, size] and the currents of a cell of the table."""
    g = np.full((size, size), 1 / OTHERS_OHM)
    g[0, 0] = 1 / taxel_ohm
    network = Network(g, 1.0, SERIES_OHM, SERIES_OHM, SERIES_OHM)  # type: ignore[arg-type]
    return network, g, column_currents(network)


def classical(size: int, taxel_ohm: float) -> float:
    """Error in % of R = V/I."""
    _, g, current = case(size, taxel_ohm)
    return 100 * float(g[0, 0] / current[0, 0] - 1)


def wu(size: int, taxel_ohm: float) -> float:
    """Error in % where the driven row carries its own taxel alone (part b, as we understand it)."""
    network, g, current = case(size, taxel_ohm)
    u = network.r_column_ohm * current[0]
    grounded = (g @ u) / (g.sum(axis=1) + 1 / SERIES_OHM)
    through = current[0] + (g[1:] * (u - grounded[1:, None])).sum(axis=0)
    return 100 * float((1 - SERIES_OHM * through[1:].sum()) * g[0, 0] / current[0, 0] - 1)


def one_step(size: int, taxel_ohm: float) -> float:
    """Error in % after one multiplicative correction by the modelled current (part c, as we understand it)."""
    network, g, current = case(size, taxel_ohm)
    stepped = current * current / column_currents(network, current[np.newaxis])[0]
    return 100 * float(g[0, 0] / stepped[0, 0] - 1)


def ours(size: int, taxel_ohm: float) -> float:
    """Error in % of the solver."""
    network, g, current = case(size, taxel_ohm)
    found = crosstalk.solve(network, current[np.newaxis]).conductance_s[0]
    return 100 * float(abs(g[0, 0] / found[0, 0] - 1))


def largest_miss(table: dict[int, tuple[float, ...]], method, taxels: tuple[float, ...] = TAXEL_OHM) -> float:
    """Return the largest difference in percentage points between a table and a method over some taxels."""
    return max(
        abs(method(size, ohm) - cell)
        for size, row in table.items()
        for ohm, cell in zip(TAXEL_OHM, row, strict=True)
        if ohm in taxels
    )
