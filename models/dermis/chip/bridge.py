# SPDX-License-Identifier: Apache-2.0
"""Runs dermis_top with an analog half: reset, scan and host around the clock loop.

Time is counted in clock edges on the digital side and in seconds on the analog side; edge n of a
frame is at n / f_clk exactly, however the HDL simulator rounds its own period. Edge 0 of a
frame is the one at which the first row is driven. Codes come as any user of the chip gets them: a
host reads each frame through the SPI pins while the next one is scanned, on a clock of its own.
"""

from __future__ import annotations

from asyncio import CancelledError
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, RisingEdge, SimTimeoutError, Timer, with_timeout
from numpy.typing import NDArray

from dermis.chip import read_out, register_map, spi_protocol
from dermis.errors import SimulatorError
from dermis.lockstep.clock_loop import AnalogHalf, ClockLoop, known
from dermis.timing import Timing

START_CLOCKS = 64
"""More than from enable to a frame's first edge, and from there to its first row without the break."""
SPI_CLOCKS = 1.37
"""Clocks of the chip in one of the host: no ratio of small numbers, so all phases occur."""
WAIT_BYTES = 64
"""Longest answer without a token; the chip needs two or three clocks, and no clock is so slow."""
SPI_SHARE = 0.5
"""Share of a frame's time in which the host reads the frame before; it sets the clock of SPI."""


@dataclass
class Trace:
    """Signals across the bridge, one entry a clock: integers whose bit c is column c (row r for `row_select`).

    `begins` has the number of entries before the first instant of each frame's analog half.
    """

    comparator: list[int] = field(default_factory=list)
    charge: list[int] = field(default_factory=list)
    row_select: list[int] = field(default_factory=list)
    preset: list[int] = field(default_factory=list)
    begins: list[int] = field(default_factory=list)


HalfFactory = Callable[[int, "list[float]"], AnalogHalf]
"""(frame, levels of rows, preset and charge switches at its first instant) -> analog half."""


def analog_s(timing: Timing, rows: int | None = None) -> float:
    """Return the seconds of a scan of some or all rows: from its first driven row to the next frame's first edge."""
    slots = timing.rows if rows is None else rows
    return (slots * timing.slot_clocks - timing.break_clocks) / timing.f_clk_hz


def _settings(timing: Timing, cols: int, rows: range, ranges: Sequence[int]) -> list[tuple[int, int]]:
    """Return the registers, address and value, that differ from reset for these rows and ranges."""
    named = register_map.REGISTERS
    values = {"ROW_MASK": sum(1 << row for row in rows)} if len(rows) < timing.rows else {}
    if len(set(ranges)) > 1:
        values["RANGE_COLUMN"] = sum(n << 2 * c for c, n in enumerate(ranges))
        values["CONTROL"] = named["CONTROL"].reset | register_map.CONTROL_RANGE_PER_COLUMN_MASK
    elif ranges and ranges[0] != named["RANGE"].reset:
        values["RANGE"] = ranges[0]
    settings = []
    for name, value in values.items():
        words = named[name].words(timing.rows, cols, timing.code_max.bit_length())
        settings += [(named[name].address + n, value >> 16 * n & 0xFFFF) for n in range(len(words))]
    return settings


