# SPDX-License-Identifier: Apache-2.0
"""cocotb bench on the pins of dermis_top alone, so that the Verilog and a netlist of it run the same."""

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import report, scenario
from spi_client import Pins

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol

HALF_NS = 100
# SPI edges fall 7 ns beside multiples of 20 ns, clock edges upon one: flop delays change no crossing.
SPI_PERIOD_PS = 80_000
SPI_OFFSET_NS = 7
OUTPUTS = "row_select preset charge range test_current frame_start spi_cipo spi_cipo_oe frame_ready".split()


class Bench:
    """Clock with random comparators, an SPI controller, and a look at every output pin before each rising edge."""

    def __init__(self, dut: Any, seed: int) -> None:
        self.dut = dut
        self.random = random.Random(seed)
        self.cols = len(dut.comp_async_i)
        self.unknown = 0
        self.first_unknown = ""
        self.pins: list[int] = []
        self.clocks = 0

    async def power_up(self) -> None:
        dut = self.dut
        for pin in ("clk_i", "enable_i", "comp_async_i", "row_sense_i"):
            getattr(dut, pin).value = 0
        dut.rst_ni.value = 0
        await Timer(HALF_NS, "ns")
        self._look()
        cocotb.start_soon(self._clock())
        await Timer(10 * HALF_NS, "ns")
        dut.rst_ni.value = 1
        await Timer(10 * HALF_NS + SPI_OFFSET_NS, "ns")

    async def _clock(self) -> None:
        dut = self.dut
        while True:
            dut.clk_i.value = 1
            await Timer(HALF_NS, "ns")
            dut.clk_i.value = 0
            await Timer(HALF_NS - 20, "ns")
            self._look()
            dut.comp_async_i.value = self.random.getrandbits(self.cols)
            row = dut.row_select_o.value
            dut.row_sense_i.value = int(row) if row.is_resolvable else 0
            await Timer(20, "ns")
            self.clocks += 1

    def known(self, name: str) -> int:
        """Return the level of a pin; count it, and return 0, if it is unknown."""
        value = getattr(self.dut, name).value
        if value.is_resolvable:
            return int(value)
        self.unknown += 1
        self.first_unknown = self.first_unknown or f"{name} = {value} at clock {self.clocks}"
        return 0

    def _look(self) -> None:
        word = 0
        for name in OUTPUTS:
            word = word << len(getattr(self.dut, f"{name}_o")) | self.known(f"{name}_o")
        self.pins.append(word)

    async def until_ready(self, limit: int) -> None:
        for _ in range(limit):
            if self.dut.frame_ready_o.value.is_resolvable and int(self.dut.frame_ready_o.value):
                return
            await Timer(2 * HALF_NS, "ns")
        raise AssertionError(f"no frame after {limit} clocks")


class _Cipo:
    """CIPO for the SPI client, which takes integers."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    @property
    def value(self) -> int:
        return self.bench.known("spi_cipo_o")


@cocotb.test()
async def reads_frames(dut: Any) -> None:
    """Set short slots, scan, read frames, take a self-test frame; hand back every byte and every pin."""
    s = scenario()
    bench = Bench(dut, s["seed"])
    host = Pins(dut, SPI_PERIOD_PS)
    host.cipo = _Cipo(bench)
    await bench.power_up()
    frames: list[str] = []

    # Before any frame was stored the memory is unknown: nothing of it may show.
    frames.append((await host.frame_bytes()).hex())
    registers = [await host.read(a) for a in (rm.ID, rm.GEOMETRY, rm.FORMAT)]
    await host.write(rm.SETTLE, s["settle"])
    await host.write(rm.GATE, s["gate"])
    dut.enable_i.value = 1
    for frame in range(s["frames"]):
        if frame == 1:
            await host.write(rm.CONTROL, 1 | 1 << 3)  # with a dark slot
        if frame == 2:
            await host.write(rm.CONTROL, 1 | 1 << 2)  # and a self-test frame
        await bench.until_ready(s["limit"])
        data = await host.frame_bytes()
        spi_protocol.parse_frame(data)
        frames.append(data.hex())
    registers += [await host.read(a) for a in (rm.STATUS, rm.FRAME_NUMBER, rm.LOST)]
    seen = {"unknown": bench.unknown, "first_unknown": bench.first_unknown, "clocks": bench.clocks}
    report(seen | {"frames": frames, "registers": registers, "pins": [f"{word:x}" for word in bench.pins]})
