# SPDX-License-Identifier: Apache-2.0
"""Tables 4 and 6 of Hidalgo-Lopez et al., J. Sensors 2018, 9735741, recomputed (docs/decode.md)."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dermis.array.array import Network, column_currents
from dermis.decode import crosstalk
from dermis.ndarrays import Floats

SERIES_OHM = 5.0
"""Fitted: the caption of table 6 does not state its Rs; 5 ohm meets all 84 cells of parts (a) and (b)."""
STEPS = {"classical": 0, "first_step": 1, "second_step": 2}
"""Correction steps of each part; part (b), "wu", is another circuit."""
OVERLOADED = {(14, 100.0, "first_step"), (16, 100.0, "first_step"), (16, 100.0, "second_step")}
"""Cells of table 6 that no network reproduces: the authors' amplifier was probably overloaded."""
WORST = (16, 100.0)
"""Size and taxel of the cell with 0.07 % after one step and 1.56 % after two."""


@dataclass(frozen=True)
class Cell:
    """Published error in % of one taxel, and its circuit."""

    part: str
    size: int
    others_ohm: float
    series_ohm: float
    taxel_ohm: float
    error: float


def cells(table: int, series_ohm: float = SERIES_OHM) -> list[Cell]:
    """Return the cells of a table that a network reproduces; `series_ohm` is for table 6."""
    found = []
    with (Path(__file__).parent / "hidalgo_lopez_2018.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if int(row["table"]) != table or (table == 4 and row["part"] == "wu"):
                continue
            circuit = int(row["size"]), float(row["others_ohm"]), float(row["series_ohm"] or series_ohm)
            found += [Cell(row["part"], *circuit, float(ohm), float(row[ohm])) for ohm in list(row)[5:]]
    return [c for c in found if table == 4 or (c.size, c.taxel_ohm, c.part) not in OVERLOADED]


def circuit(cell: Cell) -> tuple[Network, Floats]:
    """Return the network of a cell and its conductances [size, size].

    In part (b) the feedback follows the line of the read column, which then sits at the reference of all undriven
    lines.
    """
    g = np.full((cell.size, cell.size), 1 / cell.others_ohm)
    g[0, 0] = 1 / cell.taxel_ohm
    inputs = np.full(cell.size, cell.series_ohm)
    inputs[0] *= cell.part != "wu"
    return Network(g, 1.0, cell.series_ohm, cell.series_ohm, inputs), g  # type: ignore[arg-type]


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


def recomputed(cell: Cell) -> float:
    """Return the error in % after the steps of the cell's part."""
    network, g = circuit(cell)
    current = column_currents(network)
    if cell.part == "wu":  # the series resistance of the read column adds to the taxel
        return 100 * ((1 / float(current[0, 0]) + cell.series_ohm) * g[0, 0] - 1)
    found = current / network.v_bias_v
    for _ in range(STEPS[cell.part]):
        found = step(network, current, found)
    return 100 * float(g[0, 0] / found[0, 0] - 1)


def miss(cell: Cell) -> float:
    """Return the difference in percentage points between the published magnitude and the recomputed error."""
    return abs(abs(recomputed(cell)) - cell.error)


def ours(size: int, taxel_ohm: float) -> float:
    """Return the error in % of the solver in the circuit of table 6."""
    network, g = circuit(Cell("classical", size, 2000.0, SERIES_OHM, taxel_ohm, np.nan))
    found = crosstalk.solve(network, column_currents(network)[np.newaxis]).conductance_s[0]
    return 100 * float(abs(g[0, 0] / found[0, 0] - 1))
