# SPDX-License-Identifier: Apache-2.0
"""The host's side of the SPI protocol: commands, answers, frames; the reference for firmware (docs/spi.md).

A transaction is a generator: it yields the bytes to send while CS stays low, is sent the bytes that
came back, and returns its result. So one text serves a cocotb test, the engines' bridge and a
driver alike::

    value = run(read_register(0x00), exchange)      # exchange(bytes) -> bytes of the same length
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dermis.errors import DermisError, InputError

OP_WRITE, OP_READ, OP_FRAME = 0x02, 0x03, 0x0B
FILL = b"\xff"
"""What the host sends while it listens. With zeros one wrong bit could turn a read of FULL_MIN into a write of 0 whose
CRC matches. With ones no register that can be written has such a CRC."""
WAIT, TOKEN_DONE, TOKEN_DATA, TOKEN_FRAME = 0x00, 0x5A, 0xA5, 0x3C
TOKEN_OPCODE, TOKEN_CRC, TOKEN_BUSY, TOKEN_ACCESS = 0xE0, 0xE1, 0xE2, 0xE3

FORMAT = 0x01
HEADER_BYTES, CRC_BYTES = 8, 2
_HEADER = struct.Struct(">BBHBBH")  # format, flags, number, columns, bits of a code, clocks of the gate
SLOT_INJECT, SLOT_DARK, SLOT_FULL_EVEN, SLOT_FULL_ODD = 0xF0, 0xF1, 0xF2, 0xF3
SPECIAL_SLOTS = (SLOT_INJECT, SLOT_DARK, SLOT_FULL_EVEN, SLOT_FULL_ODD)

WAIT_LIMIT = 4096
"""Most wait bytes before a chip counts as one without a clock: SCK at 8000 times f_clk."""

Result = TypeVar("Result")
Transaction = Generator[bytes, bytes, Result]


class SpiError(DermisError):
    """A transaction failed."""


class NoAnswer(SpiError):
    """Only wait bytes came: no clock, no chip, or CIPO stuck at 0."""


class BadToken(SpiError):
    """A byte is not a token: wrong mode, bit slip, CIPO stuck at 1."""


class UnknownCommand(SpiError):
    """E0: unknown opcode."""


class BadCommandCrc(SpiError):
    """E1: the command was corrupted; nothing was written."""


class Busy(SpiError):
    """E2: an earlier request, of an interrupted transaction, is still crossing; no action."""


class NoSuchRegister(SpiError):
    """E3: no register has this address at this size, or it can only be read; nothing was done."""


class BadExchange(SpiError):
    """The driver returned another number of bytes than it was given."""


class BadAnswerCrc(SpiError):
    """The answer of a read does not match its CRC."""


class FrameError(SpiError):
    """The bytes of a burst are not a frame."""


class EmptyFrame(FrameError):
    """Length 0: no frame was stored since reset."""


class BadFrameCrc(FrameError):
    """The CRC-16 of a frame does not match."""


class BadFrameFormat(FrameError):
    """Another format number, or a header or slot number that no chip sends."""


class BadFrameLength(FrameError):
    """The number of bytes is not that of whole slots."""


REFUSALS: dict[int, tuple[type[SpiError], str]] = {
    TOKEN_OPCODE: (UnknownCommand, "the chip knows no such command"),
    TOKEN_CRC: (BadCommandCrc, "the chip saw a wrong CRC"),
    TOKEN_BUSY: (Busy, "an earlier request is still crossing"),
    TOKEN_ACCESS: (NoSuchRegister, "no such register, or read-only"),
}


def crc8(data: Iterable[int], crc: int = 0) -> int:
    """CRC-8/SMBUS: polynomial 0x07, start 0, MSB first; ``crc8(b"123456789") == 0xF4``."""
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x07 if crc & 0x80 else 0)) & 0xFF
    return crc


def crc16(data: Iterable[int], crc: int = 0xFFFF) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; ``crc16(b"123456789") == 0x29B1``."""
    return binascii.crc_hqx(bytes(data), crc)


