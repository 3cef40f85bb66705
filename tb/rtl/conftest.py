# SPDX-License-Identifier: Apache-2.0
"""Makes the benches importable by pytest and by the simulators, and runs each RTL test on both of them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from dermis.chip.hdl import SIMULATORS

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), *(str(d) for d in sorted(HERE.iterdir()) if d.is_dir() and d.name[0] not in "._")]


@pytest.fixture(params=SIMULATORS)
def simulator(request: pytest.FixtureRequest) -> str:
    """Each test that asks for it runs once on Icarus and once on Verilator."""
    return request.param
