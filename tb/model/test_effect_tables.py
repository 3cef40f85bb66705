# SPDX-License-Identifier: Apache-2.0
"""docs/effects.md: every effect has its rows, and what the rows say is what engines and decks do."""

import pytest

from dermis import engines
from dermis.effects import EFFECTS
from dermis.scene.design import ROOT
from scripts import effect_tables

PAGE = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("table", [effect_tables.meanings, effect_tables.places, effect_tables.bounds])
def test_every_effect_has_a_row_of_every_table(table) -> None:
    lines = table().splitlines()
    assert [line.split("`")[1] for line in lines[2:]] == list(EFFECTS)
    assert len({line.count(" | ") for line in lines if "---" not in line}) == 1


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_leaves_a_mark_in_every_engine_that_takes_it(name: str) -> None:
    assert effect_tables.fields(name)
    sheet = all(record == "sensor" for record, _ in effect_tables.fields(name))
    for engine, mark in (("rtl", effect_tables.verilog), ("cosim", effect_tables.deck)):
        refused = engines.refused(effect_tables.sample(name, engine), engine)
        if not sheet:
            assert (mark(name) == effect_tables.NONE) == bool(refused)
            assert mark(name) != ""
    if effect_tables.verilog(name) == "in the input currents":
        network = any(record == "network" for record, _ in effect_tables.fields(name))
        enters = effect_tables.enters(name)
        assert network or sheet or "in time" in enters or enters == "duty"


def test_marks_of_effects_that_are_known_by_hand() -> None:
    assert effect_tables.deck("offset_current") == "`ioffset`"
    assert effect_tables.verilog("offset_current") == "`I_OFFSET`"
    assert effect_tables.deck("lateral") == "`rlat`"
    assert effect_tables.deck("column_input") == "`xch`: `conv_r_x_ohm`"
    assert effect_tables.deck("shot_noise") == effect_tables.NONE
    assert effect_tables.deck("sensor_creep") == ""
    assert effect_tables.enters("offset_current") == "duty"
    assert effect_tables.enters("sensor_creep") == "resistances, before any engine"
    assert (
        effect_tables.parameters("row_driver")
        == "`r_ohm = 1`, `grounded_r_ohm = 1`, or `r_ohm` where only that is given"
    )
