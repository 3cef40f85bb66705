# SPDX-License-Identifier: Apache-2.0
"""The benchmark's own claims: its exact solution, its eye for faults, its rows."""

from pathlib import Path

import pytest

from dermis.effects import EFFECTS
from dermis.errors import InputError, SimulatorError
from dermis.report import verdict
from dermis.scene.design import spec
from tb.programs.bench import bench, circuit, peers
from tb.programs.bench.circuit import Circuit

LIMIT_S = 60.0
CLOCKS = 300
CIRCUIT = Circuit(gate_clocks=CLOCKS)


def test_verilog_with_ngspice_meets_the_exact_solution_at_a_tenth_of_a_clock(tmp_path: Path) -> None:
    run = circuit.cosim(CIRCUIT, 100e-9, CLOCKS, tmp_path / "run", LIMIT_S)
    assert (run.code, run.miscount) == (CIRCUIT.pulses, 0)
    assert run.charge.sum() > 100
    assert run.error_v < spec()["cosim.edge_error_v"].max


def test_a_wrong_packet_is_seen(tmp_path: Path) -> None:
    good = circuit.cosim(CIRCUIT, 1e-6, CLOCKS, tmp_path / "good", LIMIT_S)
    bad = circuit.cosim(CIRCUIT, 1e-6, CLOCKS, tmp_path / "bad", LIMIT_S, packet_error=1e-6)
    assert good.error_v < 1e-10, "far below the 1e-7 V a packet of the fault"
    assert verdict.judge("cosim.edge_error_v.step_1u", bad.error_v)["status"] == "FAIL"
    # The run's own error is 5e-7 V at most; the seeded one is 20 to 40 uV.
    assert bad.error_v == pytest.approx(int(bad.charge[:-1].sum()) * 1e-6 * CIRCUIT.packet_v, rel=0.02)


def test_a_job_that_takes_too_long_is_ended_and_named(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match=r"more than 0\.01 s"):
        circuit.cosim(CIRCUIT, 1e-6, CLOCKS, tmp_path / "run", 0.01)


def test_a_job_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match="nan cannot stand in a deck"):
        circuit.cosim(CIRCUIT, 1e-6, CLOCKS, tmp_path / "run", LIMIT_S, packet_error=float("nan"))


def test_xspice_counts_right_on_the_same_circuit(tmp_path: Path) -> None:
    run = peers.xspice(CIRCUIT, 1e-6, CLOCKS, tmp_path / "run", LIMIT_S)
    assert run.miscount == 0
    assert 0 < run.error_v < 0.5 * CIRCUIT.packet_v
    assert run.seconds > 0


def test_a_failed_section_is_an_error_row_with_its_reason() -> None:
    def fails(m: bench.Measurements):
        yield verdict.report("a.one", 1, "1")
        raise SimulatorError("the tool fell over")

    rows = bench.run_section(bench.Section(fails, ("a.one", "a.two")), None)
    assert [(row["name"], row["status"]) for row in rows] == [("a.one", "PASS"), ("a.two", "ERROR")]
    assert "the tool fell over" in rows[1]["note"]


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
    monkeypatch.setattr(bench, "SAMPLE_S", 0.001)
    monkeypatch.setattr(bench, "LARGE", 32)
    monkeypatch.setattr(bench, "SIZES", (4, 8, 16))
    rows = list(section.make(bench.Measurements(tmp_path, 1, True)))
    names = {row["name"] for row in rows}
    assert len(names) == len(rows) >= len(section.names)
    assert {n for n in READ_BY_OTHERS if n.startswith(section.names)} <= names
    assert all(name.startswith(section.names) for name in names)
    assert {row["status"] for row in rows} <= {"PASS", "SKIP"}
    assert all(row["note"] for row in rows)


def test_all_effects_are_all_that_the_engine_does() -> None:
    on, lost = bench.all_effects("event")
    assert set(on) | set(lost) == set(EFFECTS)
    assert lost == ["return"]  # event refuses it together with line_capacitance
    assert "comparator_noise" in bench.all_effects("closed")[1]
