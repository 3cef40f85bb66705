# SPDX-License-Identifier: Apache-2.0
"""Netlist faults put in on purpose: each check that lets the right circuit pass must stop the wrong one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from dermis.design import Design
from dermis.errors import SimulatorError

Measure = Callable[..., dict[str, float]]
Edits = dict[str, Sequence[tuple[str, str]]]

CHANNEL = "behavioural/channel_conveyor_mirror.sp"


def check_transfer(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("channel_conveyor_mirror__dc", edits=edits)
    assert got["transfer"] == pytest.approx(1 / design.interface.k, rel=1e-9, abs=0)
    assert abs(got["v_col_full"]) < 1e-9


def check_charge(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("channel__tran", edits=edits)
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
    assert got["charge_c"] == pytest.approx(packet, rel=1e-9, abs=0)


def check_ratios(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("mirror__dc", edits=edits)
    for index, k in enumerate(design.interface.k_options):
        assert got[f"i_out_{index}"] == pytest.approx(
            1e-3 * (1 + design.mirror.ratio_error) / k, rel=1e-4, abs=0
        )


def check_row(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("row_driver__dc", edits=edits)
    assert got["v_driven"] == pytest.approx(design.interface.v_bias_v, rel=1e-9, abs=0)
    assert got["v_grounded"] == pytest.approx(0.0, abs=1e-12)


def check_comparator(measure: Measure, design: Design, edits: Edits) -> None:
    got = measure("comparator__dc", edits=edits)
    assert got["hysteresis_v"] == pytest.approx(design.comparator.v_hysteresis_v, abs=5e-6)


CHECKS = (
    check_transfer,
    check_charge,
    check_decision,
    check_packet,
    check_ratios,
    check_row,
    check_comparator,
)

FAULTS = {
    "conveyor_x_and_y_swapped": (check_transfer, CHANNEL, "xconveyor 0 col v_z", "xconveyor col 0 v_z"),
    "mirror_in_and_out_swapped": (check_transfer, CHANNEL, "xmirror v_z v_sum", "xmirror v_sum v_z"),
    "mirror_ratio_doubled": (check_transfer, CHANNEL, "+ k={k} ratio", "+ k={2*k} ratio"),
    "mirror_polarity_wrong": (check_transfer, CHANNEL, "mirror polarity=1", "mirror polarity=-1"),
    "vfc_polarity_wrong": (check_charge, CHANNEL, "vfc polarity=1", "vfc polarity=-1"),
    "packet_5_percent_off": (
        check_packet,
        "behavioural/charge_source.sp",
        "gpacket out vss d_charge 0 {i0_a*",
        "gpacket out vss d_charge 0 {1.05*i0_a*",
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
        "v(d_preset) > 0.95 ?\n+ (v(d_preset) - 0.95)*",
        "1 > 0 ?\n+ 0.05*",
    ),
    "preset_lets_go_at_the_end_of_its_edge": (
        check_charge,
        "behavioural/integrator.sp",
        "v(d_preset) > 0.95 ?\n+ (v(d_preset) - 0.95)*",
        "v(d_preset) > 0 ?\n+ v(d_preset)*",
    ),
    "comparator_pins_swapped": (
        check_decision,
        "behavioural/vfc.sp",
        "xcomparator 0 v_int",
        "xcomparator v_int 0",
    ),
    "comparator_pins_swapped_where_inverted": (
        check_decision,
        "behavioural/vfc.sp",
        "xcomparator v_int 0",
        "xcomparator 0 v_int",
    ),
    "mirror_group_missing": (
        check_ratios,
        "behavioural/mirror.sp",
        "s2 v_gate v_2 d_k1 0",
        "s2 v_gate v_2 0 0",
    ),
    "row_driver_pins_swapped": (
        check_row,
        "behavioural/row_driver.sp",
        "edrive v_drive vss_ref d_row 0",
        "edrive vss_ref v_drive d_row 0",
    ),
    "hysteresis_halved": (
        check_comparator,
        "behavioural/comparator.sp",
        "? {0.5*v_hysteresis_v} : {-0.5*v_hysteresis_v}",
        "? {0.25*v_hysteresis_v} : {-0.25*v_hysteresis_v}",
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
