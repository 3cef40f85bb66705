# SPDX-License-Identifier: Apache-2.0
"""Content of a deck: nothing of effects that are off, and what several effects or the clock decide together.

The elements of each effect that is on are judged by the codes that they make (test_cosim_effects.py).
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from system_bench import RANDOM, SENSOR, MakePlan, scene_of

from dermis import effects
from dermis.chip import netlist
from dermis.chip.netlist import frame_deck
from dermis.scene.design import TOPOLOGIES

ROWS, COLS = 3, 4
LEVELS = [0.0] * (ROWS + 1 + COLS)

# Two frames: the first moves to the second in all taxels but one. One taxel is open, one a short.
OHM = 510 * 60 ** np.random.default_rng(8).random((2, ROWS, COLS))
OHM[1, 2, 3] = OHM[0, 2, 3]
OHM[0, 0, 1], OHM[0, 1, 2] = np.inf, 0.0


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_effects_that_are_off_leave_the_deck_as_it_is(resistance_plan: MakePlan, topology: str) -> None:
    bare = [frame_deck(resistance_plan(OHM, topology), f, LEVELS) for f in (0, 1)]
    off = resistance_plan(OHM, topology, scene_of(dict.fromkeys(effects.EFFECTS, False)))
    assert [frame_deck(off, f, LEVELS) for f in (0, 1)] == bare


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


def test_random_effects_are_refused_and_sensor_effects_are_resistances(
    resistance_plan: MakePlan,
) -> None:
    for name in RANDOM:
        fields = resistance_plan(OHM, effects=f"{name} = true").active_fields()
        assert fields - netlist.HONOURS, name

    def without_numbers(on: str) -> list[str]:
        lines = frame_deck(resistance_plan(OHM, effects=on), 0, LEVELS).lines
        return [re.sub(r"\d[\d.e+-]*", "#", line) for line in lines]

    for name in SENSOR:
        assert without_numbers(f"{name} = true") == without_numbers(""), name


def test_blocks_of_a_deck_go_by_the_clock_of_its_plan(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM)
    fast = replace(plan, timing=replace(plan.timing, f_clk_hz=4.0 * plan.timing.f_clk_hz))
    for made in (plan, fast):
        lines = frame_deck(made, 0, LEVELS).lines
        (given,) = (i for i, line in enumerate(lines) if line.startswith(".param converter_f_clk_hz="))
        # ngspice takes the last one.
        assert given > next(i for i, line in enumerate(lines) if "design.inc" in line)
        assert float(lines[given].partition("=")[2]) == made.timing.f_clk_hz


BITES = "integrator_range = { v_max_v = 0.69, v_min_v = -0.56 }"


def test_a_clamp_that_bites_asks_for_short_edges_and_another_does_not(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM, effects=BITES)
    # 5e-6 clock of 200 ns; products of two numbers, written with 15 digits.
    assert frame_deck(plan, 0, LEVELS).longest_edge_s == pytest.approx(1e-12, rel=1e-12)
    for text in ("", "integrator_range = { v_max_v = 1.6, v_min_v = -1.6 }"):
        assert frame_deck(resistance_plan(OHM, effects=text), 0, LEVELS).longest_edge_s == np.inf
