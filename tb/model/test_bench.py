# SPDX-License-Identifier: Apache-2.0
"""The benchmark's own claims: its exact solution, its eye for faults, its rows."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dermis.effects import EFFECTS
from dermis.errors import InputError, SimulatorError
from dermis.report import verdict
from dermis.scene.design import spec
from tb.programs.bench import bench, circuit, engines, peers
from tb.programs.bench.circuit import Circuit, Job

LIMIT_S = 60.0
CIRCUIT = Circuit(gate_clocks=300)


def _told(clocks: int, which: Circuit) -> np.ndarray:
    """Bits such as the Verilog gives, from a walk in rationals that shares nothing with exact_voltage."""
    w, x, bits = Fraction(-1, 2) - which.settle_clocks * which.duty, which.duty, []
    for _ in range(clocks):
        w += x
        bits.append(int(w >= 0))
        w -= bits[-1]
    return np.array([0, *bits[:-1]])  # the second flip-flop tells the switch a clock later


def _integrated(which: Circuit, told: np.ndarray, points: int = 4000) -> np.ndarray:
    """Integrator at the clocks by summing the current over a fine grid that has every corner of it."""
    t_clk = 1.0 / which.f_clk_hz
    voltage = [which.v_start_v]
    before = 0
    for now in told:
        t = np.linspace(0.0, t_clk, points + 1)  # t_edge is a whole number of grid steps
        level = np.interp(t, [0.0, which.t_edge_s, t_clk], [before, now, now])
        current = which.i_in_a - which.i0_a * level
        voltage.append(voltage[-1] - np.trapezoid(current, t) / which.c_int_f)
        before = now
    return np.array(voltage)


def test_exact_solution_is_the_integral_of_the_ramped_currents() -> None:
    told = _told(200, CIRCUIT)
    assert 0 < told.sum() < 100
    # The peer sums 200 clocks of 0.1 V in doubles: 200 roundings of 1e-16 V, and as many of time.
    assert circuit.exact_voltage(CIRCUIT, told) == pytest.approx(_integrated(CIRCUIT, told), abs=1e-12)


def test_verilog_with_ngspice_meets_the_exact_solution_at_a_tenth_of_a_clock(tmp_path: Path) -> None:
    run = circuit.measure(Job(CIRCUIT, t_max_step_s=100e-9, keep=True), tmp_path / "run", LIMIT_S)
    assert (run.code, run.miscount) == (CIRCUIT.pulses, 0)
    assert run.charge.sum() > 100
    assert run.error_v < spec()["cosim.edge_error_v"].max


def test_a_wrong_packet_is_seen(tmp_path: Path) -> None:
    good = circuit.measure(Job(CIRCUIT, keep=True), tmp_path / "good", LIMIT_S)
    bad = circuit.measure(Job(CIRCUIT, keep=True, packet_error=1e-6), tmp_path / "bad", LIMIT_S)
    # A fault of 1e-6 packet makes 1e-7 V a packet: the right run must be far below one of them.
    assert good.error_v < 1e-10
    assert verdict.judge("cosim.edge_error_v.step_1u", bad.error_v)["status"] == "FAIL"
    # The run's own error is 5e-7 V at most; the seeded one is 20 to 40 uV.
    assert bad.error_v == pytest.approx(int(bad.charge[:-1].sum()) * 1e-6 * CIRCUIT.packet_v, rel=0.02)


def test_a_job_that_takes_too_long_is_ended_and_named(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match=r"ended after 0\.01 s"):
        circuit.measure(Job(CIRCUIT), tmp_path / "run", 0.01)


def test_a_job_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match="nan cannot stand in a deck"):
        circuit.measure(Job(CIRCUIT, packet_error=float("nan")), tmp_path / "run", LIMIT_S)


def test_xspice_counts_right_on_the_same_circuit(tmp_path: Path) -> None:
    run = peers.xspice(CIRCUIT, 1e-6, 300, tmp_path / "run", LIMIT_S)
    assert run.count_error == 0
    assert 0 < run.error_v < 0.5 * CIRCUIT.packet_v
    assert run.seconds > 0


def test_failed_and_endless_sections_are_error_rows_with_their_reason() -> None:
    def fails(m: bench.Measurements):
        yield verdict.report("a.one", 1, "1")
        raise SimulatorError("the tool fell over")

    def hangs(m: bench.Measurements):
        while True:
            pass
        yield

    rows = bench.run_section(bench.Section(("a.one", "a.two"), fails, 5), None)
    rows += bench.run_section(bench.Section(("a.three",), hangs, 0.2), None)
    assert [(row["name"], row["status"]) for row in rows] == [
        ("a.one", "PASS"), ("a.two", "ERROR"), ("a.three", "ERROR"),
    ]  # fmt: skip
    assert "the tool fell over" in rows[1]["note"]
    assert "0.2 s" in rows[2]["note"]


READ_BY_OTHERS = (
    *(f"{head}.step_{s}" for s in ("10n", "100n", "1u") for head in ("cosim.edge_error_v", "peer.xspice.edge_error_v")),
    "cosim.clocks_per_s.icarus", "cosim.clocks_per_s.verilator", "cosim.frame_s", "closed.frames_per_s",
    "event.frames_per_s.ideal", "event.frames_per_s.all_effects", "rtl.frames_per_s.verilator", "array.exponent",
)  # fmt: skip
"""Names of rows that scripts read; they stay."""


def test_only_finds_what_makes_a_row_and_refuses_other_names() -> None:
    limited = [name for name, limit in spec().items() if limit.command == "make bench"]
    for name in (*READ_BY_OTHERS, *limited):
        assert len(bench.chosen([name])) == 1, name
    assert [s.names[0] for s in bench.chosen(["setup"])] == ["setup.second_call_s"]
    assert bench.chosen([]) == list(bench.SECTIONS)
    with pytest.raises(InputError, match=r"--only = cosim\.frame_: "):
        bench.chosen(["cosim.frame_"])


@pytest.mark.parametrize(
    "section",
    [
        # Compiling the loops of all effects takes most of the time.
        pytest.param(s, marks=pytest.mark.long if s.names[0].startswith("event") else (), id=s.names[0])
        for s in bench.SECTIONS
        # The others build, install or start simulators.
        if s.names[0].startswith(("closed", "peer.badcrossbar", "event", "effects_off", "array"))
    ],
)
def test_an_engine_section_makes_the_rows_it_promises(
    section: bench.Section, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "SAMPLE_S", 0.001)
    monkeypatch.setattr(engines, "LARGE", 32)
    monkeypatch.setattr(engines, "SIZES", (4, 8, 16))
    rows = list(section.make(bench.Measurements(tmp_path, 1, True)))
    names = {row["name"] for row in rows}
    assert len(names) == len(rows) >= len(section.names)
    assert {n for n in READ_BY_OTHERS if n.startswith(section.names)} <= names
    assert all(name.startswith(section.names) for name in names)
    assert {row["status"] for row in rows} <= {"PASS", "SKIP"}
    assert all(row["note"] for row in rows)


def test_all_effects_are_all_that_the_engine_does(tmp_path: Path) -> None:
    on, lost = engines.all_effects("event", tmp_path)
    assert set(on) | set(lost) == set(EFFECTS)
    assert lost == ["return"]  # event refuses it together with line_capacitance
    assert "comparator_noise" in engines.all_effects("closed", tmp_path)[1]
