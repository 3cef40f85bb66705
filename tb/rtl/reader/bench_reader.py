# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_reader with ideal converters on its columns."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import ReaderBench, report, scenario


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def frames(dut: Any) -> None:
    """Read some slots and report the counts and when the switches moved.

    `changes` are [slots, {port: value}]: inputs that change when so many slots were delivered; a
    pulse lasts a clock.
    """
    s = scenario()
    bench = ReaderBench(
        dut,
        s["x"],
        s.get("w_preset"),
        s.get("settings"),
        s.get("comp_in_preset", "model"),
        s.get("shift_clocks", 1),
        s.get("busy", True),
        s.get("checks", True),
    )
    await bench.reset()
    dut.enable_i.value = 1
    for slots, change in s.get("changes", ()):
        await bench.run_slots(slots - len(bench.slots), limit=s["limit"])
        bench.set(change)
        await bench.run(1)
        bench.set({name: 0 for name in ("shot_i", "test_i") if name in change})
    await bench.run_slots(s["slots"] - len(bench.slots), limit=s["limit"])
    await bench.run(s.get("then_clocks", 0))
    report(
        {
            "slots": bench.slots,
            "switches": bench.switches,
            "frame_starts": bench.frame_starts,
            "rising_edges": bench.rising_edges,
            "charge_clocks": bench.charge_clocks,
            "scanning": int(dut.scanning_o.value),
        }
    )


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def power_up(dut: Any) -> None:
    """Reset alone, with the clock standing, must leave no row driven, preset on and every charge switch off."""
    s = scenario()
    full = 2 ** len(dut.comp_async_i) - 1
    seen = []

    async def look(what: str) -> None:
        await Timer(10, "ns")
        outputs = (
            dut.row_select_o,
            dut.preset_o,
            dut.charge_o,
            dut.test_current_o,
            dut.row_valid_o,
            dut.range_o,
            dut.row_fault_o,
        )
        seen.append([what, *(str(output.value) for output in outputs)])

    bench = ReaderBench(dut, s["x"], settings=s["settings"])
    bench.set(bench.settings)
    for name in ("row_sense_i", "busy_i", "count_shift_i"):
        getattr(dut, name).value = 0
    for level in (1, 0):
        dut.clk_i.value = level
        dut.rst_ni.value = 0
        dut.enable_i.value = 0
        dut.comp_async_i.value = full
        await look(f"reset, clock stands at {level}")
    dut.rst_ni.value = 1
    await look("reset gone, no clock yet")
    for _ in range(5):
        dut.clk_i.value = 1
        await look("clock high, not enabled, comparators high")
        dut.clk_i.value = 0
        await look("clock low, not enabled, comparators high")
    dut.enable_i.value = 1
    await bench.run(s["into_slot"])
    assert (bench.row_select, bench.preset) == (1, 0)
    for _ in range(4):  # a phase of the clock at which a charge switch is on
        if bench.charge:
            break
        await bench.run(1)
    assert bench.charge
    dut.rst_ni.value = 0
    await look("reset in the middle of a gate")
    dut.clk_i.value = 1
    await look("and the clock stops high")
    report(seen)
