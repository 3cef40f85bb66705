# SPDX-License-Identifier: Apache-2.0
"""The k of a scene goes through SPI to RANGE or RANGE_COLUMN, and the chip's range pins must choose that of the
circuit.
"""

from pathlib import Path

import numpy as np
import pytest
from system_bench import FaultyChip, MakePlan

from dermis.engines import closed, cosim
from dermis.errors import SimulatorError
from dermis.scene.design import load as load_design

OPTIONS = load_design().interface.k_options
SKY130 = '[run]\nviews = "sky130"\n'


def taxels(rows: int, cols: int) -> np.ndarray:
    return 600 * 20 ** np.random.default_rng(4).random((rows, cols))


@pytest.mark.parametrize(
    "interface",
    [f"k = {OPTIONS[0]}", f"k = {OPTIONS[3]}", f"k_column = {[*OPTIONS, OPTIONS[0], *OPTIONS[::-1]]}"],
    ids=["RANGE 0", "RANGE 3", "RANGE_COLUMN"],
)
def test_codes_follow_the_ratio_of_the_scene(resistance_plan: MakePlan, interface: str) -> None:
    made = resistance_plan(taxels(2, 9 if "column" in interface else 4), more=interface)
    codes, expected = cosim.run(made).codes.astype(int), closed.run(made).codes.astype(int)
    # A taxel of no exact code: the ramps of ngspice's edges move its last decision by a clock at most.
    assert np.abs(codes - expected).max() <= 1
    assert len(np.unique(expected)) > 4


FAULTS = {
    "columns swapped": ("range_column :", "{range_column[1:0], range_column[2*COLS-1:2]} :"),
    "RANGE in place of RANGE_COLUMN": ("range_per_column ?", "1'b0 ?"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_chip_with_other_range_pins_is_refused_by_name(
    resistance_plan: MakePlan, tmp_path: Path, faulty_chip: FaultyChip, fault: str
) -> None:
    faulty_chip("dermis_top.v", *FAULTS[fault])
    made = resistance_plan(taxels(1, 4), more=f"k_column = {OPTIONS}")
    with pytest.raises(SimulatorError, match=r"range_o selects \d in column \d, not \d"):
        cosim.run(made, analog="exact", work=tmp_path / "work")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_mirror_in_transistors_has_the_ratio_of_the_scene(resistance_plan: MakePlan) -> None:
    """8 kohm by 20 and 1 kohm by 160 are the same eighth of full scale; with 80 for both they are 8 times apart."""
    ohm = np.array([[8000.0, 1000.0]])
    for interface, expected in (("k_column = [20, 160]", (64, 64)), ("k = 80", (16, 128))):
        codes = cosim.run(resistance_plan(ohm, more=f"{interface}\n{SKY130}")).codes[0, 0].astype(int)
        # The gain of a channel that is not calibrated: below 1 %.
        assert np.abs(codes - expected).max() <= 1
