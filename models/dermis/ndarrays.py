# SPDX-License-Identifier: Apache-2.0
"""Types of numpy arrays, and what no array may hide."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


def unmasked(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return an array; ValueError if a mask hides some of its values."""
    if np.ma.is_masked(values):
        raise ValueError(f"{name} has masked values: fill them, or leave these frames out")
    return np.asarray(values)


def place_of(which: Bools) -> str:
    """Return the first place of [frames, rows, cols] that is True, in words."""
    n, r, c = np.argwhere(which)[0]
    return f"frame {n}, row {r}, column {c}"
