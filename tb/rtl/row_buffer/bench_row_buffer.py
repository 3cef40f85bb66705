# SPDX-License-Identifier: Apache-2.0
"""cocotb test of the reset of dermis_row_buffer."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, rise


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
