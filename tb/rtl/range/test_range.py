# SPDX-License-Identifier: Apache-2.0
"""A range chosen through SPI changes the codes as V / (k i0 R) says, in whole frames and column by column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate

from dermis.chip import register_map as rm
from dermis.scene import design
from dermis.scene.design import exact

pytestmark = pytest.mark.timeout(170)

PARAMETERS = {"ROWS": 2, "COLS": 5, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}
# From full scale in all ranges to the light touch that only the most sensitive one sees.
R_OHM = [[100, 500, 2000, 4080, 64250], [5100, 999, 312, 20400, 700]]
EACH = [[0, 1, 2, 3, 1], [3, 2, 0, 1, 0]]


def word(ranges: list[int]) -> int:
    return sum(n << 2 * c for c, n in enumerate(ranges))


def steps() -> list[Any]:
    """Frame by frame: what is written in its middle, and the ranges that all its rows must have."""
    per_column = rm.CONTROL_CONTINUOUS_MASK | rm.CONTROL_RANGE_PER_COLUMN_MASK
    alike = [[n] * PARAMETERS["COLS"] for n in range(4)]
    return [
        ([(rm.RANGE, 0)], alike[2]),
        ([(rm.RANGE, 1)], alike[0]),
        ([(rm.RANGE, 3), (rm.RANGE_COLUMN, word(EACH[0]))], alike[1]),
        ([(rm.CONTROL, per_column)], alike[3]),
        ([(rm.RANGE_COLUMN, word(EACH[1]))], EACH[0]),
        ([(rm.CONTROL, rm.CONTROL_CONTINUOUS_MASK)], EACH[1]),
        ([], alike[3]),
    ]


def run(simulator: str, trap: Path | None = None) -> list[list[list[int]]]:
    made = design.load()
    unit = exact(made.interface.v_bias_v) / exact(made.converter.i0_a)
    assert unit.denominator == 1
    scenario = {
        "parameters": PARAMETERS,
        "unit_ohm": unit.numerator,
        "k_options": made.interface.k_options,
        "r_ohm": R_OHM,
        "steps": steps(),
    }
    return simulate(simulator, "bench_range", "dermis_top", "codes", PARAMETERS, scenario, trap=trap)


def test_codes_follow_the_range_of_their_column_from_frame_to_frame(simulator: str) -> None:
    frames = run(simulator)
    # By hand: 2000 ohm is x = 1/2, 1/4, 1/8, 1/16 with k = 20, 40, 80, 160.
    assert [frame[0][2] for frame in frames[:4]] == [64, 255, 128, 32]
    assert frames[4][0] == [255, 255, 64, 16, 4]
    assert len(frames) == len(steps()) + 1


FAULTS = {
    # module, right, wrong
    "ranges of two columns swapped": (
        "dermis_reader",
        "assign range_o     = range_q;",
        "assign range_o = {range_q[2*COLS-1:4], range_q[1:0], range_q[3:2]};",
    ),
    "a range taken over at once": (
        "dermis_reader",
        "else if (frame_load) range_q <= range_i;",
        "else range_q <= range_i;",
    ),
    "the range of all in place of each column's": (
        "dermis_top",
        "(range_per_column ? range_column : {COLS{range}})",
        "({COLS{range}})",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_range_shows_in_the_codes(fault: str, tmp_path: Path) -> None:
    module, right, wrong = FAULTS[fault]
    with pytest.raises(AssertionError, match="in place of"):
        run("icarus", changed(tmp_path, module, (right, wrong)))
