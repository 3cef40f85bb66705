# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_reset_sync."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, rise


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def release(dut: Any) -> None:
    """Reset falls with the clock at either level and rises somewhere between two edges; report the
    output around it.

    Of each: level of the clock where the pin fell, output just behind it, output where the pin
    rose, output behind each of the next three rising edges.
    """
    rng = random.Random(6)
    seen = []
    dut.rst_ni.value = 1
    for n in range(20):
        dut.clk_i.value = n % 2
        await Timer(3, "ns")
        dut.rst_ni.value = 0
        await Timer(1, "ns")
        fell = int(dut.rst_no.value)
        await fall(dut)
        await Timer(1 + rng.randrange(40), "ns")
        dut.rst_ni.value = 1
        await Timer(1, "ns")
        rose = int(dut.rst_no.value)
        behind = []
        for _ in range(3):
            await rise(dut)
            behind.append(int(dut.rst_no.value))
            await fall(dut)
            assert int(dut.rst_no.value) == behind[-1], "reset was let go of away from a rising edge"
        seen.append([n % 2, fell, rose, behind])
    report(seen)
