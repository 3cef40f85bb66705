# SPDX-License-Identifier: Apache-2.0
"""Interface of an analog half of a co-simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Edge = tuple[float, int, float]
"""(time in seconds, index of the source, new level in volt): a digital net begins to move."""


class AnalogHalf(Protocol):
    """The analog side of a lock-step run.

    The caller knows every edge of an interval before the interval is solved, because digital nets
    change at clock edges only; so an analog half never has to go back.
    """

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to `to` seconds with these edges; return a sample a comparator, > 0 if high."""

    def close(self) -> None:
        """Release its resources."""
