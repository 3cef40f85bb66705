# SPDX-License-Identifier: Apache-2.0
"""cocotb test of the lengths that dermis_row_scanner counts."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, RisingEdge, Timer
from cocotb.utils import get_sim_time
from rtl_bench import report, scenario


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def lengths(dut: Any) -> None:
    """Let the clock run by itself; report the clocks from enable to the gate and of the gate.

    Settle and gate go to zero meanwhile, so that the next slot is the shortest.
    """
    for name, value in (scenario()["inputs"] | {"enable_i": 0}).items():
        getattr(dut, name).value = value
    dut.rst_ni.value = 0
    dut.clk_i.value = 0
    await Timer(5, "ns")
    dut.rst_ni.value = 1
    Clock(dut.clk_i, 10, "ns").start()
    await FallingEdge(dut.clk_i)
    dut.enable_i.value = 1
    await RisingEdge(dut.clk_i)
    edges = [get_sim_time("ns")]
    for _ in range(2):
        await FallingEdge(dut.preset_o)
        edges.append(get_sim_time("ns"))
        dut.settle_i.value = 0
        dut.gate_i.value = 0
        await RisingEdge(dut.preset_o)
        edges.append(get_sim_time("ns"))
    report([round((b - a) / 10) for a, b in pairwise(edges)])
