# SPDX-License-Identifier: Apache-2.0
"""What every cocotb bench needs: the scenario, the report, clock edges and a reset."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cocotb.triggers import Timer

HALF_NS = 100  # half a clock of 5 MHz


def scenario() -> dict[str, Any]:
    """Return the scenario from pytest."""
    return json.loads(Path(os.environ["DERMIS_SCENARIO"]).read_text())


def report(result: Any) -> None:
    """Hand a result back to the pytest side."""
    Path(os.environ["DERMIS_RESULT"]).write_text(json.dumps(result))


async def rise(dut: Any) -> None:
    """Drive a rising edge of clk_i and the half clock after it, less 1 ns."""
    dut.clk_i.value = 1
    await Timer(HALF_NS - 1, "ns")


async def fall(dut: Any) -> None:
    """Drive a falling edge of clk_i and the half clock after it; inputs written now are stable 1 ns before the rise."""
    await Timer(1, "ns")
    dut.clk_i.value = 0
    await Timer(HALF_NS - 1, "ns")


async def reset(dut: Any, inputs: Iterable[str]) -> None:
    """Hold reset with the clock and these inputs low for 10 ns, then let half a clock pass."""
    for name in ("clk_i", "rst_ni", *inputs):
        getattr(dut, name).value = 0
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)
