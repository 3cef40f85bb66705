# SPDX-License-Identifier: Apache-2.0
"""What changes inside a gate in the event engine, each against a slow reference that shares nothing with it."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import mpmath
import numpy as np
import pytest
from made_plans import made, ohms
from scipy.integrate import quad, solve_ivp

from dermis import records
from dermis.array.array import Network, column_currents
from dermis.converter import course, injection
from dermis.converter.course import Slots, solve_gate
from dermis.converter.vfc import X_MAX, Y_MIN
from dermis.engines import event
from dermis.scene.design import ROOT

RIPPLE = {"relative": 0.05, "frequency_hz": 31e3, "phase_deg": 40.0}
SERIES = {
    "row_driver": {"r_ohm": 3.0, "grounded_r_ohm": 1.0},
    "lateral": True,
    "column_input": {"r_ohm": 2.0},
}


def charges(plan: records.Plan) -> np.ndarray:
    """Charge a clock, [frames, rows, cols, clocks]."""
    slots = Slots(plan, slice(0, plan.frames))
    out = np.empty((plan.frames, plan.rows, plan.cols, plan.timing.gate_clocks))
    for row, block, charge, mean in slots.blocks(5):
        for c in range(block.start, block.stop):
            out[c // plan.cols, row, c % plan.cols] = charge[:, c - block.start]
        # A mean of 510 numbers summed in another order: 510 roundings of 1.1e-16 at most.
        assert mean == pytest.approx(charge.mean(axis=0), rel=1e-12)
    # As above.
    assert slots.mean == pytest.approx(out.mean(axis=-1), rel=1e-12)
    return out


def current_at(plan: records.Plan, frame: int, row: int, clock: float) -> np.ndarray:
    """Column currents `clock` clocks after the slot of a row began, from the definition: networks at that instant."""
    drive, timing = plan.drive, plan.timing
    within = row * timing.slot_s + clock / timing.f_clk_hz
    angle = 2 * math.pi * drive.f_ripple_hz * (frame * drive.t_frame_s + within) + drive.phase_ripple_rad
    g, then = plan.conductance_s(frame), plan.next_conductance_s()[frame]
    if drive.motion:
        g = g + (then - g) * within / drive.t_frame_s
    bias = plan.v_bias_v * (1 + drive.ripple * math.sin(angle))
    return column_currents(Network(g, bias, **plan.surrounding))[row]


@pytest.mark.parametrize(
    "effects",
    [
        {"supply_ripple": RIPPLE},
        {"supply_ripple": {"relative": 0.3, "frequency_hz": 0.02}},
        {"motion": True},
        {"motion": True, "supply_ripple": RIPPLE},
        {"supply_ripple": RIPPLE, "column_offset": {"v_v": 5e-3}, "mux_leakage": {"i_a": 1e-5}, **SERIES},
    ],
)
def test_charge_of_every_clock_is_the_integral_of_the_current(tmp_path: Path, effects: dict) -> None:
    plan = made(tmp_path, ohms(1, 3, 2, 3), effects)
    found = charges(plan)
    unit = (plan.converter.k * plan.converter.i0_a)[0]
    for frame, row, clock in ((0, 0, 0), (0, 1, 509), (1, 0, 77), (2, 1, 300)):
        begin = plan.timing.settle_clocks + clock
        for col in range(plan.cols):
            # The integral is to be better than the eleven digits that are compared.
            mean, _ = quad(lambda t: current_at(plan, frame, row, t)[col], begin, begin + 1, epsrel=1e-13)  # noqa: B023
            # The sine and cosine of a phase of some hundred radian lose two digits of sixteen, the network
            # three.
            assert found[frame, row, col, clock] == pytest.approx(mean / unit, rel=1e-11)


@pytest.mark.parametrize("ratio", [1.0, 30.0])
def test_motion_through_a_network_is_solved_at_both_ends_and_in_the_middle_of_a_gate(
    tmp_path: Path, ratio: float
) -> None:
    ohm = ohms(2, 3, 5, 4)
    ohm[1] /= ratio
    plan = made(tmp_path, ohm, {"motion": True, "supply_ripple": RIPPLE, "column_offset": True, **SERIES})
    still = dataclasses.replace(plan, drive=dataclasses.replace(plan.drive, ripple=0.0))
    found = solve_gate(plan, slice(0, 3))
    timing, unit = plan.timing, (plan.converter.k * plan.converter.i0_a)[0]
    for frame in range(3):
        for row in range(plan.rows):
            for edge, got in (
                (0, found.follows_begin + found.rest_begin),
                (timing.gate_clocks, found.follows_end + found.rest_end),
                (
                    timing.gate_clocks / 2,
                    (found.follows_begin + found.follows_end + found.rest_begin + found.rest_end) / 2
                    + found.follows_bend
                    + found.rest_bend,
                ),
            ):
                expected = current_at(still, frame, row, timing.settle_clocks + edge)
                # What polynomials through the frame promise (event_input._COURSE_MISS).
                assert np.abs(got[frame, row] - expected).max() / unit < 1e-7


@pytest.mark.paper
def test_motion_that_bends_is_counted_as_the_integral_of_its_current(tmp_path: Path) -> None:
    # i = V G / (1 + G R) bends: a single row of 22 ohm moves through the whole range in one slot.
    plan = made(
        tmp_path,
        np.array([9279.0, 501.0]).reshape(2, 1, 1),
        {"motion": True, "column_input": {"r_ohm": 22.0}, "supply_ripple": RIPPLE},
    )
    # Far better than the fiftieth of a count that is compared.
    mean, _ = quad(lambda t: current_at(plan, 0, 0, t)[0], 115, 625, epsrel=1e-10, limit=200)
    unit = (plan.converter.k * plan.converter.i0_a)[0] * plan.timing.gate_clocks
    found = event.run(plan)
    # A parabola through a gate in which the current bends this hard is known to miss by a hundredth of a
    # count.
    assert found.info["x"][0, 0, 0] * plan.timing.gate_clocks == pytest.approx(mean / unit * 510, abs=0.02)


@pytest.mark.paper
def test_motion_from_an_open_taxel_to_a_short_is_solved_row_by_row(tmp_path: Path) -> None:
    ohm = np.full((2, 3, 2), 1e4)
    ohm[0, 1, 1], ohm[1, 0, 0] = np.inf, 0.0
    plan = made(tmp_path, ohm, {"motion": True, "row_driver": True})
    codes = event.run(plan).codes
    assert codes[0, 0, 0] == 255  # any part of the way to a short is a short
    assert codes[0, 1, 1] < codes[1, 1, 1]


@pytest.mark.paper
def test_a_force_that_moves_past_is_counted_at_its_mean_over_the_gate(tmp_path: Path) -> None:
    # 100 counts at the beginning of the frame, 200 at its end; a single row is read for 510 of 625 clocks
    ohm = np.array([250 * 510 / 100, 250 * 510 / 200]).reshape(2, 1, 1)
    plan = made(tmp_path, ohm, {"motion": True})
    expected = 100 + 100 * (115 + 255) / 625
    # Rounding of a code: half a count.
    assert abs(int(event.run(plan).codes[0, 0, 0]) - expected) <= 0.5
    assert event.run(plan).codes[1, 0, 0] == 200


@pytest.mark.paper
@pytest.mark.parametrize("changing", [{"supply_ripple": RIPPLE}, {"motion": True}, {"mirror_lag": True}])
def test_a_short_drowns_packets_of_any_size_where_the_input_changes(tmp_path: Path, changing: dict) -> None:
    # Twice 1e12 packets of the ideal size are no packet of these; what engine closed counts is every second clock.
    plan = made(tmp_path, np.zeros((2, 1, 2)), {"charge_packet": {"packet_error": 1e20}, **changing})
    assert (event.run(plan).codes == 255).all()


# --- slow mirror ---------------------------------------------------------------------------------------------------


@pytest.mark.paper
@pytest.mark.parametrize("extra", [{}, {"supply_ripple": RIPPLE}, {"offset_current": {"i_a": 1e-7}}])
def test_slow_mirror_is_its_differential_equation(tmp_path: Path, extra: dict) -> None:
    ohm = np.array([[[5e3, 3e5]], [[8e5, 6e2]], [[2e5, np.inf]]]).reshape(1, 3, 2)
    plan = made(tmp_path, ohm, {"mirror_lag": {"q_c": 2e-13}, **extra})
    found = charges(plan)
    kappa = 2e-13 / 5e-12
    offset = (plan.converter.i_offset_a / plan.converter.i0_a)[0]
    slots = Slots(plan, slice(0, 1))
    for col in range(2):
        inverse = None
        for row in range(3):
            # The input is the mean of each clock, as everywhere; the mirror's equation is solved by a library.
            x = np.maximum(slots.basis @ slots.terms[row, :, col], Y_MIN)
            x[: plan.timing.break_clocks] = Y_MIN
            for n, x_n in enumerate(x):
                if inverse is None and n == plan.timing.break_clocks:
                    inverse = 1 / max(slots.begin @ slots.terms[row, :, col], Y_MIN)
                if inverse is None:
                    continue
                # Three digits better than what is compared below.
                way = solve_ivp(
                    lambda t, z: [(1 - x_n * z[0]) / kappa, 1 / z[0]],  # noqa: B023
                    (0, 1),
                    [inverse, 0.0],
                    rtol=1e-10,
                    atol=1e-13,
                    method="LSODA",
                )
                inverse = way.y[0, -1]
                if n >= plan.timing.settle_clocks and n % 60 == 0:
                    got = found[0, row, col, n - plan.timing.settle_clocks] - offset
                    # Errors of the library's solver add up over hundreds of clocks; 1e-12 packet where the
                    # mirror gives nothing.
                    assert got == pytest.approx(way.y[1, -1], rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("far", [1e8, 1e11, 1e12])
@pytest.mark.parametrize("kappa", [1e-2, 1e6, 2e10])
def test_slow_mirror_is_exact_however_far_its_input_jumps(far: float, kappa: float) -> None:
    """From its floor up and down again: 1e18 times, and no digit of the ratio is left beside 1."""
    x = np.array([0.0, 0.0, far, far, 0.0, 0.0, 3.0, 0.5])
    settle, one = 2, np.ones(1)
    out, mean = np.empty((x.size, 1)), np.empty(1)
    found = course.charges(
        0, 0, x[:, None], np.zeros(1), settle, np.ones((1, 1, 1)), None, kappa * one,
        np.zeros(1), 0, None, np.zeros((1, 1)), X_MAX * one, out, mean,
    )[:, 0]  # fmt: skip
    with mpmath.workdps(60):
        y, slow = mpmath.mpf(Y_MIN), mpmath.mpf(kappa)
        for n, asked in enumerate(map(mpmath.mpf, np.maximum(x, Y_MIN))):
            charge = slow * mpmath.log1p(y * mpmath.expm1(asked / slow) / asked)
            if n >= settle:
                size = float(asked) + kappa * abs(float(mpmath.log(asked / y)))
                # What it is asked for less kappa times a logarithm: roundings of both, and of exponentials to 1e-13.
                assert found[n - settle] == pytest.approx(float(charge), rel=0.0, abs=2e-13 * size)
            y = after(y, asked, 1 / slow)


@pytest.mark.paper
def test_slow_mirror_carries_a_bright_row_into_a_dark_one_and_wakes_up_late(tmp_path: Path) -> None:
    rows = [[600.0], [np.inf], [1e5], [1e5]]
    plan = made(tmp_path, np.array(rows).reshape(1, 4, 1), {"mirror_lag": {"q_c": 1e-12}})
    codes = event.run(plan).codes[0, :, 0].astype(int)
    ideal = [212, 0, 1, 1]
    # Packets left over by the row before: kappa ln(1 + x t / kappa) of 0.2 packets grows for ever, but slowly.
    assert abs(codes[0] - ideal[0]) <= 1
    assert codes[1] - ideal[1] in (0, 1)
    assert codes[2] <= ideal[2] + 1


def with_break(plan: records.Plan, clocks: int) -> records.Plan:
    return dataclasses.replace(plan, timing=dataclasses.replace(plan.timing, break_clocks=clocks))


def dark_at(plan: records.Plan, g: np.ndarray) -> np.ndarray:
    """Column currents of conductances [rows, cols] while no row is driven: as if one without taxels were."""
    return column_currents(Network(np.vstack([g, np.zeros(g.shape[1])]), plan.v_bias_v, **plan.surrounding))[
        -1
    ]


def mirror_in_many_digits(plan: records.Plan, clocks: int, q_c: float) -> np.ndarray:
    """Charge a clock [rows, cols, clocks of the gate] of a slow mirror, its rows `clocks` dark clocks apart."""
    timing, converter = plan.timing, plan.converter
    unit = converter.k * converter.i0_a
    lit, dark = column_currents(plan.network(0)) / unit, dark_at(plan, plan.conductance_s(0)) / unit
    out = np.zeros((plan.rows, plan.cols, timing.gate_clocks))
    with mpmath.workdps(50):
        kappa = mpmath.mpf(q_c) / (mpmath.mpf(converter.i0_a[0]) / mpmath.mpf(converter.f_clk_hz))
        floor = mpmath.mpf(Y_MIN)
        for col in range(plan.cols):
            y = None
            for row in range(plan.rows):
                x = max(mpmath.mpf(lit[row, col]), floor)
                y = x if y is None else after(y, max(mpmath.mpf(dark[col]), floor), clocks / kappa)
                y = after(y, x, (timing.settle_clocks - clocks) / kappa)
                for n in range(timing.gate_clocks):
                    # the integral of y in closed form
                    out[row, col, n] = kappa * mpmath.log1p(y * mpmath.expm1(x / kappa) / x)
                    y = after(y, x, 1 / kappa)
    return out


def after(y: mpmath.mpf, x: mpmath.mpf, time: mpmath.mpf) -> mpmath.mpf:
    """y of y' = y (x - y) a time later."""
    grown = mpmath.exp(x * time)
    return x * y * grown / (x + y * (grown - 1))


