# SPDX-License-Identifier: Apache-2.0
"""A ripple's course within a clock in the event engine: what its mean leaves out, against small steps."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from made_plans import made

from dermis import engines, records
from dermis.engines import event, filter
from dermis.errors import InputError


def counted_in_small_steps(plan: records.Plan) -> int:
    """Code of one taxel through a compression and an integrator with a range: 64 instants a clock, straight from the
    definition."""
    converter, timing, drive = plan.converter, plan.timing, plan.drive
    unit = float((converter.k * converter.i0_a)[0])
    x_0, bend = plan.v_bias_v / plan.resistance_ohm[0, 0, 0] / unit, unit * converter.inv_i_range_a[0]
    low, high = converter.range_v()[:, 0] / converter.packet_v()[0]
    charge, flows, late, ones = -0.5, 0, 0, 0
    for clock in range(timing.settle_clocks, timing.settle_clocks + timing.gate_clocks):
        t = (clock + (np.arange(64) + 0.5) / 64) / timing.f_clk_hz
        sine = np.sin(2 * math.pi * drive.f_ripple_hz * t + drive.phase_ripple_rad)
        x = x_0 * (1 + drive.ripple * sine)
        x = x / (1 + bend * np.abs(x))
        for step in (x - flows) / 64 if np.isfinite(high) else [x.mean() - flows]:
            charge = min(max(charge + step, low), high)
        one = charge >= 0 and not late
        # A packet flows from one clock after its decision to the next.
        flows, late = late, int(one)
        ones += late
    return ones


def rippling(tmp_path: Path, x: float, relative: float, f_hz: float, **effects: object) -> records.Plan:
    ripple = {"relative": relative, "frequency_hz": f_hz, "phase_deg": 40.0}
    return made(tmp_path, np.full((1, 1, 1), 250.0 / x), {"supply_ripple": ripple, **effects})


def compressed(h: float) -> dict[str, float]:
    """A range switch by which a duty of 1 becomes 1 / (1 + h)."""
    return {"r_ohm": h * 50.0, "v_overdrive_v": 0.1}


@pytest.mark.paper
def test_a_fast_ripple_beside_a_compression_is_refused_by_name(tmp_path: Path) -> None:
    plan = rippling(tmp_path, 250 / 530, 0.8, 4.1e6, range_switch={"r_ohm": 30.0, "v_overdrive_v": 0.1})
    said = "effects.supply_ripple = on together with range_switch: a ripple whose waveform within a clock is "
    said += "certain to 1 LSB (here 13); use engine cosim"
    for engine in ("event", "rtl"):
        assert str(engines.refuses(plan, engine)).endswith(said)
    with pytest.raises(InputError, match="here 13"):
        event.run(plan)


@pytest.mark.paper
def test_every_frame_is_asked_for_its_ripple(tmp_path: Path) -> None:
    """Dim sheets in front and a full one, whose cells are at full scale: the frame in between is refused in the run."""
    ohm = np.array([1e5, 530.0, 1e-3]).reshape(3, 1, 1)
    on = {"supply_ripple": {"relative": 0.5, "frequency_hz": 4.1e6}, "range_switch": compressed(0.6)}
    plan = made(tmp_path, ohm, on)
    assert event.refuses(plan) is None
    for engine in (event, filter):
        with pytest.raises(InputError, match="on together with range_switch"):
            engine.run(plan)
    assert event.run(plan.part(2, 3)).codes[0, 0, 0] == 255
    assert event.run(plan.part(0, 1)).codes[0, 0, 0] == counted_in_small_steps(plan.part(0, 1))


@pytest.mark.parametrize(("relative", "f_hz"), [(0.8, 100e3), (0.3, 600e3), (0.05, 4.1e6)])
def test_slow_or_small_ripples_beside_compression_pass(tmp_path: Path, relative: float, f_hz: float) -> None:
    plan = rippling(tmp_path, 250 / 530, relative, f_hz, range_switch=compressed(0.6))
    assert event.refuses(plan) is None
    # What is left out without a word is below a count, which moves a code by one.
    assert abs(int(event.run(plan).codes[0, 0, 0]) - counted_in_small_steps(plan)) <= 1


@pytest.mark.paper
@pytest.mark.parametrize("delay", [1.0, 0.5])
def test_a_ripple_within_a_clock_changes_nothing_at_a_range_unless_the_charge_turns_there(
    tmp_path: Path, delay: float
) -> None:
    lost = 0
    for x, f_hz in ((0.2, 2.1e6), (0.31, 4.7e6), (0.44, 3.3e6)):
        narrow = {"v_max_v": 0.6, "v_min_v": -0.05}
        plan = rippling(tmp_path, x, 0.9, f_hz, integrator_range=narrow)
        timing = dataclasses.replace(plan.timing, charge_delay_clocks=delay)
        plan = dataclasses.replace(plan, timing=timing)
        if delay == 1.0:
            code = counted_in_small_steps(plan)
            assert event.run(plan).codes[0, 0, 0] == code
            lost += round(510 * x) - code
        else:  # a packet that begins within a clock makes a corner there
            with pytest.raises(InputError, match="on together with integrator_range"):
                event.run(plan)
    # Without a loss nothing would have been shown.
    assert delay != 1.0 or lost > 10
