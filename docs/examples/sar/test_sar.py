# SPDX-License-Identifier: Apache-2.0
import cocotb
import numpy as np
from cocotb.triggers import FallingEdge, RisingEdge

from dermis.lockstep import Compare, Cosim, Drive

V_REF = 1.8


@cocotb.test()
async def codes_are_the_sampled_input(dut):
    sim = Cosim(
        "sar.sp",
        inputs={
            "dut.top": Drive("vd_top"),
            # ideal capacitors between ideal sources have no time constant
            "dut.bottom": Drive("vd_bottom", abrupt=False),
            "dut.guess": Drive([f"vd_b{bit}" for bit in range(8)], high=V_REF, abrupt=False),
        },
        outputs={"dut.comp": Compare("top", above=0.0)},
        clock="dut.clk",
        period_s=1e-6,
        reset="dut.rst_n",
        probes=["vin", "d_top"],
    )
    codes = []
    async with sim.running(dut):
        for _ in range(100):
            await RisingEdge(dut.done)
            await FallingEdge(dut.clk)
            codes.append(int(dut.code.value))
    # the top switch opens in the ramp after an edge at which it is still closed
    closed = sim.samples["d_top"] > 0.5
    v_in = sim.samples["vin"][np.flatnonzero(closed[:-1] & ~closed[1:])][: len(codes)]
    exact = np.floor(v_in / V_REF * 256)  # a code is 7 mV, and vin moves by 2 uV in the ramp
    print(f"error = {(exact != codes).sum()} codes of {len(codes)}")
    assert len(set(codes)) > 90
    assert np.array_equal(exact, codes)
