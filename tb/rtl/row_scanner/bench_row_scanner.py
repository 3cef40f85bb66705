# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_row_scanner."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, rise, scenario


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def enables(dut: Any) -> None:
    """Play enable levels, all high or random; report the outputs behind each edge."""
    s = scenario()
    rng = random.Random(9)
    dut.clk_i.value = 0
    dut.rst_ni.value = 0
    dut.enable_i.value = 0
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)
    seen = []
    enable = 1
    for _ in range(s["clocks"]):
        if s["random"]:
            enable = int(rng.random() < (0.98 if enable else 0.3))
        dut.enable_i.value = enable
        await Timer(1, "ns")
        await rise(dut)
        outputs = (
            dut.row_select_o,
            dut.preset_o,
            dut.gate_o,
            dut.slot_done_o,
            dut.done_row_o,
            dut.done_last_o,
        )
        seen.append([enable, *(int(output.value) for output in outputs)])
        await fall(dut)
    report(seen)
