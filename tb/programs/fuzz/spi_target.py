# SPDX-License-Identifier: Apache-2.0
"""Target `spi`: what a chip, a bus or a broken driver may answer the host's side of the protocol."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np

from dermis.chip import spi_protocol as spi
from dermis.errors import DermisError
from tb.programs.fuzz import oracle
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target

LENGTH_MAX = 1500
"""Bytes of an answer: five whole frames of 16 x 16; a longer one is only slower."""

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x100, -1, 0xFFFF, 0x10000, 1 << 40, -(1 << 40))
"""Addresses and values that a caller may give."""


def frame(rng: random.Random, cols: int, code_bits: int, slots: int) -> bytes:
    """A frame as a chip sends it."""
    numbers = rng.sample([*range(min(slots, 128)), *spi.SPECIAL_SLOTS], slots)
    codes = np.array(
        [[rng.getrandbits(code_bits) for _ in range(cols)] for _ in range(slots)], dtype=np.uint16
    )
    overflow = np.array([[bool(rng.getrandbits(1)) for _ in range(cols)] for _ in range(slots)])
    flags = rng.getrandbits(5)
    made = spi.Frame(
        rng.getrandbits(16), cols, code_bits, rng.getrandbits(16), tuple(numbers), codes, overflow,
        test=bool(flags & 1), pedestal_mode=flags >> 1 & 3, dark=bool(flags & 8), fault=bool(flags & 16),
    )  # fmt: skip
    return spi.pack_frame(made)


def seeds() -> list[bytes]:
    """Frames of several sizes, alone and behind a command, and answers of each token."""
    rng = random.Random(5)
    found = []
    for cols, bits, slots in ((1, 1, 1), (2, 8, 3), (16, 8, 16), (3, 12, 2), (128, 16, 1)):
        data = frame(rng, cols, bits, slots)
        found += [b"\x00" + data, b"\x01" + data]
        found.append(b"\x02\x00" + bytes(2) + b"\xa5" + len(data).to_bytes(2, "big") + data)
    for token in (0, 0x5A, 0xA5, 0xE0, 0xE1, 0xE2, 0xE3, 0xFF):
        for command in (2, 3, 4):
            found.append(bytes((command, 0, 3, 9, token, 0x12, 0x34, spi.crc8((3, 9, 0x12, 0x34)))))
    found += [bytes((command, how, 5, 9)) + bytes(9) for command in (2, 3, 4) for how in range(1, 8)]
    found += [bytes((command, 0, at, at)) for command in (3, 4, 5) for at in range(len(NUMBERS))]
    return found


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Another answer: bits, bytes, lengths, and the CRC put right again or not."""
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 2, 5))):
        pick = rng.randrange(6)
        at = rng.randrange(len(out))
        if pick == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif pick == 1:
            out[at] = rng.choice(
                (0, 0x5A, 0xA5, 0xE0, 0xE1, 0xE2, 0xE3, 0xFF, 0xF0, 0xF4, 1, 128, rng.randrange(256))
            )
        elif pick == 2:
            out[at:at] = rng.randbytes(rng.choice((1, 2, 16)))
        elif pick == 3 and len(out) > 1:
            del out[at : at + rng.choice((1, 2, 16))]
        elif pick == 4:
            out[at:at] = bytes(rng.choice((1, 5, 100, 500)))
        else:
            out = bytearray((rng.randrange(6),)) + out[1:]
        out = out or bytearray(1)
    return bytes(out[:LENGTH_MAX])


def _exchange(answer: bytes, how: int) -> Any:
    """The bus: gives the answer behind the command; `how` says what a broken driver does to each piece."""
    left = bytearray(answer)
    first = True

    def exchange(sent: bytes) -> Any:
        nonlocal first
        count = len(sent)
        got = bytes(count) if first else bytes(left[:count])
        if not first:
            del left[:count]
        first = False
        got += bytes(count - len(got))
        if how == 1:
            return got[:-1]
        if how == 2:
            return got + b"\xa5"
        if how == 3:
            return b""
        return bytearray(got) if how == 4 else got

    return exchange


def _same(frame_read: spi.Frame, data: bytes) -> None:
    if spi.pack_frame(frame_read) != data:
        raise Finding("again", "spi_protocol.parse_frame", f"{data[:40].hex(' ')} is told as another frame")
    if not frame_read.rows().keys() <= set(range(128)):
        raise Finding("value", "spi_protocol.parse_frame", f"rows {sorted(frame_read.rows())}")


def run(data: bytes, place: Path) -> str:
    """Take an answer as a frame, or run a transaction over a bus that gives it."""
    what = data[0] % 6 if data else 0
    body = data[1:]

    def one() -> None:
        if what == 0:
            _same(spi.parse_frame(body), body)
        elif what == 1:
            whole = body[:-2] + spi.crc16(body[:-2]).to_bytes(2, "big")
            _same(spi.parse_frame(whole), whole)
        else:
            how, address, value = body[:3].ljust(3, b"\0")
            number = NUMBERS[value % len(NUMBERS)] if what == 5 else value * 257
            at = NUMBERS[address % len(NUMBERS)] if what == 5 else address
            bus = _exchange(body[3:], how % 6)
            if what == 2:
                _same(
                    spi.run(spi.read_frame(), bus),
                    spi.run(spi.read_frame_bytes(), _exchange(body[3:], how % 6)),
                )
            elif what == 3:
                got = spi.run(spi.read_register(at), bus)
                if not 0 <= got <= 0xFFFF:
                    raise Finding("value", "spi_protocol.read_register", str(got))
            elif what == 4:
                spi.run(spi.write_register(at, number), bus)
            elif value & 16:
                spi.run(spi.read_register(at), bus)
            else:
                spi.run(spi.write_register(at, number), bus)

    return oracle.judge(one, lambda path: False, typed=DermisError)


def prepare(place: Path) -> None:
    """Nothing to prepare."""


TARGET = Target("spi", "answers on the SPI", seeds, mutate, prepare, run)
