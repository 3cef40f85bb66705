# SPDX-License-Identifier: Apache-2.0
"""Settings that every test shares: numpy raises on invalid operations, divisions by zero and overflows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _strict_numbers() -> Iterator[None]:
    """Every invalid, overflowing or zero-dividing operation of numpy that is not meant raises."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield
