# SPDX-License-Identifier: Apache-2.0
"""cocotbext-spi 0.5.0 on cocotb 2.1, and a pin driver for what no proper client does.

The client was written for cocotb 1: it imports a class that is gone (`cocotb.clock.BaseClock`, of
which it uses only the constructor), says `units`, reads `.value.integer` and knows
`setimmediatevalue`. Below is what it takes to run it.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cocotb.clock
from cocotb.triggers import Timer, ValueChange
from cocotb.utils import get_sim_steps, get_time_from_sim_steps

from dermis.chip.spi_protocol import Result, Transaction


class _BaseClock:
    def __init__(self, signal: Any) -> None:
        self.signal = signal


if not hasattr(cocotb.clock, "BaseClock"):
    cocotb.clock.BaseClock = _BaseClock

from cocotbext.spi import SpiConfig, SpiMaster  # noqa: E402  (it needs the class above)
from cocotbext.spi import spi as client_module  # noqa: E402

client_module.Timer = lambda time, units="step": Timer(time, units)
client_module.Edge = lambda pin: ValueChange(pin.handle)
client_module.cocotb = SimpleNamespace(
    start_soon=cocotb.start_soon,
    utils=SimpleNamespace(
        get_sim_steps=lambda time, units: get_sim_steps(time, units, round_mode="round"),
        get_time_from_sim_steps=lambda steps, units: get_time_from_sim_steps(steps, units),
    ),
)


class _Pin:
    """A handle that answers as cocotb 1 did."""

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self._path = handle._path

    @property
    def value(self) -> Any:
        return SimpleNamespace(integer=int(self.handle.value))

    @value.setter
    def value(self, level: Any) -> None:
        self.handle.value = int(level)

    setimmediatevalue = value.fset


class Client:
    """The SPI client of cocotbext-spi on the pins of dermis_top."""

    def __init__(self, dut: Any, frequency_hz: float) -> None:
        pins = {"sclk": dut.spi_sck_i, "mosi": dut.spi_copi_i, "miso": dut.spi_cipo_o, "cs": dut.spi_cs_ni}
        bus = SimpleNamespace(**{name: _Pin(handle) for name, handle in pins.items()})
        config = SpiConfig(
            sclk_freq=frequency_hz, data_output_idle=0, frame_spacing_ns=int(2e9 / frequency_hz)
        )
        self.master = SpiMaster(bus, config)

    async def run(self, transaction: Transaction[Result], answer_bytes: int) -> Result:
        """One transaction with so many bytes behind the command; the client takes them in one piece."""
        command = next(transaction)
        await self.master.write(command + bytes(answer_bytes), burst=True)
        received = bytes(await self.master.read())
        assert len(received) == len(command) + answer_bytes
        assert not any(received[: len(command)]), f"CIPO during the command: {received.hex(' ')}"
        return replay(transaction, received, len(command))


def replay(transaction: Transaction[Result], received: bytes, at: int) -> Result:
    """Feed a transaction with what came back for a fixed number of bytes."""
    try:
        sent = transaction.send(received[:at])
        while True:
            assert not any(sent), "more than a command was to be sent"
            assert at + len(sent) <= len(received), f"too few bytes asked for: {received.hex(' ')}"
            sent = transaction.send(received[at : (at := at + len(sent))])
    except StopIteration as done:
        return done.value


class Pins:
    """SPI mode 0 or 3, pin by pin, with every way to break it off.

    Parameters
    ----------
    dut : cocotb handle
        dermis_top, or a module with the same SPI ports.
    period_ps : int
        Period of SCK.
    prefix : str
        In front of sck_i, cs_ni, copi_i and cipo_o.
    mode : 0 or 3
        SCK rests low or high; bits are sampled at its rising edge in both.
    """

    def __init__(self, dut: Any, period_ps: int, prefix: str = "spi_", mode: int = 0) -> None:
        self.sck, self.cs = getattr(dut, f"{prefix}sck_i"), getattr(dut, f"{prefix}cs_ni")
        self.copi, self.cipo = getattr(dut, f"{prefix}copi_i"), getattr(dut, f"{prefix}cipo_o")
        self.rest = int(mode == 3)
        self.sck.value, self.cs.value, self.copi.value = self.rest, 1, 0
        self.period_ps = period_ps
        self.sent = self.received = b""

    @property
    def period_ps(self) -> int:
        """Period of SCK; may be changed at any time."""
        return 2 * self._half_ps

    @period_ps.setter
    def period_ps(self, period_ps: int) -> None:
        self._half_ps = period_ps // 2
        self.half = Timer(self._half_ps, "ps")

    async def select(self) -> None:
        """CS low, and half a period until the first edge may come."""
        self.cs.value = 0
        self.sent = self.received = b""
        await self.half

    async def deselect(self, high_ps: int | None = None) -> None:
        """Half a period, CS high, and a period (or `high_ps`) until it may fall again."""
        await self.half
        self.cs.value = 1
        await Timer(high_ps or 2 * self._half_ps, "ps")

    async def bits(self, value: int, count: int = 8) -> int:
        """The highest `count` bits of a byte, one way and the other."""
        back = 0
        for n in range(7, 7 - count, -1):
            self.sck.value = 0
            self.copi.value = value >> n & 1
            await self.half
            back |= int(self.cipo.value) << n
            self.sck.value = 1
            await self.half
            self.sck.value = self.rest
        return back

    async def exchange(self, data: bytes) -> bytes:
        """Whole bytes, one way and the other."""
        back = bytes([await self.bits(byte) for byte in data])
        self.sent += data
        self.received += back
        return back

    async def answer(self, transaction: Transaction[Result]) -> Result:
        """A transaction while CS is low; it stays low."""
        try:
            send = next(transaction)
            while True:
                send = transaction.send(await self.exchange(send))
        except StopIteration as done:
            return done.value

    async def run(self, transaction: Transaction[Result]) -> Result:
        """A whole transaction, with CS around it."""
        await self.select()
        try:
            return await self.answer(transaction)
        finally:
            await self.deselect()