@pytest.mark.long
@pytest.mark.parametrize("clocks", [0, 1, 4])
@pytest.mark.parametrize("q_c", [5e-14, 2e-11])
def test_slow_mirror_falls_while_no_row_is_driven(tmp_path: Path, clocks: int, q_c: float) -> None:
    ohm = np.array([[[5e3, 3e5, 7e2]], [[8e5, 6e2, 9e3]], [[2e5, np.inf, 4e4]]]).reshape(1, 3, 3)
    around = {
        "row_driver": {"r_ohm": 3.0, "grounded_r_ohm": 40.0},
        "mux_leakage": {"i_a": 1e-5},
        "column_offset": {"v_v": 2e-3},
        "column_input": {"r_ohm": 2.0},
    }
    for extra in (
        around,
        {"row_driver": {"grounded_r_ohm": np.inf}, "mux_leakage": {"i_a": 1e-6}},
        {"row_driver": True},
    ):
        plan = made(tmp_path, ohm, {"mirror_lag": {"q_c": q_c}, **extra})
        found = charges(with_break(plan, clocks))[0]
        expected = mirror_in_many_digits(plan, clocks, q_c)
        # The exponential by ten squarings is good to 1e-13 (event_input._exp_of_minus).
        assert np.abs(found - expected).max() < 1e-12
        # The fast mirror forgets the break; the slow one must show it, far above the rounding.
        if clocks and q_c > 1e-12:
            at_once = mirror_in_many_digits(plan, 0, q_c)
            # far above the rounding
            assert np.abs(found - at_once).sum(axis=2).max() > 1e-4


