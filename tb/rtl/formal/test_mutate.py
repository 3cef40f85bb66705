# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis mutate`: mutants are single changes of statements, and their fates are told apart."""

from __future__ import annotations

import pytest

from dermis import mutate
from dermis.design import ROOT

pytestmark = pytest.mark.timeout(150)


def source(module: str) -> str:
    return (ROOT / "rtl" / f"{module}.v").read_text()


@pytest.mark.parametrize("module", mutate.BLOCKS)
def test_each_mutant_is_one_change_of_one_statement(module: str) -> None:
    text = source(module)
    made = mutate.mutants(module, text)
    assert len({mutant.key for mutant in made}) == len(made) > 3
    for mutant in made:
        changed = mutant.apply(text)
        assert changed != text
        assert changed.split(");\n", 1)[0] == text.split(");\n", 1)[0], "a port or a parameter"
        before, behind = text.splitlines(), changed.splitlines()
        assert len(before) - len(behind) == text[mutant.start : mutant.end].count("\n") - mutant.new.count(
            "\n"
        )
        assert not before[mutant.line - 1].lstrip().startswith(("//", "localparam", "`"))


def test_a_sample_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    every = mutate.mutants("dermis_packer", source("dermis_packer"))
    assert mutate.sample(every, 20, 1) == mutate.sample(every, 20, 1)
    assert mutate.sample(every, 20, 1) != mutate.sample(every, 20, 2)
    assert mutate.sample(every, 10**6, 1) == every


def test_every_module_with_statements_is_a_block() -> None:
    small = {
        "dermis_tech_dff",
        "dermis_tech_latch",
        "dermis_tech_sync",
        "dermis_tech_ram",
        "dermis_reset_sync",
    }
    whole = {"dermis_reader", "dermis_top"}
    found = {path.stem for path in (ROOT / "rtl").glob("dermis_*.v")}
    assert set(mutate.BLOCKS) == found - small - whole


def fate(line: str, what: str) -> str:
    text = source("dermis_gated_counter")
    every = mutate.mutants("dermis_gated_counter", text)
    (one,) = [m for m in every if m.what == what and text.splitlines()[m.line - 1].strip().startswith(line)]
    return mutate.try_mutant(one, ROOT / "rtl", ("proofs",))["fate"]


def test_a_counter_that_wraps_is_killed() -> None:
    assert fate("if (rising", "&& to ||") == "killed"


def test_a_reset_value_that_nothing_can_see_is_equivalent() -> None:
    """The first clock of a gate starts from the count, which the reset made 0, or from 0."""
    assert fate("gate_q  <= 1'b0;", "0 to 1") == "equivalent"


def test_the_table_counts_what_is_not_decided_as_surviving() -> None:
    def result(fate: str, by: str | None) -> dict[str, object]:
        place = {"module": "dermis_crc8", "line": 3, "what": "+ to -", "shown": "a  ->  b"}
        return {**place, "fate": fate, "by": by}

    fates = [("killed", "proof spi.states"), ("killed", "test a"), ("equivalent", None), ("undecided", None)]
    made = mutate.table({"dermis_crc8": 19}, [result(*fate) for fate in fates])
    assert "| dermis_crc8 | 19 | 4 | 1 | 1 | 1 | 1 | 67 % |" in made
    assert "2 of 3 mutants" in made
    assert "- `rtl/dermis_crc8.v:3` (undecided, + to -): `a  ->  b`" in made
