# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_reader with ideal converters on its columns."""

import random
from collections.abc import Mapping
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import HALF_NS, report, scenario

from tb.reference.chip import AnalogColumns

SLOT_PORTS = "slot first last test_frame dark_frame gate_clocks row_fault range".split()


class ReaderBench:
    """dermis_reader with ideal converters on its columns and a taker of its rows.

    Keys of the scenario, all but the first optional:

    x : [rows][cols] of (int, int), duty of each taxel
    w_preset : [cols] of (int, int), charge the preset forces
    settings : inputs by port name, where all rows are not scanned without end at the default times
    comp_in_preset : comparator levels during preset, "model", "ones" or "random"; a real comparator may show any
    shift_clocks : clocks in which the taker takes one column; dermis_packer takes one or two
    busy : busy_i is high until all columns are taken, as by dermis_packer
    checks : assert the protocol each clock; off only for the traps
    """

    def __init__(self, dut: Any, s: Mapping[str, Any]) -> None:
        self.dut, self.s = dut, s
        self.rows, self.cols = len(s["x"]), len(s["x"][0])
        self.analog = AnalogColumns([[tuple(d) for d in row] for row in s["x"]], s.get("w_preset"))
        idle = dict.fromkeys(("shot_i", "test_i", "dark_i", "hold_i", "pedestal_mode_i", "range_i"), 0)
        times = {"settle_i": 115, "gate_i": 510, "test_rate_i": 0x4000}
        rows = {"continuous_i": 1, "row_mask_i": (1 << self.rows) - 1}
        self.settings = idle | times | rows | s.get("settings", {})
        self.random = random.Random(1)
        self.edge = -1
        self.row_select = self.preset = self.charge = 0
        self.switches: list[tuple[int, int, int]] = []  # (edge, row_select, preset) at each change
        self.frame_starts: list[int] = []  # edges after which frame_start_o was high
        self.slots: list[dict[str, Any]] = []
        self.taking: int | None = None  # clocks since row_valid_o of the row that is being taken

    async def reset(self) -> None:
        """Power up with reset on and enable low, then leave reset."""
        dut = self.dut
        dut.clk_i.value = 0
        dut.rst_ni.value = 0
        for name in ("enable_i", "comp_async_i", "row_sense_i", "busy_i", "count_shift_i"):
            getattr(dut, name).value = 0
        self.set(self.settings)
        await Timer(HALF_NS, "ns")
        await self.run(3)
        dut.rst_ni.value = 1
        await self.run(3)

    def set(self, settings: Mapping[str, int]) -> None:
        """Change inputs, by port name."""
        for name, value in settings.items():
            getattr(self.dut, name).value = value

    async def run(self, clocks: int) -> None:
        """Run some clocks."""
        for _ in range(clocks):
            await self._clock()

    async def run_slots(self, slots: int, limit: int) -> None:
        """Run until a number of slots is delivered; fail after `limit` clocks."""
        wanted = len(self.slots) + slots
        for _ in range(limit):
            if len(self.slots) >= wanted and self.taking is None:
                return
            await self._clock()
        raise AssertionError(f"{len(self.slots)} slots instead of {wanted} after {limit} clocks")

    async def _clock(self) -> None:
        dut, analog = self.dut, self.analog
        self.edge += 1
        await Timer(1, "ns")  # values written since the last clock are stable before the edge
        dut.clk_i.value = 1
        await Timer(HALF_NS, "ns")
        row_select, preset = int(dut.row_select_o.value), int(dut.preset_o.value)
        current = int(dut.test_current_o.value)
        analog.half_clock(row_select, preset, int(dut.charge_o.value), current)
        dut.clk_i.value = 0
        await Timer(HALF_NS - 1, "ns")
        charge = int(dut.charge_o.value)
        analog.half_clock(row_select, preset, charge, current)
        levels = analog.comparators()
        if preset and (shown := self.s.get("comp_in_preset", "model")) != "model":
            full = (1 << self.cols) - 1
            levels = full if shown == "ones" else self.random.randint(0, full)
        dut.comp_async_i.value = levels
        dut.row_sense_i.value = row_select
        self._record(row_select, preset, charge)
        self._take()

    def _record(self, row_select: int, preset: int, charge: int) -> None:
        dut = self.dut
        if self.s.get("checks", True):
            assert row_select & (row_select - 1) == 0, f"rows {row_select:b} together at edge {self.edge}"
            assert not self.row_select or row_select in (0, self.row_select), f"no break at edge {self.edge}"
            assert preset or row_select in (0, self.row_select), f"row driven in a gate at edge {self.edge}"
            assert charge & self.charge == 0, f"charge pulse longer than a clock at edge {self.edge}"
            assert row_select == int(dut.row_select_o.value), f"row switched at a falling edge at {self.edge}"
            assert preset == int(dut.preset_o.value), f"preset switched at a falling edge at {self.edge}"
        if not self.switches or (row_select, preset) != self.switches[-1][1:]:
            self.switches.append((self.edge, row_select, preset))
        if int(dut.frame_start_o.value):
            self.frame_starts.append(self.edge)
        self.row_select, self.preset, self.charge = row_select, preset, charge

    def _take(self) -> None:
        """Take the columns of a row one by one, as dermis_packer does."""
        dut = self.dut
        if int(dut.row_valid_o.value):
            assert self.taking is None, f"a row at edge {self.edge} before the one before it was taken"
            self.taking = 0
            shown = {name: int(getattr(dut, f"{name}_o").value) for name in SLOT_PORTS}
            self.slots.append({"edge": self.edge, "counts": [], **shown})
        elif self.taking is None:
            return
        else:
            self.taking += 1
        shift_clocks = self.s.get("shift_clocks", 1)
        if self.taking == self.cols * shift_clocks:
            self.slots[-1]["test_count"] = int(dut.test_count_o.value)
            self.taking = None
            dut.busy_i.value = 0
            dut.count_shift_i.value = 0
            return
        column, clock = divmod(self.taking, shift_clocks)
        word, counts = int(dut.count_o.value), self.slots[-1]["counts"]
        if clock == 0:
            counts.append(0)
        # In as many clocks as there are bits, a bit a clock; otherwise the whole word in the last.
        if shift_clocks == len(dut.count_o):
            counts[column] |= word & 1 << clock
        elif clock == shift_clocks - 1:
            counts[column] = word
        dut.count_shift_i.value = int(clock == shift_clocks - 1)
        dut.busy_i.value = int(self.s.get("busy", True))


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def frames(dut: Any) -> None:
    """Read some slots and report the counts and when the switches moved.

    `changes` are [slots, {port: value}]: inputs that change when so many slots were delivered; a
    pulse lasts a clock.
    """
    s = scenario()
    bench = ReaderBench(dut, s)
    await bench.reset()
    dut.enable_i.value = 1
    for slots, change in s.get("changes", ()):
        await bench.run_slots(slots - len(bench.slots), limit=s["limit"])
        bench.set(change)
        await bench.run(1)
        bench.set({name: 0 for name in ("shot_i", "test_i") if name in change})
    await bench.run_slots(s["slots"] - len(bench.slots), limit=s["limit"])
    seen = {name: getattr(bench, name) for name in ("slots", "switches", "frame_starts")}
    report(seen | {"scanning": int(dut.scanning_o.value)})


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def power_up(dut: Any) -> None:
    """Reset alone, with the clock standing, must leave no row driven, preset on and every charge switch off."""
    s = scenario()
    full = 2 ** len(dut.comp_async_i) - 1
    seen = []

    async def look(what: str) -> None:
        await Timer(10, "ns")
        ports = "row_select preset charge test_current row_valid range row_fault".split()
        seen.append([what, *(str(getattr(dut, f"{port}_o").value) for port in ports)])

    bench = ReaderBench(dut, s)
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
