# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_sync_ff, dermis_sync_latch and dermis_reset_sync."""

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, reset, rise

INPUTS = ("inhibit_i", "comp_async_i")


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def chatter_between_edges(dut: Any) -> None:
    """A comparator that toggles between edges must not move the pulse between them; report how often it moved."""
    await reset(dut, INPUTS)
    moved = pulses = 0
    for n in range(200):
        for level in (1, 0):  # clock level
            dut.clk_i.value = level
            await Timer(1, "ns")
            now = int(dut.pulse_o.value)
            pulses += now
            for k in range(8):
                dut.comp_async_i.value = (n + k) & 1
                await Timer(1, "ns")
                moved += int(dut.pulse_o.value) != now
    report({"moved": moved, "pulses": pulses})


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def reset_with_clock_standing(dut: Any) -> None:
    """Reset while a pulse is on and the clock stands at either level; report the pulse before and after."""
    seen = []
    for level in (1, 0):
        await reset(dut, INPUTS)
        dut.comp_async_i.value = 1
        for _ in range(20):
            await Timer(1, "ns")
            await rise(dut)
            if level and int(dut.pulse_o.value):
                break
            await fall(dut)
            if not level and int(dut.pulse_o.value):
                break
        before = int(dut.pulse_o.value)
        dut.rst_ni.value = 0
        await Timer(1, "ns")
        seen.append([level, before, int(dut.pulse_o.value)])
    report(seen)


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
