# SPDX-License-Identifier: Apache-2.0
"""Target `registers`: any bit stream into the Verilog of SPI and registers, against their model."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

from hypothesis import strategies as st

from dermis.chip import hdl, register_map
from dermis.chip import spi_protocol as spi
from dermis.chip.sources import rtl_include_dirs, rtl_sources
from dermis.scene.design import ROOT
from tb.programs.fuzz import inputs
from tb.programs.fuzz.oracle import Finding
from tb.reference import chip
from tb.reference.chip import BITS, BYTE, HIGH, LOW, RESET

STREAM_MAX = 400
"""Bytes of a stream, some twenty transactions."""

ANSWER_S = 60.0
_ADDRESSES = [r.address for r in register_map.REGISTERS.values()]
_OTHER = (bytes((RESET,)), bytes((LOW,)), bytes((HIGH,)), bytes((LOW, BITS, 3, 0x55)), b"\x09")


@cache
def _program() -> list[str]:
    here = Path(__file__).parent
    sources, directories = [*rtl_sources(), here / "register_chip.v"], [*rtl_include_dirs(), ROOT / "rtl"]
    main = here / "register_chip_main.cpp"
    return hdl.program("verilator", "register_chip", {}, sources, directories, main, where="fuzz")


def _transaction(command: bytes, more: int) -> bytes:
    """Return a stream: CS low, a command, bytes for its answer, CS high."""
    return bytes((LOW, *(b for byte in command + bytes(more) for b in (BYTE, byte)), HIGH))


@st.composite
def strategy(draw: st.DrawFn) -> bytes:
    """Draw reads, writes, frames, resets and cuts of them."""
    address = st.sampled_from(_ADDRESSES) | st.integers(0, 255)
    value = st.sampled_from((0, 0xFFFF, *(1 << n for n in range(16)))) | st.integers(0, 0xFFFF)
    write = st.builds(spi.write_command, address, value)
    flipped = st.builds(
        lambda command, bit: (int.from_bytes(command, "big") ^ 1 << bit).to_bytes(5, "big"),
        write,
        st.integers(0, 39),
    )
    commands = st.one_of(
        st.builds(spi.read_command, address),
        write,
        flipped,
        st.just(spi.frame_command()),
        st.binary(min_size=1, max_size=2),
    )
    pieces = st.builds(_transaction, commands, st.sampled_from((0, 1, 2, 5, 6, 6, 13)))
    data = b"".join(draw(st.lists(pieces | st.sampled_from(_OTHER), min_size=1, max_size=6)))
    if draw(st.booleans()):
        data = draw(inputs.edited(data, [chr(n) for n in (BYTE, BITS, LOW, HIGH, RESET)]))
    return data[:STREAM_MAX]


def prepare(place: Path) -> None:
    """Build the chip."""
    _program()


def run(data: bytes, place: Path) -> str:
    """Compare the answers of the Verilog and of the model."""
    sent = len(data).to_bytes(4, "little") + data
    done = subprocess.run(_program(), input=sent, capture_output=True, timeout=ANSWER_S, check=True)
    got, wanted = done.stdout[4:], chip.answer(data)
    if got != wanted:
        at = next((n for n, (a, b) in enumerate(zip(got, wanted, strict=False)) if a != b), len(got))
        text = f"byte {at} of {len(wanted)}: {got[at:][:4].hex(' ')}, not {wanted[at:][:4].hex(' ')}"
        raise Finding("model", "rtl.register_chip", text)
    return "taken"
