# SPDX-License-Identifier: Apache-2.0
"""What the chip must answer to any stream of bits on its SPI, after docs/spi.md and the register map, bit by bit.

Written from the documents, not from the Verilog. It holds where SCK is slower than the clock: then every answer has one
wait byte, and no request is still crossing when the next command has come.
"""

from __future__ import annotations

from collections import deque

from dermis.chip.register_map import REGISTERS
from dermis.chip.spi_protocol import (
    OP_FRAME,
    OP_READ,
    OP_WRITE,
    TOKEN_ACCESS,
    TOKEN_CRC,
    TOKEN_DATA,
    TOKEN_DONE,
    TOKEN_OPCODE,
    WAIT,
    crc8,
)

ROWS, COLS, CODE_BITS = 16, 16, 8
FRAME = bytes(n ^ 0xC3 for n in range(5))
ALL = 0xFFFF
# What stands behind the read-only registers in register_chip.v.
AT_REST = {
    "STATUS": 0b0101,
    "FRAME_NUMBER": 0x1234,
    "LOST": 0x0567,
    "TEST_COUNT": 0x0089,
    "ROW_FAULT": ALL,
    "DARK_FAULT": ALL,
}


class Chip:
    """The chip as its host sees it: `cs`, `bit` and `reset` are its pins, `errors` and `pulses` what it has counted."""

    def __init__(self) -> None:
        self.cs_low = False
        self.reset()

    def reset(self) -> None:
        """Power up; what is left of a transaction that a reset fell into is no command."""
        self.errors = self.pulses = 0
        self.values: dict[int, int] = {}
        self._masks: dict[int, tuple[str, int]] = {}
        for name, register in REGISTERS.items():
            for n, exists in enumerate(register.words(ROWS, COLS, CODE_BITS)):
                self.values[register.address + n] = AT_REST.get(name, register.reset) & exists
                self._masks[register.address + n] = name, exists
        self._begun = False
        self._rest()

    def _rest(self) -> None:
        self._got: list[int] = []
        self._out = self._in = self._count = self._shown = 0
        self._over = self._refusing = False
        self._answer: deque[int] = deque()

    def cs(self, low: bool) -> None:
        """Lower or raise CS; raised, it ends the transaction wherever it is."""
        if low and not self.cs_low:
            self._begun = True
        self.cs_low = low
        if not low:
            self._rest()

    def bit(self, value: int) -> int:
        """One period of SCK: the bit sent, and the bit that came back."""
        if not self.cs_low:
            return 0
        got = self._shown
        self._in = (self._in << 1 | value) & 0xFF
        self._out = self._out << 1 & 0xFF
        self._count += 1
        if self._count == 8:
            self._count = 0
            self._out = self._byte(self._in)
        self._shown = self._out >> 7
        return got

    def byte(self, value: int) -> int:
        """Eight bits, the highest first."""
        return sum(self.bit(value >> n & 1) << n for n in range(7, -1, -1))

    def _byte(self, value: int) -> int:
        """A whole byte has come; the one that goes next."""
        if not self._begun or self._over:
            return self._next()
        self._got.append(value)
        if self._got[0] == OP_WRITE:
            if len(self._got) == 5:
                return self._written()
        elif self._got[0] == OP_READ:
            if len(self._got) == 2:
                self._read(value)
        elif self._got[0] == OP_FRAME:
            self._over = True
            self._answer.extend((TOKEN_DATA, *len(FRAME).to_bytes(2, "big"), *FRAME))
        else:
            self._over = True
            return self._refused(TOKEN_OPCODE)
        return WAIT

    def _next(self) -> int:
        if self._refusing:
            self._refusing = False
            return self._refused(TOKEN_ACCESS)
        return self._answer.popleft() if self._answer else 0

    def _refused(self, token: int) -> int:
        """A refusal counts where its token is loaded: cut before, it never was."""
        self.errors = min(self.errors + 1, ALL)
        self.values[REGISTERS["SPI_ERRORS"].address] = self.errors
        return token

    def _written(self) -> int:
        self._over = True
        if crc8(self._got[:4]) != self._got[4]:
            return self._refused(TOKEN_CRC)
        address, value = self._got[1], self._got[2] << 8 | self._got[3]
        name, exists = self._masks.get(address, ("", 0))
        if not name or not REGISTERS[name].writable:
            self._refusing = True
            return WAIT
        self.values[address] = value & REGISTERS[name].writable & exists
        self.pulses = (self.pulses + (value & REGISTERS[name].pulse).bit_count()) & ALL
        self._answer.append(TOKEN_DONE)
        return WAIT

    def _read(self, address: int) -> None:
        self._over = True
        name, _ = self._masks.get(address, ("", 0))
        if not name:
            self._refusing = True
            return
        word = self.values[address] & REGISTERS[name].readable
        body = word.to_bytes(2, "big")
        self._answer.extend((TOKEN_DATA, *body, crc8((OP_READ, address, *body))))


# What the stream of an input is made of, as register_chip_main.cpp takes it.
BYTE, BITS, LOW, HIGH, RESET = range(5)


def answer(stream: bytes) -> bytes:
    """What register_chip answers to an input: a byte for each whole byte, then errors and pulses."""
    chip, out, at = Chip(), bytearray(), 0
    while at < len(stream):
        command, left = stream[at], len(stream) - at
        if command == BYTE and left > 1:
            out.append(chip.byte(stream[at + 1]))
            at += 1
        elif command == BITS and left > 2:
            for n in range(stream[at + 1] % 8):
                chip.bit(stream[at + 2] >> (7 - n) & 1)
            at += 2
        elif command == LOW:
            chip.cs(True)
        elif command == RESET:
            chip.reset()
        else:
            chip.cs(False)
        at += 1
    return bytes(out) + chip.errors.to_bytes(2, "big") + chip.pulses.to_bytes(2, "big")
