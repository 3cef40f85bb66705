# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis formal`: theorems stand in their checkers, faults break them, and no answer is not a proof."""

import re
import signal
import sys
import time
from pathlib import Path

import pytest

from dermis.errors import InputError
from dermis.processes import children
from dermis.scene.design import ROOT
from scripts import formal

pytestmark = pytest.mark.timeout(150)
PROOFS = formal.proofs()
QUICK = [(proof, fault) for proof in PROOFS.values() for fault in proof.faults if fault.quick]


@pytest.mark.parametrize("name", PROOFS)
def test_each_theorem_is_an_assertion_with_a_fault_that_stands_once_in_its_module(name: str) -> None:
    proof = PROOFS[name]
    text = (ROOT / formal.PLACE / f"{proof.check}.v").read_text()
    asserted = formal.labels(text, "assert")
    assert len(asserted) == len(re.findall(r"\bassert\s*\(", text)), "an assertion without a label"
    named = {label for label in asserted if not label.startswith(("lemma_", "never_"))}
    assert named == set(proof.theorems) == {fault.breaks for fault in proof.faults}
    assert formal.labels(text, "cover") or any(label.startswith("never_") for label in asserted)
    for fault in proof.faults:
        text = (ROOT / "rtl" / f"{fault.module}.v").read_text()
        assert fault.module in proof.modules
        assert text.count(fault.old) == 1, fault.name
        assert fault.new != fault.old


STUBBORN = '''
import sys
from pathlib import Path
from dermis.processes import children
place = Path(sys.argv[1])
starts = """import subprocess
one = subprocess.Popen(["sleep", "600"], start_new_session=True)
subprocess.Popen(["sleep", "600"], process_group=0)
one.wait()"""
command = [sys.executable, "-c", starts]
try:
    with children.threads(2) as pool:
        list(pool.map(lambda n: children.run_child(command, place, place / f"{n}.log", 600.0), range(4)))
except KeyboardInterrupt:
    sys.exit(130)
'''


@pytest.mark.parametrize(("how", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_ends_all_that_runs_at_once_whatever_group_or_session_it_is_in(
    how: signal.Signals, exit_code: int, tmp_path: Path
) -> None:
    child = children.Child([sys.executable, "-c", STUBBORN, str(tmp_path)])
    try:
        end = time.monotonic() + 30
        # Its watchdog, and two programs below it, each with two more.
        while len(tree := child.processes()) < 8 and time.monotonic() < end:
            time.sleep(0.1)
        assert len(tree) == 8
        sent = time.monotonic()
        child.send_signal(how)
        assert child.wait(20) == exit_code
        assert time.monotonic() - sent < 10
        time.sleep(0.2)
        assert not child.processes()
    finally:
        child.end()


@pytest.mark.long  # as all that run the newer Yosys: it is 1.6 core-minutes to make ready
def test_a_proof_passes_by_induction() -> None:
    checkers = {path.stem for path in (ROOT / formal.PLACE).glob("check_*.v")}
    assert checkers == {proof.check for proof in PROOFS.values()}
    rows = formal.prove(PROOFS["counter"], where="formal_test")
    assert {row["status"] for row in rows} == {"PASS"}
    assert len(rows) == len(PROOFS["counter"].theorems)
    log = (ROOT / "build" / "formal_test" / "counter.prove_0" / "sby.log").read_text()
    assert "successful proof by k-induction" in log


@pytest.mark.long
@pytest.mark.parametrize(("proof", "fault"), QUICK, ids=[f"{p.name}.{f.name}" for p, f in QUICK])
def test_seeded_fault_gives_a_counterexample(proof: formal.Proof, fault: formal.Fault) -> None:
    (row,) = formal.break_it(proof, fault, where="formal_test")
    assert row["status"] == "PASS", row["note"]


@pytest.mark.long
def test_a_fault_that_changes_nothing_and_a_cover_that_is_not_reached_are_misses() -> None:
    old = "assign sample_d ="
    fault = formal.Fault("nothing", "dermis_sync_ff", old, old.replace(" ", "  "), "no_two_ones")
    (row,) = formal.break_it(PROOFS["sync_ff"], fault, where="formal_test")
    assert (row["status"], row["note"]) == ("FAIL", "the fault is not detected")
    (row,) = formal.cover(PROOFS["sync_ff"], where="formal_test", depth=2)
    assert row["status"] == "FAIL"
    assert row["value"] < row["min"]


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("", "TIMEOUT"),
        ("Status: passed\n", "TIMEOUT"),
        ("DONE (UNKNOWN, rc=4)", "UNKNOWN"),
        ("DONE (ERROR, rc=16)", "ERROR"),
        ("DONE (PASS, rc=0)", "PASS"),
    ],
)
def test_only_the_last_word_of_the_tool_counts(text: str, status: str) -> None:
    assert formal._outcome(text, 1.0, Path("work")).status == status


def test_a_run_without_an_answer_is_an_error_for_every_theorem(monkeypatch: pytest.MonkeyPatch) -> None:
    said = formal.Outcome("TIMEOUT", (), 1.0, ROOT / "build", "")
    monkeypatch.setattr(formal, "run", lambda *_, **__: said)
    assert {row["status"] for row in formal.prove(PROOFS["counter"])} == {"ERROR"}
    assert formal.cover(PROOFS["counter"])[0]["status"] == "ERROR"


def test_a_name_that_no_proof_has_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="counter") as caught:
        formal.chosen(["nonsense"])
    assert "\n" not in str(caught.value)
