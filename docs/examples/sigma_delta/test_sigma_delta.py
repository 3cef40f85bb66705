# SPDX-License-Identifier: Apache-2.0
import cocotb
import numpy as np
from cocotb.triggers import ClockCycles

from dermis.lockstep import Compare, Cosim, Drive

V_IN, V_DD, CLOCKS = 0.6283, 1.8, 2000


@cocotb.test()
async def follows_its_closed_form(dut):
    sim = Cosim(
        "rc.sp",
        inputs={"dut.dac": Drive("vd_dac", low=V_DD, high=0.0)},
        outputs={"dut.comp": Compare("x", above=0.6)},
        clock="dut.clk",
        period_s=1e-6,
        reset="dut.rst_n",
        step_s=1e-7,
    )
    async with sim.running(dut):
        await ClockCycles(dut.clk, CLOCKS)
    x, t = sim.samples["x"], sim.times
    dac = np.where(np.concatenate([[False], x[1:-1] > 0.6]), 0.0, V_DD)  # level from event n on
    tau, ramp = 50e-6, 1e-9  # 100 kohm parallel to 100 kohm, 1 nF
    v, worst, before = x[0], 0.0, V_DD
    for n, level in enumerate(dac):
        # event n: the feedback ramps to its new level, then stays there
        slope, span = 0.5 * (level - before) / ramp, t[n + 1] - t[n]
        start = 0.5 * (V_IN + before) - tau * slope
        v = start + slope * ramp + (v - start) * np.exp(-ramp / tau)
        end = 0.5 * (V_IN + level)
        v = end + (v - end) * np.exp(-(span - ramp) / tau)
        worst, before = max(worst, abs(v - x[n + 1])), level
    print(f"error = {worst:.3g} V after {CLOCKS} clocks; ones = {int(dut.ones.value)}")
    assert worst < 5e-7  # of ngspice: it is 100 times larger with steps of 1 us
    assert abs(int(dut.ones.value) / CLOCKS - (1 - (1.2 - V_IN) / V_DD)) < 1e-2
