# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_top with mismatched columns: a host calibrates it, then reads a frame."""

from __future__ import annotations

import functools
from typing import Any

import cocotb
import numpy as np
from cocotb.triggers import Timer
from numpy.typing import NDArray
from rtl_bench import report, scenario
from spi_client import Pins

from dermis.chip import column_calibration
from dermis.chip import spi_protocol as spi
from dermis.scene import design

SCK_PS = 400_000


async def channels(dut: Any, s: dict[str, Any]) -> None:
    """Drive the clock and the comparators: charge balance of every column in packets, half a clock at a time."""
    rows, cols = np.shape(s["duty"])
    duty, dark, full = (np.array(s[name]) for name in ("duty", "dark", "full"))
    packet, bits = np.array(s["packet"]), 1 << np.arange(cols)
    w = np.full(cols, -0.5)
    half, rest, before = Timer(100, "ns"), Timer(99, "ns"), Timer(1, "ns")

    def level(handle: Any) -> int:
        value = handle.value
        return int(value) if value.is_resolvable else 0

    @functools.cache
    def current(row: int, test: int) -> NDArray[np.float64]:
        x = dark + sum((duty[r] - dark for r in range(rows) if row >> r & 1), start=np.zeros(cols))
        return np.where(test & bits, x + full - dark, x)

    while True:
        dut.clk_i.value = 1
        await half
        row, test = level(dut.row_select_o), level(dut.test_current_o)
        dut.row_sense_i.value = row
        x = current(row, test)
        for wait in (None, rest):
            charge = level(dut.charge_o) & bits != 0
            w = np.full(cols, -0.5) if level(dut.preset_o) else w + 0.5 * (x - packet * charge)
            if wait is not None:
                dut.clk_i.value = 0
                await wait
        dut.comp_async_i.value = int(bits @ (w >= 0))
        await before


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def calibrate(dut: Any) -> None:
    s = scenario()
    for pin in (dut.rst_ni, dut.enable_i, dut.comp_async_i, dut.row_sense_i):
        pin.value = 0
    cocotb.start_soon(channels(dut, s))
    host = Pins(dut, SCK_PS)
    await Timer(1, "us")
    dut.rst_ni.value = 1
    await Timer(2, "us")
    dut.enable_i.value = 1
    steps = column_calibration.measure(design.load(), len(s["dark"]))
    made, count = None, 0
    step = next(steps)
    while made is None:
        try:
            count += 1
            step = steps.send(await host.run(step))
        except StopIteration as done:
            made = done.value
    while not int(dut.frame_ready_o.value):
        await Timer(10, "us")
    frame = await host.run(spi.read_frame())
    report(
        {
            "dark": made.dark.tolist(),
            "full": made.full.tolist(),
            "verdict": made.verdict,
            "codes": frame.codes.tolist(),
            "transactions": count,
        }
    )
