# SPDX-License-Identifier: Apache-2.0
"""Claims about the host drivers, in Python and in C: right on the Verilog, over a bad line, and without a chip."""

import ctypes
import struct
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rtl_run import changed, simulate

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi
from dermis.chip.host import Host, Spidev, WasReset
from dermis.errors import InputError
from dermis.scene.design import ROOT

SMALL = {"ROWS": 2, "COLS": 3, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}
FRAME_BYTES = spi.frame_bytes(2, 3, 8)
# The command, a wait byte, the token and two bytes of length come before the frame.
CRC_BYTE, CODE_BYTE = 5 + FRAME_BYTES - 1, 5 + 9


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    target = tmp_path_factory.mktemp("host") / "dermis_host.so"
    flags = "-std=c99 -pedantic -Wall -Wextra -Wconversion -Werror -shared -fPIC -Irtl".split()
    subprocess.run(["gcc", *flags, "-o", target, "rtl/host/dermis_host.c"], cwd=ROOT, check=True, timeout=60)
    return str(target)


@pytest.fixture(params=["python", "c"])
def driver(request: pytest.FixtureRequest) -> dict[str, str]:
    return {"library": request.getfixturevalue("library") if request.param == "c" else ""}


def drive(
    driver: dict[str, str], trap: Path | None = None, parameters: dict[str, int] = SMALL, **scenario: Any
) -> dict[str, Any]:
    asked = {"parameters": parameters} | driver | scenario
    got = simulate("icarus", "bench_host", "dermis_top", "drives", parameters, asked, trap=trap)
    assert got["held"], "chip select rose inside a transaction"
    assert got["largest"] <= 7
    return got


# What is wrong on the line -> frame commands until the frame is whole.
LINES: dict[str, tuple[dict[str, list[Any]], int]] = {
    "nothing": ({}, 3),
    "a bit of the CRC": ({"3": ["flip", CRC_BYTE]}, 4),
    "a code, twice": ({"3": ["flip", CODE_BYTE], "4": ["flip", CODE_BYTE]}, 5),
    "the end of the frame": ({"3": ["cut", CODE_BYTE]}, 4),
    "the length": ({"3": ["flip", 4]}, 4),
    "the length, to 0": ({"3": ["cut", 3]}, 4),
    "the token": ({"3": ["flip", 2]}, 4),
}


@pytest.mark.parametrize("line", LINES)
def test_a_frame_is_read_again_until_it_is_right(driver: dict[str, str], line: str) -> None:
    faults, frames = LINES[line]
    got = drive(driver, settled=2, faults=faults)
    assert got["test_rate"] == 0x1234
    assert got["frame"] == got["expected"]
    assert got["frames"] == frames


def test_a_length_with_whole_slots_too_many_is_read_again(driver: dict[str, str]) -> None:
    """34 bytes become 50, two slots of 8 more; zeros follow, which keep the CRC."""
    got = drive(driver, parameters=SMALL | {"ROWS": 3, "COLS": 6}, settled=2, faults={"3": ["flip", 4]})
    assert got["frame"] == got["expected"]
    assert got["frames"] == 4


OTHER = "dermis_registers", ("16'hDE01", "16'hDE02")
SHORT = "dermis_frame_buffer", ("front_q ? length1_q : length0_q;", "length1_q - 16'd1;")
# What ends in an error -> its name in Python and in C, and frame commands until then.
ENDS: dict[str, tuple[dict[str, Any], str, str, int]] = {
    "bad line": ({"faults": {str(n): ["flip", CRC_BYTE] for n in range(1, 9)}}, "BadFrameCrc", "BAD_CRC", 3),
    "no clock": ({"dead": True}, "NoAnswer", "NO_ANSWER", 0),
    "no frames": ({"enable": False, "timeout_s": 0.05}, "TimedOut", "TIMEOUT", 0),
    "no such register": ({"write": 0x1F}, "NoSuchRegister", "NO_REGISTER", 1),
    "another chip": ({"trap": OTHER}, "OtherChip", "OTHER_CHIP", 0),
    "too few bytes": ({"trap": SHORT}, "BadFrameCrc", "BAD_CRC", 3),
}


