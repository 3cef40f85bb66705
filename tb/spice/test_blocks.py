# SPDX-License-Identifier: Apache-2.0
"""Each behavioural block against the formulas of its parameters, with the values of design.toml."""

import math
from collections.abc import Callable

import pytest

from dermis.scene.design import Design

Measure = Callable[..., dict[str, float]]


def test_integrator_has_its_preset_its_slope_and_its_range(measure: Measure, design: Design) -> None:
    got, p, i = measure("integrator__tran"), design.integrator, 12.5e-6
    # out = v_sum + v_preset - i r_preset, v_sum = offset - out / gain, with what r_in takes from i
    i_eff = i - got["v_sum_again"] / p.r_in_ohm
    out = (0.5 - i_eff * p.r_preset_ohm + p.v_offset_v) / (1 + 1 / p.gain_dc)
    # The bench's vntol of 1e-9 V, which the operating point ends with.
    assert [got["v_preset"], got["v_preset_again"]] == pytest.approx([out, out], abs=1e-9)
    assert got["v_sum_again"] == pytest.approx(p.v_offset_v - out / p.gain_dc, abs=1e-9)
    # On a ramp the summing node is at offset + t_gbw |slope|, 9 mV, and feeds r_in. It moves by -d out / gain, so
    # the capacitor sees (1 + 1/gain) d out.
    i_ramp = i - (p.v_offset_v + design.derived()["integrator.t_gbw_s"] * 2.5e6) / p.r_in_ohm
    slope = -i_ramp / design.converter.c_int_f / (1 + 1 / p.gain_dc)
    # A difference of two voltages to 1e-9 V over 1 V, and of two times to 1e-16 s.
    assert got["slope"] == pytest.approx(slope, rel=1e-7, abs=0)
    # The clamp's own knee: 12.5 uA on 10 ohm and less.
    assert got["v_rail"] == pytest.approx(p.v_out_min_v, abs=0.2e-3)
    assert abs(got["v_sum_rail"]) < 2e-3, "the summing node left virtual ground"


def test_integrator_amplifier_has_its_gain_and_bandwidth(measure: Measure, design: Design) -> None:
    got = measure("integrator__ac")
    p = design.integrator
    # At 1 Hz the pole of 5 kHz is 1e-8 away; ngspice solves an ac point to rounding.
    assert got["gain_low"] == pytest.approx(p.gain_dc, rel=1e-6, abs=0)
    f_pole = p.gbw_hz / p.gain_dc
    # The pole's other factor, 1e-4 at 1 MHz; a crossing is interpolated between points of the sweep.
    assert got["gain_band"] == pytest.approx(p.gain_dc / math.hypot(1, 1e6 / f_pole), rel=1e-4, abs=0)
    assert got["gbw_hz"] == pytest.approx(p.gbw_hz, rel=1e-3, abs=0)


def test_comparator_has_its_thresholds_gain_and_levels(measure: Measure, design: Design) -> None:
    got, p = measure("comparator__dc"), design.comparator
    # The sweep steps by 2 uV: one step of it, and of two thresholds two and a half.
    assert got["offset_v"] == pytest.approx(p.v_offset_v, abs=2e-6)
    assert got["hysteresis_v"] == pytest.approx(p.v_hysteresis_v, abs=5e-6)
    half = (design.supply.vdd_v - design.supply.vss_v) / 2
    # out = half tanh(gain v / half) goes from -0.5 V to 0.5 V
    span = 2 * half * math.atanh(0.5 / half) / p.gain_dc
    # 1 V of output is 100 uV of input in a sweep of 2 uV: 2 % of a step's curvature, interpolated. tanh ends
    # 1 uV off the rails.
    assert got["v_one_volt"] == pytest.approx(span, rel=0.01, abs=0)
    assert got["v_low"] == pytest.approx(design.supply.vss_v, abs=1e-6)
    assert got["v_high"] == pytest.approx(design.supply.vdd_v, abs=1e-6)


def test_comparator_delays_a_ramp_and_a_step(measure: Measure, design: Design) -> None:
    got, p, slope = measure("comparator__tran"), design.comparator, 2.5e6
    for edge, sign in (("rise", 1), ("fall", -1)):
        late_s = p.t_delay_s + (sign * p.v_offset_v + p.v_hysteresis_v / 2) / slope
        # Steps of 1 ns; the crossing is interpolated to a fiftieth of one.
        assert got[f"delay_{edge}_s"] == pytest.approx(late_s, abs=0.02e-9)
    symmetrical = {"v_offset_v": 0.0, "v_hysteresis_v": 0.0}
    got = measure("comparator__tran", dut=symmetrical)
    # ln 2 of its pole. A step of 1 ns instead of none, and time steps of a fifth of the pole.
    assert got["delay_step_s"] == pytest.approx(math.log(2) * p.t_delay_s, rel=0.02, abs=0)
    # Beyond a twentieth of a clock it is a line, which delays a step and a ramp alike.
    late_s = 0.3 / design.converter.f_clk_hz
    got = measure("comparator__tran", dut=symmetrical | {"t_delay_s": late_s})
    # It asks for no finer steps than the bench's 1 ns, in one of which the output goes from rail to rail: half.
    assert [got["delay_step_s"], got["delay_rise_s"]] == pytest.approx([late_s, late_s], abs=0.5e-9)


