# SPDX-License-Identifier: Apache-2.0
"""Claims about the row sequencer, against a plain clock count."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from rtl_run import simulate

pytestmark = pytest.mark.timeout(120)

SHAPES = {
    "default": {},
    "3_rows": {"ROWS": 3, "GATE_CLOCKS": 7, "SETTLE_CLOCKS": 4},
    "1_row": {"ROWS": 1, "GATE_CLOCKS": 1, "SETTLE_CLOCKS": 2},
    "settle_longer_than_gate": {"ROWS": 4, "GATE_CLOCKS": 3, "SETTLE_CLOCKS": 16},
}


def scan(enables: Iterable[int], rows: int, gate: int, settle: int) -> list[list[int]]:
    """Outputs behind each edge, from the position in the frame alone."""
    clock = None  # position in the frame; None when idle
    done_row = done_last = 0
    wanted = []
    for enable in enables:
        done = 0
        if clock is not None:
            clock += 1
            if clock % (gate + settle) == 0:
                done, done_row = 1, clock // (gate + settle) - 1
                done_last = int(done_row == rows - 1)
                clock %= rows * (gate + settle)
        elif enable:
            clock = 0
        if not enable:
            clock = None
        row = 0 if clock is None else 1 << clock // (gate + settle)
        preset = int(clock is None or clock % (gate + settle) < settle)
        wanted.append([enable, row, preset, 1 - preset, done, done_row, done_last])
    return wanted


@pytest.mark.parametrize("random_enable", [False, True], ids=["continuous", "random_enable"])
@pytest.mark.parametrize("shape", SHAPES)
def test_each_output_moves_on_its_edge_and_no_other(simulator: str, shape: str, random_enable: bool) -> None:
    p = {"ROWS": 16, "GATE_CLOCKS": 510, "SETTLE_CLOCKS": 115} | SHAPES[shape]
    frame = p["ROWS"] * (p["GATE_CLOCKS"] + p["SETTLE_CLOCKS"])
    clocks = frame + 700 if shape == "default" else 60 * frame
    scenario = {"clocks": clocks, "random": random_enable}
    seen = simulate(simulator, "bench_row_scanner", "dermis_row_scanner", "enables", SHAPES[shape], scenario)
    wanted = scan((s[0] for s in seen), p["ROWS"], p["GATE_CLOCKS"], p["SETTLE_CLOCKS"])
    if not random_enable:
        assert sum(w[4] for w in wanted) >= p["ROWS"]
    elif shape != "default":  # the default slot is longer than any random enable
        assert any(w[4] for w in wanted)
        assert any(not w[0] for w in wanted)
    assert seen == wanted
