# SPDX-License-Identifier: Apache-2.0
"""Target `spi`: any answer to the host's driver.

The first byte of an input says which transaction runs, three more how.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from dermis.chip import spi_protocol as spi
from dermis.errors import DermisError
from tb.programs.fuzz import inputs, oracle
from tb.programs.fuzz.oracle import Finding

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x100, -1, 0xFFFF, 0x10000, 1 << 40, -(1 << 40))
"""Addresses and values that a caller may give."""

_TOKENS = (0, 0x5A, 0xA5, 0xE0, 0xE1, 0xE2, 0xE3, 0xFF, 0xF0, 0xF4, 1, 128)
_SIZES = ((1, 1, 1), (2, 8, 3), (16, 8, 16), (3, 12, 2), (128, 16, 1))


@st.composite
def _frame(draw: st.DrawFn) -> bytes:
    """Draw a frame as a chip sends it."""
    cols, bits, slots = draw(st.sampled_from(_SIZES))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    numbers = rng.permutation([*range(min(slots, 128)), *spi.SPECIAL_SLOTS])[:slots]
    flags = rng.integers(0, 2, 3).astype(bool).tolist()
    made = spi.Frame(
        int(rng.integers(1 << 16)), cols, bits, int(rng.integers(1 << 16)), tuple(int(n) for n in numbers),
        rng.integers(0, 1 << bits, (slots, cols)).astype(np.uint16), rng.integers(0, 2, (slots, cols)) > 0,
        test=flags[0], pedestal_mode=int(rng.integers(4)), dark=flags[1], fault=flags[2],
    )  # fmt: skip
    return spi.pack_frame(made)


@st.composite
def strategy(draw: st.DrawFn) -> bytes:
    """Draw a transaction and its answer: frames, tokens with and without a right CRC, bytes."""
    kind = draw(st.integers(0, 5))
    how, address, value = (draw(st.sampled_from((0, 0, 1, 2, 3, 4, 5, 9, 11, 16, 255))) for _ in range(3))
    token, body = draw(st.sampled_from(_TOKENS)), draw(st.binary(min_size=2, max_size=4))
    short = bytes(draw(st.integers(0, 3))) + bytes((token,)) + body[:2]
    data = draw(_frame() | st.binary(max_size=20))
    data = draw(st.sampled_from((data, bytes(2) + b"\xa5" + len(data).to_bytes(2, "big") + data, short)))
    if draw(st.booleans()):
        data += bytes((spi.crc8((3, address, *body[:2])),))
    if draw(st.booleans()):
        data = draw(inputs.edited(data, [chr(t) for t in _TOKENS]))
    return bytes((kind,) if kind < 2 else (kind, how, address, value)) + data[:1500]  # five frames of 16 x 16


def prepare(place: Path) -> None:
    """Do nothing: everything is loaded."""


def _bus(answer: bytes, how: int) -> Any:
    """Return a bus that gives the answer after the command; `how` is a defect of its driver."""
    left, first = bytearray(answer), True

    def exchange(sent: bytes) -> Any:
        nonlocal first
        count = len(sent)
        got = bytes(count) if first else bytes(left[:count]).ljust(count, b"\0")
        if not first:
            del left[:count]
        first = False
        return {1: got[:-1], 2: got + b"\xa5", 3: b"", 4: bytearray(got)}.get(how, got)

    return exchange


def _same(read: spi.Frame, data: bytes) -> None:
    if spi.pack_frame(read) != data:
        raise Finding("again", "spi_protocol.parse_frame", f"{data[:40].hex(' ')} reads as another frame")
    if not read.rows().keys() <= set(range(128)):
        raise Finding("value", "spi_protocol.parse_frame", f"rows {sorted(read.rows())}")


def run(data: bytes, place: Path) -> str:
    """Parse an answer as a frame, or run a transaction over a bus that gives it."""
    kind, body = data[0] % 6 if data else 0, data[1:]
    how, address, value = body[:3].ljust(3, b"\0")
    number = NUMBERS[value % len(NUMBERS)] if kind == 5 else value * 257
    at = NUMBERS[address % len(NUMBERS)] if kind == 5 else address

    def one() -> None:
        bus = _bus(body[3:], how % 6)
        if kind < 2:
            whole = body if kind == 0 else body[:-2] + spi.crc16(body[:-2]).to_bytes(2, "big")
            _same(spi.parse_frame(whole), whole)
        elif kind == 2:
            again = spi.run(spi.read_frame_bytes(), _bus(body[3:], how % 6))
            _same(spi.run(spi.read_frame(), bus), again)
        elif kind == 3 or (kind == 5 and value & 16):
            if not 0 <= (got := spi.run(spi.read_register(at), bus)) <= 0xFFFF:
                raise Finding("value", "spi_protocol.read_register", str(got))
        else:
            spi.run(spi.write_register(at, number), bus)

    return oracle.judge(one, typed=DermisError)
