# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_frame_buffer: a writer on clk and a reader on a clock of its own, both at random."""

import random
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, RisingEdge, Timer
from rtl_bench import report, scenario

CLOCK_PS = 200_000


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def whole_frames(dut: Any) -> None:
    """Every read sees one whole frame, the newest at its grant or a newer one; lost frames are counted."""
    s = scenario()
    rng = random.Random(s["seed"])
    size = s["bank_bytes"]
    written: list[bytes] = []

    dut.rst_ni.value = 0
    for pin in (dut.begin_i, dut.we_i, dut.byte_i, dut.end_i, dut.hold_toggle_i, dut.raddr_i):
        pin.value = 0
    dut.cs_ni.value = 1
    Clock(dut.clk_i, CLOCK_PS, "ps").start()
    await Timer(3 * CLOCK_PS, "ps")
    await FallingEdge(dut.clk_i)
    dut.rst_ni.value = 1

    async def clock(begin: int = 0, we: int = 0, byte: int = 0, end: int = 0) -> None:
        dut.begin_i.value, dut.we_i.value, dut.byte_i.value, dut.end_i.value = begin, we, byte, end
        await RisingEdge(dut.clk_i)
        await FallingEdge(dut.clk_i)
        dut.begin_i.value = dut.we_i.value = dut.end_i.value = 0

    async def writer() -> None:
        number = 0
        while True:
            number += 1
            length = rng.randint(2, size)
            frame = bytes([number & 0xFF] + [(number * 7 + n) & 0xFF for n in range(1, length)])
            joined = rng.random() < 0.5  # begin and end with a byte, or by themselves
            if not joined:
                await clock(begin=1)
            cut = rng.randrange(length) if rng.random() < 0.2 else None  # enable fell: the frame never ends
            for n, byte in enumerate(frame):
                if n == cut:
                    break
                ends = joined and n == length - 1
                if ends:
                    written.append(frame)
                await clock(begin=int(joined and n == 0), we=1, byte=byte, end=int(ends))
                for _ in range(rng.choice((0, 0, 0, 1))):
                    await clock()
            else:
                if not joined:
                    written.append(frame)
                    await clock(end=1)
            for _ in range(rng.choice((0, 1, 5, 40))):
                await clock()

    async def granted(toggle: int, period: int) -> None:
        for _ in range(200):
            await Timer(8 * period, "ps")
            if int(dut.hold_ack_o.value) == toggle:
                return
        raise AssertionError("no grant")

    cocotb.start_soon(writer())
    numbers: list[int] = []
    for _ in range(s["reads"]):
        period = int(CLOCK_PS * 10 ** rng.uniform(-1.3, 0.7))
        dut.cs_ni.value = 0
        await Timer(8 * period, "ps")
        ready = int(dut.frame_ready_o.value)
        toggle = 1 - int(dut.hold_toggle_i.value)
        dut.hold_toggle_i.value = toggle
        if rng.random() < 0.15:  # broken off before the grant; the next claim waits until this one was seen
            await Timer(period, "ps")
            dut.cs_ni.value = 1
            await Timer(rng.choice((1_000, period, 3 * CLOCK_PS)), "ps")
            dut.cs_ni.value = 0
            await granted(toggle, period)
            ready = int(dut.frame_ready_o.value)
            toggle = 1 - toggle
            dut.hold_toggle_i.value = toggle
        await granted(toggle, period)
        length = int(dut.length_o.value)
        data = bytearray()
        for n in range(length):
            dut.raddr_i.value = n
            await Timer(8 * period, "ps")
            data.append(int(dut.rdata_o.value))
        assert int(dut.length_o.value) == length, "the length moved during a read"
        if length:
            assert bytes(data) in written, f"torn: {data.hex(' ')}"
            number = len(written) - 1 - written[::-1].index(bytes(data))
            assert not (ready and numbers) or number > numbers[-1], "ready, and yet nothing newer"
            numbers.append(number)
        else:
            assert not ready, "ready, and nothing to read"
        await Timer(period, "ps")
        dut.cs_ni.value = 1
        # Often far too short for clk to see.
        await Timer(rng.choice((1_000, 5_000, CLOCK_PS, 5 * CLOCK_PS, 40 * CLOCK_PS)), "ps")
    assert numbers == sorted(numbers), "an older frame behind a newer one"
    report({"read": len(numbers), "different": len(set(numbers)), "lost": int(dut.lost_o.value)})