def _checked(name: str, number: int, bits: int) -> int:
    if not 0 <= number < 1 << bits:
        raise InputError("SPI command", name, number, f"a whole number 0..{(1 << bits) - 1}")
    return number


def write_command(address: int, value: int) -> bytes:
    """Return the five bytes that write a register; InputError for more than 8 bits of address or 16 of value."""
    _checked("address", address, 8)
    _checked("value", value, 16)
    body = bytes((OP_WRITE, address, value >> 8, value & 0xFF))
    return body + bytes((crc8(body),))


def read_command(address: int) -> bytes:
    """Return the two bytes that read a register; InputError if the address has more than 8 bits."""
    return bytes((OP_READ, _checked("address", address, 8)))


def frame_command() -> bytes:
    """The command byte for the newest whole frame."""
    return bytes((OP_FRAME,))


def write_register(address: int, value: int, wait_limit: int = WAIT_LIMIT) -> Transaction[int]:
    """Write a register; return the number of wait bytes. After an SpiError it is as it was."""
    return (yield from _answer(write_command(address, value), TOKEN_DONE, wait_limit))


def read_register(address: int, wait_limit: int = WAIT_LIMIT) -> Transaction[int]:
    """Read a register; return its 16 bits."""
    yield from _answer(read_command(address), TOKEN_DATA, wait_limit)
    high, low, check = yield from _exchanged(3 * FILL)
    if check != crc8((OP_READ, address, high, low)):
        raise BadAnswerCrc(f"register 0x{address:02X}: {high:02X} {low:02X} came with CRC {check:02X}")
    return high << 8 | low


def read_frame_bytes(wait_limit: int = WAIT_LIMIT) -> Transaction[bytes]:
    """Read the newest whole frame as packed, for `parse_frame`; empty if there is none."""
    yield from _answer(frame_command(), TOKEN_FRAME, wait_limit)
    high, low = yield from _exchanged(2 * FILL)
    return (yield from _exchanged((high << 8 | low) * FILL)) if high or low else b""


def read_frame(wait_limit: int = WAIT_LIMIT) -> Transaction[Frame]:
    """Read the newest whole frame; `EmptyFrame` if none was stored since reset."""
    return parse_frame((yield from read_frame_bytes(wait_limit)))


def _exchanged(send: bytes) -> Transaction[bytes]:
    got = yield send
    if len(got) != len(send):
        raise BadExchange(f"{len(got)} bytes came back for {len(send)}")
    return bytes(got)


def _answer(command: bytes, wanted: int, wait_limit: int) -> Transaction[int]:
    """Send a command and wait for a token; return the number of bytes before it."""
    during = yield from _exchanged(command)
    if early := next(filter(None, during), WAIT):
        # A wrong opcode is answered before this command is over: as unknown, or as a shorter one.
        if early in (TOKEN_DATA, TOKEN_FRAME) or early in REFUSALS:
            raise UnknownCommand(f"0x{early:02X} came during the command: the chip took another one")
        raise BadToken(f"0x{early:02X} is no token: it came during the command")
    for waited in range(wait_limit + 1):
        (token,) = yield from _exchanged(FILL)
        if token == wanted:
            return waited
        if token != WAIT:
            kind, text = REFUSALS.get(token, (BadToken, f"0x{token:02X} is no token that may stand here"))
            raise kind(text)
    raise NoAnswer(f"no answer after {wait_limit} wait bytes")


def run(transaction: Transaction[Result], exchange: Callable[[bytes], bytes]) -> Result:
    """Run a transaction over `exchange`; CS is low during this call."""
    try:
        send = next(transaction)
        while True:
            send = transaction.send(exchange(send))
    except StopIteration as done:
        return done.value


