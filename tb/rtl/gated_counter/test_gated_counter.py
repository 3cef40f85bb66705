# SPDX-License-Identifier: Apache-2.0
"""Claims about the gated, saturating edge counter."""

import random

import pytest
from rtl_run import play

pytestmark = pytest.mark.timeout(120)


def count(simulator: str, levels: list[list[int]], code_bits: int) -> list[int]:
    steps = [{"gate_i": gate, "pulse_i": pulse} for gate, pulse in levels]
    seen = play(simulator, "dermis_gated_counter", steps, ["count_o"], {"CODE_BITS": code_bits})
    return [outputs["count_o"] for outputs, _ in seen]


@pytest.mark.parametrize("code_bits", [1, 8, 10])
def test_counter_saturates_at_its_own_width(simulator: str, code_bits: int) -> None:
    full = 2**code_bits - 1
    pulses = [[1, n & 1] for n in range(1, 2 * full + 20)]
    assert count(simulator, pulses, code_bits) == [min(full, (n + 1) // 2) for n in range(1, 2 * full + 20)]


def test_random_gates_and_pulses_match_a_plain_count(simulator: str) -> None:
    """4 bits, so that many of the gates, 50 clocks on average, saturate."""
    rng = random.Random(8)
    gate, levels = 0, []
    for _ in range(4000):
        gate ^= rng.random() < (0.02 if gate else 0.2)
        levels.append([int(gate), rng.randint(0, 1)])
    total, last_gate, last_pulse, wanted = 0, 0, 0, []
    for gate, pulse in levels:
        if gate and not last_gate:
            total = 0
        total += gate and pulse and not last_pulse
        last_gate, last_pulse = gate, pulse
        wanted.append(min(15, total))
    assert wanted.count(15) > 100
    assert count(simulator, levels, 4) == wanted
