# SPDX-License-Identifier: Apache-2.0
"""What changes inside a gate in the event engine, each against a slow reference that shares nothing with it."""

import math
import re
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from made_plans import made, ohms, with_break
from scipy.integrate import quad

from dermis import engines, records
from dermis.array.array import Network, column_currents
from dermis.converter.vfc import Y_MIN
from dermis.engines import event, filter
from dermis.errors import InputError
from dermis.scene.design import ROOT

RIPPLE = {"relative": 0.05, "frequency_hz": 31e3, "phase_deg": 40.0}
SERIES = {
    "row_driver": {"r_ohm": 3.0, "grounded_r_ohm": 1.0},
    "lateral": True,
    "column_input": {"r_ohm": 2.0},
}
SOURCES = {"column_offset": {"v_v": 5e-3}, "mux_leakage": {"i_a": 1e-5}}


def unit_a(plan: records.Plan) -> float:
    """Current of one packet a clock."""
    return float((plan.converter.k * plan.converter.i0_a)[0])


def current_at(plan: records.Plan, frame: int, row: int, clock: float, dark: bool = False) -> np.ndarray:
    """Column currents `clock` clocks after the slot of a row began, from the definition: the network at that instant.

    In the dark no row is driven: as if one without taxels were.
    """
    drive, timing = plan.drive, plan.timing
    within = row * timing.slot_s + clock / timing.f_clk_hz
    angle = 2 * math.pi * drive.f_ripple_hz * (frame * drive.t_frame_s + within) + drive.phase_ripple_rad
    g, then = plan.conductance_s(frame), plan.next_conductance_s()[frame]
    if drive.motion:
        g = g + (then - g) * within / drive.t_frame_s
    bias = plan.v_bias_v * (1 + drive.ripple * math.sin(angle))
    if dark:
        g, row = np.vstack([g, np.zeros(g.shape[1])]), -1
    return column_currents(Network(g, bias, **plan.surrounding))[row]


@pytest.mark.paper
@pytest.mark.parametrize(
    ("effects", "miss"),
    [
        # Sine and cosine of a phase of some hundred radian lose two digits of sixteen, the network three.
        ({"supply_ripple": RIPPLE}, 1e-11),
        ({"supply_ripple": {"relative": 0.3, "frequency_hz": 0.02}}, 1e-11),
        ({"motion": True}, 1e-11),
        ({"motion": True, "supply_ripple": RIPPLE}, 1e-11),
        ({"supply_ripple": RIPPLE, **SOURCES, **SERIES}, 1e-11),
        # Through a network, a parabola in time stands for motion (docs/event.md).
        ({"motion": True, "supply_ripple": RIPPLE, **SOURCES, **SERIES}, 1e-6),
    ],
)
def test_duty_is_the_integral_of_the_current(tmp_path: Path, effects: dict[str, Any], miss: float) -> None:
    plan = made(tmp_path, ohms(1, 3, 2, 3), effects)
    found, (begin, end) = event.run(plan).info["x"], (115, 625)
    for frame, row, col in ((0, 0, 0), (0, 1, 2), (1, 0, 1), (2, 1, 0)):
        # Three digits better than what is compared.
        mean, _ = quad(lambda t: current_at(plan, frame, row, t)[col], begin, end, epsrel=1e-13, limit=200)  # noqa: B023
        assert found[frame, row, col] == pytest.approx(mean / unit_a(plan) / 510, rel=miss)


@pytest.mark.paper
def test_motion_that_bends_is_counted_as_the_integral_of_its_current(tmp_path: Path) -> None:
    # i = V G / (1 + G R) bends: a single row of 22 ohm moves through the whole range in one slot.
    effects = {"motion": True, "column_input": {"r_ohm": 22.0}, "supply_ripple": RIPPLE}
    plan = made(tmp_path, np.array([9279.0, 501.0]).reshape(2, 1, 1), effects)
    # Far better than what is compared.
    mean, _ = quad(lambda t: current_at(plan, 0, 0, t)[0], 115, 625, epsrel=1e-10, limit=200)
    # A parabola in place of a current that bends this hard, and ripples, is known to miss by a hundredth of a count.
    assert event.run(plan).info["x"][0, 0, 0] * 510 == pytest.approx(mean / unit_a(plan), abs=0.02)


