# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_row_buffer."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, rise


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def random_loads(dut: Any) -> None:
    """Counts that change every clock, loaded now and then and shifted; report inputs and outputs of each edge."""
    rng = random.Random(10)
    dut.clk_i.value = 0
    dut.rst_ni.value = 0
    for port in (dut.load_i, dut.shift_i, dut.counts_i):
        port.value = 0
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)
    seen = []
    for _ in range(2000):
        inputs = [int(rng.random() < 0.1), int(rng.random() < 0.7), rng.getrandbits(len(dut.counts_i))]
        for port, value in zip((dut.load_i, dut.shift_i, dut.counts_i), inputs, strict=True):
            port.value = value
        await Timer(1, "ns")
        await rise(dut)
        seen.append([inputs, [int(dut.count_o.value), int(dut.valid_o.value)]])
        await fall(dut)
    report(seen)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def reset(dut: Any) -> None:
    """Reset at power-up and behind a load; report count and valid in it, behind it, and behind the load."""
    seen = []

    def look() -> None:
        seen.append([str(dut.count_o.value), str(dut.valid_o.value)])

    dut.clk_i.value = 0
    dut.shift_i.value = 0
    dut.load_i.value = 0
    dut.counts_i.value = 2 ** len(dut.counts_i) - 1
    for _ in range(2):
        dut.rst_ni.value = 0
        await Timer(10, "ns")
        look()
        dut.rst_ni.value = 1
        await Timer(10, "ns")
        look()
        await fall(dut)
        dut.load_i.value = 1
        await Timer(1, "ns")
        await rise(dut)
        look()
        await fall(dut)
        dut.load_i.value = 0
    report(seen)
