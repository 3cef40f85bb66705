# SPDX-License-Identifier: Apache-2.0
"""cocotb bench of the host drivers, in Python and in C, on dermis_top through its pins."""

import ctypes
from collections.abc import Callable
from typing import Any

import cocotb
import cocotb.task
from cocotb.triggers import FallingEdge
from rtl_bench import report, scenario
from spi_client import Pins
from top_bench import Chip

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi
from dermis.chip.host import Host
from dermis.errors import DermisError

LIMIT = 7  # bytes of a transfer: even a command and its answer take several
ERRORS = "OK PORT NO_ANSWER BAD_TOKEN NO_REGISTER NOT_WRITTEN BAD_CRC BAD_LENGTH TIMEOUT OTHER_CHIP WAS_RESET".split()


class Line:
    """The pins as a driver's transfer, with faults: {number of the frame command: [kind, byte]}."""

    def __init__(self, pins: Pins, faults: dict[str, list[Any]]) -> None:
        self.pins, self.faults = pins, faults
        self.transactions = self.frames = self.largest = 0
        self.selected = False

    async def transfer(self, data: bytes, hold: bool) -> bytes:
        if not self.selected:
            self.selected = True
            self.transactions += 1
            await self.pins.select()
        self.largest = max(self.largest, len(data))
        before = len(self.pins.received)
        back = bytearray(await self.pins.exchange(data))
        if self.pins.sent[0] == spi.OP_FRAME:
            self.frames += before == 0
            kind, byte = self.faults.get(str(self.frames), ("none", 0))
            for n in range(len(back)):
                if kind == "flip" and before + n == byte:
                    back[n] ^= 0x10
                elif kind == "cut" and before + n >= byte:
                    back[n] = 0
        if not hold:
            self.selected = False
            await self.pins.deselect()
        return bytes(back)


class CHost:
    """The driver in C as the one in Python."""

    CALL = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    )

    def __init__(self, library: str, transfer: Callable[[bytes, bool], bytes], room: int) -> None:
        class Struct(ctypes.Structure):
            _fields_ = (
                ("transfer", self.CALL),
                ("port", ctypes.c_void_p),
                ("transfer_bytes", ctypes.c_size_t),
                ("wait_bytes", ctypes.c_uint),
                ("tries", ctypes.c_uint),
            )

        def call(_port: Any, send: Any, receive: Any, count: int, hold: int) -> int:
            back = transfer(ctypes.string_at(send, count) if send else count * spi.FILL, bool(hold))
            ctypes.memmove(receive, back, count)
            return 0

        self.library, self.bytes = ctypes.CDLL(library), ctypes.create_string_buffer(room)
        self.host = Struct(self.CALL(call), None, LIMIT, 512, 3)

    def _checked(self, function: str, *arguments: Any) -> None:
        if status := getattr(self.library, function)(ctypes.byref(self.host), *arguments):
            raise DermisError(ERRORS[status])

    def read(self, address: int) -> int:
        value = ctypes.c_uint16()
        self._checked("dermis_read", address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        self._checked("dermis_write", address, value)

    def set_up(self, **registers: int) -> None:
        pairs = [(rm.REGISTERS[name].address, value) for name, value in registers.items()]
        table = (ctypes.c_uint16 * 2 * len(pairs))(*pairs)
        self._checked("dermis_set_up", table, ctypes.c_size_t(len(pairs)))

    def frame(self, timeout_s: float = 1.0) -> spi.Frame:
        length, room = ctypes.c_size_t(), ctypes.c_size_t(len(self.bytes))
        self._checked("dermis_frame", round(1000 * timeout_s), self.bytes, room, ctypes.byref(length))
        return spi.parse_frame(self.bytes.raw[: length.value])


def session(host: Any, asked: dict[str, Any], outcome: dict[str, Any]) -> None:
    """Use a driver as a host does; write down what comes out, or the error."""
    try:
        host.set_up(GATE=50, SETTLE=6, TEST_RATE=0x1234)
        outcome["test_rate"] = host.read(rm.TEST_RATE)
        for _ in range(asked.get("settled", 0)):  # frames with the gate of before
            host.frame(2.0)
        frame = host.frame(asked.get("timeout_s", 2.0))
        outcome["frame"] = spi.pack_frame(frame).hex()
        outcome["number"] = frame.number
        if (address := asked.get("write")) is not None:
            host.write(address, 1)
    except DermisError as error:
        outcome["error"] = type(error).__name__ if isinstance(error, spi.SpiError) else str(error)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def drives(dut: Any) -> None:
    """A session of a driver, over a line with faults."""
    asked = scenario()
    chip = Chip(dut, asked["parameters"], levels=lambda frame, row: frame * 5 + row + 1)
    line = Line(Pins(dut, chip.clock_ps), asked.get("faults", {}))
    await chip.reset(enable=asked.get("enable", True))
    if asked.get("dead"):
        dut.rst_ni.value = 0
    selected = 0

    async def count() -> None:
        nonlocal selected
        while True:
            await FallingEdge(dut.spi_cs_ni)
            selected += 1

    cocotb.start_soon(count())
    transfer = cocotb.task.resume(line.transfer)
    host = (
        CHost(asked["library"], transfer, asked.get("room", 512))
        if asked["library"]
        else Host(transfer, LIMIT)
    )
    outcome: dict[str, Any] = {}
    await cocotb.task.bridge(session)(host, asked, outcome)
    if "number" in outcome:
        gate = 50 if asked.get("settled") else asked["parameters"]["GATE_CLOCKS"]
        outcome["expected"] = spi.pack_frame(chip.expected(outcome["number"], gate)).hex()
    outcome |= {"frames": line.frames, "largest": line.largest, "held": selected == line.transactions}
    report(outcome)
