# SPDX-License-Identifier: Apache-2.0
"""The holding register of a row of counts, from reset on."""

import random

import pytest
from rtl_run import play

pytestmark = pytest.mark.timeout(120)


@pytest.mark.parametrize(("cols", "bits"), [(1, 2), (5, 3)])
def test_columns_come_in_order_behind_a_load_and_valid_marks_it(simulator: str, cols: int, bits: int) -> None:
    p = {"COLS": cols, "COUNT_BITS": bits}
    rng = random.Random(10)
    ports = "load_i", "shift_i", "counts_i"
    drawn = ((rng.random() < 0.1, rng.random() < 0.7, rng.getrandbits(cols * bits)) for _ in range(2000))
    steps = [dict(zip(ports, values, strict=True)) for values in drawn]
    seen = play(simulator, "dermis_row_buffer", steps, ["count_o", "valid_o"], p)
    words = [0] * cols
    loads = emptied = 0
    for step, (outputs, _) in zip(steps, seen, strict=True):
        load, shift, counts = step.values()
        if load:
            words = [counts >> (c * bits) & (1 << bits) - 1 for c in range(cols)]
            loads += 1
        elif shift:
            words = [*words[1:], 0]
            emptied += not any(words)
        assert list(outputs.values()) == [words[0], load]
    assert loads > 100
    assert cols > 5 or emptied > 10
