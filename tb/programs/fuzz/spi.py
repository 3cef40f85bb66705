# SPDX-License-Identifier: Apache-2.0
"""Targets `spi` and `registers`: any answer to the host's driver, and any bit stream into the
Verilog of SPI.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from dermis.chip import hdl, register_map
from dermis.chip import spi_protocol as spi
from dermis.chip.sources import rtl_include_dirs, rtl_sources
from dermis.errors import DermisError
from dermis.scene.design import ROOT
from tb.programs.fuzz import inputs, oracle
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target
from tb.reference import chip
from tb.reference.chip import BITS, BYTE, HIGH, LOW, RESET

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x100, -1, 0xFFFF, 0x10000, 1 << 40, -(1 << 40))
"""Addresses and values that a caller may give."""

# ---- answers on the SPI: the first byte says which transaction runs, three more how

_TOKENS = (0, 0x5A, 0xA5, 0xE0, 0xE1, 0xE2, 0xE3, 0xFF, 0xF0, 0xF4, 1, 128)


@st.composite
def _frame(draw: st.DrawFn) -> bytes:
    """Draw a frame as a chip sends it."""
    cols, bits, slots = draw(st.sampled_from(((1, 1, 1), (2, 8, 3), (16, 8, 16), (3, 12, 2), (128, 16, 1))))
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
def answers(draw: st.DrawFn) -> bytes:
    """Draw a transaction and an answer to it: frames, tokens with and without a right CRC,
    bytes.
    """
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
    head = bytes((kind,)) if kind < 2 else bytes((kind, how, address, value))
    return head + data[:1500]  # five frames of 16 x 16


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


def run_answer(data: bytes, place: Path) -> str:
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

    return oracle.judge(one, lambda path: False, typed=DermisError)


# ---- bits on the SPI pins

STREAM_MAX = 400
"""Bytes of a stream, some twenty transactions."""

_ADDRESSES = [r.address for r in register_map.REGISTERS.values()]
_chip: subprocess.Popen[bytes] | None = None


def start(replaced: Sequence[Path] = ()) -> None:
    """Build and start the chip; `replaced` are files that replace others of rtl/."""
    global _chip
    stop()
    names, here = {path.name: path for path in replaced}, Path(__file__).parent
    sources = [*(names.get(path.name, path) for path in rtl_sources()), here / "register_chip.v"]
    directories, main = [*rtl_include_dirs(), ROOT / "rtl"], here / "register_chip_main.cpp"
    command = hdl.program("verilator", "register_chip", {}, sources, directories, main, where="fuzz")
    _chip = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)


def stop() -> None:
    """End the chip, which ends with its input."""
    global _chip
    if _chip is not None:
        _chip.communicate()
        _chip = None


def chip_answer(stream: bytes) -> bytes:
    """Return the answer of the Verilog to a stream."""
    if _chip is None or _chip.stdin is None or _chip.stdout is None:
        raise ValueError("the chip is not started")
    _chip.stdin.write(len(stream).to_bytes(4, "little") + stream)
    _chip.stdin.flush()
    return _chip.stdout.read(int.from_bytes(_chip.stdout.read(4), "little"))


def transaction(command: bytes, more: int) -> bytes:
    """Return a stream: CS low, a command, bytes for its answer, CS high."""
    return bytes((LOW, *(b for byte in command + bytes(more) for b in (BYTE, byte)), HIGH))


@st.composite
def streams(draw: st.DrawFn) -> bytes:
    """Draw reads, writes, frames, resets and cuts of them."""
    address = st.sampled_from(_ADDRESSES) | st.integers(0, 255)
    value = st.sampled_from((0, 0xFFFF, *(1 << n for n in range(16)))) | st.integers(0, 0xFFFF)
    more = st.sampled_from((0, 1, 2, 5, 6, 6))
    flipped = st.builds(
        lambda a, v, bit: (int.from_bytes(spi.write_command(a, v), "big") ^ 1 << bit).to_bytes(5, "big"),
        address, value, st.integers(0, 39),
    )  # fmt: skip
    pieces = st.one_of(
        st.builds(transaction, st.builds(spi.read_command, address), more),
        st.builds(transaction, st.builds(spi.write_command, address, value) | flipped, more),
        st.builds(transaction, st.just(spi.frame_command()), st.integers(0, 13)),
        st.builds(transaction, st.binary(min_size=1, max_size=2), more),
        st.sampled_from(
            (bytes((RESET,)), bytes((LOW,)), bytes((HIGH,)), bytes((LOW, BITS, 3, 0x55)), b"\x09")
        ),
    )
    data = b"".join(draw(st.lists(pieces, min_size=1, max_size=6)))
    if draw(st.booleans()):
        data = draw(inputs.edited(data, [chr(n) for n in (BYTE, BITS, LOW, HIGH, RESET)]))
    return data[:STREAM_MAX]


def run_stream(data: bytes, place: Path) -> str:
    """Compare the answers of the Verilog and of the model."""

    def one() -> None:
        got, wanted = chip_answer(data), chip.answer(data)
        if got != wanted:
            at = next((n for n, (a, b) in enumerate(zip(got, wanted, strict=False)) if a != b), len(got))
            text = f"byte {at} of {len(wanted)}: {got[at:][:4].hex(' ')}, not {wanted[at:][:4].hex(' ')}"
            raise Finding("model", "rtl.register_chip", text)

    return oracle.judge(one, lambda path: False)


TARGETS = {
    "spi": Target(answers, lambda place: None, run_answer, ("dermis.chip.spi_protocol",)),
    "registers": Target(streams, lambda place: start(), run_stream, ("tb.reference.chip",), stop),
}