class Bridge:
    """Runs frames of dermis_top against analog halves, inside a cocotb test.

    Parameters
    ----------
    dut : cocotb handle of dermis_top
    sync_latch : the chip was built with the flip-flop + latch synchronizer
    rows : adjacent rows that the chip scans, written to its ROW_MASK before it is enabled; all by default
    ranges : range of each column, written to RANGE or RANGE_COLUMN before it is enabled; as reset by default
    trace : keep what crossed, clock by clock
    samples : number of samples of the analog half that are kept each clock, in `samples`
    progress : called after each slot
    """

    def __init__(
        self,
        dut: Any,
        timing: Timing,
        cols: int,
        *,
        rows: range | None = None,
        ranges: Sequence[int] = (),
        sync_latch: bool = False,
        trace: bool = False,
        samples: int = 0,
        progress: Callable[[], object] = lambda: None,
    ) -> None:
        self._dut, self._timing, self._cols, self._sync_latch = dut, timing, cols, sync_latch
        self._rows = range(timing.rows) if rows is None else rows
        self._settings = _settings(timing, cols, self._rows, ranges)
        self._progress, self._samples = progress, samples
        self.samples: list[NDArray[np.float64]] = []
        self.trace = Trace() if trace else None
        self.charge_delay_clocks = 0.5 if sync_latch else 0.0  # the latch opens with the falling edge
        self._half_ps = max(1, round(0.5e12 / timing.f_clk_hz))
        self._host = _Host(dut, timing, cols, self._rows)

    async def run(self, frames: int, make_half: HalfFactory) -> NDArray[np.uint16]:
        """Reset the chip and read `frames` frames; return codes [frames, scanned rows, cols].

        SimulatorError if the analog half stopped, the Verilog drives an X or loses its row scan, or the host read
        anything but every frame once and whole.
        """
        dut = self._dut
        # made once: a trigger may be awaited again and again
        self._edge, self._settled = FallingEdge(dut.clk_i), Timer(1, unit="ps")
        pins = (dut.rst_ni, dut.enable_i, dut.comp_async_i, dut.row_sense_i, dut.spi_sck_i, dut.spi_copi_i)
        for pin in pins:
            pin.value = 0
        dut.spi_cs_ni.value = 1
        loop = ClockLoop()
        self._per_ps = round(1e-12 / loop.unit_s)
        loop.clock(dut.clk_i, self._half_ps * self._per_ps)
        # Sources of a deck are rows, preset, charge switches.
        loop.net(dut.row_select_o, copy=dut.row_sense_i)
        loop.net(dut.preset_o)
        loop.net(dut.charge_o)
        loop.output(dut.comp_async_i, (0.0,) * self._cols)
        for _ in range(3):
            await FallingEdge(dut.clk_i)
        dut.rst_ni.value = 1
        await FallingEdge(dut.clk_i)
        for address, value in self._settings:
            await self._host.write(address, value)
            await FallingEdge(dut.clk_i)
        dut.enable_i.value = 1
        host = cocotb.start_soon(self._host.read(frames))
        try:
            for _ in range(START_CLOCKS):
                await self._next_clock()
                if known(dut.frame_start_o):
                    break
            for frame in range(frames):
                await self._first_row(frame)
                half = make_half(frame, loop.levels())
                try:
                    await self._frame(frame, loop, half)
                finally:
                    loop.stop()
                    half.close()
                if frame:
                    self._host.require(frame)
            # The analog side rests while the last frame is read.
            with suppress(SimTimeoutError):  # `require` says what is missing
                await with_timeout(host, round(4 * self._host.frame_ps), "ps")
            self._host.require(frames)
            return np.array(self._host.frames)
        finally:  # another bridge may start from reset after an abort of the analog half
            host.cancel()
            loop.close()

    async def _first_row(self, frame: int) -> None:
        """Wait until the first row is driven."""
        for _ in range(START_CLOCKS + self._timing.break_clocks):
            if (pins := self._pins())[0]:
                break
            await self._next_clock()
            self._record()
        first = self._rows[0]
        if pins[:2] != (1 << first, 1):
            raise SimulatorError(f"frame {frame} does not begin with row {first} driven and the preset on")
        self._dut.row_sense_i.value = 1 << first

    def _pins(self) -> tuple[int, int, int]:
        dut = self._dut
        return known(dut.row_select_o), known(dut.preset_o), known(dut.charge_o)

    def _record(self) -> None:
        """Keep a clock between two frames, which no analog half sees."""
        if self.trace is not None and self.trace.begins:
            self._keep([[bits] for bits in (*self._pins(), known(self._dut.comp_async_i))])

    def _keep(self, nets: list[list[int]]) -> None:
        for name, more in zip(("row_select", "preset", "charge", "comparator"), nets, strict=True):
            getattr(self.trace, name).extend(more)

    async def _next_clock(self) -> None:
        await self._edge
        if self._sync_latch:
            await self._settled  # the latch opens with the falling edge: look once it has settled

    def ranges(self) -> list[int]:
        """Return the range that the chip's pins select for each column."""
        word = known(self._dut.range_o)
        return [word >> 2 * c & 3 for c in range(self._cols)]

    async def _frame(self, frame: int, loop: ClockLoop, half: AnalogHalf) -> None:
        """Run one frame, from the edge of its first row (already passed) to that of the next."""
        timing, trace = self._timing, self.trace is not None
        slots = len(self._rows)
        clocks = slots * timing.slot_clocks - timing.break_clocks
        if trace:
            self.trace.begins.append(len(self.trace.row_select))
        # Nets move at rising edges, and with the latch at falling ones; this is a falling edge.
        settle = (self._half_ps + int(self._sync_latch)) * self._per_ps
        times = {"base": 2 * self._half_ps * self._per_ps, "base_s": 1.0 / timing.f_clk_hz, "settle": settle}
        kept = max(self._samples, trace * self._cols)
        loop.arm(half, **times, before=settle, end=clocks, samples=kept, trace=trace)
        await Timer(2, unit="ps")  # from here on after the loop's look at a clock
        for slot in range(slots):
            wait = timing.slot_clocks - (0 if slot else timing.break_clocks)
            await Timer(2 * self._half_ps * wait, unit="ps")
            loop.require()
            self._progress()
        samples = loop.samples()[1]
        if trace:
            comparators = np.packbits(samples[1:, : self._cols] > 0.0, axis=1, bitorder="little")
            self._keep([*loop.trace(), [int.from_bytes(row.tobytes(), "little") for row in comparators]])
        if self._samples:
            self.samples.append(samples[:, : self._samples])
        if self._pins()[0] or not known(self._dut.frame_start_o):
            raise SimulatorError(f"frame {frame} does not end {clocks} clocks after its first row")


