# SPDX-License-Identifier: Apache-2.0
"""Accuracy against time: the references, the order of convergence, and the command."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mpmath import mpf
from scipy.integrate import solve_ivp

from dermis import engines
from dermis.chip.ngspice import NgspiceHalf
from dermis.converter.vfc import count_exact
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from tb.programs.accuracy import chip, command, converter, frames
from tb.programs.accuracy.points import Method, Outcome, Point, from_csv, measure, pareto, points_csv
from tb.programs.bench import circuit as circuits
from tb.programs.bench.measure import random_plan
from tb.reference import frame as exact


def test_trapezoids_are_of_second_order_behind_a_pole(tmp_path: Path) -> None:
    _, orders = converter.orders(tmp_path)
    assert min(orders) >= 1.9, "the gate accuracy.order"


def test_backward_euler_would_miss_the_gate(tmp_path: Path) -> None:
    _, orders = converter.orders(tmp_path, converter.options_with(converter.EXACT, method="gear", maxord="1"))
    assert min(orders) < 1.5, "a method of order 1 has to show"


@pytest.mark.parametrize(
    ("cuts", "order"),
    [
        ((1,), 2),
        pytest.param((1, 2), 4, marks=pytest.mark.long),
        pytest.param((1, 2, 3), 6, marks=pytest.mark.long),
    ],
)
def test_runs_of_the_same_pulses_extrapolate_by_two_orders_each(
    cuts: tuple[int, ...], order: int, tmp_path: Path
) -> None:
    circuit = replace(converter.IDEAL, gate_clocks=60, t_gbw_s=converter.T_GBW_S)
    errors = []
    # 10 and 20 steps a clock; a wrong weight leaves order 2. Order 6 comes down to 1e-12 V, rounding leaves a tenth.
    for step in (100e-9, 50e-9):
        where = tmp_path / f"{step:g}"
        found = converter.extrapolated("icarus", step, cuts, circuit, where)
        assert found.largest_lsb == 0
        errors.append(found.error)
    assert np.log2(errors[0] / errors[1]) > order - 0.3, errors


def test_cut_steps_are_equal_from_corner_to_corner(tmp_path: Path) -> None:
    circuit = replace(converter.IDEAL, gate_clocks=4, t_gbw_s=converter.T_GBW_S)
    half = NgspiceHalf(
        circuits.deck(circuit),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=300e-9,
        t_stop_s=12e-6,
        log=tmp_path / "ngspice.log",
        record=True,
        use_ic=True,
        cuts=3,
    )
    circuits.walk(half, circuit, [0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0])
    half.close()
    times, _ = half.waveform()
    # The charge switch moves at 3 us: its ramp has 3 steps, the 999 ns behind it 3 times 4, 999 / 300 rounded up.
    behind = times[(times > 3e-6 - 1e-13) & (times < 4e-6 + 1e-13)]
    steps = np.diff(behind)
    assert steps.size == 3 + 12
    assert steps[:3] == pytest.approx(1e-9 / 3, rel=1e-5)  # a time of 3 us has 4e-22 s of rounding
    assert steps[3:] == pytest.approx(999e-9 / 12, rel=1e-8)  # the same rounding, of 83 ns


UNEVEN = """
import sys
from pathlib import Path
from dermis.errors import SimulatorError
from dermis.chip.ngspice import Deck, NgspiceHalf

lines = ("cut", "v_d d 0 external", "r1 d out 1k", "c1 out 0 1n", *sys.argv[2:])
half = NgspiceHalf(
    Deck(lines, ("v_d",), (0.0,), (False,), ("out",)),
    t_edge_s=1e-9,
    t_max_step_s=1e-7,
    t_stop_s=4e-6,
    log=Path("ngspice.log"),
    cuts=int(sys.argv[1]),
)
try:
    for n in range(1, 5):
        half.advance(1e-6 * n, [(1e-6 * (n - 1), 0, float(n % 2))] if n > 1 else [])
    print("all of it", half.statistics["rejected"])
except SimulatorError as error:
    print(error)
