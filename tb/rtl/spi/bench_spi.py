# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_spi alone: the other clock domain is a model that answers when it likes, or never."""

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer, ValueChange
from rtl_bench import report, scenario
from spi_client import Pins

from dermis.chip import spi_protocol as spi

PERIOD_PS = 200_000


class OtherSide:
    """Model of registers and frame buffer at the toggles; `delay_ps` from toggle to acknowledge."""

    def __init__(self, dut: Any) -> None:
        self.dut = dut
        self.delay_ps = 100
        self.memory: dict[int, int] = {}
        self.accesses: list[tuple[int, int, int]] = []
        self.frame = b""
        for pin in (dut.ack_toggle_i, dut.rdata_i, dut.refused_i, dut.hold_ack_i, dut.frame_data_i):
            pin.value = 0
        dut.frame_length_i.value = 0
        for task in (self._requests, self._holds, self._reads):
            cocotb.start_soon(task())

    async def _late(self) -> None:
        await Timer(max(1, self.delay_ps), "ps")

    async def _requests(self) -> None:
        dut = self.dut
        while True:
            await ValueChange(dut.request_toggle_o)
            await Timer(1, "ps")  # the payload moves with the toggle
            if not dut.rst_ni.value:
                continue
            asked = (int(dut.write_o.value), int(dut.address_o.value), int(dut.wdata_o.value))
            await self._late()
            now = (int(dut.write_o.value), int(dut.address_o.value), int(dut.wdata_o.value))
            assert now == asked, f"a request moved while it crossed: {asked} became {now}"
            self.accesses.append(asked)
            write, address, value = asked
            refused = address >= 0xF0
            if write and not refused:
                self.memory[address] = value
            dut.rdata_i.value = self.memory.get(address, address * 257)
            dut.refused_i.value = int(refused)
            dut.ack_toggle_i.value = int(dut.request_toggle_o.value)

    async def _holds(self) -> None:
        while True:
            await ValueChange(self.dut.hold_toggle_o)
            if not self.dut.rst_ni.value:
                continue
            await self._late()
            self.dut.frame_length_i.value = len(self.frame)
            self.dut.frame_data_i.value = self.frame[0] if self.frame else 0xEE
            self.dut.hold_ack_i.value = int(self.dut.hold_toggle_o.value)

    async def _reads(self) -> None:
        while True:
            await ValueChange(self.dut.frame_address_o)
            address = int(self.dut.frame_address_o.value)
            self.dut.frame_data_i.value = self.frame[address] if address < len(self.frame) else 0xEE


async def start(dut: Any) -> tuple[Pins, OtherSide]:
    """Power up."""
    dut.rst_ni.value = 0
    mode = scenario().get("mode", 0)
    host, other = Pins(dut, PERIOD_PS, prefix="", mode=mode), OtherSide(dut)
    await Timer(PERIOD_PS, "ps")
    dut.rst_ni.value = 1
    await Timer(PERIOD_PS, "ps")
    return host, other


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def commands(dut: Any) -> None:
    """Every command and every answer, byte by byte, with answers that take from nothing to many bytes."""
    rng = random.Random(scenario()["seed"])
    host, other = await start(dut)
    errors = 0

    def error_toggle() -> int:
        return int(dut.error_toggle_o.value)

    for _ in range(scenario()["rounds"]):
        other.delay_ps = rng.choice((1, PERIOD_PS, 5 * PERIOD_PS, 30 * PERIOD_PS))
        address, value = rng.randrange(0xF0), rng.getrandbits(16)
        before = len(other.accesses)
        waits = await host.write(address, value)
        assert other.accesses[before:] == [(1, address, value)]
        # The acknowledge is sampled by the third edge after it, and used at the end of that byte.
        assert waits == -(-(other.delay_ps // PERIOD_PS + 3) // 8), (waits, other.delay_ps)
        assert await host.read(address) == value
        assert int(dut.cipo_oe_o.value) == 0
        # Refused by the registers, and by the CRC.
        for make, error in (
            (lambda: spi.write_register(0xF3, 1), spi.NoSuchRegister),
            (lambda: spi.read_register(0xFF), spi.NoSuchRegister),
        ):
            try:
                await host.run(make())
                raise AssertionError("not refused")
            except error:
                errors ^= 1
            assert error_toggle() == errors
        before = len(other.accesses)
        command = bytearray(spi.write_command(address, value ^ 1))
        command[rng.randrange(1, 5)] ^= 1 << rng.randrange(8)
        await host.select()
        assert not any(await host.exchange(bytes(command)))
        assert await host.exchange(bytes(4)) == bytes((spi.TOKEN_CRC, 0, 0, 0))
        await host.deselect()
        errors ^= 1
        assert (len(other.accesses), error_toggle()) == (before, errors)
        # An opcode there is not.
        await host.select()
        await host.exchange(bytes((rng.choice((0, 1, 4, 0x0A, 0x0C, 0x82, 0xFF)),)))
        assert await host.exchange(rng.randbytes(5)) == bytes((spi.TOKEN_OPCODE, 0, 0, 0, 0))
        await host.deselect()
        errors ^= 1
        assert error_toggle() == errors
        # A frame, then zeros.
        other.frame = rng.randbytes(rng.choice((0, 1, 2, 255, 256, 300)))
        await host.select()
        assert await host.answer(spi.read_frame_bytes()) == other.frame
        assert await host.exchange(bytes(3)) == bytes(3)
        await host.deselect()
    report(len(other.accesses))


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def bits_and_resets(dut: Any) -> None:
    """Any number of bits, then CS or reset, gives no request; nor does the rest of a command after a reset."""
    rng = random.Random(2)
    host, other = await start(dut)
    for count in range(41):
        command = spi.write_command(0x21, rng.getrandbits(16))
        before = len(other.accesses)
        await host.select()
        await host.exchange(command[: count // 8])
        if count % 8:
            await host.bits(command[count // 8], count % 8)
        await host.deselect()
        await Timer(2 * PERIOD_PS, "ps")
        assert len(other.accesses) == before + (count == 40), f"{count} bits"
        assert not int(dut.cipo_o.value)
    for _ in range(20):
        before = len(other.accesses)
        await host.select()
        await host.bits(rng.randrange(256), rng.randrange(1, 8))
        dut.rst_ni.value = 0
        await Timer(PERIOD_PS // 3, "ps")
        dut.ack_toggle_i.value = dut.hold_ack_i.value = 0
        dut.rst_ni.value = 1
        assert not any(await host.exchange(spi.write_command(0x21, 1)))
        assert not any(await host.exchange(bytes(4)))
        await host.deselect()
        await Timer(2 * PERIOD_PS, "ps")
        assert len(other.accesses) == before
        assert await host.write(0x21, 2) >= 1
