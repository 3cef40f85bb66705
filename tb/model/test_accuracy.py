# SPDX-License-Identifier: Apache-2.0
"""Accuracy against time: the references, the order of convergence, and the command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dermis import engines
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from tb.programs.accuracy import simulator
from tb.programs.accuracy.simulator import Method, Point
from tb.programs.bench import circuit as circuits
from tb.programs.bench.measure import random_plan
from tb.reference import frame as exact


@pytest.mark.parametrize(
    ("other", "status"), [({}, "PASS"), ({"method": "gear", "maxord": "1"}, "FAIL")], ids=["trap", "euler"]
)
def test_trapezoids_are_of_second_order_behind_a_pole_and_backward_euler_is_not(
    other: dict[str, str], status: str, tmp_path: Path
) -> None:
    options = simulator.options_with(simulator.EXACT, **other)
    row = simulator.order_row(tmp_path, options, simulator.ORDER_STEPS_S[:3])
    assert row["status"] == status
    assert (row["value"] < 1.5) == (status == "FAIL"), "a method of order 1 has to show"


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", simulator.CIRCUITS)
def test_every_method_of_a_circuit_has_a_name_of_its_own(name: str, quick: bool, tmp_path: Path) -> None:
    methods = list(simulator.converter_methods(name, tmp_path, quick))
    assert len(methods) == len({simulator.row_name(m.work, m.name, m.setting) for m in methods})
    bound = {"bound"} if name == simulator.NO_POLE else set()
    assert {m.name.split(",")[0].split(":")[0] for m in methods} == {"cosim", "peer"} | bound


@pytest.mark.long
@pytest.mark.paper
def test_the_options_of_a_solver_reach_ngspice() -> None:
    made = replace(random_plan(1, "event", 2, **simulator.EFFECTS), engine="cosim")
    runs = [engines.run(made, solver=solver) for solver in simulator.SOLVERS.values()]
    assert (runs[0].codes[0] == exact.codes(made)).all()
    shipped, loose, _ = (run.info["steps"]["accepted"] for run in runs)
    assert loose < 0.6 * shipped, "tolerances that the deck has as well are replaced: 1107 steps, not 2978"


def test_methods_run_in_turns_slow_ones_once_and_a_failure_is_an_error_row() -> None:
    order: list[str] = []

    def method(name: str, slow: bool) -> Method:
        def run() -> simulator.Found:
            order.append(name)
            if name == "c":
                raise SimulatorError("it fell over")
            return 1e-3, 1.0, float(len(order))

        return Method("frames, x", name, "s", run, slow)

    points, [row] = simulator.measure([method("a", False), method("b", True), method("c", True)], 3)
    assert order == ["a", "b", "c", "a", "a"]
    assert [(p.method, p.seconds) for p in points] == [("a", 4.0), ("b", 2.0)]
    found = tuple(row[key] for key in ("name", "status", "note"))
    assert found == ("accuracy.frames.x.c.s", "ERROR", "it fell over")


def test_a_wrong_engine_is_off_the_reference_and_the_right_one_is_not() -> None:
    methods = {m.name: m for m in simulator.frame_methods(True)}
    assert methods["event"].run()[:2] == (0.0, 0.0)
    error, largest, _ = methods["closed, effects out"].run()
    assert 0 < error < largest


def test_the_exact_voltage_behind_a_pole_solves_its_equation() -> None:
    circuit = replace(simulator.IDEAL, gate_clocks=12, t_gbw_s=2e-7)
    told = [0, 0, 1, 1, 0, 0, 0, 1, 0, 1, 0, 0]
    found = circuits.exact_voltage(circuit, np.array(told))

    def rates(t: float, y: np.ndarray, n: int) -> list[float]:
        switch = np.interp(t - n / circuit.f_clk_hz, [0.0, circuit.t_edge_s], [[0, *told][n], told[n]])
        du = (switch * circuit.i0_a - circuit.i_in_a) / circuit.c_int_f
        return [du, (y[0] - y[1]) / circuit.t_gbw_s]

    y = [circuit.v_start_v, circuit.v_start_v]
    for n in range(len(told)):
        for begin, end in ((n / 1e6, n / 1e6 + 1e-9), (n / 1e6 + 1e-9, (n + 1) / 1e6)):
            # Far below the difference that is asked for.
            y = solve_ivp(rates, (begin, end), y, "DOP853", args=(n,), rtol=1e-12, atol=1e-15).y[:, -1]
        assert y[1] == pytest.approx(found[n + 1], abs=1e-12), "some dozen steps at 1e-12 of 0.2 V"


def test_the_reference_refuses_what_it_does_not_know() -> None:
    made = random_plan(1, "event", 2, comparator_hysteresis=True)
    with pytest.raises(ValueError, match="v_hysteresis_v"):
        exact.codes(made)


def test_a_later_option_replaces_the_earlier_one() -> None:
    line = simulator.options_with(simulator.CONTROLLED, reltol=2e-6, method="gear")
    assert line.count("reltol=") == line.count("reltol=2e-06") == 1
    assert line.endswith("method=gear")


def point(time: float, error: float, method: str = "method") -> Point:
    return Point(simulator.NO_POLE, method, f"{time}", error, 0.0, time)


def test_the_front_holds_what_nothing_beats() -> None:
    points = [point(1.0, 0.5), point(2.0, 0.6), point(3.0, 0.1), point(0.5, 0.9), point(4.0, 0.1)]
    assert [p.seconds for p in simulator.pareto(points)] == [0.5, 1.0, 3.0]
    assert simulator.points_csv(points).count("\n") == 6


def test_engines_are_compared_with_the_best_peer() -> None:
    ours = [point(1.0, 1e-3, "cosim, icarus, step"), point(10.0, 1e-9, "cosim, icarus, step")]
    peers = [point(5.0, 1e-3, "peer: x"), point(40.0, 1e-9, "peer: y")]
    points = [*ours, *peers, point(0.5, 0.0, simulator.ALONE)]
    rows = {row["name"].removeprefix("accuracy."): row["value"] for row in simulator.ratios(points)}
    assert rows == pytest.approx(
        {
            "speed_at_equal_error.no_pole.best_peer": 4.0,
            "speed_at_equal_error.no_pole.one_percent": 5.0,
            "speed_at_equal_error.no_pole.coarsest": 5.0,
            "error_at_equal_time.no_pole.best_peer": 1.0,
            "step_ratio.no_pole": 1e6,
        }
    )
    finer = [*ours, point(40.0, 1e-12, "peer: z")]
    statuses = [next(simulator.ratios(finer, quick))["status"] for quick in (False, True)]
    assert statuses == ["ERROR", "SKIP"]


def test_between_two_methods_no_setting_is_made_up() -> None:
    fast, slow = point(1.0, 1e-2), point(100.0, 1e-6)
    assert simulator.time_at([fast, slow], 1e-4) == pytest.approx(10.0)
    assert simulator.time_at([replace(fast, method="another"), slow], 1e-4) == 100.0
    assert simulator.time_at([fast, slow], 1e-7) is None


# ---- the command -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["accuracy_lsb", "time_s"])
def test_a_scene_that_asks_for_an_accuracy_is_told_of_auto(key: str, tmp_path: Path) -> None:
    data = {"stimulus": {"kind": "uniform", "r_ohm": 1e3}, "run": {key: 0.1}}
    with pytest.raises(InputError, match=rf"run\.{key} = 0\.1: .*effects\] auto"):
        scene.from_data(data, tmp_path / "asks.toml")