@pytest.mark.parametrize("why", ENDS)
def test_what_cannot_be_done_is_an_error(driver: dict[str, str], why: str, tmp_path: Path) -> None:
    asked, in_python, in_c, frames = ENDS[why]
    trap = changed(tmp_path, *asked["trap"]) if "trap" in asked else None
    got = drive(driver, **asked | {"trap": trap})
    assert (got["error"], got["frames"]) == (in_c if driver["library"] else in_python, frames)


def test_the_driver_in_c_does_not_write_past_its_buffer(library: str) -> None:
    assert drive({"library": library}, room=FRAME_BYTES - 1)["error"] == "BAD_LENGTH"


TRANSFER = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
)


class HostInC(ctypes.Structure):
    """`dermis_host`."""

    _fields_ = (
        ("transfer", TRANSFER), ("port", ctypes.c_void_p), ("transfer_bytes", ctypes.c_size_t),
        ("wait_bytes", ctypes.c_uint), ("tries", ctypes.c_uint),
    )  # fmt: skip


def in_c(chip: Callable[[bytes, bool], bytes], tries: int = 3) -> HostInC:
    """Return a host in C of a transfer in Python."""

    def transfer(_port: int, send: int | None, receive: int, count: int, hold: int) -> int:
        back = chip(ctypes.string_at(send, count) if send else b"\xff" * count, bool(hold))
        ctypes.memmove(receive, back, count)
        return 0

    return HostInC(TRANSFER(transfer), None, 0, 100, tries)


class Opcode:
    """A chip of one register, and a line that flips bits of the first opcode; each answer after one wait byte.

    Its frame has the length of two slots, with which the format is the CRC of register 4.
    """

    def __init__(self, flip: int, register: int = 0x015A) -> None:
        self.flip, self.register, self.sent = flip, register, b""

    def transfer(self, data: bytes, hold: bool) -> bytes:
        """Exchange bytes: what stands after the command as the chip saw it is its answer."""
        first, self.sent = len(self.sent), self.sent + data
        op = self.sent[0] ^ self.flip
        read = b"\xa5" + self.register.to_bytes(2, "big")
        checked = spi.crc8((3, *self.sent[1:2], *read[1:]))
        good = len(self.sent) >= 5 and not spi.crc8((op, *self.sent[1:5]))
        answers = {
            spi.OP_WRITE: (5, b"\x5a" if good else b"\xe1"),
            spi.OP_READ: (2, read + bytes((checked,))),
        }
        answers[spi.OP_FRAME] = 1, bytes((spi.TOKEN_FRAME, 0, 48, spi.FORMAT))
        length, answer = answers.get(op, (0, b"\xe0"))
        if op == spi.OP_WRITE and good:
            self.register = int.from_bytes(self.sent[2:4], "big")
        back = (bytes(length + 1) + answer + bytes(99))[first : len(self.sent)]
        if not hold:
            self.flip, self.sent = 0, b""
        return back


@pytest.mark.parametrize("flip", [1 << bit for bit in range(8)])
def test_a_write_whose_opcode_the_line_changed_is_sent_again(library: str, flip: int) -> None:
    """As a read its answer holds 5A, the token of a write, where the driver looks for that."""
    chip = Opcode(flip)
    Host(chip.transfer).write(5, 100)
    assert chip.register == 100

    chip = Opcode(flip)
    host = in_c(chip.transfer)
    assert ctypes.CDLL(library).dermis_write(ctypes.byref(host), 5, 100) == 0
    assert chip.register == 100


@pytest.mark.parametrize("flip", [1 << bit for bit in range(8)])
def test_a_read_whose_opcode_the_line_changed_is_read_again(library: str, flip: int) -> None:
    assert Host(Opcode(flip, 115).transfer).read(4) == 115
    host, value = in_c(Opcode(flip, 115).transfer), ctypes.c_uint16()
    assert ctypes.CDLL(library).dermis_read(ctypes.byref(host), 4, ctypes.byref(value)) == 0
    assert value.value == 115


