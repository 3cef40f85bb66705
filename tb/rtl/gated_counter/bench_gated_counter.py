# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_gated_counter."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, rise, scenario


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def levels(dut: Any) -> None:
    """Play gate and pulse levels, given or random; report the count behind each edge."""
    s = scenario()
    rng = random.Random(8)
    played = s.get("levels")
    if played is None:
        played, gate = [], 0
        for _ in range(s["clocks"]):
            gate ^= rng.random() < (0.02 if gate else 0.2)
            played.append([int(gate), rng.randint(0, 1)])
    dut.clk_i.value = 0
    dut.rst_ni.value = 0
    dut.gate_i.value = 0
    dut.pulse_i.value = 0
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)
    counts = []
    for gate, pulse in played:
        dut.gate_i.value = gate
        dut.pulse_i.value = pulse
        await Timer(1, "ns")
        await rise(dut)
        counts.append(int(dut.count_o.value))
        await fall(dut)
    report({"levels": played, "counts": counts})
