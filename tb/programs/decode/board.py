# SPDX-License-Identifier: Apache-2.0
"""A board with dividers by its own dense nodal solve, and its calibration session: nothing here is of the decoder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tomli_w import dumps

from dermis.ndarrays import Floats
from tb.programs.decode import session


@dataclass(frozen=True)
class Board:
    """Dividers at every column, switches at every row, resistors between neighbouring columns in every row.

    Force = k_force_n_ohm / R for a taxel of factor 1. `divider_ohm` is [cols]; the ADC has `bits` for reference_v.
    """

    rows: int
    cols: int
    bits: int
    divider_ohm: Floats
    lateral_ohm: float
    factor: Floats
    side: str = "ground"
    supply_v: float = 3.3
    reference_v: float = 3.3
    multiplexer_ohm: float = 0.0
    idle_rows: str = "held"
    k_force_n_ohm: float = 7500.0
    noise_counts: float = 0.0

    @property
    def most(self) -> int:
        """Largest count."""
        return 2**self.bits - 1

    def column_volts(self, force_n: Floats) -> Floats:
        """Return the voltages over the dividers [rows, cols]: one dense nodal matrix for each driven row."""
        g, rows, cols = force_n / self.k_force_n_ohm * self.factor, self.rows, self.cols
        # Nodes: the row lines, then the columns. A switch of 0 ohm is a nanoohm.
        laplace = np.zeros((rows + cols, rows + cols))
        laplace[:rows, rows:] = -g
        laplace[rows:, rows:] = np.diag(np.full(cols - 1, -rows / self.lateral_ohm), 1)
        laplace += laplace.T
        laplace -= np.diag(laplace.sum(axis=1))
        laplace[range(rows, rows + cols), range(rows, rows + cols)] += 1.0 / self.divider_ohm
        switch_s = 1.0 / max(self.multiplexer_ohm, 1e-9)
        matrix, lines = np.tile(laplace, (rows, 1, 1)), range(rows)
        matrix[:, lines, lines] += switch_s * (
            np.ones((rows, rows)) if self.idle_rows == "held" else np.eye(rows)
        )
        # A row line without any conductance is at no voltage.
        matrix[:, lines, lines] += 1e-15
        source = self.supply_v * switch_s * np.eye(rows, rows + cols)
        return np.linalg.solve(matrix, source[..., None])[:, rows:, 0]

    def counts(self, force_n: Floats, rng: np.random.Generator) -> NDArray[np.int64]:
        """Return what the ADC reads of forces [frames, rows, cols]."""
        volts = np.array([self.column_volts(frame) for frame in force_n])
        counts = volts * (2**self.bits / self.reference_v)
        if self.side == "supply":
            counts = 2**self.bits - counts
        counts = counts + self.noise_counts * rng.standard_normal(counts.shape)
        return np.clip(np.floor(counts + 0.5), 0, self.most).astype(np.int64)

    def alone(self, force_n: Floats) -> Floats:
        """Return the counts, with fractions, of taxels alone on the board with a factor of 1: a scale of force."""
        with np.errstate(divide="ignore"):
            part = self.divider_ohm / (self.divider_ohm + self.k_force_n_ohm / force_n)
        return self.supply_v * part * (2**self.bits / self.reference_v)

    def force_of(self, counts: NDArray) -> Floats:
        """Return the forces of counts without any correction: the formula of a divider."""
        rising = self.most + 1 - counts if self.side == "supply" else counts
        volts = rising * (self.reference_v / 2**self.bits)
        return self.k_force_n_ohm / self.divider_ohm * volts / np.maximum(self.supply_v - volts, 1e-9)

    def scene(self, nominal_ohm: float) -> dict[str, Any]:
        """Return the scene of the board as its user writes it: nominal parts, nothing of the sheet."""
        circuit = {"circuit": "divider", "resistor_ohm": nominal_ohm, "side": self.side}
        circuit["idle_rows"] = self.idle_rows
        adc = {"full_scale": self.most, "supply_v": self.supply_v, "reference_v": self.reference_v}
        size, sensor = {"rows": self.rows, "cols": self.cols}, {"k_force_n_ohm": self.k_force_n_ohm}
        return {"array": size, "sensor": sensor, "front_end": circuit | adc}

    def session(self, directory: Path, loads: Floats, nominal_ohm: float, rng: np.random.Generator) -> Path:
        """Write the scene and a session of loads [loads, rows, cols] in newtons; return the session's file."""
        (directory / "board.toml").write_text(dumps(self.scene(nominal_ohm)))
        frames = 4 if self.noise_counts else 1
        codes = [self.counts(np.repeat(load[None], frames, axis=0), rng) for load in loads]
        return session.write_tables(directory, (self.rows, self.cols), 'scene = "board.toml"', loads, codes)


def touches(rng: np.random.Generator, frames: int, rows: int, cols: int) -> Floats:
    """Return frames of two or three round touches of up to 6 N each, [frames, rows, cols] in newtons."""
    row, col = np.mgrid[:rows, :cols]
    out = np.zeros((frames, rows, cols))
    for frame in out:
        for _ in range(rng.integers(2, 4)):
            distance = np.hypot(row - rng.uniform(0, rows), col - rng.uniform(0, cols)) / rng.uniform(2, 6)
            frame += rng.uniform(0.3, 1) * 6.0 * np.maximum(1 - distance**2, 0)
    return out