@dataclass(frozen=True)
class Frame:
    """One frame as it was read.

    Attributes
    ----------
    number : frames whose first slot was packed since reset, modulo 65536; the first is 1
    cols, code_bits, gate_clocks : geometry, width of a code, and the gate this frame was measured with
    slots : [n], what each slot measured: a row's number, or one of `SPECIAL_SLOTS`
    codes : [n, cols], code of each column in each slot; pedestals are taken off rows only
    overflow : [n, cols], the count was above full scale
    test, dark, fault : a self-test frame; with a dark slot first; a fault in a mask
    pedestal_mode : 0 none, 1 registers, 2 latest dark slot
    """

    number: int
    cols: int
    code_bits: int
    gate_clocks: int
    slots: tuple[int, ...]
    codes: npt.NDArray[np.uint16]
    overflow: npt.NDArray[np.bool_]
    test: bool = False
    pedestal_mode: int = 0
    dark: bool = False
    fault: bool = False

    def slot(self, number: int) -> npt.NDArray[np.uint16]:
        """Codes [cols] of a slot by its number; KeyError if the frame has none."""
        if number not in self.slots:
            raise KeyError(number)
        return self.codes[self.slots.index(number)]


class RowsOfInterest:
    """Choose the rows of the next frame: touched ones and their neighbours, all rows `every` n frames.

    A row is touched if one of its codes (or forces in newtons) is at least `threshold`, until it is
    measured again without: so it does not matter how many frames later a mask acts. NaN is no touch.
    While no row is touched, each frame has one row in 2 neighbours + 1 by turns: a mask of no row gives
    no frame. `mask` [rows] is True for the rows of the next frame. InputError for a number out of range.
    """

    def __init__(self, rows: int, threshold: float = 8, neighbours: int = 1, every: int = 16) -> None:
        for name, value, least in (("rows", rows, 1), ("neighbours", neighbours, 0), ("every", every, 1)):
            most = 128 if name == "rows" else 1 << 31
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise InputError("RowsOfInterest", name, value, f"a whole number {least}..{most}")
        if not math.isfinite(threshold):
            raise InputError("RowsOfInterest", "threshold", threshold, "a number")
        self.threshold, self.neighbours, self.every = threshold, neighbours, every
        self.mask, self._touched, self._frame = np.ones(rows, bool), np.zeros(rows, bool), 0

    @property
    def words(self) -> list[int]:
        """Values of the registers ROW_MASK, ROW_MASK + 1, ... (docs/registers.md)."""
        bits = np.packbits(np.pad(self.mask, (0, -len(self.mask) % 16)), bitorder="little")
        return bits.view("<u2").tolist()

    def next(self, slots: npt.ArrayLike, codes: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return the next mask from slots [n] and codes [n, cols] of a `Frame`; InputError for other shapes."""
        slots, codes, rows = np.asarray(slots), np.asarray(codes), len(self.mask)
        if codes.ndim != 2 or slots.shape != codes.shape[:1]:
            raise InputError("RowsOfInterest", "codes", f"shape {codes.shape}", f"[{slots.size}, cols]")
        if not all(s in range(rows) or s in SPECIAL_SLOTS for s in slots.tolist()):
            allowed = f"rows below {rows}, or special slots"
            raise InputError("RowsOfInterest", "slots", slots.tolist(), allowed)
        measured, near_by = slots < rows, min(self.neighbours, rows)
        reach = 2 * near_by + 1
        self._touched[slots[measured].astype(int)] = (codes[measured] >= self.threshold).any(axis=1)
        near = np.convolve(self._touched, np.ones(reach))[near_by:][:rows] > 0
        self._frame += 1
        idle = (np.arange(rows) + self._frame) % min(reach, rows) == 0
        self.mask = (near if near.any() else idle) | (self._frame % self.every == 0)
        return self.mask


def _slot(cols: int, code_bits: int) -> np.dtype:
    """One slot in a frame: its number, the codes, the overflow bits."""
    code = ">u2" if code_bits > 8 else "u1"
    return np.dtype([("number", "u1"), ("codes", code, (cols,)), ("overflow", "u1", ((cols + 7) // 8,))])


def slot_bytes(cols: int, code_bits: int) -> int:
    """Bytes of one slot in a frame."""
    return _slot(cols, code_bits).itemsize


def frame_bytes(slots: int, cols: int, code_bits: int) -> int:
    """Return the bytes of a frame of `slots` slots."""
    return HEADER_BYTES + slots * slot_bytes(cols, code_bits) + CRC_BYTES


def parse_frame(data: bytes, sure: bool = False) -> Frame:
    """Take a frame apart; EmptyFrame, BadFrameCrc, BadFrameFormat or BadFrameLength if it is none.

    The CRC is looked at first, so that the others mean a chip of another kind, not a bad line. One frame in 65 536 that
    ends in zeros also looks like a shorter one with zeros behind it: only if its length is `sure`, because it came
    twice or by no line, it is taken.
    """
    if not data:
        raise EmptyFrame("no frame was stored since reset")
    if len(data) < HEADER_BYTES + CRC_BYTES:
        raise BadFrameLength(f"{len(data)} bytes are fewer than an empty frame has")
    if crc16(data):
        raise BadFrameCrc(f"frame of {len(data)} bytes: CRC {data[-2]:02X}{data[-1]:02X} does not match")
    form, flags, number, cols, code_bits, gate_clocks = _HEADER.unpack(data[:HEADER_BYTES])
    if form != FORMAT or flags >> 5 or not 1 <= cols <= 128 or not 1 <= code_bits <= 16:
        raise BadFrameFormat(f"header {data[:HEADER_BYTES].hex(' ')}")
    size, body = slot_bytes(cols, code_bits), data[HEADER_BYTES:-CRC_BYTES]
    if len(body) % size or not len(body):
        raise BadFrameLength(f"{len(body)} bytes are not one or more slots of {size}")
    # Zeros follow an answer and keep a CRC of 0: a frame whose length was corrupted upwards is whole with them.
    ends = range(HEADER_BYTES + CRC_BYTES + size, len(data), size)
    whole = next((end for end in ends if not any(data[end:]) and not crc16(data[:end])), 0)
    if whole and not sure:
        raise BadFrameLength(f"{len(data)} bytes: a frame of {whole}, and zeros")
    table = np.frombuffer(body, dtype=_slot(cols, code_bits))
    codes = table["codes"].astype(np.uint16)
    overflow = np.unpackbits(table["overflow"], axis=1, bitorder="little").astype(bool)
    slots = tuple(table["number"].tolist())
    order = [(s not in SPECIAL_SLOTS, s) for s in slots]
    if order != sorted(set(order)) or any(s >= 128 and s not in SPECIAL_SLOTS for s in slots):
        raise BadFrameFormat(f"slots {bytes(slots).hex(' ')}")
    if overflow[:, cols:].any() or (codes >> code_bits).any():
        raise BadFrameFormat("bits beyond the columns or beyond a code are not 0")
    test, dark, fault = (bool(flags >> bit & 1) for bit in (0, 3, 4))
    head = number, cols, code_bits, gate_clocks
    return Frame(*head, slots, codes, overflow[:, :cols], test, flags >> 1 & 3, dark, fault)


def pack_frame(frame: Frame) -> bytes:
    """Pack a frame as the chip does, for comparison in tests."""
    flags = frame.test | frame.pedestal_mode << 1 | frame.dark << 3 | frame.fault << 4
    head = _HEADER.pack(FORMAT, flags, frame.number, frame.cols, frame.code_bits, frame.gate_clocks)
    table = np.zeros(len(frame.slots), _slot(frame.cols, frame.code_bits))
    table["number"], table["codes"] = frame.slots, frame.codes
    table["overflow"] = np.packbits(frame.overflow, axis=1, bitorder="little")
    out = head + table.tobytes()
    return out + crc16(out).to_bytes(2, "big")
