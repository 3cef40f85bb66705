# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_register_port: requests from another clock, each to be one access of one clock."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, Timer
from rtl_bench import report, scenario

CLOCK_PS = 200_000


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def requests(dut: Any) -> None:
    """One access a request, its answer with the acknowledge and at rest behind it; errors are counted to a stop."""
    s = scenario()
    rng = random.Random(s["seed"])
    seen: list[tuple[int, int, int]] = []
    answers: list[tuple[int, int]] = []
    for pin in (
        dut.rst_ni,
        dut.request_toggle_i,
        dut.write_i,
        dut.address_i,
        dut.wdata_i,
        dut.error_toggle_i,
    ):
        pin.value = 0
    dut.rdata_i.value = dut.error_i.value = 0
    Clock(dut.clk_i, CLOCK_PS, "ps").start()
    await Timer(3 * CLOCK_PS, "ps")
    dut.rst_ni.value = 1

    async def bus() -> None:
        """The registers: an answer that moves every clock."""
        while True:
            await FallingEdge(dut.clk_i)
            answer = (rng.getrandbits(16), rng.getrandbits(1))
            dut.rdata_i.value, dut.error_i.value = answer
            if int(dut.valid_o.value):
                seen.append((int(dut.write_o.value), int(dut.address_o.value), int(dut.wdata_o.value)))
                answers.append(answer)

    cocotb.start_soon(bus())
    latest = 0.0
    for n in range(s["requests"]):
        request = (rng.getrandbits(1), rng.getrandbits(8), rng.getrandbits(16))
        dut.write_i.value, dut.address_i.value, dut.wdata_i.value = request
        toggle = 1 - int(dut.request_toggle_i.value)
        dut.request_toggle_i.value = toggle
        clocks = 0.0
        while True:
            await Timer(CLOCK_PS // 10, "ps")
            clocks += 0.1
            if int(dut.ack_toggle_o.value) == toggle:
                break
            assert clocks < 6, "no acknowledge"
        latest = max(latest, clocks)
        assert len(seen) == n + 1, f"{len(seen)} accesses for {n + 1} requests"
        assert seen[-1] == request
        rest = (int(dut.rdata_o.value), int(dut.refused_o.value))
        assert rest == answers[-1], f"{rest} is not the answer of the access, {answers[-1]}"
        await Timer(rng.randrange(1, 8 * CLOCK_PS), "ps")
        assert (int(dut.rdata_o.value), int(dut.refused_o.value)) == rest, "the answer moved"
        assert len(seen) == n + 1
    for n in range(10):
        assert int(dut.errors_o.value) == n
        dut.error_toggle_i.value = 1 - int(dut.error_toggle_i.value)
        await Timer(5 * CLOCK_PS, "ps")
    report({"latest acknowledge, clocks": latest})