def test_conveyor_is_its_input_resistance_and_a_single_pole(measure: Measure, design: Design) -> None:
    got = measure("conveyor__ac")
    for name in ("r_x_low_ohm", "r_x_high_ohm"):
        # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
        assert got[name] == pytest.approx(design.conveyor.r_x_ohm, rel=1e-9, abs=0)
    # ac points at 1 kHz, and at the pole rounded to 4 digits: (1 kHz / 20 MHz)^2 is 3e-9, then the digits of
    # the frequency.
    assert got["gain_low"] == pytest.approx(1 + design.conveyor.gain_error, rel=1e-6, abs=0)
    assert got["gain_pole"] / got["gain_low"] == pytest.approx(1 / math.sqrt(2), rel=1e-3, abs=0)
    assert got["gain_decade"] / got["gain_low"] == pytest.approx(1 / math.sqrt(101), rel=5e-3, abs=0)


@pytest.mark.parametrize("dut", [{}, {"gain_error": 0.01}])
def test_conveyor_dc_is_offset_resistance_gain_and_limit(measure: Measure, design: Design, dut: dict) -> None:
    got, p = measure("conveyor__dc", dut=dut), design.conveyor
    gain = 1 + dut.get("gain_error", p.gain_error)
    # A linear stretch; differences of ngspice's operating points to 1e-9 V; a slope over 1e6 ohm keeps six
    # digits.
    assert got["gain"] == pytest.approx(gain, rel=1e-9, abs=0)
    assert got["r_x_ohm"] == pytest.approx(p.r_x_ohm, rel=1e-6, abs=0)
    assert got["offset_v"] == pytest.approx(p.v_offset_v, abs=1e-9)
    assert got["g_z_s"] == pytest.approx(1 / p.r_z_ohm, rel=1e-6, abs=0)
    # beyond the limit 100 kohm remain: 0.7 V add 7 uA
    assert [got["i_max_a"], -got["i_min_a"]] == pytest.approx([p.i_out_max_a * gain] * 2, rel=1e-3, abs=0)


def test_mirror_settles_with_its_pole_and_faster_with_more_devices(measure: Measure, design: Design) -> None:
    got = measure("mirror__tran")
    tau = design.derived()["mirror.t_pole_s"]
    k = design.interface.k_options
    found = [got[name] for name in ("tau_fixed_s", "tau_k0_s", "tau_k3_s")]
    # Steps of 20 ps at a time constant of 8 ns, second order, and a logarithm of the ratio.
    assert found == pytest.approx([tau, tau, tau * k[0] / k[3]], rel=2e-3, abs=0)


# The mirror as it is, and with switches in series that compress its current, a pole and a lag.
@pytest.mark.parametrize("dut", [{}, {"inv_i_range_a": 100.0, "t_pole_s": 1e-9, "q_lag_c": 5e-14}])
def test_mirror_divides_by_each_k_of_its_pins(measure: Measure, design: Design, dut: dict) -> None:
    got, p = measure("mirror__dc", dut=dut), design.mirror
    copied = 1e-3 / (1 + 1e-3 * dut.get("inv_i_range_a", 0.0)) * (1 + p.ratio_error)
    for index, k in enumerate(design.interface.k_options):
        # Switches of 1e-3 ohm stand for the pins of k: 1e-4 of the gate's conductance.
        assert got[f"i_out_{index}"] == pytest.approx(copied / k, rel=1e-4, abs=0)
    # A settled pole and lag leave reltol 1e-9 of the deck. A slope over 5e7 ohm keeps six digits.
    assert got["i_out_fixed"] == pytest.approx(copied / design.interface.k, rel=1e-9, abs=0)
    assert got["i_out_sink"] == pytest.approx(-copied / design.interface.k, rel=1e-9, abs=0)
    assert got["g_out_s"] == pytest.approx(1 / p.r_out_ohm, rel=1e-6, abs=0)


