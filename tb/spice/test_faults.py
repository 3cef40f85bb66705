# SPDX-License-Identifier: Apache-2.0
"""Seeded netlist faults: the tests of blocks and channels, which pass the right circuit, fail the wrong one."""

from collections.abc import Callable
from functools import partial

import pytest
import test_blocks as blocks
import test_channels as channels

from dermis.errors import SimulatorError
from dermis.scene.design import Design

transfer = partial(channels.test_dc_transfer_of_each_channel_is_its_k_and_sign, name="m")
charge = partial(channels.test_ideal_channels_integrate_exactly, r_ohm=500.0)
mirror = blocks.test_mirror_divides_by_each_k_of_its_pins
slow = partial(blocks.test_a_slow_mirror_follows_its_logistic_curve, q_lag_c=5e-14)
lag = blocks.test_mirror_of_a_channel_has_the_lag_that_a_deck_asks_for
driver = partial(blocks.test_row_driver_has_its_level_and_both_resistances, dut={})
packet = blocks.test_charge_source_gives_one_packet_a_pulse_of_either_sign

FAULTS = {
    "conveyor_x_and_y_swapped": (transfer, "channel", "xconveyor 0 col v_z", "xconveyor col 0 v_z"),
    "mirror_polarity_wrong": (transfer, "channel", "mirror polarity=1", "mirror polarity=-1"),
    "vfc_polarity_wrong": (charge, "channel", "vss_d vfc", "vss_d vfc_inverted"),
    "capacitor_1_ppm_off": (charge, "integrator", "iin out {c_int_f}", "iin out {1.000001*c_int_f}"),
    "preset_switch_missing": (charge, "integrator", "bpreset out iin i", "bpreset 0 0 i"),
    "preset_is_released_at_the_end_of_its_edge": (
        charge,
        "integrator",
        "v(d_preset,vss_d) > {0.95*supply_v_logic_v} ?\n+ (v(d_preset,vss_d) - {0.95*supply_v_logic_v})*",
        "v(d_preset) > 0 ?\n+ v(d_preset)*",
    ),
    "comparator_pins_swapped": (charge, "vfc", "xcomparator agnd v_int", "xcomparator v_int agnd"),
    "packet_5_percent_off": (packet, "charge_source", "vss d_charge vss_d {", "vss d_charge vss_d {1.05*"),
    "mirror_group_missing": (partial(mirror, dut={}), "mirror", "s2 v_gate v_2 d_k1", "s2 v_gate v_2 vss_d"),
    "compression_of_the_divided_current": (
        partial(mirror, dut={"inv_i_range_a": 100.0}),
        "mirror",
        "{inv_i_range_a}*abs(i(vin))",
        "{inv_i_range_a/80}*abs(i(vin))",
    ),
    "row_driver_pins_swapped": (driver, "row_driver", "v_drive agnd d_row", "agnd v_drive d_row"),
    "hysteresis_halved": (
        blocks.test_comparator_has_its_thresholds_gain_and_levels,
        "comparator",
        "? {0.5*g_in*v_hysteresis_v} : {-0.5*g_in*v_hysteresis_v}",
        "? {0.25*g_in*v_hysteresis_v} : {-0.25*g_in*v_hysteresis_v}",
    ),
    "lag_of_half_the_charge": (slow, "mirror_lag", "v_gate 0 {q_lag_c}", "v_gate 0 {0.5*q_lag_c}"),
    "lag_of_the_mirror_left_out": (lag, "mirror", "xlag v_late out 0 mirror_lag", "vlag v_late out 0 ;"),
}
"""Test, block, its text, and text in its place, by name of the fault."""


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_caught(measure: Callable[..., dict[str, float]], design: Design, fault: str) -> None:
    test, block, right, wrong = FAULTS[fault]
    path = f"behavioural/{'channel_conveyor_mirror' if block == 'channel' else block}.sp"
    faulty = partial(measure, edits={path: [(right, wrong)]})
    with pytest.raises((AssertionError, SimulatorError)):
        test(measure=faulty, design=design)
