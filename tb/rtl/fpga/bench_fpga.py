# SPDX-License-Identifier: Apache-2.0
"""cocotb bench of the board top: the pins of an FPGA."""

from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, Timer
from cocotb.utils import get_sim_time
from rtl_bench import report, scenario
from spi_client import Pins

from dermis.chip import register_map as rm

CLOCK_PS = 40_000


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def board(dut: Any) -> None:
    """A frame of comparators at 1 0 1 .., after power-up alone."""
    cols, divide = scenario()["cols"], scenario()["divide"]
    dut.comp_i.value = int("01" * 64, 2) & ((1 << cols) - 1)
    pins = Pins(dut, 2 * CLOCK_PS, prefix="")
    Clock(dut.clk_i, CLOCK_PS, "ps").start()
    charge: set[str] = set()
    test: list[str] = []

    async def watch() -> None:
        while True:
            await FallingEdge(dut.clk_i)
            charge.update(str(dut.charge_o.value))
            if (now := str(dut.test_o.value)) not in ("00", *test[-1:]):
                test.append(now)

    await Timer(8 * divide * CLOCK_PS, "ps")
    cocotb.start_soon(watch())
    found = await pins.read(rm.ID)
    times = []
    for _ in range(2):
        while not int(dut.ready_o.value):
            await Timer(CLOCK_PS, "ps")
        times.append(get_sim_time("ps") / CLOCK_PS)
        frame = await pins.frame()
    await pins.write(rm.CONTROL, rm.CONTROL_TEST_MASK)
    while not (await pins.read(rm.STATUS)) & rm.STATUS_TEST_DONE_MASK:
        pass
    report(
        {"id": found, "codes": frame.codes.tolist(), "clocks": times[1] - times[0]}
        | {"charge": sorted(charge), "cipo": str(dut.cipo_o.value), "test": test}
    )
