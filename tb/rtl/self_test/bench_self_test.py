# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the self-test, with faults in the array around the reader."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import HALF_NS, report, scenario

from tb.reference.chip import AnalogColumns

MASKS = ("inject_fault_o", "dark_fault_o", "full_fault_o", "row_fault_o")


class FaultyArray:
    """The chain in an array with faults.

    Parameters
    ----------
    dut : cocotb handle
        self_test_chain.
    x : [rows][cols] of (int, int)
        Duty of each taxel; the self-test must not need any.
    fault : mapping
        comparators_high, comparators_low, open_columns: columns; shorted_columns: pairs of columns;
        rows_high, rows_low: rows; shorted_rows: pairs of rows, of which the driven one pulls the other along.
    """

    def __init__(self, dut: Any, x: list[list[Any]], fault: Mapping[str, Any]) -> None:
        self.dut, self.fault = dut, fault
        self.analog = AnalogColumns(
            [[tuple(d) for d in row] for row in x],
            open_columns=fault.get("open_columns", ()),
            shorted_columns=fault.get("shorted_columns", ()),
        )

    def _rows(self, selected: int) -> int:
        rows = selected
        for a, b in self.fault.get("shorted_rows", ()):
            if rows >> a & 1 or rows >> b & 1:
                rows |= 1 << a | 1 << b
        for r in self.fault.get("rows_high", ()):
            rows |= 1 << r
        for r in self.fault.get("rows_low", ()):
            rows &= ~(1 << r)
        return rows

    async def clock(self) -> None:
        dut = self.dut
        await Timer(1, "ns")
        dut.clk_i.value = 1
        await Timer(HALF_NS, "ns")
        rows = self._rows(int(dut.row_select_o.value))
        preset, current = int(dut.preset_o.value), int(dut.test_current_o.value)
        self.analog.half_clock(rows, preset, int(dut.charge_o.value), current)
        dut.clk_i.value = 0
        await Timer(HALF_NS - 1, "ns")
        self.analog.half_clock(rows, preset, int(dut.charge_o.value), current)
        levels = self.analog.comparators()
        for c in self.fault.get("comparators_high", ()):
            levels |= 1 << c
        for c in self.fault.get("comparators_low", ()):
            levels &= ~(1 << c)
        dut.comp_async_i.value = levels
        dut.row_sense_i.value = rows

    async def reset(self, settings: Mapping[str, int]) -> None:
        dut = self.dut
        dut.clk_i.value = 0
        dut.rst_ni.value = 0
        for name in ("enable_i", "continuous_i", "test_i", "dark_i", "comp_async_i", "row_sense_i"):
            getattr(dut, name).value = 0
        for name, value in settings.items():
            getattr(dut, name).value = value
        await self.clock()
        dut.rst_ni.value = 1
        await self.clock()
        dut.enable_i.value = 1

    async def test_frame(self, limit: int) -> None:
        """Ask for a self-test and wait for it."""
        self.dut.test_i.value = 1
        await self.clock()
        self.dut.test_i.value = 0
        await self.clock()
        assert not int(self.dut.done_o.value), "done before the test"
        for _ in range(limit):
            await self.clock()
            if int(self.dut.done_o.value):
                return
        raise AssertionError(f"no self-test after {limit} clocks")

    def found(self) -> dict[str, Any]:
        """Numbers in each mask, by name."""
        masks = {name.removesuffix("_fault_o"): int(getattr(self.dut, name).value) for name in MASKS}
        named = {name: [n for n in range(mask.bit_length()) if mask >> n & 1] for name, mask in masks.items()}
        assert int(self.dut.fault_o.value) == any(masks.values())
        return {name: numbers for name, numbers in named.items() if numbers}


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def faults(dut: Any) -> None:
    """Reset and test an array with each fault in turn; report what was found."""
    s = scenario()
    found = []
    for fault in s["faults"]:
        array = FaultyArray(dut, s["x"], fault)
        await array.reset(s["settings"])
        await array.test_frame(s["limit"])
        found.append(array.found())
    report(found)
