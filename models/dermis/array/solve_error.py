# SPDX-License-Identifier: Apache-2.0
"""Error of array solves: bounds derived from their arithmetic, checks, and a record of both.

docs/array_proofs.md, "Count of roundings", has the derivation. Counts are in roundings, u = 2^-53
each.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np

from dermis.errors import SimulatorError
from dermis.ndarrays import Floats

U = 2.0**-53
"""Largest relative error of one rounded operation."""

LIMIT_LSB = 1e-3
"""Largest error of a solve: below any other bound of a level."""

# Terms of second order are a part n u of those of first order, below 1e-6 for any array that fits a memory.
_SECOND_ORDER = 1.001
# JSON has no infinity.
_LARGEST = 1e300
# Beyond this the first-order bounds say nothing.
_HOPELESS = 0.01


def elements(rows: int, cols: int, bent: bool) -> float:
    """Roundings in any link, leak or drive between column lines once the row lines are eliminated.

    A driver's node is a sum of cols + 1 terms, each of its links a quotient of two products, summed
    over the rows; along a row line with resistance up to cols factors of up to 4 cols roundings
    each are multiplied on either side.
    """
    return rows + 2 * cols + 10 + (6 * cols * cols + 8 * cols if bent else 0)


@functools.lru_cache(maxsize=256)
def one_matrix(cols: int, per_element: float) -> float:
    """Roundings in any node voltage of cols nodes that are eliminated by star-mesh steps.

    The step with m nodes left rounds each link that stays at most m + 4 times, and a voltage is a
    quotient of polynomials with positive terms of degree m + 1 at most in the links that are left
    (matrix-tree theorem), so it moves by 2 (m + 1) times as much. Going back adds m + 2 in each
    step.
    """
    m = np.arange(1, cols + 1)
    return float(2 * (cols + 1) * per_element + (2 * (m + 1) * (m + 4) + m + 2).sum())


@functools.lru_cache(maxsize=256)
def chain(rows: int, cols: int, per_element: float) -> float:
    """Roundings in any node voltage of a chain of `rows` blocks that are inverted and folded one
    into the next.

    As `one_matrix` with cols nodes in each of the blocks still to come, to which a block under
    elimination has as many links again; the inverse, a sum over its nodes, and folding it round what
    the next one gets once more.
    """
    m = np.arange(1, cols + 1)
    left = cols * np.arange(rows)
    steps = (2 * (m[:, np.newaxis] + left + 1) * (m[:, np.newaxis] + 5)).sum()
    folds = (2 * (left + 1) * (3 * cols + 10)).sum()
    return float(steps + folds + 2 * (rows * cols + 1) * per_element + rows * (3 * cols + 10))


def part(voltage: float, rows: int, cols: int) -> float:
    """Relative bound of what is a sum of voltages, with the operations that it takes."""
    bound = _SECOND_ORDER * (voltage + 2 * (rows + cols) + 16) * U
    return bound if bound < _HOPELESS else np.inf


def of(part: float | Floats, size: Floats) -> Floats:
    """Return part * size for sizes of 0 or above; 0 for a size of 0, also if the part is
    infinite.
    """
    product = part * size
    return product if isinstance(part, float) and part < np.inf else np.where(size > 0, product, 0.0)


def balance(voltage: float) -> float:
    """Return the allowed relative miss of Kirchhoff's law: that of rounded voltages.

    Where that bound says little, 1e-9: a wrong term is of order 1.
    """
    return min(1e-9, 4 * (voltage + 8) * U)


@dataclass
class ErrorRecord:
    """Error figures of all solves since it was opened: the largest of each.

    Attributes
    ----------
    lsb_a, reach_a : ndarray or None
        [cols] column current that moves a code by one, and the magnitude of currents beyond which codes stay as they
        are; None where nobody reads codes.
    solves : int
        Networks solved: a frame is one.
    residual : float
        Largest miss of Kirchhoff's law, of the current at that place.
    condition : float
        Bound of Skeel's condition number of the nodal matrix, the largest row of |inverse| |matrix|.
    bound : float
        Bound of the error of a column current, of all that adds up in it.
    bound_lsb : float
        The same in codes.
    slots_alone : int
        Slots that were solved again by themselves, because the change from one slot to the next cancels.
    """

    lsb_a: Floats | None = None
    reach_a: Floats | None = None
    solves: int = 0
    residual: float = 0.0
    condition: float = 1.0
    bound: float = 0.0
    bound_lsb: float = 0.0
    slots_alone: int = 0

    def tolerance_a(self, cols: int) -> Floats:
        """Return the error of column currents [cols] in ampere that needs no slower solve."""
        # A millionth of an LSB; without codes a millionth of the design's, 0.5 V / 64 kohm / 256.
        return np.full(cols, 1e-12) if self.lsb_a is None else 1e-6 * self.lsb_a

    def take(
        self, residual: float = 0.0, condition: float = 1.0, bound: float = 0.0, slots_alone: int = 0
    ) -> None:
        """Add the figures of a solve."""
        self.residual = max(self.residual, residual)
        self.condition = max(self.condition, condition)
        self.bound = max(self.bound, bound)
        self.slots_alone += slots_alone

    def check(
        self, driven: Floats, rest: Floats | None, part: float | Floats, rest_error: Floats | None
    ) -> None:
        """Turn errors of currents [frames, rows, cols] into codes.

        Parameters
        ----------
        driven, rest : ndarray, ndarray or None
            The currents; rest adds to driven.
        part : float or ndarray
            Bound of the error of `driven`, relative; one number, or an array [frames, rows, cols] or less.
        rest_error : ndarray or None
            Bound of the error of `rest` in ampere.

        Raises
        ------
        SimulatorError
            A code may be off by more than LIMIT_LSB.
        """
        if self.lsb_a is None or self.reach_a is None:
            return
        where, worst = "any taxel", float(np.max(part * (self.reach_a / self.lsb_a)))
        if rest is not None or isinstance(part, np.ndarray):
            with np.errstate(over="ignore", invalid="ignore"):
                total, error = driven, of(part, np.abs(driven))
                if rest is not None:
                    total, error = driven + rest, error + rest_error
            from dermis.array import star_mesh  # compiled: numba takes 0.4 s to load

            worst, row, column = star_mesh.worst_code(total, error, self.reach_a, self.lsb_a)
            where = f"row {row}, column {column}"
        if not worst <= LIMIT_LSB:
            raise SimulatorError(
                f"array solve: the current of {where} is uncertain by {worst:.1e} LSB (limit {LIMIT_LSB:g}), since "
                "currents of offsets and leaks cancel beyond double precision; use resistances closer to each "
                "other, smaller offsets, or engine cosim"
            )
        self.bound_lsb = max(self.bound_lsb, worst)

    def report(self) -> dict[str, Any]:
        """Return the figures for a summary, empty without any solve."""
        if not self.solves:
            return {}
        return {
            "solves": self.solves,
            "residual": self.residual,
            "bound": self.bound,
            "bound_lsb": self.bound_lsb,
            "condition": min(self.condition, _LARGEST),
            "refinement_steps": self.slots_alone,
        }


_record: ContextVar[ErrorRecord | None] = ContextVar("record", default=None)


def current() -> ErrorRecord:
    """Return the open record, or a temporary one."""
    return _record.get() or ErrorRecord()


@contextmanager
def recording(lsb_a: Floats | None = None, reach_a: Floats | None = None) -> Iterator[ErrorRecord]:
    """Collect the error figures of all solves in the block; refuse errors that may move a code."""
    opened = ErrorRecord(lsb_a, reach_a)
    token = _record.set(opened)
    try:
        yield opened
    finally:
        _record.reset(token)