class _Host:
    """The host at the SPI pins: reads each frame when the chip reports it ready, and checks it."""

    def __init__(self, dut: Any, timing: Timing, cols: int, rows: range) -> None:
        self._dut, self._timing, self._cols, self._rows = dut, timing, cols, rows
        self.frames: list[NDArray[np.uint16]] = []
        self._failure: SimulatorError | None = None
        self.frame_ps = 1e12 * timing.frame_s * len(rows) / timing.rows
        bits = 8 * (16 + spi_protocol.frame_bytes(len(rows), cols, timing.code_max.bit_length()))
        period_ps = min(SPI_CLOCKS * 1e12 / timing.f_clk_hz, SPI_SHARE * self.frame_ps / bits)
        self._period_ps = 2 * max(1, round(0.5 * period_ps))

    def require(self, frames: int) -> None:
        """Raise the first error, or an error if fewer frames than expected were read."""
        if self._failure is not None:
            raise self._failure
        if (done := len(self.frames)) < frames:
            raise SimulatorError(f"read-out {done + 1} through SPI: the chip never reports a frame as ready")

    async def read(self, frames: int) -> None:
        """Read `frames` frames; stop at the first one that is not right."""
        dut = self._dut
        try:
            for frame in range(frames):
                if not known(dut.frame_ready_o):
                    await RisingEdge(dut.frame_ready_o)
                data = await self._transact(spi_protocol.read_frame_bytes(WAIT_BYTES))
                codes = read_out.codes_of_frame(data, frame, self._timing, self._cols, self._rows)
                self.frames.append(codes)
        except (SimulatorError, spi_protocol.SpiError) as error:
            self._failure = SimulatorError(f"read-out {frame + 1} of {frames} through SPI: {error}")

    async def write(self, address: int, value: int) -> None:
        """Write a register."""
        try:
            await self._transact(spi_protocol.write_register(address, value, WAIT_BYTES))
        except spi_protocol.SpiError as error:
            raise SimulatorError(f"write to register 0x{address:02X} through SPI: {error}") from None

    async def _transact(self, transaction: spi_protocol.Transaction[Any]) -> Any:
        """Run a transaction with CS around it; return its result."""
        dut, ended = self._dut, False
        dut.spi_cs_ni.value = 0
        sck = Clock(dut.spi_sck_i, self._period_ps, unit="ps", impl="gpi")
        sck.start(start_high=False)
        try:
            send = next(transaction)
            while True:
                send = transaction.send(await self._exchange(send))
        except StopIteration as done:
            return done.value
        except CancelledError:
            ended = True
            raise
        finally:
            if not ended and known(dut.spi_sck_i):
                await FallingEdge(dut.spi_sck_i)
            sck.stop()
            dut.spi_cs_ni.value = 1
            if not ended:  # CS stays high longer than the chip takes to see it
                await Timer(round(4e12 / self._timing.f_clk_hz), unit="ps")

    async def _exchange(self, send: bytes) -> bytes:
        """Send bytes and return those received; COPI moves once if all their bits are alike, as while listening."""
        dut, cipo = self._dut, self._dut.spi_cipo_o
        rise, fall = RisingEdge(dut.spi_sck_i), FallingEdge(dut.spi_sck_i)
        word, got, bits = int.from_bytes(send, "big"), 0, 8 * len(send)
        moves = word not in (0, (1 << bits) - 1)
        dut.spi_copi_i.value = word >> (bits - 1) & 1
        for bit in range(bits - 1, -1, -1):
            if moves:
                dut.spi_copi_i.value = word >> bit & 1
            await rise
            got = got << 1 | known(cipo)
            if moves:
                await fall
        return got.to_bytes(len(send), "big")
