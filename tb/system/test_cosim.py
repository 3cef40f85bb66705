# SPDX-License-Identifier: Apache-2.0
"""The real Verilog in lock-step with an analog half, against the exact charge-balance count."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from system_bench import FaultyChip, MakePlan, of_codes

from dermis import engines
from dermis.chip import netlist
from dermis.chip.analog import ExactHalf
from dermis.engines import Result, closed, cosim
from dermis.errors import InputError, SimulatorError
from dermis.lockstep.ngspice import Deck
from dermis.report import comparison
from dermis.report.waves import integrator_waves
from dermis.scene.design import TOPOLOGIES
from tb.reference.ladder_circuits import LEAP


@pytest.mark.parametrize(
    ("simulator", "sync_latch"),
    [
        pytest.param("icarus", False, id="icarus-two_flops"),
        pytest.param("icarus", True, id="icarus-flop_and_latch"),
        pytest.param("verilator", True, id="verilator-flop_and_latch", marks=pytest.mark.long),
        pytest.param("verilator", False, id="verilator-two_flops", marks=pytest.mark.long),
    ],
)
def test_verilog_counts_charge_balance(resistance_plan: MakePlan, simulator: str, sync_latch: bool) -> None:
    """No circuit simulator: the bridge and the Verilog alone, from open to short, against the closed formula."""
    rng = np.random.default_rng(7)
    ohm = 300 * 300 ** rng.random((4, 16))
    ohm[1, :4] = [0.0, np.inf, 312.0, 500.0]
    ohm[2, :4] = [np.inf, 500.0, 64250.0, 0.0]
    made = resistance_plan(ohm)
    got = cosim.run(made, simulator=simulator, sync_latch=sync_latch, analog="exact").codes
    assert np.array_equal(got, closed.run(made).codes)


SPI = "dermis_spi.v", "assign cipo_o           = cipo_q;"
FAULTY_CHIPS = {
    # file, right, wrong, what the run says
    "crc": ("dermis_packer.v", "16'hFFFF", "16'h0000", "through SPI: frame of 38 bytes: CRC .* does not match"),
    "frame_number": ("dermis_packer.v", "_number_q + 16'd1", "_number_q + 16'd2", "handed over number 2 in place of 1"),
    "slot_number": ("dermis_packer.v", "data = slot_i", "data = slot_i + 8'd1", r"slots \(1, 2\) in place of"),
    "x_on_charge": (
        "dermis_safe_outputs.v", "assign charge_o       = charge_i",
        "assign charge_o = row_select_i[1] ? {COLS{1'bx}} : charge_i", r"dermis_top\.charge_o is x+, not 0 or 1",
    ),
    "never_ready": (
        "dermis_frame_buffer.v", "assign frame_ready_o = ready_q;", "assign frame_ready_o = 1'b0;",
        "never reports a frame as ready",
    ),
    "cipo_at_1": (*SPI, "assign cipo_o = 1'b1;", "0xFF is no token"),
    "cipo_at_0": (*SPI, "assign cipo_o = 1'b0;", "no answer after"),
    "no_scan": ("dermis_row_scanner.v", "= row_select_q;", "= {ROWS{1'b0}};", "does not begin with row 0 driven"),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTY_CHIPS)
def test_a_faulty_chip_is_a_simulator_error(
    resistance_plan: MakePlan, tmp_path: Path, faulty_chip: FaultyChip, fault: str
) -> None:
    """Whatever the host gets that is not every frame, once and whole, ends the run with what was received."""
    file, right, wrong, said = FAULTY_CHIPS[fault]
    faulty_chip(file, right, wrong)
    with pytest.raises(SimulatorError, match=said):
        cosim.run(resistance_plan(np.full((2, 2, 11), 700.0)), analog="exact", work=tmp_path / "work")


REFUSED = {
    "array.rows = 129: the chip does 1 to 128 ": ({}, (129, 1)),
    "array.cols = 129: the chip does 1 to 128 ": ({}, (1, 129)),
    "timing.gate_clocks = 65536: the chip does ": ({"gate_clocks": 65536, "slot_clocks": 65651}, (2, 2)),
    # To pack 16 columns of one byte takes 34 clocks; the chip would lengthen its slots.
    "timing.gate_clocks = 33: the chip does 34 to ": ({"code_max": 15, "gate_clocks": 33, "slot_clocks": 148}, (2, 16)),
    "timing.settle_clocks = 2: the chip does ": ({"settle_clocks": 2, "slot_clocks": 512}, (2, 2)),
    "timing.code_bits = 17: the chip does 1 to 16 ": ({"code_max": 2**17 - 1}, (2, 2)),
}  # fmt: skip


@pytest.mark.parametrize("engine", ["rtl", "cosim"])
@pytest.mark.parametrize("said", REFUSED)
def test_what_the_chip_is_not_made_for_is_refused(resistance_plan: MakePlan, said: str, engine: str) -> None:
    timing, shape = REFUSED[said]
    made = resistance_plan(np.full(shape, 1000.0))
    made = replace(made, engine=engine, timing=replace(made.timing, **timing))
    for refused in (engines.check, engines.runner(engine)):
        with pytest.raises(InputError, match=said) as caught:
            refused(made)
        assert "\n" not in str(caught.value)


@pytest.mark.paper
# test_sweep.py reads a row of every topology through ngspice.
@pytest.mark.parametrize(
    "topology", [pytest.param(t, marks=[pytest.mark.long] * (t != "conveyor_mirror")) for t in TOPOLOGIES]
)
def test_all_256_codes_read_back_exactly_through_ngspice(resistance_plan: MakePlan, topology: str) -> None:
    codes = np.random.default_rng(3).permutation(256).reshape(16, 16)
    made = resistance_plan(of_codes(codes), topology)
    assert np.array_equal(cosim.run(made).codes[0], codes)


@pytest.mark.paper
def test_shorts_and_opens_leave_no_ghost(resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of 312 ohm, of 0 or open, in two frames of one process: the preset must make the next row
    and the next frame forget them.
    """
    monkeypatch.setattr(cosim.os, "cpu_count", lambda: 1)
    row_ohm = np.array([[312.0, 31875.0, 0.0, 0.0], [31875.0, np.inf, 15937.5, 0.0]])
    codes = np.array([[255, 4, 255, 255], [4, 0, 8, 255]])
    made = resistance_plan(np.repeat(row_ohm[..., None], 3, axis=2))
    assert np.array_equal(cosim.run(made).codes, np.repeat(codes[..., None], 3, axis=2))