@pytest.mark.paper
def test_motion_of_random_taxels_is_the_integral_of_its_current_or_refused(tmp_path: Path) -> None:
    rng, taken = np.random.default_rng(4), 0
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for _ in range(60):
        high, low = (10 ** rng.uniform(*decades, (2, 3)) for decades in ((3.5, 5), (1, 3)))
        low[:, 0] = rng.uniform(250, 2000)
        on = {"motion": True, "lateral": True, "row_driver": {"r_ohm": 10 ** rng.uniform(0.5, 2)}}
        plan = made(tmp_path, rng.permutation([high, low]), on)
        if event.refuses(plan):
            continue
        taken += 1
        gate = 115 + 510 * (nodes + 1) / 2
        for row in (0, 1):
            counts = 255 * weights @ [current_at(plan, 0, row, clock) for clock in gate] / unit_a(plan)
            found = event.run(plan).info["x"][0, row] * 510
            # Boole's rule, where Simpson's is off by a count at most.
            assert found[counts < 510] == pytest.approx(counts[counts < 510], abs=0.05)
    assert taken > 30


@pytest.mark.paper
@pytest.mark.parametrize(
    ("ohm", "on"),
    [
        # The driver's voltage falls at once and leaves little of 250 ohm: 119, where the integral is 117.4.
        ([[250.0, 1e5, 1e5, 1e5], [250.0, 30.0, 30.0, 30.0]], {"row_driver": {"r_ohm": 60.0}}),
        # The integral is right, but the duty passes 1/2 within the gate, or the charge its range, and what is lost
        # there depends on when: 225 and 244 where cosim reads 227 and 246, with a range 213 where it reads 222.
        ([[893.4, 3.1, 1000.8], [191.0, 100.4, 2935.4]], {"row_driver": {"r_ohm": 3.53}}),
        ([[206.71, 9115.17, 152.51, 64.85], [677.16, 100.06, 2.56, 42.64]], {"row_driver": {"r_ohm": 5.0}}),
        ([[241.87, 3295.68, 8.77], [2.58, 40.66, 19493.77]],
         {"row_driver": {"r_ohm": 91.824}, "column_input": {"r_ohm": 10.725}, "integrator_range": True}),
    ],
)  # fmt: skip
def test_motion_that_bends_too_much_within_a_gate_is_refused(
    tmp_path: Path, ohm: list[list[float]], on: dict[str, Any]
) -> None:
    # In the second of four frames.
    plan = made(tmp_path, np.array(ohm)[[0, 0, 1, 1], np.newaxis], {"motion": True} | on)
    for engine in ("event", "rtl"):
        refusal = str(engines.refuses(plan, engine))
        assert "effects.motion = on together with row_driver" in refusal
        assert "a current that bends within a gate is certain to 1 LSB" in refusal
    for engine in (event, filter):
        with pytest.raises(InputError, match="a current that bends within a gate"):
            engine.run(plan)


@pytest.mark.paper
def test_motion_that_bends_at_full_scale_is_taken(tmp_path: Path) -> None:
    ohm = np.array([20.0, 0.2]).reshape(2, 1, 1)  # misses six packets of many more
    assert event.refuses(made(tmp_path, ohm, {"motion": True, "row_driver": {"r_ohm": 20.0}})) is None


