# SPDX-License-Identifier: Apache-2.0
"""Import paths of the benches for pytest and simulators; each RTL test runs on Icarus, and with LONG=1 on Verilator."""

import sys
from pathlib import Path

import pytest

from dermis.chip.hdl import SIMULATORS

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), *(str(d) for d in sorted(HERE.iterdir()) if d.is_dir() and d.name[0] not in "._")]


@pytest.fixture(params=[pytest.param(s, marks=[pytest.mark.long] * (s == "verilator")) for s in SIMULATORS])
def simulator(request: pytest.FixtureRequest) -> str:
    """Name of the simulator. Verilator compiles C++ for each set of parameters, 5 to 15 s, and is `long`."""
    return request.param
