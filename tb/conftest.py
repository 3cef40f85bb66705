# SPDX-License-Identifier: Apache-2.0
"""What every test shares: floating point that complains, in numpy and in compiled code, wherever a test runs it."""

from __future__ import annotations

import os
from collections.abc import Iterator

# Before dermis is imported, which reads it then; processes that a test starts inherit it.
os.environ["DERMIS_FLOAT_FLAGS"] = "raise"

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _strict_numbers() -> Iterator[None]:
    """Every invalid, overflowing or zero-dividing operation of numpy that is not meant raises."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield
