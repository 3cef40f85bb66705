# SPDX-License-Identifier: Apache-2.0
"""Tables 4 and 6 of Hidalgo-Lopez et al., J. Sensors 2018, 9735741, recomputed (docs/decode.md)."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents
from dermis.decode import crosstalk

Floats = NDArray[np.float64]

SERIES_OHM = 5.0
"""Fitted: the caption of table 6 does not state its Rs; 5 ohm meets all 84 cells of parts (a) and (b)."""
STEPS = {"classical": 0, "first_step": 1, "second_step": 2}
"""Correction steps of each part; part (b), "wu", is another circuit."""
OVERLOADED = {(14, 100.0, "first_step"), (16, 100.0, "first_step"), (16, 100.0, "second_step")}
"""Cells of table 6 that are off: the authors' amplifier was probably overloaded."""
WORST = (16, 100.0)
"""Size and taxel of the cell with 0.07 % after one step and 1.56 % after two."""
LIMIT_S = 0.0146
"""Fitted to the two cells of 16 x 16: current limit of the feedback amplifier, relative to the bias."""


@dataclass(frozen=True)
class Cell:
    """Published error in % of one taxel, and its circuit."""

    table: int
    part: str
    size: int
    others_ohm: float
    series_ohm: float
    taxel_ohm: float
    error: float

    @property
    def overloaded(self) -> bool:
        """Return True for the cells of table 6 that no network reproduces."""
        return self.table == 6 and (self.size, self.taxel_ohm, self.part) in OVERLOADED


def cells(table: int, series_ohm: float = SERIES_OHM) -> list[Cell]:
    """Return the cells of a table; `series_ohm` is for table 6."""
    found = []
    with (Path(__file__).parent / "hidalgo_lopez_2018.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if int(row["table"]) == table:
                circuit = int(row["size"]), float(row["others_ohm"]), float(row["series_ohm"] or series_ohm)
                found += [
                    Cell(table, row["part"], *circuit, float(ohm), float(row[ohm]))
                    for ohm in list(row)[5:]
                ]  # fmt: skip
    return found


def circuit(cell: Cell) -> tuple[Network, Floats]:
    """Return the network of a cell and its conductances [size, size]."""
    g = np.full((cell.size, cell.size), 1 / cell.others_ohm)
    g[0, 0] = 1 / cell.taxel_ohm
    return Network(g, 1.0, cell.series_ohm, cell.series_ohm, cell.series_ohm), g  # type: ignore[arg-type]


def step(network: Network, current: Floats, g: Floats) -> Floats:
    """Return conductances [rows, cols] after one correction of the estimate `g`.

    The measured currents give every column voltage. The estimates give the row voltages, as a divider between the
    driver and the columns, and the current that leaves through other rows. What remains is the taxel's own current.
    """
    out, total, series = np.empty_like(g), g.sum(axis=1), network.r_row_driven_ohm
    for r, seen in enumerate(current):
        u = network.r_column_ohm * seen
        volt = (g @ u) / (total + 1 / series)
        driven = (network.v_bias_v / series + g[r] @ u) / (1 / series + total[r])
        others = np.delete(np.arange(len(g)), r)
        lost = (g[others] * (u - volt[others, None])).sum(axis=0)
        out[r] = (seen + lost) / (driven - u)
    return out


def corrected(cell: Cell, current: Floats | None = None) -> float:
    """Return the error in % after the steps of the cell's part, from its own currents or from others."""
    network, g = circuit(cell)
    current = column_currents(network) if current is None else current
    found = current / network.v_bias_v
    for _ in range(STEPS[cell.part]):
        found = step(network, current, found)
    return 100 * float(g[0, 0] / found[0, 0] - 1)


def wu(cell: Cell) -> float:
    """Return the error in % where the feedback follows the line of the read column (part b).

    The column then sits at the reference of all undriven lines. Its series resistance adds to the taxel.
    """
    _, g = circuit(cell)
    inputs = np.full(cell.size, cell.series_ohm)
    inputs[0] = 0.0
    sensed = Network(g, 1.0, cell.series_ohm, cell.series_ohm, inputs)  # type: ignore[arg-type]
    return 100 * ((1 / float(column_currents(sensed)[0, 0]) + cell.series_ohm) * g[0, 0] - 1)


def miss(cell: Cell) -> float:
    """Return the difference in percentage points between the published and the recomputed error.

    The tables print magnitudes.
    """
    return abs(abs(wu(cell) if cell.part == "wu" else corrected(cell)) - cell.error)


def ours(size: int, taxel_ohm: float) -> float:
    """Return the error in % of the solver in the circuit of table 6."""
    network, g = circuit(Cell(6, "classical", size, 2000.0, SERIES_OHM, taxel_ohm, np.nan))
    found = crosstalk.solve(network, column_currents(network)[np.newaxis]).conductance_s[0]
    return 100 * float(abs(g[0, 0] / found[0, 0] - 1))


def overloaded_currents(cell: Cell) -> Floats:
    """Return the currents [rows, cols] with a feedback amplifier that delivers at most `LIMIT_S`.

    It holds all undriven lines, so a taxel of low resistance overloads it while its neighbours of the row are read.
    Above the limit the lines rise until the current fits.
    """
    _, g = circuit(cell)
    size, series_s = cell.size, 1 / cell.series_ohm
    matrix = np.block(
        [[np.diag(g.sum(axis=1) + series_s), -g], [-g.T, np.diag(g.sum(axis=0) + series_s)]]
    )  # fmt: skip
    solve, out = np.linalg.inv(matrix), np.empty_like(g)
    for r, c in np.ndindex(g.shape):
        held = np.ones(2 * size, bool)
        held[[r, size + c]] = False
        driven = series_s * solve[:, r]
        lifted = series_s * solve @ held
        excess = series_s * driven[held].sum() - LIMIT_S
        rise = max(excess, 0.0) / (series_s * (1 - lifted[held]).sum())
        out[r, c] = series_s * (driven + rise * lifted)[size + c]
    return out
