# SPDX-License-Identifier: Apache-2.0
"""A driver of the SPI pins, with every way to break a transaction off."""

from typing import Any

from cocotb.triggers import Timer

from dermis.chip import spi_protocol as spi
from dermis.chip.spi_protocol import Result, Transaction


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

    async def read(self, address: int) -> int:
        return await self.run(spi.read_register(address))

    async def write(self, address: int, value: int) -> int:
        """Write a register; return the number of wait bytes."""
        return await self.run(spi.write_register(address, value))

    async def frame_bytes(self) -> bytes:
        return await self.run(spi.read_frame_bytes())

    async def frame(self) -> spi.Frame:
        return await self.run(spi.read_frame())
