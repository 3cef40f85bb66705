# SPDX-License-Identifier: Apache-2.0
"""Clock, analog columns and protocol checks around dermis_top in cocotb."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cocotb.triggers import Timer
from rtl_reference import AnalogColumns, Duty

HALF_NS = 100  # half a clock of 5 MHz


def scenario() -> dict[str, Any]:
    """What the pytest side asked for."""
    return json.loads(os.environ["DERMIS_SCENARIO"])


def report(result: Any) -> None:
    """Hand a result back to the pytest side."""
    Path(os.environ["DERMIS_RESULT"]).write_text(json.dumps(result))


async def rise(dut: Any) -> None:
    """Rising edge of clk_i and the half clock behind it, short of the falling edge by 1 ns."""
    dut.clk_i.value = 1
    await Timer(HALF_NS - 1, "ns")


async def fall(dut: Any) -> None:
    """Falling edge of clk_i and the half clock behind it; an input written now is there 1 ns before the next rise."""
    await Timer(1, "ns")
    dut.clk_i.value = 0
    await Timer(HALF_NS - 1, "ns")


class TopBench:
    """dermis_top with ideal converters on its columns.

    Parameters
    ----------
    dut : cocotb handle
        dermis_top.
    x : [rows][cols] of (int, int)
        Duty of each taxel.
    w_preset : [cols] of (int, int), optional
        Charge the preset forces.
    comp_in_preset : "model", "ones" or "random"
        What the comparators say while preset is on; a real one may say anything before its integrator has settled.
    checks : bool
        Assert the protocol each clock; off only for the traps.
    """

    def __init__(
        self,
        dut: Any,
        x: Sequence[Sequence[Duty]],
        w_preset: Sequence[Duty] | None = None,
        comp_in_preset: str = "model",
        checks: bool = True,
    ) -> None:
        self.dut = dut
        self.rows, self.cols = len(x), len(x[0])
        self.code_bits = len(dut.codes_o) // self.cols
        self.analog = AnalogColumns([[tuple(d) for d in row] for row in x], w_preset)
        self.comp_in_preset = comp_in_preset
        self.checks = checks
        self.random = random.Random(1)
        self.edge = -1
        self.row_select = self.preset = self.charge = 0
        self.switches: list[tuple[int, int, int]] = []  # (edge, row_select, preset) at each change
        self.slots: list[dict[str, Any]] = []
        self.rising_edges = [0] * self.cols  # of charge_o, whole run
        self.charge_clocks = [0] * self.cols  # clocks with charge_o on, whole run
        self.last_codes: int | None = None

    async def reset(self) -> None:
        """Power up with reset on and enable low, then leave reset."""
        dut = self.dut
        dut.clk_i.value = 0
        dut.rst_ni.value = 0
        dut.enable_i.value = 0
        dut.comp_async_i.value = 0
        await Timer(HALF_NS, "ns")
        await self.run(3)
        dut.rst_ni.value = 1
        await self.run(3)

    async def run(self, clocks: int) -> None:
        """Run some clocks."""
        for _ in range(clocks):
            await self._clock()

    async def run_slots(self, slots: int, limit: int) -> None:
        """Run until so many more slots were delivered; fail after `limit` clocks."""
        wanted = len(self.slots) + slots
        for _ in range(limit):
            if len(self.slots) >= wanted:
                return
            await self._clock()
        raise AssertionError(f"{len(self.slots)} slots instead of {wanted} after {limit} clocks")

    async def _clock(self) -> None:
        dut, analog = self.dut, self.analog
        self.edge += 1
        dut.clk_i.value = 1
        await Timer(HALF_NS, "ns")
        row_select, preset = int(dut.row_select_o.value), int(dut.preset_o.value)
        analog.half_clock(row_select, preset, int(dut.charge_o.value))
        dut.clk_i.value = 0
        await Timer(HALF_NS - 1, "ns")
        charge = int(dut.charge_o.value)
        analog.half_clock(row_select, preset, charge)
        levels = analog.comparators()
        if preset and self.comp_in_preset != "model":
            full = (1 << self.cols) - 1
            levels = full if self.comp_in_preset == "ones" else self.random.randint(0, full)
        dut.comp_async_i.value = levels
        self._record(row_select, preset, charge)
        await Timer(1, "ns")

    def _record(self, row_select: int, preset: int, charge: int) -> None:
        dut = self.dut
        valid, done, codes = int(dut.codes_valid_o.value), int(dut.frame_done_o.value), int(dut.codes_o.value)
        if self.checks:
            assert row_select & (row_select - 1) == 0, (
                f"rows {row_select:b} driven together at edge {self.edge}"
            )
            assert row_select or preset, f"preset off and no row driven at edge {self.edge}"
            assert charge & self.charge == 0, f"charge pulse longer than a clock at edge {self.edge}"
            assert row_select == int(dut.row_select_o.value), f"row switched at a falling edge at {self.edge}"
            assert preset == int(dut.preset_o.value), f"preset switched at a falling edge at {self.edge}"
            assert valid or self.last_codes in (None, codes), (
                f"codes changed without valid at edge {self.edge}"
            )
            assert valid or not done, f"frame_done without codes_valid at edge {self.edge}"
        if not self.switches or (row_select, preset) != self.switches[-1][1:]:
            self.switches.append((self.edge, row_select, preset))
        for c in range(self.cols):
            if charge >> c & 1:
                self.charge_clocks[c] += 1
                self.rising_edges[c] += not (self.charge >> c & 1)
        if valid:
            mask = (1 << self.code_bits) - 1
            self.slots.append(
                {
                    "edge": self.edge,
                    "row": int(dut.codes_row_o.value),
                    "codes": [codes >> (c * self.code_bits) & mask for c in range(self.cols)],
                    "frame_done": bool(done),
                }
            )
        self.row_select, self.preset, self.charge, self.last_codes = row_select, preset, charge, codes
