# SPDX-License-Identifier: Apache-2.0
"""Target `registers`: any stream of bits, chip selects and resets into the Verilog of SPI, port and registers."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Sequence
from pathlib import Path

from dermis.chip import hdl, register_map
from dermis.chip import spi_protocol as spi
from dermis.chip.sources import rtl_include_dirs, rtl_sources
from dermis.scene.design import ROOT
from tb.programs.fuzz import oracle
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target
from tb.reference import chip
from tb.reference.chip import BITS, BYTE, HIGH, LOW, RESET

HERE = Path(__file__).parent
STREAM_MAX = 400
"""Bytes of an input: some twenty transactions; a chip knows nothing of earlier ones but its registers."""

ADDRESSES = [r.address for r in register_map.REGISTERS.values()]

_chip: subprocess.Popen[bytes] | None = None


def start(replaced: Sequence[Path] = ()) -> None:
    """Build the chip, if it is not yet, and start it; `replaced` are files in the place of others in rtl/."""
    global _chip
    stop()
    names = {path.name: path for path in replaced}
    sources = [names.get(path.name, path) for path in rtl_sources()]
    command = hdl.program(
        "verilator",
        "register_chip",
        {},
        [*sources, HERE / "register_chip.v"],
        [*rtl_include_dirs(), ROOT / "rtl"],
        HERE / "register_chip_main.cpp",
        where="fuzz",
    )
    _chip = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)


def stop() -> None:
    """End the chip: it ends by itself where its input does."""
    global _chip
    if _chip is not None:
        _chip.communicate()
        _chip = None


def chip_answer(stream: bytes) -> bytes:
    """What the Verilog answers to an input."""
    if _chip is None or _chip.stdin is None or _chip.stdout is None:
        raise ValueError("the chip is not started")
    _chip.stdin.write(len(stream).to_bytes(4, "little") + stream)
    _chip.stdin.flush()
    size = int.from_bytes(_chip.stdout.read(4), "little")
    return _chip.stdout.read(size)


def _bytes(data: bytes) -> bytes:
    return b"".join(bytes((BYTE, byte)) for byte in data)


def transaction(command: bytes, more: int) -> bytes:
    """CS low, a command, so many bytes for its answer, CS high."""
    return bytes((LOW,)) + _bytes(command + bytes(more)) + bytes((HIGH,))


def seeds() -> list[bytes]:
    """A read and a write of every register, refusals, frames, cuts and resets."""
    found = [transaction(spi.read_command(a), 6) for a in (*ADDRESSES, 0x10, 0x8F, 0x90, 0xFF)]
    for n, address in enumerate(ADDRESSES):
        write = transaction(spi.write_command(address, (0x1235 * (n + 1)) & 0xFFFF), 2)
        found.append(write + transaction(spi.read_command(address), 6))
    wrong = bytearray(spi.write_command(4, 5))
    wrong[4] ^= 1
    count = transaction(spi.read_command(register_map.SPI_ERRORS), 6)
    found += [
        transaction(bytes(wrong), 2) + count,
        transaction(b"\x00", 2) + count,
        transaction(spi.read_command(0xF0), 2) + count,
    ]
    found += [transaction(spi.frame_command(), n) for n in (0, 1, 4, 12)]
    found.append(
        bytes((LOW,))
        + _bytes(b"\x02\x04")
        + bytes((RESET,))
        + _bytes(b"\x03\x04\x00\x00\x00\x00")
        + bytes((HIGH,))
    )
    found.append(bytes((LOW, BITS, 3, 0x55)) + _bytes(b"\x03\x00") + bytes((HIGH,)) + count)
    found.append(_bytes(b"\x03\x00") + bytes((LOW,)) + _bytes(spi.read_command(0) + bytes(6)))
    return found


def _piece(rng: random.Random) -> bytes:
    address = rng.choice((*ADDRESSES, *ADDRESSES, rng.randrange(256)))
    pick = rng.randrange(8)
    if pick < 3:
        return transaction(spi.read_command(address), rng.choice((0, 1, 2, 5, 6, 6)))
    if pick < 6:
        command = bytearray(
            spi.write_command(address, rng.choice((0, 0xFFFF, 1 << rng.randrange(16), rng.getrandbits(16))))
        )
        if rng.random() < 0.2:
            command[rng.randrange(5)] ^= 1 << rng.randrange(8)
        return transaction(bytes(command), rng.choice((0, 1, 2, 2)))
    if pick == 6:
        return transaction(spi.frame_command(), rng.randrange(14))
    return bytes((rng.choice((RESET, LOW, HIGH, 9)), BITS, rng.randrange(8), rng.randrange(256)))


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Another stream: pieces put in, bytes and bits changed, cut anywhere."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randint(0, len(out))
        pick = rng.randrange(5)
        if pick < 2:
            out[at:at] = _piece(rng)
        elif pick == 2 and out:
            out[at % len(out)] = rng.choice((BYTE, BITS, LOW, HIGH, RESET, rng.randrange(256)))
        elif pick == 3:
            del out[at : at + rng.choice((1, 2, 4, 20))]
        elif out:
            out[at % len(out)] ^= 1 << rng.randrange(8)
    return bytes(out[:STREAM_MAX])


def run(data: bytes, place: Path) -> str:
    """Let the Verilog and the model answer, and compare."""

    def one() -> None:
        stream = data[:STREAM_MAX]
        got, wanted = chip_answer(stream), chip.answer(stream)
        if got != wanted:
            at = next((n for n, (a, b) in enumerate(zip(got, wanted, strict=False)) if a != b), len(got))
            text = (
                f"byte {at} of {len(wanted)}: {got[at : at + 4].hex(' ')}, not {wanted[at : at + 4].hex(' ')}"
            )
            raise Finding("model", "rtl.register_chip", text)

    return oracle.judge(one, lambda path: False)


def prepare(place: Path) -> None:
    """Build and start the chip."""
    start()


TARGET = Target("registers", "bits on the SPI pins", seeds, mutate, prepare, run)