@pytest.mark.paper
def test_motion_from_an_open_taxel_to_a_short_is_solved_row_by_row(tmp_path: Path) -> None:
    ohm = np.full((2, 3, 2), 1e4)
    ohm[0, 1, 1], ohm[1, 0, 0] = np.inf, 0.0
    codes = event.run(made(tmp_path, ohm, {"motion": True, "row_driver": True})).codes
    assert codes[0, 0, 0] == 255  # any part of the way to a short is a short
    assert codes[0, 1, 1] < codes[1, 1, 1]


@pytest.mark.paper
@pytest.mark.parametrize("changing", [{"supply_ripple": RIPPLE}, {"motion": True}, {"mirror_lag": True}])
def test_a_short_drowns_any_packet_where_the_input_changes(tmp_path: Path, changing: dict[str, Any]) -> None:
    # Twice 1e12 packets of the ideal size are no packet of these; what engine closed counts is every second clock.
    plan = made(tmp_path, np.zeros((2, 1, 2)), {"charge_packet": {"packet_error": 1e20}, **changing})
    assert (event.run(plan).codes == 255).all()


# --- slow mirror ------------------------------------------------------------------------------------------------------


def inputs(plan: records.Plan) -> np.ndarray:
    """Mean input of every clock of the slots of frame 0 in packets a clock, [rows, clocks, cols]."""
    timing, places = plan.timing, (0.0,)
    if plan.drive.ripple or plan.drive.motion:
        places = (0.5 - 3**-0.5 / 2, 0.5 + 3**-0.5 / 2)  # Gauss: cubics exactly
    out = np.zeros((plan.rows, timing.slot_clocks, plan.cols))
    for row in range(plan.rows):
        for n in range(timing.slot_clocks):
            if len(places) == 1 and n not in (0, timing.break_clocks):
                out[row, n] = out[row, n - 1]
                continue
            dark = n < timing.break_clocks
            now = [current_at(plan, 0, row, n + place, dark) for place in places]
            out[row, n] = np.mean(now, axis=0) / unit_a(plan)
    return out


def mirrored(plan: records.Plan, q_c: float) -> np.ndarray:
    """Mean duty [rows, cols] behind a slow mirror, kappa y' = y (x - y), in 50 digits; it begins settled."""
    timing, x_of = plan.timing, inputs(plan)
    out = np.zeros((plan.rows, plan.cols))
    with mpmath.workdps(50):
        kappa = mpmath.mpf(q_c) / (mpmath.mpf(plan.converter.i0_a[0]) / mpmath.mpf(timing.f_clk_hz))
        for col in range(plan.cols):
            settled = current_at(plan, 0, 0, timing.break_clocks)[col] / unit_a(plan)
            y = mpmath.mpf(max(settled, Y_MIN))
            for row in range(plan.rows):
                total = mpmath.mpf(0)
                for n in range(timing.break_clocks if row == 0 else 0, timing.slot_clocks):
                    x = mpmath.mpf(max(x_of[row, n, col], Y_MIN))
                    grown = mpmath.expm1(x / kappa)
                    if n >= timing.settle_clocks:
                        total += kappa * mpmath.log1p(y * grown / x)
                    y = x * y * (grown + 1) / (x + y * grown)
                out[row, col] = total / timing.gate_clocks
    return out


DARK = {"row_driver": {"r_ohm": 3.0, "grounded_r_ohm": 40.0}, "column_input": {"r_ohm": 2.0}, **SOURCES}
FLOATING = {"row_driver": {"grounded_r_ohm": np.inf}, "mux_leakage": {"i_a": 1e-6}}