@pytest.mark.parametrize("grounded", [3.0, 40.0])
def test_dark_current_is_the_network_with_every_row_grounded_at_its_instant(
    tmp_path: Path, grounded: float
) -> None:
    around = {
        "row_driver": {"r_ohm": 3.0, "grounded_r_ohm": grounded},
        "mux_leakage": {"i_a": 1e-5},
        "column_offset": {"v_v": 5e-3},
        "column_input": {"r_ohm": 2.0},
    }
    plan = with_break(
        made(
            tmp_path,
            ohms(4, 3, 5, 3),
            {"mirror_lag": True, "motion": True, "supply_ripple": RIPPLE, **around},
        ),
        2,
    )
    slots, drive, timing = Slots(plan, slice(0, 3)), plan.drive, plan.timing
    unit = (plan.converter.k * plan.converter.i0_a)[0]
    for frame, row, clock in ((0, 1, 0), (1, 4, 1), (2, 2, 0)):
        share = (row * timing.slot_clocks + clock + 0.5) / (timing.f_clk_hz * drive.t_frame_s)
        g, then = plan.conductance_s(frame), plan.next_conductance_s()[frame]
        expected = dark_at(plan, g + share * (then - g)) / unit
        got = (slots.basis[clock] @ slots.idle[row]).reshape(3, -1)[frame]
        # The parabola in time is exact at three instants; between them it misses by the square of 1 % of
        # motion.
        assert got == pytest.approx(expected, abs=1e-6)
        assert np.abs(expected).max() > 1e-4
    # what follows the bias is that of the row, where it is driven
    begin = current_at(plan, 1, 0, 2) / unit
    # The parabola in time, as above.
    assert (slots.begin @ slots.terms[0]).reshape(3, -1)[1] == pytest.approx(begin, abs=1e-6)


