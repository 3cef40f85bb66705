# SPDX-License-Identifier: Apache-2.0
"""Helpers of all cocotb benches, and the test of any module with clk_i and rst_ni, clock by clock."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cocotb
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
    for name in ("clk_i", *inputs):
        getattr(dut, name).value = 0
    for level in (1, 0):  # Verilator resets a flop at an edge alone
        dut.rst_ni.value = level
        await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def play(dut: Any) -> None:
    """Play the steps; report the outputs behind each rising and each falling edge."""
    s = scenario()
    outputs = [getattr(dut, name) for name in s["outputs"]]
    await reset(dut, s["ports"])
    assert all(output.value.is_resolvable for output in outputs), "unknown after reset"
    seen = []
    for values in s["steps"]:
        for name, value in zip(s["ports"], values, strict=True):
            getattr(dut, name).value = value
        await Timer(1, "ns")
        await rise(dut)
        high = [int(output.value) for output in outputs]
        await fall(dut)
        seen.append([high, [int(output.value) for output in outputs]])
    report(seen)