@pytest.mark.paper
@pytest.mark.parametrize(
    ("around", "q_c", "clocks", "miss"),
    [
        # The exponential by ten squarings is good to 1e-13 of a clock (docs/event_proofs.md).
        ({}, 2e-13, 1, 1e-12),
        (DARK, 2e-11, 0, 1e-12),
        (DARK, 2e-11, 4, 1e-12),
        (DARK, 5e-14, 4, 1e-12),
        (FLOATING, 2e-11, 1, 1e-12),
        # Two points a clock stand for the mean of a sine here, and a parabola for motion in the engine.
        ({"supply_ripple": RIPPLE} | DARK, 2e-11, 1, 1e-9),
        ({"motion": True} | DARK, 2e-11, 4, 1e-6),
    ],
    ids=["alone", "dark", "break", "fast", "floating", "ripple", "motion"],
)
def test_a_slow_mirror_follows_its_input_from_the_first_clock_of_a_slot(
    tmp_path: Path, around: dict[str, Any], q_c: float, clocks: int, miss: float
) -> None:
    ohm = np.array([[5e3, 3e5], [8e5, 6e2], [2e4, np.inf]])
    if "motion" in around:
        ohm[2, 1] = 1e6
    moves = np.stack([ohm, 2 * ohm[::-1]])[: 1 + ("motion" in around)]
    plan = with_break(made(tmp_path, moves, {"mirror_lag": {"q_c": q_c}, **around}), clocks)
    # The mean of 510 clocks.
    assert np.abs(event.run(plan).info["x"][0] - mirrored(plan, q_c)).max() < miss


@pytest.mark.paper
@pytest.mark.parametrize("far", [1e8, 1e11])
@pytest.mark.parametrize("kappa", [1e-2, 1e6])
def test_a_slow_mirror_is_exact_however_far_its_input_jumps(tmp_path: Path, far: float, kappa: float) -> None:
    """From its floor up and down again: 1e18 times, and no digit of the ratio is left beside 1."""
    x = np.array([0.0, far, 0.0, 3.0, 0.5])
    with np.errstate(divide="ignore"):
        plan = made(tmp_path, (250.0 / x).reshape(1, 5, 1), {"mirror_lag": {"q_c": kappa * 5e-12}})
    expected = mirrored(plan, kappa * 5e-12)
    # What it is asked for less kappa times a logarithm of 1e18: roundings of both, and of exponentials to 1e-13.
    assert (np.abs(event.run(plan).info["x"][0] - expected) <= 2e-13 * (x[:, np.newaxis] + 50 * kappa)).all()


@pytest.mark.parametrize(
    "effects", [{}, {"supply_ripple": RIPPLE, "motion": True, **SERIES}, {"line_capacitance": True, **SERIES}]
)
def test_a_break_changes_nothing_that_has_no_memory(tmp_path: Path, effects: dict[str, Any]) -> None:
    plan = made(tmp_path, ohms(6, 3, 4, 3), effects)
    late, at_once = event.run(with_break(plan, 1)), event.run(plan)
    assert (late.info["x"] == at_once.info["x"]).all()
    assert (late.codes == at_once.codes).all()


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


# --- line capacitance -------------------------------------------------------------------------------------------------


@pytest.mark.paper
@pytest.mark.parametrize("topology", ["direct", "conveyor_mirror"])
def test_charge_that_capacitances_inject_is_refused_where_it_counts(tmp_path: Path, topology: str) -> None:
    on: dict[str, Any] = {
        "line_capacitance": True, "supply_ripple": True, "integrator_gain": True, "integrator_bandwidth": True,
        "integrator_range": True,
    }  # fmt: skip
    on |= {"mirror_lag": True} if topology == "conveyor_mirror" else {}
    assert event.refuses(made(tmp_path, ohms(1, 1, 16, 4), on, topology)) is None
    on |= {"line_capacitance": {"c_taxel_f": 1e-7}, "supply_ripple": {"relative": 0.5, "frequency_hz": 1e5}}
    said = str(event.refuses(made(tmp_path, ohms(1, 1, 16, 4), on, topology)))
    # 5 pF and 0.5 mV of ripple are 1e-5 of a packet; 20 000 times as much by 1000 times as much are 100.
    assert "line_capacitance = on together with supply_ripple" in said
    assert said.endswith("certain to 1 LSB (here 1.2e+02); use engine cosim")