@pytest.mark.parametrize(
    "effects", [{}, {"supply_ripple": RIPPLE, "motion": True, **SERIES}, {"line_capacitance": True, **SERIES}]
)
def test_a_break_changes_nothing_that_has_no_memory(tmp_path: Path, effects: dict) -> None:
    plan = made(tmp_path, ohms(6, 3, 4, 3), effects)
    assert (event.run(with_break(plan, 1)).info["x"] == event.run(plan).info["x"]).all()
    assert (event.run(with_break(plan, 1)).codes == event.run(plan).codes).all()


# --- settling --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "floor"),
    [
        ("spice/behavioural/mirror_lag.sp", r"\{(\S+)\*i_ref_a\}\), \{"),
        ("models/verilog/mirror.sv", r"real FLOOR = (\S+);"),
    ],
)
def test_the_slow_mirror_has_the_same_floor_in_every_engine(file: str, floor: str) -> None:
    found = re.findall(floor, (ROOT / file).read_text(encoding="utf-8"))
    assert [float(f) for f in found] == [Y_MIN]


EVERY = {
    "line_capacitance": True,
    "supply_ripple": True,
    "integrator_gain": True,
    "integrator_bandwidth": True,
    "integrator_range": True,
}


@pytest.mark.paper
@pytest.mark.parametrize(
    ("topology", "counts"),
    [
        # 5 pF and 0.5 mV of ripple on packets of 0.4 nC, all of one swing; 480 pF across 400 pF and a gain of 1e4, 1.5
        # packets away, and 3.18 ns times 1.2, 5 MHz; 5 pF and 0.5 V, 1 mV more at the crest.
        ("direct", {"ripple": 1.25e-5, "inv_gain_dc": 1.8e-4 / 1.0001, "t_gbw_s": 0.0159154943 * 1.2}),
        ("conveyor_mirror", {"ripple": 1.25e-5, "q_mirror_c": 6.25e-3 * 1.001}),
    ],
)
def test_what_capacitances_displace_is_far_below_a_count_at_the_defaults(
    tmp_path: Path, topology: str, counts: dict[str, float]
) -> None:
    on = EVERY | ({"mirror_lag": True} if topology == "conveyor_mirror" else {})
    plan = made(tmp_path, ohms(1, 1, 16, 4), on, topology)
    found = {name: float(value.max()) for name, value in injection.counts(plan).items()}
    # Formulas against numbers of nine digits.
    assert found == pytest.approx(counts, rel=1e-6)
    assert event.refuses(plan) is None
    # A range that bites: 256 times as much, by what every packet of a gate may lose.
    bites = {**on, "integrator_range": {"v_max_v": 0.69, "v_min_v": -0.56}}
    beside = injection.counts(made(tmp_path, ohms(1, 1, 16, 4), bites, topology))
    factor = 1.0 + (plan.timing.gate_clocks + 1) / 2
    # A product and a quotient of doubles.
    assert {n: float(v.max()) / factor for n, v in beside.items()} == pytest.approx(found, rel=1e-12)
