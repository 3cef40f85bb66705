# SPDX-License-Identifier: Apache-2.0
"""Seeded netlist faults: each check passes the right circuit and fails the wrong one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pytest

from dermis.errors import SimulatorError
from dermis.scene.design import Design

Measure = Callable[..., dict[str, float]]
Edits = dict[str, Sequence[tuple[str, str]]]

CHANNEL = "behavioural/channel_conveyor_mirror.sp"
LAG = "behavioural/mirror_lag.sp"


def check_transfer(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("channel_conveyor_mirror__dc", edits=edits)
    # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
    assert got["transfer"] == pytest.approx(1 / design.interface.k, rel=1e-9, abs=0)
    assert abs(got["v_col_full"]) < 1e-9


def check_charge(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("channel__tran", edits=edits)
    # The bench's vntol of 1e-9 V: the lines between corners are straight.
    assert got["v_preset_m"] == pytest.approx(0.5, abs=1e-9)
    assert got["v_clock_m"] == pytest.approx(0.0, abs=1e-9)
    assert got["v_train_m"] == pytest.approx(0.0, abs=1e-9)
    assert got["v_again_m"] == pytest.approx(0.5, abs=1e-9)


def check_decision(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("channel__tran", edits=edits)
    for name in "dmio":
        assert got[f"comp_end_{name}"] == pytest.approx(design.supply.vdd_v)
    got = measure("channel__tran", params={"r_taxel": 1e18}, edits=edits)
    for name in "dmio":
        assert got[f"comp_end_{name}"] == pytest.approx(design.supply.vss_v)


def check_packet(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("charge_source__tran", edits=edits)
    packet = design.converter.packet_c * (1 + design.charge.packet_error)
    # The integral of trapezoids whose corners are time points is exact; ten digits are printed.
    assert got["charge_c"] == pytest.approx(packet, rel=1e-9, abs=0)


def check_ratios(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("mirror__dc", edits=edits)
    for index, k in enumerate(design.interface.k_options):
        # Switches of 1e-3 ohm stand for the pins of k: 1e-4 of the gate's conductance.
        assert got[f"i_out_{index}"] == pytest.approx(
            1e-3 * (1 + design.mirror.ratio_error) / k, rel=1e-4, abs=0
        )


def check_lag(measure: Measure, design: Design, edits: Edits) -> None:
    """From 0.1 uA towards 10 uA, half way back, and to nothing: dy/dt = y (x - y) / q at every look."""
    got = measure("mirror_lag__tran", edits=edits)
    q, low, high = design.mirror.q_lag_c, 1e-7, 1e-5
    up = high / (1 + (high / low - 1) * math.exp(-high * 20e-9 / q))
    down = low / (1 + (low / high - 1) * math.exp(-low * 100e-9 / q))
    last = low / (1 + (low / high - 1) * math.exp(-low * 10e-6 / q))
    # Here the formula starts from the settled current, which the circuit has reached to some thousandths.
    assert got["i_up"] == pytest.approx(up, rel=5e-3, abs=0)
    assert got["i_down"] == pytest.approx(down, rel=5e-3, abs=0)
    assert got["i_open"] == pytest.approx(last / (1 + last * 10e-6 / q), rel=5e-3, abs=0)
    assert got["i_sunk"] == pytest.approx(-got["i_open"], rel=1e-9, abs=0)
    taken = got["charge_c"] - low * 0.1e-6 - high * 9.9e-6
    # As above, of a charge that is a hundredth of what flows.
    assert taken == pytest.approx(-q * math.log(high / low), rel=1e-3, abs=0)


def check_late_channel(measure: Measure, design: Design, edits: Edits) -> None:
    """The mirror of a channel with the lag that a deck asks for."""
    got = measure("mirror__tran", dut={"q_lag_c": 1e-13}, edits=edits)
    # 2 ns after a step from nothing it still gives nothing
    assert got["i_end_fixed"] == pytest.approx(
        1e-3 * (1 + design.mirror.ratio_error) / design.interface.k, rel=1e-3, abs=0
    )
    assert abs(got["i_fixed"]) < 1e-3 * got["i_end_fixed"]


def check_compression(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("mirror__dc", dut={"inv_i_range_a": 100.0}, edits=edits)
    copied = 1e-3 / (1 + 1e-3 * 100) * (1 + design.mirror.ratio_error)
    # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
    assert got["i_out_fixed"] == pytest.approx(copied / design.interface.k, rel=1e-9, abs=0)
    assert got["i_out_sink"] == pytest.approx(-copied / design.interface.k, rel=1e-9, abs=0)


def check_row(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("row_driver__dc", edits=edits)
    # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
    assert got["v_driven"] == pytest.approx(design.interface.v_bias_v, rel=1e-9, abs=0)
    assert got["v_grounded"] == pytest.approx(0.0, abs=1e-12)


def check_comparator(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("comparator__dc", edits=edits)
    # The sweep steps by 2 uV: two and a half of it for two thresholds.
    assert got["hysteresis_v"] == pytest.approx(design.comparator.v_hysteresis_v, abs=5e-6)


CHECKS = (
    check_transfer,
    check_charge,
    check_decision,
    check_packet,
    check_ratios,
    check_row,
    check_comparator,
    check_lag,
    check_late_channel,
    check_compression,
)

FAULTS = {
    "conveyor_x_and_y_swapped": (check_transfer, CHANNEL, "xconveyor 0 col v_z", "xconveyor col 0 v_z"),
    "mirror_in_and_out_swapped": (check_transfer, CHANNEL, "xmirror v_z v_sum", "xmirror v_sum v_z"),
    "mirror_ratio_doubled": (check_transfer, CHANNEL, "+ k={k} ratio", "+ k={2*k} ratio"),
    "mirror_polarity_wrong": (check_transfer, CHANNEL, "mirror polarity=1", "mirror polarity=-1"),
    "vfc_polarity_wrong": (check_charge, CHANNEL, "vss_d vfc", "vss_d vfc_inverted"),
    "packet_5_percent_off": (
        check_packet,
        "behavioural/charge_source.sp",
        "gpacket out vss d_charge vss_d {i0_a*",
        "gpacket out vss d_charge vss_d {1.05*i0_a*",
    ),
    "packet_5_percent_off_in_a_channel": (check_charge, CHANNEL, "+ i0_a={i0_a}", "+ i0_a={1.05*i0_a}"),
    "capacitor_1_ppm_off": (
        check_charge,
        "behavioural/integrator.sp",
        "cint iin out {c_int_f}",
        "cint iin out {1.000001*c_int_f}",
    ),
    "preset_switch_missing": (
        check_charge,
        "behavioural/integrator.sp",
        "bpreset out iin i",
        "bpreset 0 0 i",
    ),
    "preset_never_lets_go": (
        check_charge,
        "behavioural/integrator.sp",
        "v(d_preset,vss_d) > {0.95*supply_v_logic_v} ?\n+ (v(d_preset,vss_d) - {0.95*supply_v_logic_v})*",
        "1 > 0 ?\n+ 0.05*",
    ),
    "preset_lets_go_at_the_end_of_its_edge": (
        check_charge,
        "behavioural/integrator.sp",
        "v(d_preset,vss_d) > {0.95*supply_v_logic_v} ?\n+ (v(d_preset,vss_d) - {0.95*supply_v_logic_v})*",
        "v(d_preset) > 0 ?\n+ v(d_preset)*",
    ),
    "comparator_pins_swapped": (
        check_decision,
        "behavioural/vfc.sp",
        "xcomparator agnd v_int",
        "xcomparator v_int agnd",
    ),
    "comparator_pins_swapped_where_inverted": (
        check_decision,
        "behavioural/vfc.sp",
        "xcomparator v_int agnd",
        "xcomparator agnd v_int",
    ),
    "mirror_group_missing": (
        check_ratios,
        "behavioural/mirror.sp",
        "s2 v_gate v_2 d_k1 vss_d",
        "s2 v_gate v_2 vss_d vss_d",
    ),
    "row_driver_pins_swapped": (
        check_row,
        "behavioural/row_driver.sp",
        "edrive v_drive agnd d_row vss_d",
        "edrive agnd v_drive d_row vss_d",
    ),
    "hysteresis_halved": (
        check_comparator,
        "behavioural/comparator.sp",
        "? {0.5*g_in*v_hysteresis_v} : {-0.5*g_in*v_hysteresis_v}",
        "? {0.25*g_in*v_hysteresis_v} : {-0.25*g_in*v_hysteresis_v}",
    ),
    "lag_with_a_fixed_time_constant": (
        check_lag,
        LAG,
        "{i_ref_a}*exp(v(v_gate))",
        "{i_ref_a}*(6 + v(v_gate))",
    ),
    "lag_of_half_the_charge": (check_lag, LAG, "cgate v_gate 0 {q_lag_c}", "cgate v_gate 0 {0.5*q_lag_c}"),
    "lag_gate_driven_backwards": (check_lag, LAG, "bgate 0 v_gate", "bgate v_gate 0"),
    "lag_output_drawn": (check_lag, LAG, "fout 0 out vcopy", "fout out 0 vcopy"),
    "lag_floor_too_high": (check_lag, LAG, "{1e-6*i_ref_a}", "{1e-3*i_ref_a}"),
    "lag_ends_swapped_in_the_mirror": (
        check_late_channel,
        "behavioural/mirror.sp",
        "xlag v_late out 0 mirror_lag",
        "xlag v_late 0 out mirror_lag",
    ),
    "lag_of_the_mirror_left_out": (
        check_late_channel,
        "behavioural/mirror.sp",
        "xlag v_late out 0 mirror_lag",
        "vlag v_late out 0 ;",
    ),
    "compression_of_the_divided_current": (
        check_compression,
        "behavioural/mirror.sp",
        "{inv_i_range_a}*abs(i(vin))",
        "{inv_i_range_a/80}*abs(i(vin))",
    ),
}


@pytest.mark.parametrize("check", CHECKS)
def test_the_right_circuit_passes(measure: Measure, design: Design, check: Callable[..., None]) -> None:
    check(measure, design, {})


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_caught(measure: Measure, design: Design, fault: str) -> None:
    check, path, right, wrong = FAULTS[fault]
    with pytest.raises((AssertionError, SimulatorError)):
        check(measure, design, {path: [(right, wrong)]})
