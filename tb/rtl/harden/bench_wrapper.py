# SPDX-License-Identifier: Apache-2.0
"""cocotb test of the Caravel-style wrapper: only pads are touched; test_harden.py says what it claims."""

from types import SimpleNamespace
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import Timer
from rtl_bench import report
from spi_client import Pins

from dermis.chip import register_map as rm

SCK, CS_N, COPI, CIPO, READY, ENABLE = 5, 6, 7, 8, 9, 10
GATE = 20


class Pad:
    """One GPIO of a vector of pads, as a handle."""

    def __init__(self, pads: Any, number: int) -> None:
        self.pads, self.number = pads, number

    @property
    def value(self) -> int:
        return int(self.pads.value) >> self.number & 1


class Driven(Pad):
    """One that the test drives: the vector's other bits keep their levels."""

    levels = 0

    @property
    def value(self) -> int:
        return Driven.levels >> self.number & 1

    @value.setter
    def value(self, level: int) -> None:
        Driven.levels = Driven.levels & ~(1 << self.number) | int(level) << self.number
        self.pads.value = Driven.levels


@cocotb.test(timeout_time=2, timeout_unit="ms")
async def read_out(dut: Any) -> None:
    """Identity, a register written, and a frame."""
    spi_pads = {"spi_sck_i": SCK, "spi_cs_ni": CS_N, "spi_copi_i": COPI}
    handles = {name: Driven(dut.io_in, number) for name, number in spi_pads.items()}
    handles["spi_cipo_o"] = Pad(dut.io_out, CIPO)
    dut.wb_rst_i.value = 1
    for quiet in ("wb_clk_i", "wbs_stb_i", "wbs_cyc_i", "wbs_we_i", "wbs_sel_i", "wbs_dat_i", "wbs_adr_i"):
        getattr(dut, quiet).value = 0
    dut.la_data_in.value = dut.la_oenb.value = dut.io_in_3v3.value = 0
    Clock(dut.user_clock2, 200, "ns").start()
    host = Pins(SimpleNamespace(**handles), 500_000)
    await Timer(1, "us")
    bias = [int(dut.u_front_end.d_enable.value)]
    dut.wb_rst_i.value = 0
    await Timer(2, "us")
    bias.append(int(dut.u_front_end.d_enable.value))
    analyser = int(dut.la_data_out.value)
    idle = int(dut.io_oeb.value)
    await host.select()
    selected = int(dut.io_oeb.value)
    await host.deselect()
    identity = await host.read(rm.ID)
    geometry = await host.read(rm.GEOMETRY)
    await host.write(rm.GATE, GATE)
    Driven(dut.io_in, ENABLE).value = 1
    while not Pad(dut.io_out, READY).value:
        await Timer(1, "us")
    frame = await host.frame()
    found = {"idle": idle, "selected": selected, "identity": identity, "geometry": geometry}
    report(found | {"codes": frame.codes.tolist(), "bias": bias, "analyser": analyser})
