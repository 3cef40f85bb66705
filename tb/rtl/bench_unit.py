# SPDX-License-Identifier: Apache-2.0
"""cocotb test of any module with clk_i and rst_ni: inputs clock by clock, and what its outputs do."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, reset, rise, scenario


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