def test_mirror_of_a_channel_has_the_lag_that_a_deck_asks_for(measure: Measure, design: Design) -> None:
    got = measure("mirror__tran", dut={"q_lag_c": 1e-13})
    settled_a = 1e-3 * (1 + design.mirror.ratio_error) / design.interface.k
    # 2 ns after a step from nothing it still gives nothing.
    assert got["i_end_fixed"] == pytest.approx(settled_a, rel=1e-3, abs=0)
    assert abs(got["i_fixed"]) < 1e-3 * settled_a


def logistic(settled: float, start: float, charge: float, t_s: float) -> float:
    """Current of a slow mirror t_s after its settled value became `settled`."""
    if settled == 0:
        return start / (1 + start * t_s / charge)
    return settled / (1 + (settled / start - 1) * math.exp(-settled * t_s / charge))


@pytest.mark.paper
@pytest.mark.parametrize("q_lag_c", [5e-14, 2e-13])
def test_a_slow_mirror_follows_its_logistic_curve(measure: Measure, design: Design, q_lag_c: float) -> None:
    got = measure("mirror_lag__tran", dut={"q_lag_c": q_lag_c})
    low, high = 1e-7, 1e-5
    top = logistic(high, low, q_lag_c, 9.9e-6)
    low_again, floor = logistic(low, top, q_lag_c, 10e-6), 1e-6 * 25e-6
    between = {
        "i_up": logistic(high, low, q_lag_c, 20e-9),
        "i_down": logistic(low, top, q_lag_c, 100e-9),
        "i_low_again": logistic(low, top, q_lag_c, 9.9e-6),
        "i_open": logistic(floor, low_again, q_lag_c, 10e-6),
    }
    # Settled values to the bench's reltol of 1e-6; in between trapezoids of a logistic curve, a thousandth.
    assert [got["i_start"], got["i_top"]] == pytest.approx([low, top], rel=1e-6, abs=0)
    assert {name: got[name] for name in between} == pytest.approx(between, rel=1e-3, abs=0)
    # The sunk copy is the same number.
    assert got["i_sunk"] == pytest.approx(-got["i_open"], rel=1e-9, abs=0)
    # what the gate took to rise: q ln(top / low)
    given = low * 0.1e-6 + high * 9.9e-6 - q_lag_c * math.log(top / low)
    # Of 1e-10 C the edge of 1 ns and trapezoids of the rise leave a part in 1e5.
    assert got["charge_c"] == pytest.approx(given, rel=1e-5, abs=0)


@pytest.mark.parametrize("dut", [{}, {"r_ground_ohm": 4.0}])
def test_row_driver_has_its_level_and_both_resistances(measure: Measure, design: Design, dut: dict) -> None:
    got, p = measure("row_driver__dc", dut=dut), design.row_driver
    # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
    assert got["v_driven"] == pytest.approx(design.interface.v_bias_v, rel=1e-9, abs=0)
    assert got["v_grounded"] == pytest.approx(0, abs=1e-12)
    assert got["r_on_ohm"] == pytest.approx(p.r_on_ohm, rel=1e-6, abs=0)
    assert got["r_ground_ohm"] == pytest.approx(dut.get("r_ground_ohm", p.r_ground_ohm), rel=1e-6, abs=0)


def test_charge_source_gives_one_packet_a_pulse_of_either_sign(measure: Measure, design: Design) -> None:
    got = measure("charge_source__tran")
    packet = design.derived()["converter.packet_c"] * (1 + design.charge.packet_error)
    # The integral of trapezoids whose corners are time points is exact; ten digits are printed.
    assert got["charge_c"] == pytest.approx(packet, rel=1e-9, abs=0)
    assert got["charge_negative_c"] == pytest.approx(-packet, rel=1e-9, abs=0)
    assert got["i_off"] == 0.0


def test_vfc_with_a_flip_flop_counts_charge_and_not_cycles(measure: Measure, design: Design) -> None:
    """Count 251 in 512 clocks at 510 ohm; 252 needs a start at w = +1/2, outside the converter's own range."""
    x = design.interface.v_bias_v / (design.interface.k * design.converter.i0_a * 510)
    for v_preset, w0 in ((0.5, -0.5), (0.0, 0.0), (-0.5, 0.5)):
        got = measure("vfc__tran", dut={"v_preset_v": v_preset})
        # decisions are at clocks 1..512 after the release; floor(w at the first of them + 511 x) + 1
        expected = math.floor(w0 + x + 511 * x) + 1
        # a pulse under way at the end of the measurement counts 0.9
        assert round(got["pulses"]) == expected
    assert expected == 252
    # XSPICE bridges switch at the end of their own 1 ns: 2.5 mV a ns at either end, mostly cancelling.
    assert got["v_end"] - got["balance_v"] == pytest.approx(v_preset - 0.5, abs=1e-3)
