# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_frame_buffer."""

from pathlib import Path

import pytest
from rtl_run import changed, simulate, sync_random

SIZE = {"BANK_BYTES": 20}


def whole_frames(simulator: str, trap: Path | None) -> dict[str, int]:
    scenario = {"seed": 0, "bank_bytes": SIZE["BANK_BYTES"], "reads": 150}
    bench = simulator, "bench_frame_buffer", "dermis_frame_buffer", "whole_frames"
    return simulate(*bench, SIZE, scenario, trap=trap)


def test_a_read_sees_one_whole_frame_whatever_the_clocks(simulator: str, tmp_path: Path) -> None:
    got = whole_frames(simulator, sync_random(tmp_path))
    assert got["different"] > 20
    assert got["lost"] > 0


# CS always seen a clock late: the worst that a metastable flop may do to the order of CS and claim.
LATE = """
module late_sync (input wire clk_i, input wire rst_ni, input wire d_i, output wire q_o);
  wire q;
  dermis_tech_sync u_sync (.clk_i (clk_i), .rst_ni (rst_ni), .d_i (d_i), .q_o (q));
  dermis_tech_dff u_late (.clk_i (clk_i), .rst_ni (rst_ni), .d_i (q), .q_o (q_o));
endmodule
"""
LATE_CS = ("dermis_tech_sync u_sync_cs", "late_sync u_sync_cs")

FAULTS = {
    "the bank in front is written": [("assign back  = ~(front_q", "assign back  =  (front_q")],
    "a held bank is swapped": [("assign free  = ~held_q | grant | deselected;", "assign free  = 1'b1;")],
    "a late release goes before the grant": [
        LATE_CS,
        ("if (grant)           held_q <= 1'b1;", "if (deselected)     held_q <= 1'b0;"),
        ("else if (deselected) held_q <= 1'b0;", "else if (grant) held_q <= 1'b1;"),
    ],
}


@pytest.mark.long
def test_a_cs_that_is_seen_late_lets_go_of_nothing(tmp_path: Path) -> None:
    trap = changed(tmp_path, "dermis_frame_buffer", LATE_CS, more=LATE)
    assert whole_frames("icarus", trap)["different"] > 20


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    trap = changed(tmp_path, "dermis_frame_buffer", *FAULTS[fault], more=LATE)
    with pytest.raises(AssertionError, match=r"0 ran|1 failed"):
        whole_frames("icarus", trap)
