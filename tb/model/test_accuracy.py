# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs: the references, the order of convergence, and the choice that is made from the curve."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from mpmath import mpf
from scipy.integrate import solve_ivp

from dermis import bench_vfc, engines
from dermis.accuracy import converter, exact
from dermis.accuracy.point import Point, pareto, to_csv
from dermis.bench_engines import random_plan
from dermis.vfc import count_exact


def test_trapezoids_are_of_second_order_behind_a_pole(tmp_path: Path) -> None:
    _, orders = converter.orders(tmp_path)
    assert min(orders) >= 1.9, "the gate accuracy.order"


def test_backward_euler_would_miss_the_gate(tmp_path: Path) -> None:
    _, orders = converter.orders(tmp_path, converter.options_with(converter.EXACT, method="gear", maxord="1"))
    assert min(orders) < 1.5, "a method of order 1 has to show"


def test_the_exact_voltage_behind_a_pole_solves_its_equation() -> None:
    circuit = replace(converter.IDEAL, gate_clocks=12, t_gbw_s=2e-7)
    told = [0, 0, 1, 1, 0, 0, 0, 1, 0, 1, 0, 0]
    found = bench_vfc.exact_voltage(circuit, np.array(told))

    def rates(t: float, y: np.ndarray, n: int) -> list[float]:
        s = t * circuit.f_clk_hz - n
        moved = min(1.0, s / (circuit.t_edge_s * circuit.f_clk_hz))
        before = told[n - 1] if n else 0
        switch = before + (told[n] - before) * moved
        du = (switch * circuit.i0_a - circuit.i_in_a) / circuit.c_int_f
        return [du, (y[0] - y[1]) / circuit.t_gbw_s]

    y = [circuit.v_start_v, circuit.v_start_v]
    for n in range(len(told)):
        for begin, end in ((n / 1e6, n / 1e6 + 1e-9), (n / 1e6 + 1e-9, (n + 1) / 1e6)):
            # Far below the difference that is asked for.
            y = solve_ivp(rates, (begin, end), y, "DOP853", args=(n,), rtol=1e-12, atol=1e-15).y[:, -1]
        assert y[1] == pytest.approx(found[n + 1], abs=1e-12), "some dozen steps at 1e-12 of 0.2 V"


def test_the_count_in_fifty_digits_is_the_rational_one() -> None:
    for x in (Fraction(1, 3), Fraction(37, 510), Fraction(1, 2), Fraction(3, 7)):
        for packet in (Fraction(1), Fraction(1003, 1000)):
            expected = count_exact(x, 510, packet=packet)
            start, level = mpf(-1) / 2, mpf(0)
            wanted = mpf(x.numerator) / x.denominator
            took = exact.count(wanted, 510, mpf(packet.numerator) / packet.denominator, start, level, mpf(0))
            assert took == expected


def test_the_frame_reference_equals_the_event_engine(tmp_path: Path) -> None:
    on = {"row_driver": True, "column_input": True, "charge_packet": True}
    made = random_plan(tmp_path, 1, "event", 4, **on, integrator_bandwidth={"gbw_hz": 2e6})
    assert (engines.run(made).codes == exact.codes(made, 1)).all()
    # A wrong reference, or engine, by a percent of gain shows.
    wrong = replace(made, converter=replace(made.converter, gain=1.01))
    assert (engines.run(wrong).codes != exact.codes(made, 1)).any()


def test_the_reference_refuses_what_it_does_not_know(tmp_path: Path) -> None:
    made = random_plan(tmp_path, 1, "event", 2, comparator_hysteresis=True)
    with pytest.raises(ValueError, match="v_hysteresis_v"):
        exact.codes(made, 1)


def test_a_later_option_replaces_the_earlier_one() -> None:
    line = converter.options_with(converter.POLE, reltol=1e-6, method="gear")
    assert line.split().count("reltol=1e-06") == 1
    assert "reltol=0.0001" not in line
    assert line.endswith("method=gear")


def point(time: float, error: float) -> Point:
    return Point("work", "method", f"{time}", error, "V", 0.0, (time,))


def test_the_front_holds_what_nothing_beats() -> None:
    points = [point(1.0, 0.5), point(2.0, 0.6), point(3.0, 0.1), point(0.5, 0.9), point(4.0, 0.1)]
    assert [p.time_s for p in pareto(points)] == [0.5, 1.0, 3.0]
    assert to_csv(points).count("\n") == 6
