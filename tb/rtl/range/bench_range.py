# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_top with columns whose mirrors divide by what range_o says; test_range.py has the claims."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.triggers import RisingEdge, Timer
from rtl_bench import report, scenario
from spi_client import Client
from top_bench import Chip

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi
from tb.reference.chip import AnalogColumns, code

GATE = 510
PICK = 0b11


class RangedChip(Chip):
    """A chip with taxels of `r_ohm` [rows][cols]: x = unit_ohm / (k R), where range_o chooses k for each column."""

    def __init__(self, dut: Any, s: dict[str, Any]) -> None:
        self.duty = [
            [[(s["unit_ohm"], k * r_ohm) for r_ohm in row] for row in s["r_ohm"]] for k in s["k_options"]
        ]
        self.ranges: list[list[int]] = [[]]
        """Of each frame, by its number: the range that each column must have in it."""
        self.late: list[str] = []
        super().__init__(dut, s["parameters"], x=self.duty[0])

    async def _charge_balance(self) -> None:
        dut, before = self.dut, Timer(1, "ns")
        half, rest = Timer(self.clock_ps // 2, "ps"), Timer(self.clock_ps // 2 - 1000, "ps")
        # A row for each row and range, so that all steps are of one unit of charge.
        analog = AnalogColumns([row for ranged in self.duty for row in ranged])
        steps, ranges = analog.half_step, -1
        dut.clk_i.value = 0
        await half
        while True:
            dut.clk_i.value = 1
            await half
            now = self._level(dut.range_o)
            if now != ranges:
                if ranges > 0 and now and not self._level(dut.frame_start_o):
                    self.late.append(f"range_o {ranges:x} -> {now:x} in frame {self.frame}")
                ranges = now
                analog.half_step = [
                    [steps[(now >> 2 * c & PICK) * self.rows + r][c] for c in range(self.cols)]
                    for r in range(self.rows)
                ]
            rows, preset = self._level(dut.row_select_o), self._level(dut.preset_o)
            analog.half_clock(rows, preset, self._level(dut.charge_o))
            dut.clk_i.value = 0
            await rest
            analog.half_clock(rows, preset, self._level(dut.charge_o))
            dut.comp_async_i.value = analog.comparators()
            await before

    def _counts(self, number: int, row: int, gate: int) -> list[int]:
        ranged = zip(self.ranges[number], range(self.cols), strict=True)
        return [code(self.duty[n][row][c], gate, self.code_bits + 1) for n, c in ranged]


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def codes(dut: Any) -> None:
    """A setting is written in the middle of each frame: that frame keeps its codes, the next one has the new ones."""
    s = scenario()
    chip = RangedChip(dut, s)
    host = Client(dut, 5e6)
    length = spi.frame_bytes(chip.rows, chip.cols, chip.code_bits)

    async def write(address: int, value: int) -> None:
        await host.run(spi.write_register(address, value), 4)

    await chip.reset(enable=False)
    await write(rm.GATE, GATE)
    dut.enable_i.value = 1
    read = []
    for writes, then in [*s["steps"], ([], None), ([], None)]:
        # What holds in the frame that begins now.
        chip.ranges.append(chip.ranges[-1] if then is None else then)
        begun = chip.frame + 1
        while chip.frame < begun:
            await RisingEdge(dut.frame_start_o)
            await Timer(1, "ns")
        if begun > 1:
            while not int(dut.frame_ready_o.value):
                await chip.clocks(4)
            data = await host.run(spi.read_frame_bytes(), 2 + 3 + length)
            wanted = chip.expected(begun - 1, GATE)
            got = spi.parse_frame(data)
            assert data == spi.pack_frame(wanted), (
                f"frame {begun - 1}: {got.codes.tolist()} in place of {wanted.codes.tolist()}"
            )
            read.append(got.codes.tolist())
        for address, value in writes:
            await write(address, value)
        assert chip.frame == begun, "the writes did not end within a frame"
    assert not chip.late, chip.late
    report(read)
