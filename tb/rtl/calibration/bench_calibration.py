# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_top with mismatched columns: a host calibrates it, then reads a frame."""

import functools
from collections.abc import Mapping
from typing import Any

import cocotb
import numpy as np
from cocotb.triggers import Timer
from numpy.typing import NDArray
from rtl_bench import report, scenario
from spi_client import Pins
from top_bench import Chip

from dermis.chip import column_calibration
from dermis.scene import design


class Channels:
    """Charge balance of mismatched columns, in packets; methods as in AnalogColumns."""

    def __init__(self, s: Mapping[str, Any]) -> None:
        names = "duty", "dark", "full", "packet"
        self.duty, self.dark, self.full, self.packet = (np.array(s[name]) for name in names)
        self.bits = 1 << np.arange(len(self.dark))
        self.w = np.full(len(self.dark), -0.5)

    @functools.cache  # noqa: B019
    def _current(self, rows: int, test: int) -> NDArray[np.float64]:
        driven = [row - self.dark for r, row in enumerate(self.duty) if rows >> r & 1]
        return sum(driven, start=self.dark) + np.where(test & self.bits, self.full - self.dark, 0.0)

    def half_clock(self, rows: int, preset: int, charge: int, test: int) -> None:
        step = 0.5 * (self._current(rows, test) - self.packet * (charge & self.bits != 0))
        self.w = np.full(len(self.dark), -0.5) if preset else self.w + step

    def comparators(self) -> int:
        return int(self.bits @ (self.w >= 0))


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def calibrate(dut: Any) -> None:
    s = scenario()
    rows, cols = np.shape(s["duty"])
    chip = Chip(dut, {"ROWS": rows, "COLS": cols}, analog=Channels(s))
    host = Pins(dut, 2 * chip.clock_ps)
    await chip.reset()
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
    frame = await host.frame()
    seen = {"dark": made.dark.tolist(), "full": made.full.tolist(), "verdict": made.verdict}
    report(seen | {"codes": frame.codes.tolist(), "transactions": count})