def test_a_reset_in_operation_is_seen(library: str) -> None:
    settings = (ctypes.c_uint16 * 2 * 1)((rm.SETTLE, 115))
    for now, ends in ((115, 0), (90, 10)):
        host = in_c(Opcode(0, now).transfer)
        assert ctypes.CDLL(library).dermis_check(ctypes.byref(host), settings, ctypes.c_size_t(1)) == ends
        with nullcontext() if not ends else pytest.raises(WasReset, match="SETTLE is 90, not 115"):
            Host(Opcode(0, now).transfer).check(SETTLE=115)


@pytest.mark.parametrize(
    ("at", "value", "ends"),
    [(0, 1, 0), (0, 2, 7), (1, 0x1F, 0), (1, 0x20, 7), (4, 0, 7), (5, 0, 7), (5, 17, 7), (8, 200, 7)],
)
def test_the_driver_in_c_takes_a_frame_in_one_transfer_or_says_what_it_is(
    library: str, at: int, value: int, ends: int
) -> None:
    """A host without a limit and without a number of tries; a header or slot that no chip sends is refused."""
    body = bytearray((1, 0, 0, 7, 3, 8, 1, 254, 0, 10, 20, 30, 0))
    body[at] = value
    frame = bytes(body) + spi.crc16(bytes(body)).to_bytes(2, "big")
    assert framed(library, [frame], 0) == (ends, b"" if ends else frame)


def showing(frames: list[bytes]) -> Callable[[bytes, bool], bytes]:
    """A chip that has a frame ready: each of these in turn, the last one again and again."""
    left, started = b"", False

    def transfer(data: bytes, hold: bool) -> bytes:
        nonlocal left, started
        if not started and data[0] == spi.OP_READ:  # STATUS
            left = b"\0\0\0\xa5\xff\xff" + bytes((spi.crc8(data[:2] + b"\xff\xff"),))
        elif not started:
            left = b"\0\0\x3c" + len(frames[0]).to_bytes(2, "big") + frames[0]
            frames[:] = frames[1:] or frames
        started = hold
        back, left = left[: len(data)], left[len(data) :]
        return back + bytes(len(data) - len(back))

    return transfer


def framed(library: str, frames: list[bytes], tries: int) -> tuple[int, bytes]:
    """Read a frame with the driver in C; return its status and the frame, if it is good."""
    room, length, host = ctypes.create_string_buffer(999), ctypes.c_size_t(), in_c(showing(frames), tries)
    status = ctypes.CDLL(library).dermis_frame(
        ctypes.byref(host), 1, room, ctypes.c_size_t(999), ctypes.byref(length)
    )
    return status, b"" if status else room.raw[: length.value]


def test_a_frame_that_looks_like_a_shorter_one_is_taken_when_it_comes_twice(library: str) -> None:
    """At rest one frame in 65 536 has a CRC of 0 and is whole without its last slot; a length may be wrong as well."""
    idle = spi.Frame(
        2106, 16, 8, 510, tuple(range(16)), np.zeros((16, 16), np.uint16), np.zeros((16, 16), bool)
    )
    frame = spi.pack_frame(idle)
    assert not any(frame[-2:])
    body = bytes((1, 0, 0, 7, 3, 8, 1, 254, 0, 10, 20, 30, 0))
    short = body + spi.crc16(body).to_bytes(2, "big")
    for frames, found in (([frame], frame), ([short + bytes(5), short], short)):
        assert framed(library, [*frames], 1)[0] == 7
        assert framed(library, [*frames], 2) == (0, found)
        assert spi.pack_frame(Host(showing([*frames])).frame()) == found


