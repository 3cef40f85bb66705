# SPDX-License-Identifier: Apache-2.0
"""Clock, analog columns and protocol checks around dermis_reader in cocotb."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cocotb.triggers import Timer

from tb.reference.chip import AnalogColumns, Duty

HALF_NS = 100  # half a clock of 5 MHz


def scenario() -> dict[str, Any]:
    """Return the scenario from pytest."""
    return json.loads(Path(os.environ["DERMIS_SCENARIO"]).read_text())


def report(result: Any) -> None:
    """Hand a result back to the pytest side."""
    Path(os.environ["DERMIS_RESULT"]).write_text(json.dumps(result))


async def rise(dut: Any) -> None:
    """Drive a rising edge of clk_i and the half clock after it, less 1 ns."""
    dut.clk_i.value = 1
    await Timer(HALF_NS - 1, "ns")


async def fall(dut: Any) -> None:
    """Drive a falling edge of clk_i and the half clock after it; inputs written now are stable 1 ns before the rise."""
    await Timer(1, "ns")
    dut.clk_i.value = 0
    await Timer(HALF_NS - 1, "ns")


async def reset(dut: Any, inputs: Iterable[str]) -> None:
    """Hold reset with the clock and these inputs low for 10 ns, then let half a clock pass."""
    for name in ("clk_i", "rst_ni", *inputs):
        getattr(dut, name).value = 0
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)


def everything(rows: int) -> dict[str, int]:
    """Inputs of dermis_reader at which it scans all rows without end."""
    return {
        "continuous_i": 1,
        "shot_i": 0,
        "test_i": 0,
        "dark_i": 0,
        "hold_i": 0,
        "pedestal_mode_i": 0,
        "settle_i": 115,
        "gate_i": 510,
        "row_mask_i": (1 << rows) - 1,
        "range_i": 0,
        "test_rate_i": 0x4000,
    }


class ReaderBench:
    """dermis_reader with ideal converters on its columns and a taker of its rows.

    Parameters
    ----------
    dut : cocotb handle
        dermis_reader.
    x : [rows][cols] of (int, int)
        Duty of each taxel.
    w_preset : [cols] of (int, int), optional
        Charge the preset forces.
    settings : mapping
        Inputs other than those of `everything`, by port name.
    comp_in_preset : "model", "ones" or "random"
        Comparator levels during preset; a real comparator may show any level then.
    shift_clocks : int
        Clocks in which the taker takes one column; dermis_packer takes one or two.
    busy : bool
        True if busy_i is high until all columns are taken, as by dermis_packer.
    checks : bool
        Assert the protocol each clock; off only for the traps.
    """

    def __init__(
        self,
        dut: Any,
        x: Sequence[Sequence[Duty]],
        w_preset: Sequence[Duty] | None = None,
        settings: Mapping[str, int] | None = None,
        comp_in_preset: str = "model",
        shift_clocks: int = 1,
        busy: bool = True,
        checks: bool = True,
    ) -> None:
        self.dut = dut
        self.rows, self.cols = len(x), len(x[0])
        self.analog = AnalogColumns([[tuple(d) for d in row] for row in x], w_preset)
        self.settings = everything(self.rows) | dict(settings or {})
        self.comp_in_preset = comp_in_preset
        self.shift_clocks = shift_clocks
        self.busy = busy
        self.checks = checks
        self.random = random.Random(1)
        self.edge = -1
        self.row_select = self.preset = self.charge = 0
        self.switches: list[tuple[int, int, int]] = []  # (edge, row_select, preset) at each change
        self.frame_starts: list[int] = []  # edges after which frame_start_o was high
        self.slots: list[dict[str, Any]] = []
        self.taking: int | None = None  # clocks since row_valid_o of the row that is being taken
        self.rising_edges = [0] * self.cols  # of charge_o, whole run
        self.charge_clocks = [0] * self.cols  # clocks with charge_o on, whole run

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
        if preset and self.comp_in_preset != "model":
            full = (1 << self.cols) - 1
            levels = full if self.comp_in_preset == "ones" else self.random.randint(0, full)
        dut.comp_async_i.value = levels
        dut.row_sense_i.value = row_select
        self._record(row_select, preset, charge)
        self._take()

    def _record(self, row_select: int, preset: int, charge: int) -> None:
        dut = self.dut
        if self.checks:
            assert row_select & (row_select - 1) == 0, (
                f"rows {row_select:b} driven together at edge {self.edge}"
            )
            assert not self.row_select or row_select in (0, self.row_select), f"no break at edge {self.edge}"
            assert preset or row_select in (0, self.row_select), f"row driven in a gate at edge {self.edge}"
            assert charge & self.charge == 0, f"charge pulse longer than a clock at edge {self.edge}"
            assert row_select == int(dut.row_select_o.value), f"row switched at a falling edge at {self.edge}"
            assert preset == int(dut.preset_o.value), f"preset switched at a falling edge at {self.edge}"
        if not self.switches or (row_select, preset) != self.switches[-1][1:]:
            self.switches.append((self.edge, row_select, preset))
        if int(dut.frame_start_o.value):
            self.frame_starts.append(self.edge)
        for c in range(self.cols):
            if charge >> c & 1:
                self.charge_clocks[c] += 1
                self.rising_edges[c] += not (self.charge >> c & 1)
        self.row_select, self.preset, self.charge = row_select, preset, charge

    def _take(self) -> None:
        """Take the columns of a row one by one, as dermis_packer does."""
        dut = self.dut
        if int(dut.row_valid_o.value):
            assert self.taking is None, f"a row at edge {self.edge} before the one before it was taken"
            self.taking = 0
            self.slots.append(
                {
                    "edge": self.edge,
                    "slot": int(dut.slot_o.value),
                    "first": int(dut.first_o.value),
                    "last": int(dut.last_o.value),
                    "test": int(dut.test_frame_o.value),
                    "dark": int(dut.dark_frame_o.value),
                    "gate": int(dut.gate_clocks_o.value),
                    "row_fault": int(dut.row_fault_o.value),
                    "range": int(dut.range_o.value),
                    "counts": [],
                }
            )
        elif self.taking is None:
            return
        else:
            self.taking += 1
        if self.taking == self.cols * self.shift_clocks:
            self.slots[-1]["test_count"] = int(dut.test_count_o.value)
            self.taking = None
            dut.busy_i.value = 0
            dut.count_shift_i.value = 0
            return
        column, clock = divmod(self.taking, self.shift_clocks)
        bits = len(dut.count_o)
        word = int(dut.count_o.value)
        counts = self.slots[-1]["counts"]
        if clock == 0:
            counts.append(0)
        # In as many clocks as there are bits, a bit a clock; otherwise the whole word in the last.
        if self.shift_clocks == bits:
            counts[column] |= word & 1 << clock
        elif clock == self.shift_clocks - 1:
            counts[column] = word
        dut.count_shift_i.value = int(clock == self.shift_clocks - 1)
        dut.busy_i.value = int(self.busy)