"""
EVEN = ".options trtol=1e12"  # no truncation control
TRUNCATED = ".options trtol=1 reltol=1e-6 vntol=1e-9 chgtol=1e-18"  # 86 steps of this circuit are rejected


@pytest.mark.parametrize(
    ("cuts", "lines", "said"),
    [
        (2, [EVEN], "all of it 0"),
        (2, [TRUNCATED], "steps cut in 2 must stay equal, and the one to "),
        (0, [TRUNCATED], "all of it"),
    ],
    ids=["even", "rejected", "not_cut"],
)
def test_a_cut_step_that_is_rejected_ends_the_run(
    cuts: int, lines: list[str], said: str, tmp_path: Path
) -> None:
    """The rest of an interval was divided anew, without a word. A process that failed takes no other circuit."""
    done = subprocess.run(
        [sys.executable, "-c", UNEVEN, str(cuts), *lines],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    if not cuts:
        assert done.stdout.strip() != "all of it 0", "the truncation control of this deck rejects"


def test_steps_are_not_cut_in_less_than_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cuts = -1: 0 or more"):
        NgspiceHalf(
            circuits.deck(converter.IDEAL),
            t_edge_s=1e-9,
            t_max_step_s=1e-7,
            t_stop_s=1e-6,
            log=tmp_path / "log",
            cuts=-1,
        )


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", converter.CIRCUITS)
def test_every_method_of_a_circuit_has_a_name_of_its_own(name: str, quick: bool) -> None:
    methods = [(who, how) for who, how, _ in converter.methods(converter.CIRCUITS[name], quick)]
    assert len(methods) == len(set(methods))
    assert {n.split(",")[0].split(":")[0] for n, _ in methods} == {"rtl", "cosim", "peer"}


@pytest.mark.parametrize("name", converter.CIRCUITS)
def test_the_integrators_of_engine_rtl_follow_the_exact_solution(name: str, tmp_path: Path) -> None:
    circuit = converter.CIRCUITS[name]
    effects = {"integrator_bandwidth": {"gbw_hz": 1e6}} if circuit.t_gbw_s else {}
    duty = np.full((1, 1, 1), float(circuit.duty))
    made = chip.plan_at(duty, effects, circuit.f_clk_hz, 60, 9e-6)
    codes, output, charge = converter.probed(made, "icarus", tmp_path / "run")
    assert abs(int(codes[0, 0]) - int(charge.sum())) <= 1, "the last packet may not have begun"
    # Packets of this engine have no ramps.
    exact_v = circuits.exact_voltage(replace(circuit, settle_clocks=0, t_edge_s=1e-30), charge)
    # 60 roundings of 0.1 V.
    assert -circuit.packet_v * output == pytest.approx(exact_v[1:], abs=1e-13)
    # With the ramps of the circuit they are off by half of one while a packet runs, and by nothing else.
    ramped = circuits.exact_voltage(replace(circuit, settle_clocks=0), charge)
    off = np.max(np.abs(-circuit.packet_v * output - ramped[1:]))
    assert off == pytest.approx(0.5 * circuit.t_edge_s * circuit.f_clk_hz * circuit.packet_v, rel=0.01), (
        "an amplifier of 1 MHz takes less than a hundredth of it away by the end of the clock"
    )


@pytest.mark.long
@pytest.mark.paper
def test_the_options_of_a_solver_reach_ngspice(tmp_path: Path) -> None:
    made = replace(random_plan(tmp_path, 1, "event", 2, **frames.EFFECTS), engine="cosim")
    runs = [engines.run(made, solver=solver) for solver in frames.SOLVERS.values()]
    assert (runs[0].codes[0] == exact.frame(made).codes).all()
    shipped, loose, _ = (run.info["steps"]["accepted"] for run in runs)
    assert loose < 0.6 * shipped, "tolerances that the deck has as well are replaced: 1107 steps, not 2978"


def test_a_failure_is_an_error_row() -> None:
    def broken() -> Outcome:
        raise SimulatorError("it fell over")

    points, rows = measure("frames, x", [Method("cosim", "s", broken)], 1, lambda words: None)
    assert points == []
    assert [(row["name"], row["status"], row["note"]) for row in rows] == [
        ("accuracy.frames.x.cosim.s", "ERROR", "it fell over")
    ]


def test_methods_run_in_turns_and_slow_ones_once() -> None:
    order: list[str] = []

    def method(name: str, slow: bool) -> Method:
        def run() -> Outcome:
            order.append(name)
            return Outcome(1e-3, 1.0, float(len(order)))

        return Method(name, "s", run, slow)

    points, rows = measure("w", [method("a", False), method("b", True)], 3, lambda words: None)
    assert rows == []
    assert order == ["a", "b", "a", "a"]
    assert [(p.method, p.seconds, p.least_s, p.most_s, p.runs) for p in points] == [
        ("a", 3.0, 1.0, 4.0, 3), ("b", 2.0, 2.0, 2.0, 1),
    ]  # fmt: skip


def test_the_exact_voltage_behind_a_pole_solves_its_equation() -> None:
    circuit = replace(converter.IDEAL, gate_clocks=12, t_gbw_s=2e-7)
    told = [0, 0, 1, 1, 0, 0, 0, 1, 0, 1, 0, 0]
    found = circuits.exact_voltage(circuit, np.array(told))

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
            size = mpf(packet.numerator) / packet.denominator
            took, w_end = exact.count(wanted, 510, size, start, level, mpf(0))
            drawn = (510 * x - Fraction(1, 2) - Fraction(float(w_end))) / packet
            # Decided in the last two clocks and not yet drawn: the rest is whole packets, up to a double's rounding.
            assert abs(float(drawn) - round(drawn)) < 1e-12
            assert 0 <= took - round(drawn) <= 2
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
    # A value that stands in no option set.
    line = converter.options_with(converter.POLE, reltol=2e-6, method="gear")
    assert line.split().count("reltol=2e-06") == 1  # the one given here
    assert "reltol=0.0001" not in line  # that of the set
    assert line.endswith("method=gear")


def point(time: float, error: float, method: str = "method") -> Point:
    return Point("converter, no pole", method, f"{time}", error, "V", 0.0, time, time, time, 1)


def test_the_front_holds_what_nothing_beats() -> None:
    points = [point(1.0, 0.5), point(2.0, 0.6), point(3.0, 0.1), point(0.5, 0.9), point(4.0, 0.1)]
    assert [p.seconds for p in pareto(points)] == [0.5, 1.0, 3.0]
    assert from_csv(points_csv(points)) == points


def test_engines_are_compared_with_the_best_peer() -> None:
    ours = [point(1.0, 1e-3, "cosim, icarus, step"), point(10.0, 1e-9, "cosim, icarus, step")]
    points = [
        *ours,
        point(0.1, 1e-3, "rtl, verilator"),
        point(5.0, 1e-3, "peer: x"),
        point(40.0, 1e-9, "peer: y"),
    ]
    rows = {row["name"].removeprefix("accuracy."): row["value"] for row in command.ratios(points)}
    assert rows == pytest.approx(
        {
            "speed_at_equal_error.no_pole.best_peer": 4.0,
            "error_at_equal_time.no_pole.best_peer": 1.0,
            "speed_at_equal_error.no_pole.any_engine.best_peer": 4.0,
            "error_at_equal_time.no_pole.any_engine.best_peer": 1.0,
            "step_ratio.no_pole": 1e6,
        }
    )


def test_between_two_methods_no_setting_is_made_up() -> None:
    fast, slow = point(1.0, 1e-2), point(100.0, 1e-6)
    assert command.time_at([fast, slow], 1e-4) == pytest.approx(10.0)
    assert command.time_at([replace(fast, method="another"), slow], 1e-4) == 100.0
    assert command.time_at([fast, slow], 1e-7) is None


# ---- the command -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--redraw --only order --quick", "--redraw = with --quick and --only"),
        ("--docs --only order", "--docs = with --quick or --only"),
        ("--docs --quick", "--docs = with --quick or --only"),
        ("--quick --repeat 2", "--quick and --repeat = 2"),
    ],
)
def test_options_that_would_be_ignored_are_refused_before_anything_is_measured(
    words: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--docs would write a quick run's figures, or nothing, and both ended with 0."""
    for place, name in ((command, "draw"), (converter, "order_row"), (command, "_measured")):
        monkeypatch.setattr(place, name, pytest.fail)
    refused = CliRunner().invoke(command.accuracy_command, words.split())
    assert isinstance(refused.exception, InputError), refused
    assert said in str(refused.exception)


@pytest.mark.parametrize(("words", "done"), [("--redraw", "drawn"), ("--redraw --docs", "drawn and copied")])
def test_what_an_option_is_for_goes_through(words: str, done: str, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    monkeypatch.setattr(command, "draw", lambda *_: steps.append("drawn"))
    monkeypatch.setattr(command, "_copy_figures", lambda *_: steps.append("copied"))
    went = CliRunner().invoke(command.accuracy_command, words.split(), standalone_mode=False)
    assert went.exception is None
    assert " and ".join(steps) == done


@pytest.mark.parametrize("key", ["accuracy_lsb", "time_s"])
def test_a_scene_that_asks_for_an_accuracy_is_told_of_auto(key: str, tmp_path: Path) -> None:
    data = {"stimulus": {"kind": "uniform", "r_ohm": 1e3}, "run": {key: 0.1}}
    with pytest.raises(InputError, match=rf"run\.{key} = 0\.1: .*effects\] auto"):
        scene.from_data(data, tmp_path / "asks.toml")
