# SPDX-License-Identifier: Apache-2.0
"""The k of a scene goes through SPI to RANGE or RANGE_COLUMN, and the chip's range pins choose that of the circuit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dermis import engines
from dermis import plan as planning
from dermis.chip import hdl
from dermis.engines import closed, cosim
from dermis.errors import InputError
from dermis.records import Plan
from dermis.scene import scene
from dermis.scene.design import load as load_design
from scripts import lint

OPTIONS = load_design().interface.k_options


def plan(ohm: np.ndarray, tmp_path: Path, interface: dict, **run: object) -> Plan:
    np.save(tmp_path / "taxels.npy", ohm)
    data = {
        "array": {"rows": ohm.shape[0], "cols": ohm.shape[1]},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "interface": interface,
        "run": run,
    }
    return planning.make(scene.from_data(data, tmp_path / "scene.toml"), "cosim")


def taxels(rows: int, cols: int) -> np.ndarray:
    return 600 * 20 ** np.random.default_rng(4).random((rows, cols))


@pytest.mark.parametrize(
    "interface",
    [{"k": OPTIONS[0]}, {"k": OPTIONS[3]}, {"k_column": [*OPTIONS, OPTIONS[0], *OPTIONS[::-1]]}],
    ids=["RANGE 0", "RANGE 3", "RANGE_COLUMN"],
)
def test_codes_follow_the_ratio_that_the_pins_choose(tmp_path: Path, interface: dict) -> None:
    made = plan(taxels(2, len(interface.get("k_column", OPTIONS))), tmp_path, interface)
    codes, expected = cosim.run(made).codes.astype(int), closed.run(made).codes.astype(int)
    # A taxel of no exact code: the ramps of ngspice's edges move its last decision by a clock at most.
    assert np.abs(codes - expected).max() <= 1
    assert len(np.unique(expected)) > 4


FAULTS = {
    "columns swapped": ("dermis_top.v", "range_column :", "{range_column[1:0], range_column[2*COLS-1:2]} :"),
    "RANGE in place of RANGE_COLUMN": ("dermis_top.v", "range_per_column ?", "1'b0 ?"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_chip_with_other_range_pins_gives_other_codes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    file, right, wrong = FAULTS[fault]
    sources = lint.rtl_sources()
    at = next(i for i, source in enumerate(sources) if source.name == file)
    text = sources[at].read_text()
    assert text.count(right) == 1, "the fault no longer fits the chip"
    sources[at] = tmp_path / file
    sources[at].write_text(text.replace(right, wrong))
    monkeypatch.setattr(hdl, "rtl_sources", lambda: sources)
    made = plan(taxels(1, 4), tmp_path, {"k_column": OPTIONS})
    codes = cosim.run(made, analog="exact", work=tmp_path / "work").codes
    assert not np.array_equal(codes, closed.run(made).codes)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_mirror_in_transistors_follows_the_range_pins(tmp_path: Path) -> None:
    """8 kohm by 20 and 1 kohm by 160 are the same eighth of full scale; with 80 for both they are 8 times apart."""
    ohm = np.array([[8000.0, 1000.0]])
    for interface, expected in (({"k_column": [20, 160]}, (64, 64)), ({"k": 80}, (16, 128))):
        codes = cosim.run(plan(ohm, tmp_path, interface, views="sky130")).codes[0, 0].astype(int)
        # The gain of a channel that is not calibrated: below 1 %.
        assert np.abs(codes - expected).max() <= 1


def test_ratios_that_the_mirror_does_not_have_are_refused(tmp_path: Path) -> None:
    made = plan(np.array([[1000.0]]), tmp_path, {}, views="sky130")
    design = made.scene.design
    other = design.model_copy(
        update={"interface": design.interface.model_copy(update={"k_options": [10, 40, 80, 160]})}
    )
    world = scene.resolve(made.scene.table, tmp_path / "scene.toml", other)
    with pytest.raises(
        InputError, match=r"k_options = \[10, 40, 80, 160\]: .*the ratios of the sky130 mirror"
    ):
        engines.check(planning.make(world, "cosim"))
