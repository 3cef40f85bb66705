# SPDX-License-Identifier: Apache-2.0
"""Claims about the holding register of a row of codes."""

from __future__ import annotations

import pytest
from rtl_run import simulate

pytestmark = pytest.mark.timeout(120)


def test_codes_change_at_a_load_only_and_valid_marks_it(simulator: str) -> None:
    seen = simulate(simulator, "bench_row_buffer", "dermis_row_buffer", "random_loads")
    codes = row = 0
    for (load, last, row_in, counts), outputs in seen:
        if load:
            codes, row = counts, row_in
        assert outputs == [codes, row, load, load & last]
    loads = sum(inputs[0] for inputs, _ in seen)
    assert 100 < loads < 300
