# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis mutate`: mutants are single changes of statements, and each gets the right fate."""

import os
import subprocess
import sys
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
        lost = text[mutant.start : mutant.end].count("\n") - mutant.new.count("\n")
        assert len(before) - len(behind) == lost
        assert not before[mutant.line - 1].lstrip().startswith(("//", "localparam", "`"))


def test_every_module_is_a_block_with_tests_and_proofs_that_exist() -> None:
    found = {path.stem for path in (ROOT / "rtl").glob("dermis_*.v")}
    assert set(mutate.BLOCKS) == found
    for block in mutate.BLOCKS.values():
        assert block.tests or block.proofs
        assert all((ROOT / "tb" / "rtl" / test).is_dir() for test in block.tests)
        assert set(block.proofs) <= set(mutate.formal.proofs())


PROOF, TESTS = "proof spi, which no longer succeeds", "tests, which timed out after 30 s"


@pytest.mark.parametrize(
    ("doubts", "same", "fate"),
    [
        ([], True, "equivalent"),
        ([], False, "survives"),
        ([], None, "undecided"),
        ([PROOF], None, "undecided"),
        ([PROOF], True, "equivalent"),
        ([PROOF], False, "killed"),
        ([TESTS], False, "undecided"),
    ],
)
def test_a_stopped_proof_of_another_module_kills_and_a_timeout_does_not(
    doubts: list[str], same: bool | None, fate: str
) -> None:
    assert mutate.fate(doubts, same)[0] == fate


def test_tests_that_do_not_end_kill_nothing_and_must_pass_on_the_right_module(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(mutate, "BUILD", tmp_path)
    (tmp_path / "pytest.log").write_text("FAILED a.py::test_a")
    block = mutate.BLOCKS["dermis_crc8"]
    for code, sure in ((None, False), (0, False), (5, False), (1, True)):
        monkeypatch.setattr(mutate.children, "run_child", lambda *_, code=code: code)
        said, killed = mutate._noticed_by_test(block, tmp_path, tmp_path, 30.0)
        assert killed is sure
        assert (said is not None) is (code in (None, 1))
        if code != 0:
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


def fate(line: str, what: str, by: str = "proofs") -> str:
    text = source("dermis_gated_counter")
    every = mutate.mutants("dermis_gated_counter", text)
    (one,) = [m for m in every if m.what == what and text.splitlines()[m.line - 1].strip().startswith(line)]
    return mutate.try_mutant(one, ROOT / "rtl", (by,), 120.0)["fate"]


@pytest.mark.long
@pytest.mark.parametrize("by", ["proofs", "tests"])
def test_a_counter_that_wraps_is_killed(by: str) -> None:
    assert fate("if (rising", "&& to ||", by) == "killed"


def test_the_benches_build_the_mutated_sources(tmp_path: Path) -> None:
    code = "import scripts.mutate_plugin, rtl_run; print(*rtl_run.rtl_sources())"
    environment = os.environ | {
        "DERMIS_MUTANT_RTL": str(tmp_path),
        "DERMIS_MUTANT_WORK": str(tmp_path),
        "PYTHONPATH": f"{ROOT}:{ROOT / 'tb' / 'rtl'}",
    }
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert {Path(path).parent for path in said.stdout.split()} == {tmp_path}


@pytest.mark.long
def test_a_reset_value_that_nothing_can_see_is_equivalent() -> None:
    """The first clock of a gate starts from the count, which the reset made 0, or from 0."""
    assert fate("gate_q  <= 1'b0;", "0 to 1") == "equivalent"
