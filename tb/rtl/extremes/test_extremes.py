# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_top at the ends of its settings, and with every row and column broken in turn."""

from __future__ import annotations

from typing import Any

import pytest
from rtl_run import simulate

pytestmark = pytest.mark.timeout(170)
PARAMETERS = {"ROWS": 4, "COLS": 5, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}


def run(simulator: str, testcase: str, **scenario: Any) -> Any:
    scenario |= {"parameters": PARAMETERS}
    return simulate(simulator, "bench_extremes", "dermis_top", testcase, PARAMETERS, scenario)


def test_longest_and_shortest_slots_count_exactly(simulator: str) -> None:
    """All 16 bits in Verilator; Icarus would take a minute for the longest."""
    run(simulator, "lengths", longest=0xFFFF if simulator == "verilator" else 0x0FFF)


def test_each_broken_line_is_found_by_its_own_bit(simulator: str) -> None:
    run(simulator, "lines")


def test_injected_rate_is_counted_exactly(simulator: str) -> None:
    counts = run(simulator, "rates")
    assert counts[0] in (499, 500)
    assert counts[1] == 0
