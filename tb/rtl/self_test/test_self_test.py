# SPDX-License-Identifier: Apache-2.0
"""Claims about the self-test: every fault it says it can find, found and named, and none in a healthy array."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, play, simulate

from scripts.lint import header_values

pytestmark = pytest.mark.timeout(120)

CHAIN = Path(__file__).resolve().parent / "self_test_chain.v"
ROWS, COLS = 4, 5
SETTINGS = {"gate_i": 62, "dark_max_i": 2, "full_min_i": 28}  # full scale is 31
NO_SENSOR = [[(0, 1)] * COLS] * ROWS
PRESSED = [[(1, 2)] * COLS] * ROWS

# fault: what is found
FAULTS: list[tuple[dict[str, Any], dict[str, list[int]]]] = [
    ({}, {}),
    ({"comparators_high": [3]}, {"dark": [3]}),
    ({"comparators_low": [2]}, {"full": [2]}),
    ({"open_columns": [4]}, {"full": [4]}),
    ({"open_columns": [0, 1]}, {"full": [0, 1]}),
    ({"shorted_columns": [[1, 2]]}, {"dark": [1, 2], "full": [1, 2]}),
    ({"shorted_columns": [[0, 3]]}, {"dark": [0, 3], "full": [0, 3]}),
    ({"rows_high": [2]}, {"row": [2]}),
    ({"rows_low": [0]}, {"row": [0]}),
    ({"rows_low": [1, 3]}, {"row": [1, 3]}),
    ({"shorted_rows": [[0, 3]]}, {"row": [0, 3]}),
    ({"rows_low": [1], "comparators_high": [0]}, {"row": [1], "dark": [0]}),
    # What two halves of the columns cannot tell apart: both carry their own full current.
    ({"shorted_columns": [[0, 2]]}, {}),
]


def self_test(simulator: str, x: Any, faults: list[Any], trap: Path | None = None) -> Any:
    scenario = {"x": x, "faults": faults, "settings": SETTINGS, "limit": (ROWS + 4) * 68 + 60}
    return simulate(
        simulator, "bench_self_test", "self_test_chain", "faults", {}, scenario, trap=trap, around=[CHAIN]
    )


def test_each_fault_is_found_and_named_without_a_sensor(simulator: str) -> None:
    found = self_test(simulator, NO_SENSOR, [fault for fault, _ in FAULTS])
    for (fault, wanted), seen in zip(FAULTS, found, strict=True):
        assert seen == wanted, fault


def test_pressing_the_array_changes_nothing_but_what_a_stuck_row_lets_through(simulator: str) -> None:
    faults = [f for f in FAULTS if "rows_high" not in f[0]]
    found = self_test(simulator, PRESSED, [fault for fault, _ in faults])
    assert found == [wanted for _, wanted in faults]
    # A row that stays on lights every column in the dark slot, and in the full slots those without
    # current.
    [stuck] = self_test(simulator, PRESSED, [{"rows_high": [2]}])
    assert stuck == {"row": [2], "dark": [0, 1, 2, 3, 4]}


BROKEN = {
    # change in dermis_reader: (what the counter of column 2 does, what is found)
    "stays at zero": (
        ".rst_ni  (rst_ni),\n        .gate_i  (gate_count)",
        ".rst_ni  (rst_ni & (c != 2)),\n        .gate_i  (gate_count)",
        {"inject": [2], "full": [2]},
    ),
    "misses its gate": (
        ".gate_i  (gate_count)",
        ".gate_i  (gate_count & (c != 2))",
        {"inject": [2], "full": [2]},
    ),
    "counts without pause": (
        ".pulse_i (charge_o[c])",
        ".pulse_i (charge_o[c] | (c == 2 && clocks_q[0]))",
        {"inject": [2], "dark": [2]},
    ),
    "sees the gate a clock late": (".gate_i  (gate_count)", ".gate_i  ((c == 2) ? late_q : gate_count)", {}),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_counter_is_named(how: str, tmp_path: Path) -> None:
    old, new, wanted = BROKEN[how]
    flops = (
        "  genvar c;\n",
        "  reg [1:0] clocks_q;\n  reg late_q;\n  always @(posedge clk_i or negedge rst_ni)\n"
        "    if (!rst_ni) {clocks_q, late_q} <= 3'd0;\n"
        "    else {clocks_q, late_q} <= {clocks_q + 2'd1, gate_count};\n  genvar c;\n",
    )
    wrong = changed(tmp_path, "dermis_reader", (old, new), flops)
    [found] = self_test("icarus", NO_SENSOR, [{}], trap=wrong)
    assert found == wanted


COLUMNS, ROW_LINES = 5, 4


def masks_by_the_words(steps: list[dict[str, int]]) -> list[list[int]]:
    """Outputs behind each edge, from the table of docs/rtl.md."""
    inject, dark, full, rows = set(), set(), set(), 0
    latest = done = 0
    wanted = []
    for i in steps:
        begins = i["row_valid_i"] and i["first_i"] and i["test_frame_i"]
        if begins:
            inject, dark, full, rows = set(), set(), set(), 0
        if i["row_valid_i"]:
            rows |= i["row_fault_i"]
        c, n, slot = i["column_i"], i["column_count_i"], i["column_slot_i"]
        if i["column_valid_i"]:
            lit = {0xF2: c % 2 == 0, 0xF3: c % 2 == 1}.get(slot)
            if slot == 0xF0 and n != i["test_count_i"]:
                inject.add(c)
            if (slot == 0xF1 or lit is False) and n > i["dark_max_i"]:
                dark.add(c)
            if lit and n < i["full_min_i"]:
                full.add(c)
        if i["end_i"] and i["test_frame_i"] and latest:
            done = 1
        if i["test_i"] or begins:
            done = 0
        if begins:
            latest = not i["test_pending_i"]
        if i["test_i"]:
            latest = 0
        masks = [sum(1 << c for c in mask) for mask in (inject, dark, full)] + [rows]
        wanted.append([*masks, int(any(masks)), done])
    return wanted


UNIT_INPUTS = """test_i test_pending_i row_valid_i first_i test_frame_i end_i row_fault_i column_valid_i column_i
    column_count_i column_slot_i test_count_i dark_max_i full_min_i""".split()
UNIT_OUTPUTS = "inject_fault_o dark_fault_o full_fault_o row_fault_o fault_o done_o".split()


def random_columns() -> list[dict[str, int]]:
    """Inputs of dermis_self_test in each clock of random frames, with counts at and near every limit."""
    rng, bits = random.Random(12), header_values()["DERMIS_CODE_BITS"] + 1
    inputs = dict.fromkeys(UNIT_INPUTS, 0)
    steps: list[dict[str, int]] = []

    def clock(**now: int) -> None:
        steps.append(inputs | now)

    def near(limit: int) -> int:
        return min(max(limit + rng.choice([-1, 0, 0, 1]), 0), 2**bits - 1)

    for _ in range(40):
        test = int(rng.random() < 0.4)
        slots = [0xF0, 0xF1, 0xF2, 0xF3] if test else rng.choice([[], [0xF1]])
        slots = [*slots, *range(rng.randint(0 if slots else 1, ROW_LINES))]
        inputs["test_frame_i"] = test
        inputs["test_count_i"] = rng.getrandbits(bits)
        inputs["dark_max_i"] = rng.choice([rng.getrandbits(bits), rng.getrandbits(16)])
        inputs["full_min_i"] = rng.choice([rng.getrandbits(bits), rng.getrandbits(16)])
        if rng.random() < 0.3:
            clock(test_i=1)
        for n, slot in enumerate(slots):
            inputs |= {"first_i": int(n == 0), "column_slot_i": slot}
            fault = rng.getrandbits(ROW_LINES) if rng.random() < 0.1 else 0
            pending = int(rng.random() < 0.2)
            again = int(rng.random() < 0.03)
            clock(row_valid_i=1, row_fault_i=fault, test_i=again, test_pending_i=pending)
            for column in range(COLUMNS):
                limit = rng.choice(["test_count_i", "dark_max_i", "full_min_i"])
                clock(
                    column_valid_i=int(rng.random() < 0.98 or column == COLUMNS - 1),
                    column_i=column,
                    column_count_i=near(inputs[limit]),
                    row_fault_i=rng.getrandbits(ROW_LINES),
                )
        clock(end_i=int(rng.random() < 0.9))
    return steps


def masks_of(simulator: str, steps: list[dict[str, int]], trap: Path | None = None) -> list[list[int]]:
    p = {"ROWS": ROW_LINES, "COLS": COLUMNS}
    seen = play(simulator, "dermis_self_test", steps, UNIT_OUTPUTS, p, trap)
    return [list(outputs.values()) for outputs, _ in seen]


def test_masks_follow_the_table_at_counts_around_every_limit(simulator: str) -> None:
    steps = random_columns()
    seen = masks_of(simulator, steps)
    assert seen == masks_by_the_words(steps)
    for mask, lines in enumerate((COLUMNS, COLUMNS, COLUMNS, ROW_LINES)):
        levels = [outputs[mask] for outputs in seen]
        assert all({v >> n & 1 for v in levels} == {0, 1} for n in range(lines))


SEEDED = {
    "a short is not looked for": ("(full & ~driven)", "(full & 1'b0)"),
    "even and odd exchanged": ("(column_slot_i[0] == column_i[0])", "(column_slot_i[0] != column_i[0])"),
    "rows behind the first slot not looked at": ("row_fault_q | row_fault_i", "row_fault_q"),
    "masks never cleared": ("else if (begins) begin", "else if (1'b0) begin"),
    "done of an earlier frame": ("latest_q <= ~(test_i | test_pending_i)", "latest_q <= 1'b1"),
    "a second request is not looked at": ("if (test_i) latest_q", "if (1'b0) latest_q"),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", SEEDED)
def test_the_table_finds_a_seeded_fault(fault: str, tmp_path: Path) -> None:
    wrong = changed(tmp_path, "dermis_self_test", SEEDED[fault])
    steps = random_columns()
    assert masks_of("icarus", steps, wrong) != masks_by_the_words(steps)
