# SPDX-License-Identifier: Apache-2.0
"""The benchmark's own claims: its exact solution, its eye for faults, its rows."""

from __future__ import annotations

import os
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from dermis.effects import EFFECTS
from dermis.errors import InputError, SimulatorError
from dermis.report import verdict
from dermis.scene.design import spec
from tb.programs.bench import bench, circuit, engines, measure, peers
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


def test_ngspice_alone_repeats_a_run_that_starts_at_the_preset(tmp_path: Path) -> None:
    job = Job(replace(CIRCUIT, preset=True), keep=True)
    whole = circuit.measure(job, tmp_path / "whole", LIMIT_S)
    assert whole.code == CIRCUIT.pulses
    assert whole.error_v < spec()["cosim.edge_error_v"].max
    alone = circuit.measure(replace(job, simulator=None, charge=whole.charge), tmp_path / "alone", LIMIT_S)
    assert np.array_equal(alone.voltage, whole.voltage)


@pytest.mark.parametrize(
    "fault", [{"packet_error": 1e-6}, {"late_s": 20e-12}], ids=["packet_1e-6", "one_edge_20ps"]
)
def test_a_wrong_packet_and_a_late_edge_are_seen(tmp_path: Path, fault: dict[str, float]) -> None:
    good = circuit.measure(Job(CIRCUIT, keep=True), tmp_path / "good", LIMIT_S)
    bad = circuit.measure(Job(CIRCUIT, keep=True, **fault), tmp_path / "bad", LIMIT_S)
    assert np.array_equal(good.charge, bad.charge)  # far too little to move a pulse
    # A fault of 1e-6 packet makes 1e-7 V a packet: the right run must be far below one of them.
    assert good.error_v < 1e-10
    assert verdict.judge("cosim.edge_error_v.step_1u", bad.error_v)["status"] == "FAIL"
    packet, finished = CIRCUIT.packet_v, int(good.charge[:-1].sum())
    expected = finished * 1e-6 * packet if "packet_error" in fault else 20e-12 * 1e6 * packet
    # The run's own error is 5e-7 V at most; the seeded one is 20 to 40 uV.
    assert bad.error_v == pytest.approx(expected, rel=0.02)


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


def test_every_promised_row_is_promised_once() -> None:
    names = [name for section in bench.SECTIONS for name in section.names]
    assert len(names) == len(set(names))
    steps = {
        f"{head}.step_{s}"
        for s in ("10n", "100n", "1u")
        for head in ("cosim.edge_error_v", "peer.xspice.edge_error_v")
    }
    needed = {"cosim.frame_s", "closed.frames_per_s", "array.exponent", "rtl.frames_per_s.verilator", *steps}
    needed |= {f"event.frames_per_s.{kind}" for kind in ("ideal", "all_effects")}
    needed |= {f"cosim.clocks_per_s.{simulator}" for simulator in ("icarus", "verilator")}
    # Of rows with limits, those that have several variants are named by their head.
    heads = {".".join(name.split(".")[:end]) for name in names for end in (2, 3)}
    limited = {name for name, limit in spec().items() if limit.command == "make bench"}
    assert needed | limited <= {*names, *heads}


def test_only_takes_the_beginning_of_a_name_and_refuses_others() -> None:
    assert [s.names[0] for s in bench.chosen(["setup"])] == ["setup.second_call_s"]
    assert bench.chosen([]) == list(bench.SECTIONS)
    with pytest.raises(InputError, match=r"--only = cosim\.frame_: "):
        bench.chosen(["cosim.frame_"])


def test_docs_table_goes_between_its_marks_and_nowhere_else(tmp_path: Path) -> None:
    rows = [
        verdict.report("machine.cores", 2, "cores", "some machine"),
        verdict.judge("cosim.edge_error_v.step_1u", 2e-6, "a | b"),
    ]
    docs = tmp_path / bench.DOCS
    docs.parent.mkdir()
    docs.write_text(f"before\n{bench.BEGIN}\nold\n{bench.END}\nafter\n")
    bench.write_docs(rows, tmp_path)
    text = docs.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "Machine: some machine." in text
    assert "| `cosim.edge_error_v.step_1u` | 2e-06 | V | at most 1e-06 | FAIL | a \\| b |" in text
    assert "machine.cores" not in text


def test_quick_figures_never_reach_the_docs() -> None:
    result = CliRunner().invoke(bench.bench_command, ["--docs", "--quick"])
    assert isinstance(result.exception, InputError)


@pytest.mark.parametrize(
    "section",
    [
        # Compiling the loops of all effects takes most of the time.
        pytest.param(s, marks=pytest.mark.long if s.names[0].startswith("event") else (), id=s.names[0])
        for s in bench.SECTIONS
        # The others build, install or start simulators.
        if s.names[0].startswith(("closed", "peer.badcrossbar", "event", "effects_off", "array", "batch"))
    ],
)
def test_an_engine_section_makes_the_rows_it_promises(
    section: bench.Section, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "SAMPLE_S", 0.001)
    monkeypatch.setattr(engines, "LARGE", 32)
    monkeypatch.setattr(engines, "SIZES", (4, 8, 16))
    monkeypatch.setattr(engines, "BATCH_FRAMES", 8)
    rows = list(section.make(bench.Measurements(tmp_path, 1, True)))
    assert [row["name"] for row in rows] == list(section.names)
    assert {row["status"] for row in rows} <= {"PASS", "SKIP"}
    assert all(row["note"] for row in rows)


def test_the_benchmark_holds_itself_on_one_core() -> None:
    before = os.sched_getaffinity(0)
    with measure.one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before


def test_all_effects_are_all_that_the_engine_does(tmp_path: Path) -> None:
    on, lost = engines.all_effects("event", tmp_path)
    assert set(on) | set(lost) == set(EFFECTS)
    assert lost == ["return"]  # event refuses it together with line_capacitance
    assert "comparator_noise" in engines.all_effects("closed", tmp_path)[1]
