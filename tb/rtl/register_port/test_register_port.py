# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_register_port."""

from __future__ import annotations

from pathlib import Path

import pytest
from rtl_run import changed, simulate

SYNC_RANDOM = Path(__file__).parents[1] / "frame_buffer" / "sync_random.v"


def requests(simulator: str, trap: Path | None, seed: int = 0) -> float:
    scenario = {"seed": seed, "requests": 300}
    got = simulate(
        simulator, "bench_register_port", "dermis_register_port", "requests", {}, scenario, trap=trap
    )
    return got["latest acknowledge, clocks"]


def test_each_request_is_one_access(simulator: str) -> None:
    # Two edges to see the toggle, one more where it is metastable, one for the access.
    assert 3 <= requests(simulator, SYNC_RANDOM) <= 4.2
    assert requests(simulator, None) <= 3.2


FAULTS = {
    "the answer of another clock": ("if (valid_o) begin", "if (request) begin"),
    "two accesses for a request": (
        "      ack_q   <= request;",
        "      ack_q   <= late_q; late_q <= request;",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    right, wrong = FAULTS[fault]
    late = ("  reg         ack_q;", "  reg         ack_q;\n  reg late_q;")
    trap = changed(tmp_path, "dermis_register_port", (right, wrong), late)
    with pytest.raises(AssertionError, match=r"0 ran|1 failed"):
        requests("icarus", trap)
