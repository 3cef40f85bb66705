# SPDX-License-Identifier: Apache-2.0
"""Claims about the two-flop synchronizer and the release of the reset."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from rtl_run import changed, play, simulate

pytestmark = pytest.mark.timeout(120)


def two_edges_late(simulator: str, trap: Path | None = None) -> bool:
    """Return True if the output after an edge is the input level at the edge before; 0 after reset."""
    rng = random.Random(5)
    levels = [1] + [rng.getrandbits(1) for _ in range(200)]
    seen = play(simulator, "dermis_tech_sync", [{"d_i": level} for level in levels], ["q_o"], trap=trap)
    return [(high["q_o"], low["q_o"]) for high, low in seen] == [(q, q) for q in [0, *levels[:-1]]]


def released_at_the_second_edge(simulator: str, trap: Path | None = None) -> bool:
    seen = simulate(simulator, "bench_tech_sync", "dermis_reset_sync", "release", trap=trap)
    return seen == [[n % 2, 0, 0, [0, 1, 1]] for n in range(20)]


def test_a_level_is_there_behind_the_second_edge_that_sees_it(simulator: str) -> None:
    assert two_edges_late(simulator)


def test_reset_falls_at_once_and_is_let_go_of_at_the_second_edge(simulator: str) -> None:
    assert released_at_the_second_edge(simulator)


STRAIGHT = ("  wire first_q;\n", "  wire first_q;\n  assign rst_no = rst_ni;\n")
FAULTS = {
    "one flop": ("dermis_tech_sync", [(".d_i    (first_q)", ".d_i    (first_d)")]),
    "reset straight through": ("dermis_reset_sync", [(".q_o    (rst_no)", ".q_o    ()"), STRAIGHT]),
    "let go of an edge early": ("dermis_reset_sync", [(".d_i    (first_q)", ".d_i    (1'b1)")]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    module, changes = FAULTS[fault]
    check = two_edges_late if module == "dermis_tech_sync" else released_at_the_second_edge
    assert not check("icarus", changed(tmp_path, module, *changes))
