# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis mutate`: mutants are single changes of statements, and each gets the right fate."""

from __future__ import annotations

from pathlib import Path

import pytest

from dermis.errors import SimulatorError
from dermis.scene.design import ROOT
from scripts import mutate

pytestmark = pytest.mark.timeout(150)


def source(module: str) -> str:
    return (ROOT / "rtl" / f"{module}.v").read_text()


@pytest.mark.parametrize("module", mutate.BLOCKS)
def test_each_mutant_is_one_change_of_one_statement(module: str) -> None:
    text = source(module)
    made = mutate.mutants(module, text)
    assert len({mutant.key for mutant in made}) == len(made) >= 3
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


def test_every_module_but_the_top_is_a_block_with_tests_and_proofs_that_exist() -> None:
    found = {path.stem for path in (ROOT / "rtl").glob("dermis_*.v")}
    assert set(mutate.BLOCKS) == found - {"dermis_top"}
    for block in mutate.BLOCKS.values():
        assert block.tests
        assert all((ROOT / "tb" / "rtl" / test).is_dir() for test in block.tests)
        assert set(block.proofs) <= set(mutate.formal.proofs())


def test_the_hierarchy_below_a_module_is_read_from_its_source() -> None:
    rtl = ROOT / "rtl"
    assert mutate.below("dermis_sync_latch", rtl) == ["dermis_tech_dff", "dermis_tech_latch"]
    assert set(mutate.below("dermis_frame_buffer", rtl)) == {
        "dermis_tech_ram",
        "dermis_tech_sync",
        "dermis_tech_dff",
    }
    assert mutate.below("dermis_crc8", rtl) == []


@pytest.mark.parametrize(
    ("sure", "doubts", "same", "fate"),
    [
        (True, ["tests, which timed out after 30 s"], None, "killed"),
        (False, [], True, "equivalent"),
        (False, [], False, "survives"),
        (False, [], None, "undecided"),
        (False, ["proof spi, which no longer succeeds"], None, "undecided"),
        (False, ["proof spi, which no longer succeeds"], True, "equivalent"),
        (False, ["proof spi, which no longer succeeds"], False, "killed"),
        (False, ["tests, which timed out after 30 s"], False, "undecided"),
        (False, ["tests, which timed out after 30 s"], True, "equivalent"),
    ],
)
def test_nothing_but_a_counterexample_a_failing_test_or_a_stopped_proof_of_another_module_kills(
    sure: bool, doubts: list[str], same: bool | None, fate: str
) -> None:
    assert mutate.fate(sure, doubts, same)[0] == fate


def test_tests_that_do_not_end_kill_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "pytest.log").write_text("FAILED a.py::test_a")
    block = mutate.BLOCKS["dermis_crc8"]
    for code, sure in ((None, False), (0, False), (5, False), (1, True)):
        monkeypatch.setattr(mutate, "_run", lambda *_, code=code: code)
        said, killed = mutate._noticed_by_test(block, tmp_path, tmp_path, 30.0)
        assert killed is sure
        assert (said is not None) is (code in (None, 1))


def test_tests_that_fail_on_the_right_module_are_an_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(mutate, "ROOT", tmp_path)
    for code in (None, 1, 5):
        monkeypatch.setattr(mutate, "_run", lambda *_, code=code: code)
        with pytest.raises(SimulatorError, match="dermis_tech_latch"):
            mutate.control("dermis_tech_latch", ROOT / "rtl")


def test_a_fate_is_that_of_its_judges(tmp_path: Path) -> None:
    before = mutate.judges("dermis_tech_sync", ROOT / "rtl")
    assert before == mutate.judges("dermis_tech_sync", ROOT / "rtl")
    for path in [*(ROOT / "rtl").glob("*.v"), *(ROOT / "rtl").glob("*.vh")]:
        (tmp_path / path.name).write_text(path.read_text())
    assert before == mutate.judges("dermis_tech_sync", tmp_path)
    (tmp_path / "dermis_tech_dff.v").write_text("module dermis_tech_dff; endmodule\n")
    assert before != mutate.judges("dermis_tech_sync", tmp_path)


def fate(line: str, what: str) -> str:
    text = source("dermis_gated_counter")
    every = mutate.mutants("dermis_gated_counter", text)
    (one,) = [m for m in every if m.what == what and text.splitlines()[m.line - 1].strip().startswith(line)]
    return mutate.try_mutant(one, ROOT / "rtl", ("proofs",))["fate"]


def test_a_counter_that_wraps_is_killed() -> None:
    assert fate("if (rising", "&& to ||") == "killed"


@pytest.mark.long
def test_a_reset_value_that_nothing_can_see_is_equivalent() -> None:
    """The first clock of a gate starts from the count, which the reset made 0, or from 0."""
    assert fate("gate_q  <= 1'b0;", "0 to 1") == "equivalent"


def test_the_table_counts_what_is_not_decided_as_surviving() -> None:
    def result(fate: str, by: str | None) -> dict[str, object]:
        place = {"module": "dermis_crc8", "line": 3, "what": "+ to -", "shown": "a  ->  b"}
        return {**place, "fate": fate, "by": by}

    fates = [("killed", "proof spi.states"), ("killed", "test a"), ("equivalent", None), ("undecided", None)]
    made = mutate.table({"dermis_crc8": 19}, [result(*fate) for fate in fates])
    assert "| dermis_crc8 | 19 | 4 | 1 | 1 | 1 | 0 | 1 | 67 % |" in made
    assert "- `rtl/dermis_crc8.v:3` (only size, + to -): `a  ->  b`" in made
    assert "2 of 3 mutants" in made
    assert "- `rtl/dermis_crc8.v:3` (undecided, + to -): `a  ->  b`" in made
