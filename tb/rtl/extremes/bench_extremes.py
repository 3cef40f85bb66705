# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_top at the ends of its settings and with each line broken; claims: test_extremes.py."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import RisingEdge, Timer
from cocotb.utils import get_sim_time
from rtl_bench import report, scenario
from spi_client import Pins
from top_bench import CLOCK_PS, Chip

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi

TEST_DONE = rm.STATUS_TEST_DONE_MASK


class Faulty(Chip):
    """Every comparator high while a row is driven, but for columns that are stuck."""

    stuck_high = stuck_low = 0

    def _drive(self) -> None:
        driven, test_current = self._level(self.dut.row_select_o), self._level(self.dut.test_current_o)
        self.dut.row_sense_i.value = driven & ~self.broken_rows
        level = (1 << self.cols) - 1 if driven else test_current
        self.dut.comp_async_i.value = (level | self.stuck_high) & ~self.stuck_low


async def started(dut: Any) -> tuple[Faulty, Pins]:
    """A chip that waits to be told, and its host."""
    chip = Faulty(dut, scenario()["parameters"])
    host = Pins(dut, chip.clock_ps)
    await chip.reset()
    await host.run(spi.write_register(rm.CONTROL, 0))
    await chip.clocks(2 * chip.rows * 70)
    return chip, host


async def shot(chip: Faulty, host: Pins, control: int) -> spi.Frame:
    """One frame, read when it is there."""
    if int(chip.dut.frame_ready_o.value):
        await host.run(spi.read_frame())
    await host.run(spi.write_register(rm.CONTROL, control))
    if not int(chip.dut.frame_ready_o.value):
        await RisingEdge(chip.dut.frame_ready_o)
    return await host.run(spi.read_frame())


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def lengths(dut: Any) -> None:
    """The longest and the shortest slots, each row by itself, and enable falling in the middle of a slot."""
    chip, host = await started(dut)
    longest = scenario()["longest"]
    every = (1 << chip.rows) - 1
    for settle, gate, mask in ((longest, longest, 1 << 1), (0, 0, every)):
        await host.run(spi.write_register(rm.SETTLE, settle))
        await host.run(spi.write_register(rm.GATE, gate))
        await host.run(spi.write_register(rm.ROW_MASK, mask))
        frame = await shot(chip, host, rm.CONTROL_SHOT_MASK)
        clocks = max(gate, 1)
        assert frame.gate_clocks == clocks
        count = (clocks + 1) // 2
        assert (frame.codes == min(count, 255)).all()
        assert (frame.overflow == (count > 255)).all()
    await host.run(spi.write_register(rm.GATE, 60))
    for row in range(chip.rows):
        await host.run(spi.write_register(rm.ROW_MASK, 1 << row))
        assert tuple((await shot(chip, host, rm.CONTROL_SHOT_MASK)).slots) == (row,)
    await host.run(spi.write_register(rm.CONTROL, rm.CONTROL_CONTINUOUS_MASK))
    await RisingEdge(dut.frame_start_o)
    await chip.clocks(20)
    assert int(dut.row_select_o.value)
    dut.enable_i.value = 0
    await chip.clocks(4)
    assert (int(dut.row_select_o.value), int(dut.preset_o.value)) == (0, 1)
    report("done")


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def lines(dut: Any) -> None:
    """Each row and column broken by itself is found by its own bit, and forgotten by the next self-test."""
    chip, host = await started(dut)
    await host.run(spi.write_register(rm.FULL_MIN, 29))

    async def faults() -> tuple[int, ...]:
        assert (await shot(chip, host, rm.CONTROL_TEST_MASK)).test
        assert await host.run(spi.read_register(rm.STATUS)) & TEST_DONE
        names = (rm.ROW_FAULT, rm.INJECT_FAULT, rm.DARK_FAULT, rm.FULL_FAULT)
        return tuple([await host.run(spi.read_register(name)) for name in names])

    assert await faults() == (0, 0, 0, 0)
    for row in range(chip.rows):
        chip.broken_rows = 1 << row
        assert await faults() == (1 << row, 0, 0, 0)
    chip.broken_rows = 0
    for column in range(chip.cols):
        chip.stuck_high = 1 << column
        assert await faults() == (0, 0, 1 << column, 0)
        chip.stuck_high, chip.stuck_low = 0, 1 << column
        assert await faults() == (0, 0, 0, 1 << column)
        chip.stuck_low = 0
    assert await faults() == (0, 0, 0, 0)
    report("done")


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def rates(dut: Any) -> None:
    """TEST_COUNT is the rate times the gate, to a pulse and the clocks of the way in, and so is every column."""
    chip, host = await started(dut)
    gate = 1000
    await host.run(spi.write_register(rm.GATE, gate))
    counts = []
    for rate in (0x7FFF, 0x0001, 0x4001, 0x2AAB, 0x1555, 0x7FFE):
        await host.run(spi.write_register(rm.TEST_RATE, rate))
        frame = await shot(chip, host, rm.CONTROL_TEST_MASK)
        count = await host.run(spi.read_register(rm.TEST_COUNT))
        # A pulse either way, and half of one for the clocks on the way in.
        assert abs(count - rate * gate / 65536) <= 1.5, (rate, count)
        assert (frame.slot(spi.SLOT_INJECT) == min(count, 255)).all()
        assert await host.run(spi.read_register(rm.INJECT_FAULT)) == 0
        counts.append(count)
    report(counts)


