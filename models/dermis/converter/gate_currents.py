# SPDX-License-Identifier: Apache-2.0
"""Column currents through a gate, as a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GateCurrents:
    """Column currents of some frames at the beginning and at the end of every gate, [frames, rows,
    cols] each.

    `follows` goes with the bias, `rest` does not. The bends are what both are in the middle of the
    gate beyond the mean of its ends, None where everything goes straight.
    """

    follows_begin: Floats
    follows_end: Floats
    rest_begin: Floats
    rest_end: Floats
    follows_bend: Floats | None = None
    rest_bend: Floats | None = None
