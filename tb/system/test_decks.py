# SPDX-License-Identifier: Apache-2.0
"""Content of a deck: the elements of each effect that is on, nothing of others, and the array."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from system_bench import OF_THE_CHIP, RANDOM, SENSOR, MakePlan, scene_of

from dermis import effects
from dermis.chip import netlist
from dermis.chip.netlist import frame_deck
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES

ROWS, COLS = 3, 4
LEVELS = [0.0] * (ROWS + 1 + COLS)

# Two frames: the first moves to the second in all taxels but one. One taxel is open, one a short.
OHM = 510 * 60 ** np.random.default_rng(8).random((2, ROWS, COLS))
OHM[1, 2, 3] = OHM[0, 2, 3]
OHM[0, 0, 1], OHM[0, 1, 2] = np.inf, 0.0

TAXELS = ROWS * COLS - 1  # the open one has no element
MOVING = ROWS * COLS - 1


def names(count: int, *stems: str) -> Counter[str]:
    return Counter(dict.fromkeys(stems, count))


# By effect: the number of elements and parameters that it adds to the deck, each name with # for its numbers. A
# parameter is written element.parameter; `.options` limits the steps to a pole. An effect without a row adds anything.
MIRRORED = ("conveyor_mirror", "conveyor_mirror_inverted")
ADDS: dict[str, Counter[str]] = {
    "lateral": names(ROWS * (COLS - 1), "rlat_r#c#"),
    "row_driver": names(ROWS, "xrow#.r_on_ohm", "xrow#.r_ground_ohm"),
    "pad": names(ROWS, "rpad_row#", "xrow#") + names(COLS, "rpad_col#", "xch#"),
    "return": names(ROWS, "xrow#", "xrow#.follow") + names(1, "rreturn"),
    "column_input": names(COLS, "xch#.conv_r_x_ohm"),
    "column_offset": names(COLS, "xch#.conv_v_offset_v"),
    "mirror_ratio": names(COLS, "xch#.mir_ratio_error"),
    "offset_current": names(COLS, "ioffset#"),
    "integrator_gain": names(COLS, "xch#.int_gain_dc", "xch#.int_r_in_ohm"),
    "integrator_range": names(COLS, "xch#.int_v_out_max_v", "xch#.int_v_out_min_v") + names(1, ".options"),
    "comparator_offset": names(COLS, "xch#.comp_v_offset_v"),
    "comparator_hysteresis": names(COLS, "xch#.comp_v_hysteresis_v") + names(1, ".options"),
    "comparator_delay": names(COLS, "xch#.comp_t_delay_s") + names(1, ".options"),
    "charge_packet": names(COLS, "xch#.packet_error"),
    "preset_error": names(COLS, "xch#.v_preset_v"),
    "trace": names(ROWS * COLS, "rtrace_row_r#c#", "rtrace_col_r#c#") + names(TAXELS, "rtaxel_r#c#"),
    "line_capacitance": Counter({"crow#": ROWS, "ccolumn#": COLS, "ctaxel_r#c#": ROWS * COLS, ".options": 1}),
    "mux_leakage": names(COLS, "ileak#"),
    "mirror_output": names(COLS, "xch#.int_r_in_ohm"),
    "mirror_lag": names(COLS, "xch#.out_q_lag_c") + names(1, ".options"),
    "range_switch": names(COLS, "xch#.out_inv_i_range_a"),
    "integrator_bandwidth": names(COLS, "xch#.int_t_gbw_s") + names(1, ".options"),
    "reference_drift": names(COLS, "xch#.packet_error"),
    "supply_ripple": names(1, "vbias") + names(ROWS, "xrow#.follow"),
    "motion": names(MOVING, "btaxel_r#c#"),
}

# There in every deck, at the ideal value or between other nodes where nothing departs from it.
ALWAYS = {
    "xch#", "xrow#", "xch#.v_preset_v", "xrow#.r_on_ohm", "xrow#.r_ground_ohm", "vbias", ".options", "rtaxel_r#c#",
}  # fmt: skip


def atoms(plan: Plan, frame: int = 0) -> Counter[str]:
    """A deck as a set of elements and of parameters of blocks, each with its value."""
    found: Counter[str] = Counter()
    for line in frame_deck(plan, frame, LEVELS).lines:
        if re.match(r"x(ch|row)\d+ ", line):
            words = line.split()
            found[" ".join(w for w in words if "=" not in w)] += 1
            for word in words:
                if "=" in word:
                    found[f"{words[0]}.{word}"] += 1
        else:
            found[line] += 1
    return found


def kinds(some: Counter[str]) -> Counter[str]:
    """Their names without numbers and values."""
    found: Counter[str] = Counter()
    for atom, count in some.items():
        name = re.sub(r"\d+", "#", re.split(r"[ =]", atom, maxsplit=1)[0])
        found[name] += count
    return found


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_effects_named_and_switched_off_leave_the_deck_as_it_is_without_them(
    resistance_plan: MakePlan, topology: str
) -> None:
    bare = [frame_deck(resistance_plan(OHM, topology), f, LEVELS) for f in (0, 1)]
    off = resistance_plan(OHM, topology, scene_of(dict.fromkeys(effects.EFFECTS, False)))
    assert [frame_deck(off, f, LEVELS) for f in (0, 1)] == bare


@pytest.mark.parametrize("topology", MIRRORED)
@pytest.mark.parametrize("name", sorted(OF_THE_CHIP))
def test_an_effect_alone_adds_exactly_its_own_elements(
    resistance_plan: MakePlan, topology: str, name: str
) -> None:
    bare = atoms(resistance_plan(OHM, topology))
    got = atoms(resistance_plan(OHM, topology, scene_of({name: True})))
    added = kinds(got - bare)
    assert added == ADDS.get(name, added)
    assert added, "no element and no parameter"
    # What goes is replaced: a value that is always written, taxels that trace and motion write in another way.
    gone = kinds(bare - got)
    assert gone.keys() <= ({"rtaxel_r#c#"} if name in ("trace", "motion") else ALWAYS - {"rtaxel_r#c#"})
    if name == "motion":  # the open taxel had no element before
        assert gone == names(MOVING - 1, "rtaxel_r#c#")


def test_shared_values_are_sums_of_what_each_effect_adds(resistance_plan: MakePlan) -> None:
    both = (
        "integrator_gain = { gain_dc = 1e3, r_in_ohm = 2e6 }\nmirror_output = { r_out_ohm = 6e6 }\n"
        "charge_packet = { packet_error = 0.01 }\nreference_drift = { tc_per_k = 1e-4, delta_k = 20.0 }\n"
    )
    line = next(li for li in frame_deck(resistance_plan(OHM, effects=both), 0, LEVELS).lines if "xch2 " in li)
    value = {k: float(v) for k, v in (w.split("=") for w in line.split() if "=" in w)}
    # A deck has 15 digits of a number, and a parallel of two is three roundings.
    assert value["int_r_in_ohm"] == pytest.approx(1.5e6, rel=1e-12)
    assert value["packet_error"] == pytest.approx(0.012, rel=1e-12)


def test_random_effects_are_refused_and_sensor_effects_are_only_other_resistances(
    resistance_plan: MakePlan,
) -> None:
    for name in RANDOM:
        fields = resistance_plan(OHM, effects=f"{name} = true").active_fields()
        assert fields - netlist.HONOURS, name
    bare = kinds(atoms(resistance_plan(OHM)))
    for name in SENSOR:
        assert kinds(atoms(resistance_plan(OHM, effects=f"{name} = true"))) == bare, name


def test_blocks_of_a_deck_go_by_the_clock_of_its_plan(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM)
    fast = replace(plan, timing=replace(plan.timing, f_clk_hz=4.0 * plan.timing.f_clk_hz))
    for made in (plan, fast):
        lines = frame_deck(made, 0, LEVELS).lines
        (given,) = (i for i, line in enumerate(lines) if line.startswith(".param converter_f_clk_hz="))
        assert given > next(
            i for i, line in enumerate(lines) if "design.inc" in line
        )  # ngspice takes the last one
        assert float(lines[given].partition("=")[2]) == made.timing.f_clk_hz


BITES = "integrator_range = { v_max_v = 0.69, v_min_v = -0.56 }"


def test_a_clamp_that_bites_asks_for_short_edges_and_another_does_not(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM, effects=BITES)
    # 5e-6 clock of 200 ns; products of two numbers, written with 15 digits.
    assert frame_deck(plan, 0, LEVELS).longest_edge_s == pytest.approx(1e-12, rel=1e-12)
    for text in ("", "integrator_range = { v_max_v = 1.6, v_min_v = -1.6 }"):
        assert frame_deck(resistance_plan(OHM, effects=text), 0, LEVELS).longest_edge_s == np.inf
