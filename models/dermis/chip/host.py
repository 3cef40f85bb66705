# SPDX-License-Identifier: Apache-2.0
"""Host of a chip on an SPI port: registers and frames, with repeats and time limits (docs/fpga.md).

``Host(Spidev("/dev/spidev0.0", 5_000_000)).frame()`` reads a frame on Linux.
"""

from __future__ import annotations

import ctypes
import operator
import os
import struct
import time
from collections.abc import Callable, Mapping

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi
from dermis.errors import InputError

# The chip did nothing; a corrupted opcode or address looks like a command or register that it does not have.
NOT_DONE = (spi.BadCommandCrc, spi.Busy, spi.UnknownCommand, spi.NoSuchRegister)
CORRUPTED = (spi.BadToken, spi.BadAnswerCrc, spi.FrameError, *NOT_DONE)


class TimedOut(spi.SpiError):
    """STATUS did not show a bit within the time limit."""


class OtherChip(spi.SpiError):
    """ID is not that of this chip."""


class WasReset(spi.SpiError):
    """A register is not as it was set up."""


class Host:
    """A chip behind ``transfer(data, hold)``, which exchanges bytes with chip select low and leaves it
    low if `hold`. `limit` is the most bytes of one transfer, `tries` of a request the line corrupted.
    """

    def __init__(self, transfer: Callable[[bytes, bool], bytes], limit: int = 4096, tries: int = 3) -> None:
        if limit < 1 or tries < 1:
            raise InputError("Host", "limit, tries", (limit, tries), "numbers from 1")
        self.transfer, self.limit, self.tries = transfer, limit, tries

    def _exchange(self, data: bytes) -> bytes:
        parts = (data[n : n + self.limit] for n in range(0, len(data), self.limit))
        return b"".join(bytes(self.transfer(part, True)) for part in parts)  # py-spidev returns a list

    def _run(self, request: Callable[[], spi.Transaction], repeat: tuple[type[spi.SpiError], ...]) -> object:
        for left in reversed(range(self.tries)):
            try:
                return spi.run(request(), self._exchange)
            except repeat:
                if not left:
                    raise
            finally:
                self.transfer(spi.FILL, False)  # ends the transaction; the chip ignores this byte

    def read(self, address: int) -> int:
        """Return a register; SpiError."""
        return self._run(lambda: spi.read_register(address), CORRUPTED)

    def write(self, address: int, value: int) -> None:
        """Write a register; SpiError. Not repeated after a bad token: a shot would be taken twice."""
        self._run(lambda: spi.write_register(address, value), NOT_DONE)

    def set_up(self, **registers: int) -> None:
        """Check the chip's ID, then write registers by name; SpiError, InputError for another name or value."""
        _refuse("set_up", registers)
        if (found := self.read(rm.ID)) != rm.REGISTERS["ID"].reset:
            raise OtherChip(f"ID is 0x{found:04X}")
        for name, value in registers.items():
            self.write(rm.REGISTERS[name].address, value)

    def check(self, **registers: int) -> None:
        """Read registers by name, as given to `set_up`; WasReset for another value, or errors as there.

        A chip that is reset in operation goes on with its reset values; only the frame number begins again at 1.
        """
        _refuse("check", registers)
        for name, value in registers.items():
            register = rm.REGISTERS[name]
            if (found := self.read(register.address)) != operator.index(value) & ~register.pulse:
                raise WasReset(f"{name} is {found}, not {value}: set the chip up again")

    def wait(self, mask: int, timeout_s: float) -> None:
        """Read STATUS until a bit of `mask` is set; TimedOut after `timeout_s` seconds."""
        end = time.monotonic() + timeout_s
        while not self.read(rm.STATUS) & mask:
            if time.monotonic() > end:
                raise TimedOut(f"STATUS shows no bit of 0x{mask:X} within {timeout_s:g} s")

    def frame(self, timeout_s: float = 1.0) -> spi.Frame:
        """Wait for a new frame and return it, read again after a bad CRC; SpiError."""
        before = b""

        def read() -> spi.Transaction[spi.Frame]:
            nonlocal before
            last, before = before, (yield from spi.read_frame_bytes())
            return spi.parse_frame(before, before == last)

        self.wait(rm.STATUS_FRAME_READY_MASK, timeout_s)
        return self._run(read, CORRUPTED)


def _refuse(call: str, registers: Mapping[str, int]) -> None:
    if unknown := registers.keys() - rm.REGISTERS.keys():
        raise InputError(call, "register", min(unknown), ", ".join(rm.REGISTERS))
    for name, value in registers.items():
        register = rm.REGISTERS[name]
        bits = register.pulse | (register.writable if call == "set_up" else register.readable)
        if not hasattr(value, "__index__") or operator.index(value) & ~bits:
            raise InputError(call, name, value, f"a whole number in the bits 0x{bits:04X}")


class Spidev:
    """`transfer` of a Host on Linux, at `hz` of SCK. py-spidev has no `cs_change`, which holds chip select."""

    MODE, MESSAGE = 0x40016B01, 0x40206B00  # SPI_IOC_WR_MODE, SPI_IOC_MESSAGE(1)

    def __init__(self, path: str, hz: int) -> None:
        import fcntl  # Unix only

        self.hz, self.ioctl = hz, fcntl.ioctl
        try:
            self.file = os.open(path, os.O_RDWR)
            self.ioctl(self.file, self.MODE, b"\0")
        except OSError as error:
            raise InputError(path, "port", error.strerror, "an SPI port of this machine") from None

    def __call__(self, data: bytes, hold: bool) -> bytes:
        send, back = ctypes.create_string_buffer(data, len(data)), ctypes.create_string_buffer(len(data))
        # struct spi_ioc_transfer: places, length, speed, delay, bits of a word, cs_change, zeros.
        places = (ctypes.addressof(send), ctypes.addressof(back), len(data))
        self.ioctl(self.file, self.MESSAGE, struct.pack("=QQIIHBB4x", *places, self.hz, 0, 8, hold))
        return back.raw