class Kernel:
    """ioctl of a spidev port: at most 4096 bytes a message, chip select high after one without cs_change."""

    def __init__(self, frame: bytes) -> None:
        self.left = b""
        self.frame = frame
        self.low, self.falls, self.largest = False, 0, 0

    def __call__(self, _file: int, request: int, fields: bytes) -> int:
        if request == Spidev.MODE:
            return 0
        assert request == Spidev.MESSAGE
        tx, rx, length, hz, delay, bits, hold = struct.unpack("=QQIIHBB4x", fields)
        if length > 4096:
            raise OSError(90, "Message too long")
        assert (hz, delay, bits) == (5_000_000, 0, 8)
        self.largest = max(self.largest, length)
        sent = ctypes.string_at(tx, length)
        if not self.low:
            self.falls += 1
            answer = b"\x3c" + len(self.frame).to_bytes(2, "big") + self.frame
            if sent[0] == spi.OP_READ:
                answer = b"\xa5\0\2" + bytes((spi.crc8(spi.read_command(7) + b"\0\2"),))
            self.left = bytes(len(sent) + 1) + answer
        back, self.left = self.left[:length], self.left[length:]
        ctypes.memmove(rx, back + bytes(length - len(back)), length)
        self.low = bool(hold)
        return length


def test_linux_splits_a_long_frame_and_holds_select(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = (bytes((row, *range(128), *bytes(16))) for row in range(64))
    body = bytes((1, 0, 0, 7, 128, 8, 1, 254)) + b"".join(rows)
    frame = body + spi.crc16(body).to_bytes(2, "big")
    assert len(frame) > 2 * 4096
    kernel = Kernel(frame)
    monkeypatch.setattr("fcntl.ioctl", kernel)
    (tmp_path / "port").touch()
    got = Host(Spidev(str(tmp_path / "port"), 5_000_000)).frame()
    assert spi.pack_frame(got) == frame
    assert (kernel.falls, kernel.largest, kernel.low) == (2, 4096, False)
    # A longer transfer is what the kernel refuses.
    with pytest.raises(OSError, match="too long"):
        Host(Spidev(str(tmp_path / "port"), 5_000_000), limit=5000).frame()


def test_the_message_is_that_of_the_kernel(tmp_path: Path) -> None:
    header = Path("/usr/include/linux/spi/spidev.h")
    if not header.is_file():
        pytest.skip("no headers of the kernel here")
    text = """
    #include <linux/spi/spidev.h>
    #include <stddef.h>
    #include <stdio.h>
    int main(void) {
      printf("%lu %lu %zu %zu %zu %zu %zu", (unsigned long)SPI_IOC_WR_MODE, (unsigned long)SPI_IOC_MESSAGE(1),
             sizeof(struct spi_ioc_transfer), offsetof(struct spi_ioc_transfer, len),
             offsetof(struct spi_ioc_transfer, speed_hz), offsetof(struct spi_ioc_transfer, bits_per_word),
             offsetof(struct spi_ioc_transfer, cs_change));
    }"""
    (tmp_path / "spi.c").write_text(text)
    subprocess.run(["gcc", "-o", "spi", "spi.c"], cwd=tmp_path, check=True, timeout=60)
    said = subprocess.check_output(["./spi"], cwd=tmp_path, timeout=60, text=True)
    assert [int(word) for word in said.split()] == [Spidev.MODE, Spidev.MESSAGE, 32, 16, 20, 26, 27]


def test_a_port_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="an SPI port of this machine"):
        Spidev(str(tmp_path / "spidev0.0"), 1_000_000)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Host(lambda data, hold: data, tries=0), "numbers from 1"),
        (lambda: Host(lambda data, hold: data, limit=0), "numbers from 1"),
        (lambda: Host(lambda data, hold: data).set_up(GATE=510, GAIT=1), "GAIT"),
        (lambda: Host(lambda data, hold: data).check(GAIT=1), "GAIT"),
        (
            lambda: Host(lambda data, hold: data).set_up(RANGE=4),
            "RANGE = 4: a whole number in the bits 0x0003",
        ),
        (lambda: Host(lambda data, hold: data).set_up(GATE=510.7), "GATE = 510.7: a whole number"),
        (
            lambda: Host(lambda data, hold: data).set_up(ID=0xDE01),
            "ID = 56833: a whole number in the bits 0x0000",
        ),
    ],
)
def test_a_wrong_option_or_register_is_one_line(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()
