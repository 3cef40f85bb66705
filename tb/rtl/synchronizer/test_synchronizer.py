# SPDX-License-Identifier: Apache-2.0
"""Claims about the two synchronizer forms."""

from __future__ import annotations

import random

import pytest
from rtl_run import play, simulate

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
    # Each decision lasts a clock: from the next rising edge (two flops) or from this falling edge
    # (latch).
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
