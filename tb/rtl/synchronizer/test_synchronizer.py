# SPDX-License-Identifier: Apache-2.0
"""Claims about the two synchronizer forms, their two flops, and the release of the reset."""

import random
from pathlib import Path

import pytest
from rtl_run import changed, play, simulate

pytestmark = pytest.mark.timeout(120)
FORMS = pytest.mark.parametrize("form", ["dermis_sync_ff", "dermis_sync_latch"])


def random_levels(simulator: str, form: str) -> list[list[int]]:
    """Random comparator and inhibit levels at each edge, and the pulse in each half clock behind it."""
    rng = random.Random(7)
    steps = []
    for n in range(2000):
        comp = rng.choice([0, 1, 1, 1]) if n % 200 < 150 else 1
        steps.append({"comp_async_i": comp, "inhibit_i": int(rng.random() < 0.1)})
    seen = play(simulator, form, steps, ["pulse_o"])
    return [
        [*step.values(), high["pulse_o"], low["pulse_o"]]
        for step, (high, low) in zip(steps, seen, strict=True)
    ]


def decisions(seen: list[list[int]]) -> list[int]:
    """q[n] = comparator and not q[n-1] and not inhibited, from the levels at each edge."""
    q: list[int] = []
    for comp, inhibit, *_ in seen:
        q.append(int(comp and not inhibit and not (q and q[-1])))
    return q


@FORMS
def test_pulse_is_the_gated_sample_at_its_stated_half_clock(simulator: str, form: str) -> None:
    seen = random_levels(simulator, form)
    q = decisions(seen)
    assert 500 < sum(q) < len(q) / 2
    halves = [half for _, _, high, low in seen for half in (high, low)]
    # A decision lasts a clock, from the next rising edge (two flops) or this falling edge (latch).
    delay = 2 if form == "dermis_sync_ff" else 1
    wanted = [0] * delay + [v for v in q for _ in (0, 1)]
    assert halves == wanted[: len(halves)]


@FORMS
def test_comparator_chatter_between_edges_never_moves_the_pulse(simulator: str, form: str) -> None:
    result = simulate(simulator, "bench_synchronizer", form, "chatter_between_edges")
    assert result["pulses"] > 50
    assert result["moved"] == 0


@FORMS
def test_reset_ends_a_pulse_even_with_the_clock_standing(simulator: str, form: str) -> None:
    seen = simulate(simulator, "bench_synchronizer", form, "reset_with_clock_standing")
    assert seen == [[1, 1, 0], [0, 1, 0]]  # clock level, pulse before, pulse after


def two_edges_late(simulator: str, trap: Path | None = None) -> bool:
    """Return True if the output after an edge is the input level at the edge before; 0 after reset."""
    rng = random.Random(5)
    levels = [1] + [rng.getrandbits(1) for _ in range(200)]
    seen = play(simulator, "dermis_tech_sync", [{"d_i": level} for level in levels], ["q_o"], trap=trap)
    return [(high["q_o"], low["q_o"]) for high, low in seen] == [(q, q) for q in [0, *levels[:-1]]]


def released_at_the_second_edge(simulator: str, trap: Path | None = None) -> bool:
    seen = simulate(simulator, "bench_synchronizer", "dermis_reset_sync", "release", trap=trap)
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