async def reset(dut: Any) -> None:
    """Power up, with nothing in Python that follows the rows: millions of clocks go by."""
    dut.rst_ni.value = 0
    await Timer(3 * CLOCK_PS, "ps")
    dut.rst_ni.value = 1
    await Timer(10 * CLOCK_PS, "ps")


@cocotb.test(timeout_time=10, timeout_unit="sec")
async def counters(dut: Any) -> None:
    """Frames beside a host that holds one, then commands that there are not."""
    frames = commands = scenario()["many"]
    Clock(dut.clk_i, CLOCK_PS, "ps").start()
    host = Pins(dut, CLOCK_PS)
    dut.enable_i.value = dut.comp_async_i.value = dut.row_sense_i.value = 0
    await reset(dut)
    for address, value in ((rm.SETTLE, 0), (rm.GATE, 1), (rm.ROW_MASK, 1)):
        await host.run(spi.write_register(address, value))
    dut.enable_i.value = 1
    starts = []
    for _ in range(4):
        await RisingEdge(dut.frame_start_o)
        starts.append(get_sim_time("ps"))
    slot_ps = starts[-1] - starts[-2]
    await host.select()
    await host.exchange(next(spi.read_frame_bytes()) + bytes(4))
    await Timer(frames * slot_ps, "ps")
    await host.deselect()
    dut.enable_i.value = 0
    seen = {"number": await host.run(spi.read_register(rm.FRAME_NUMBER))}
    seen["lost"] = await host.run(spi.read_register(rm.LOST))
    await reset(dut)
    seen["lost_after_reset"] = await host.run(spi.read_register(rm.LOST))
    # 24 clocks a command, 20 of them with CS low; its edges lie between those of SCK.
    dut.spi_copi_i.value = 1
    sck = Clock(dut.spi_sck_i, CLOCK_PS, "ps")
    sck.start()
    await Timer(3 * CLOCK_PS // 4, "ps")
    cs = Clock(dut.spi_cs_ni, 24 * CLOCK_PS, "ps", period_high=4 * CLOCK_PS)
    cs.start()
    await Timer(24 * CLOCK_PS * commands, "ps")
    cs.stop()
    sck.stop()
    await host.deselect()
    seen["errors"] = await host.run(spi.read_register(rm.SPI_ERRORS))
    await reset(dut)
    seen["errors_after_reset"] = await host.run(spi.read_register(rm.SPI_ERRORS))
    report(seen)