def test_integrators_follow_the_exact_half_to_a_microvolt(resistance_plan: MakePlan) -> None:
    """Replays what the Verilog did in the exact half and compares every integrator at every clock edge."""
    rng = np.random.default_rng(5)
    made = resistance_plan(600 * 50 ** rng.random((2, 4)))
    record = cosim.run(made, record=True).info["records"][0]
    t_clk, rows, cols = 1.0 / made.timing.f_clk_hz, made.rows, made.cols
    time, volts = integrator_waves(record, cols)
    duty = made.duty_ideal()[0]
    levels = [1.0] + [0.0] * (rows - 1) + [1.0] + [0.0] * cols
    half = ExactHalf(duty, levels, t_clk_s=t_clk, t_edge_s=cosim.Solver().t_edge_s)
    nets = [record["trace"][name] for name in ("row_select", "preset", "charge")]
    old, edges, worst = (1, 1, 0), [], 0.0
    for clock, new in enumerate(zip(*nets, strict=True), start=1):
        half.advance(clock * t_clk, edges)
        at = int(np.argmin(np.abs(time - clock * t_clk)))
        assert abs(time[at] - clock * t_clk) < 1e-15, "every clock edge is a time point"
        if old[1] == 0:
            worst = max(worst, float(np.abs(-volts[:, at] - half.w * made.converter.packet_v()).max()))
        places = ((0, 0, rows), (1, rows, 1), (2, rows + 1, cols))
        bits = [(net, first + bit, bit) for net, first, width in places for bit in range(width)]
        changed = [(net, source, bit) for net, source, bit in bits if (new[net] ^ old[net]) >> bit & 1]
        edges = [(clock * t_clk, source, float(new[net] >> bit & 1)) for net, source, bit in changed]
        old = new
    # A packet is 1 V; steps are as long as a clock.
    assert worst < 1e-6


@pytest.mark.paper
def test_the_judge_catches_one_wrong_code(resistance_plan: MakePlan) -> None:
    codes = np.arange(256).reshape(16, 16)
    made = resistance_plan(of_codes(codes))
    right = codes.astype(np.uint8)[np.newaxis]
    wrong = right.copy()
    wrong[0, 9, 9] += 1

    def exact_row(read: np.ndarray) -> dict:
        rows = comparison.compare(made, Result(read), "case")
        return next(row for row in rows if row["name"] == "frame.code_error_exact_lsb.case")

    assert exact_row(right)["status"] == "PASS"
    assert exact_row(wrong)["status"] == "FAIL"
    assert exact_row(wrong)["value"] == 1


@pytest.mark.paper
def test_a_frame_given_up_in_mid_run_is_read_again_on_the_next_rung(
    resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    made = resistance_plan(of_codes(np.array([[100]])))
    plain = netlist.frame_deck

    def leaping(*arguments: Any, **options: Any) -> Deck:
        """Add a circuit that ngspice gives up in mid-run and that touches no converter."""
        deck = plain(*arguments, **options)
        return replace(deck, lines=(*deck.lines, *LEAP))

    monkeypatch.setattr(netlist, "frame_deck", leaping)
    got = cosim.run(made)
    assert got.codes.tolist() == [[[100]]]
    ((frame, (retry,)),) = got.info["retries"].items()
    assert (frame, retry["rung"], retry["next"]) == ("frame 0", "plain", "capacitance")
    assert "Timestep too small" in retry["said"]
    assert retry["node"] == "leap"
    # the law begins there
    assert retry["time_s"] == pytest.approx(6e-5, rel=1e-6)
    assert "ngspice, frame 0, at " in capfd.readouterr().err
