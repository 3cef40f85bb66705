# SPDX-License-Identifier: Apache-2.0
import cocotb
import numpy as np
from cocotb.triggers import Timer

from dermis.lockstep import Compare, Cosim, Drive

LOW, HIGH, TAU, RAMP = 1 / 3, 2 / 3, 1e-6, 1e-9


def leg(v, before, after, target):
    """Seconds from v to target while q goes from `before` to `after` in a ramp and stays there."""
    slope = (after - before) / RAMP
    start = before - TAU * slope
    v = start + slope * RAMP + (v - start) * np.exp(-RAMP / TAU)
    return RAMP + TAU * np.log((after - v) / (after - target))


@cocotb.test()
async def oscillates_with_its_exact_period(dut):
    sim = Cosim(
        "rc.sp",
        inputs={"dut.q": Drive("vd_q", edge_s=RAMP)},
        outputs={"dut.above_low": Compare("x", above=LOW), "dut.above_high": Compare("x", above=HIGH)},
        step_s=2e-9,
    )
    async with sim.running(dut):
        await Timer(30, unit="us")
    x, t = sim.samples["x"], sim.times
    turns = t[np.abs(x - LOW) < 1e-9][::2]  # it comes back over the threshold within a ramp
    exact = leg(HIGH, 1, 0, LOW) + leg(LOW, 0, 1, HIGH)
    error = np.abs(np.diff(turns) - exact).max()
    print(f"error = {error:.3g} s of {len(turns)} periods; overshoot {sim.overshoot_v:.3g} V")
    assert sim.overshoot_v < 2e-12
    assert error < 1e-12  # of ngspice: it grows with the square of the step
    assert abs(int(dut.periods.value) - len(turns)) <= 1
    assert int(dut.divided.value) == int(dut.periods.value) % 4
