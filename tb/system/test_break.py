# SPDX-License-Identifier: Apache-2.0
"""The break between two rows: what mirrors carry across it, in ngspice, the Verilog and the event engine."""

import numpy as np
import pytest
from deck_bench import DeckReader
from system_bench import MakePlan

from dermis.engines import event, rtl
from tb.model.made_plans import with_break

MIRROR = "mirror_lag = { q_c = 9e-11 }\n"
SOURCES = "mux_leakage = { i_a = 2e-5 }\ncolumn_offset = { v_v = 3e-4 }\n"
EFFECTS = MIRROR + SOURCES


def ohm(seed: int) -> np.ndarray:
    return 500.0 * 10 ** np.random.default_rng(seed).uniform(0, 3, (1, 4, 3))


@pytest.mark.parametrize("clocks", [1, 100])
@pytest.mark.paper
def test_what_crosses_a_break_reads_as_in_ngspice(
    resistance_plan: MakePlan, reader: DeckReader, clocks: int
) -> None:
    made = with_break(resistance_plan(ohm(3), effects=EFFECTS), clocks)
    got = reader.codes(made)
    # A count may fall either side of a half in another engine's rounding.
    assert np.abs(got - event.run(made).codes).max() <= 1
    if clocks == 100:  # a break that is forgotten is seen
        assert np.abs(got - event.run(with_break(made, 0)).codes).max() > 1


@pytest.mark.parametrize("clocks", [1, 100])
def test_what_crosses_a_break_reads_alike_in_the_verilog(resistance_plan: MakePlan, clocks: int) -> None:
    made = with_break(resistance_plan(ohm(4), effects=EFFECTS), clocks)
    got = rtl.run(made, simulator="icarus").codes.astype(int)
    assert np.array_equal(got, event.run(made).codes)
    if clocks == 100:
        assert np.abs(got - event.run(with_break(made, 0)).codes).max() > 0
