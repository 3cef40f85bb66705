# SPDX-License-Identifier: Apache-2.0
"""Claims about the self-test: every fault it says it can find, found and named, and none in a healthy array."""

from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate

pytestmark = pytest.mark.timeout(120)

ROWS, COLS = 4, 5
PARAMETERS = {"ROWS": ROWS, "COLS": COLS, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}
NO_SENSOR = [[(0, 1)] * COLS] * ROWS

# fault: what is found
FAULTS: list[tuple[dict[str, Any], dict[str, list[int]]]] = [
    ({}, {}),
    *(({"rows_low": [row]}, {"row": [row]}) for row in range(ROWS)),
    *(({"comparators_high": [column]}, {"dark": [column]}) for column in range(COLS)),
    *(({"comparators_low": [column]}, {"full": [column]}) for column in range(COLS)),
    ({"open_columns": [0, 1]}, {"full": [0, 1]}),
    ({"open_columns": [4]}, {"full": [4]}),
    ({"shorted_columns": [[1, 2]]}, {"dark": [1, 2], "full": [1, 2]}),
    ({"shorted_columns": [[0, 3]]}, {"dark": [0, 3], "full": [0, 3]}),
    ({"rows_high": [2]}, {"row": [2]}),
    ({"rows_low": [1, 3]}, {"row": [1, 3]}),
    ({"shorted_rows": [[0, 3]]}, {"row": [0, 3]}),
    ({"rows_low": [1], "comparators_high": [0]}, {"row": [1], "dark": [0]}),
    # What two halves of the columns cannot tell apart: both carry their own full current.
    ({"shorted_columns": [[0, 2]]}, {}),
]


def self_test(
    simulator: str, faults: list[Any], x: Any = NO_SENSOR, rates: Any = (), trap: Path | None = None
) -> Any:
    scenario = {"parameters": PARAMETERS, "x": x, "faults": faults, "rates": rates}
    return simulate(simulator, "bench_top", "dermis_top", "self_test", PARAMETERS, scenario, trap=trap)


def test_each_fault_is_found_and_named_without_a_sensor(simulator: str) -> None:
    rates = (0x7FFF, 0x0001, 0x2AAB, 0x1555)
    found = self_test(simulator, [fault for fault, _ in FAULTS], rates=rates)
    for (fault, wanted), seen in zip(FAULTS, found, strict=True):
        assert seen == wanted, fault
    # A pressed row that stays on lights all columns in the dark slot, in full slots those without current.
    pressed = [[(1, 2)] * COLS] * ROWS
    assert self_test(simulator, [{"rows_high": [2]}], pressed) == [{"row": [2], "dark": [0, 1, 2, 3, 4]}]


# Change in dermis_reader, what the counter of column 2 does: what is found.
BROKEN = {
    "stays at zero": ("(rst_ni),\n        .gate_i ", "(rst_ni & (c != 2)),\n        .gate_i ", "inject full"),
    "misses its gate": ("(gate_count)", "(gate_count & (c != 2))", "inject full"),
    "counts without pause": ("(charge_o[c]),", "(charge_o[c] | (c == 2 && clocks_q[0])),", "inject dark"),
    "sees the gate a clock late": ("(gate_count)", "((c == 2) ? late_q : gate_count)", ""),
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
    assert self_test("icarus", [{}], trap=wrong) == [{kind: [2] for kind in wanted.split()}]
