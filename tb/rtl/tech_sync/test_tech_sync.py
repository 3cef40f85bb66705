# SPDX-License-Identifier: Apache-2.0
"""Claims about the two-flop synchronizer and the release of the reset."""

from __future__ import annotations

from pathlib import Path

import pytest
from rtl_run import changed, simulate

pytestmark = pytest.mark.timeout(120)


def two_edges_late(seen: list[list[int]]) -> bool:
    """Return True if the output after an edge is the input level at the edge before; 0 after reset."""
    levels, outputs = zip(*seen, strict=True)
    return list(outputs) == [0, 0, *levels[1:-1]]


def released_at_the_second_edge(seen: list[list[object]]) -> bool:
    return seen == [[n % 2, 0, 0, [0, 1, 1]] for n in range(20)]


def test_a_level_is_there_behind_the_second_edge_that_sees_it(simulator: str) -> None:
    assert two_edges_late(simulate(simulator, "bench_tech_sync", "dermis_tech_sync", "levels"))


def test_reset_falls_at_once_and_is_let_go_of_at_the_second_edge(simulator: str) -> None:
    assert released_at_the_second_edge(simulate(simulator, "bench_tech_sync", "dermis_reset_sync", "release"))


FAULTS = {
    "one flop": ("dermis_tech_sync", ".d_i    (first_q)", ".d_i    (first_d)", "levels"),
    "reset straight through": ("dermis_reset_sync", ".q_o    (rst_no)", ".q_o    ()", "release"),
    "let go of an edge early": ("dermis_reset_sync", ".d_i    (first_q)", ".d_i    (1'b1)", "release"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    module, right, wrong, testcase = FAULTS[fault]
    changes = [(right, wrong)]
    if fault == "reset straight through":
        changes.append(("  wire first_q;\n", "  wire first_q;\n  assign rst_no = rst_ni;\n"))
    trap = changed(tmp_path, module, *changes)
    right_behaviour = two_edges_late if testcase == "levels" else released_at_the_second_edge
    assert not right_behaviour(simulate("icarus", "bench_tech_sync", module, testcase, trap=trap))
