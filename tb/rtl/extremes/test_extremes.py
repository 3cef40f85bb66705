# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_top at the ends of its settings, and with every row and column broken in turn."""

from __future__ import annotations

import os
from typing import Any

import pytest
from rtl_run import simulate

pytestmark = pytest.mark.timeout(170)
PARAMETERS = {"ROWS": 4, "COLS": 5, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}


def run(simulator: str, testcase: str, **scenario: Any) -> Any:
    scenario |= {"parameters": PARAMETERS}
    return simulate(simulator, "bench_extremes", "dermis_top", testcase, PARAMETERS, scenario)


@pytest.mark.long
def test_longest_and_shortest_slots_count_exactly(simulator: str) -> None:
    """All 16 bits in Verilator; Icarus would take a minute for the longest."""
    run(simulator, "lengths", longest=0xFFFF if simulator == "verilator" else 0x0FFF)


def test_each_broken_line_is_found_by_its_own_bit(simulator: str) -> None:
    run(simulator, "lines")


@pytest.mark.long
def test_injected_rate_is_counted_exactly(simulator: str) -> None:
    counts = run(simulator, "rates")
    assert counts[0] in (499, 500)
    assert counts[1] == 0


@pytest.mark.long
def test_counters_of_16_bits_wrap_or_stop_in_verilator() -> None:
    """FRAME_NUMBER wraps, LOST and SPI_ERRORS stop at their top; that far only in `make coverage`."""
    many = 70_000 if "DERMIS_COVERAGE" in os.environ else 700
    seen = run("verilator", "counters", many=many)
    most = 2**16 - 1
    assert many <= seen["number"] + 2**16 * (many > most) <= many + 10
    assert min(many - 2, most) <= seen["lost"] <= min(many + 10, most)
    assert min(many - 1, most) <= seen["errors"] <= min(many + 2, most)
    assert seen["lost_after_reset"] == seen["errors_after_reset"] == 0
