# SPDX-License-Identifier: Apache-2.0
"""The benchmark's own claims: its exact solution, its eye for faults, its rows."""

from __future__ import annotations

import json
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
    run = circuit.measure(Job(CIRCUIT, 1, t_max_step_s=100e-9, keep=True), tmp_path / "run", LIMIT_S)
    assert run.codes.tolist() == [CIRCUIT.pulses]
    assert run.charge[0].sum() > 100
    assert circuit.edge_error_v(CIRCUIT, run.voltage[0], run.charge[0]) < spec()["cosim.edge_error_v"].max


def test_integration_starts_at_the_edge_that_opens_the_preset(tmp_path: Path) -> None:
    held = replace(CIRCUIT, preset=True)
    run = circuit.measure(Job(held, 2, keep=True), tmp_path / "run", LIMIT_S)
    assert run.codes.tolist() == [held.pulses] * 2
    for voltage, charge in zip(run.voltage, run.charge, strict=True):
        assert circuit.edge_error_v(held, voltage, charge) < spec()["cosim.edge_error_v"].max


@pytest.mark.parametrize(
    "fault", [{"packet_error": 1e-6}, {"late_s": 20e-12}], ids=["packet_1e-6", "one_edge_20ps"]
)
def test_a_wrong_packet_and_a_late_edge_are_seen(tmp_path: Path, fault: dict[str, float]) -> None:
    good = circuit.measure(Job(CIRCUIT, 1, keep=True), tmp_path / "good", LIMIT_S)
    bad = circuit.measure(Job(CIRCUIT, 1, keep=True, **fault), tmp_path / "bad", LIMIT_S)
    assert np.array_equal(good.charge, bad.charge)  # far too little to move a pulse
    # A fault of 1e-6 packet makes 1e-7 V a packet: the right run must be far below one of them.
    assert circuit.edge_error_v(CIRCUIT, good.voltage[0], good.charge[0]) < 1e-10
    error = circuit.edge_error_v(CIRCUIT, bad.voltage[0], bad.charge[0])
    row = verdict.judge("cosim.edge_error_v.step_1u", error)
    assert row["status"] == "FAIL"
    packet = CIRCUIT.packet_v
    expected = run_up(good.charge[0]) * 1e-6 * packet if "packet_error" in fault else 20e-12 * 1e6 * packet
    # The run's own error is 5e-7 V at most; the seeded one is 20 to 40 uV.
    assert error == pytest.approx(expected, rel=0.02)


def run_up(charge: np.ndarray) -> int:
    """Packets finished by the last clock."""
    return int(charge[:-1].sum())


def test_ngspice_alone_repeats_the_run_with_the_verilog(tmp_path: Path) -> None:
    held = replace(CIRCUIT, preset=True)
    whole = circuit.measure(Job(held, 1, keep=True), tmp_path / "whole", LIMIT_S)
    job = Job(held, 1, simulator=None, keep=True, charge=whole.charge[0])
    alone = circuit.measure(job, tmp_path / "alone", LIMIT_S)
    assert np.array_equal(alone.voltage, whole.voltage)


def test_a_job_that_takes_too_long_is_ended_and_named(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match=r"more than 0\.01 s"):
        circuit.measure(Job(CIRCUIT, 1), tmp_path / "run", 0.01)


def test_a_child_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match="nan cannot stand in a deck"):
        circuit.measure(Job(CIRCUIT, 1, packet_error=float("nan")), tmp_path / "run", LIMIT_S)


def test_xspice_counts_right_on_the_same_circuit(tmp_path: Path) -> None:
    run = peers.xspice(CIRCUIT, 1e-6, 300, tmp_path / "run", LIMIT_S)
    assert run.count_error == 0
    assert 0 < run.error_v < 0.5 * CIRCUIT.packet_v
    assert run.rate > 0


def test_a_failed_measurement_is_an_error_row_with_its_reason() -> None:
    def make(m: bench.Measurements):
        yield verdict.report("a.one", 1, "1")
        raise SimulatorError("the tool fell over")

    rows = bench.run_section(bench.Section(("a.one", "a.two"), make, 5), None)
    assert [(row["name"], row["status"]) for row in rows] == [("a.one", "PASS"), ("a.two", "ERROR")]
    assert rows[1]["note"] == "the tool fell over"
    assert verdict.exit_code(rows) == 1


def test_a_section_that_hangs_is_an_error_row() -> None:
    def make(m: bench.Measurements):
        while True:
            pass
        yield

    rows = bench.run_section(bench.Section(("a.one",), make, 0.2), None)
    assert rows[0]["status"] == "ERROR"
    assert "0.2 s" in rows[0]["note"]


def test_every_promised_row_is_promised_once() -> None:
    names = [name for section in bench.SECTIONS for name in section.names]
    assert len(names) == len(set(names))
    needed = {
        "cosim.frame_s",
        "closed.frames_per_s",
        "event.frames_per_s.ideal",
        "event.frames_per_s.all_effects",
    }
    needed |= {f"cosim.edge_error_v.step_{s}" for s in ("10n", "100n", "1u")} | {"array.exponent"}
    needed |= {"cosim.clocks_per_s.icarus", "cosim.clocks_per_s.verilator", "rtl.frames_per_s.verilator"}
    assert needed <= set(names)


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
    docs.write_text("no marks")
    with pytest.raises(InputError, match=bench.DOCS):
        bench.write_docs(rows, tmp_path)


def test_quick_figures_never_reach_the_docs() -> None:
    result = CliRunner().invoke(bench.bench_command, ["--docs", "--quick"])
    assert isinstance(result.exception, InputError)


def test_a_row_survives_json() -> None:
    row = verdict.median("cosim.clocks_per_s.icarus", [6000.0, 7000.0, 9000.0], "1/s")
    assert json.loads(json.dumps(row, allow_nan=False))["value"] == 7000.0
    assert "6000 .. 9000" in row["note"]
    assert row["status"] == "PASS"
    assert verdict.median("cosim.clocks_per_s.icarus", [10.0], "1/s")["status"] == "SKIP"


@pytest.mark.parametrize(
    ("names", "make"),
    [
        # Compiling the loops of all effects takes most of the time.
        pytest.param(names, make, marks=pytest.mark.long if make is engines.event_rows else ())
        for names, make, _ in engines.SECTIONS
        if make not in (engines.rtl_rows, engines.memory_rows)  # a build, and five processes
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_an_engine_section_makes_the_rows_it_promises(
    names: tuple[str, ...], make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "SAMPLE_S", 0.001)
    monkeypatch.setattr(engines, "LARGE", 32)
    monkeypatch.setattr(engines, "SIZES", (4, 8, 16))
    monkeypatch.setattr(engines, "BATCH_FRAMES", 8)
    rows = list(make(tmp_path, 1, True))
    assert [row["name"] for row in rows] == list(names)
    assert {row["status"] for row in rows} <= {"PASS", "SKIP"}
    assert all(row["note"] for row in rows)


def test_memory_grows_with_the_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {"memory_mb.start": 1, "memory_mb.closed": 3000}
    monkeypatch.setattr(engines, "MEMORY", {n: ("closed", 16, f, {}) for n, f in sizes.items()})
    small, large = engines.memory_rows(tmp_path, 1, True)
    assert 20 < small["value"] < large["value"] - 3000 * 256 * 8 / 1e6


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
