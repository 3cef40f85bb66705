# SPDX-License-Identifier: Apache-2.0
"""Disturbed runs: the judge of `make faults` notices faults, and commands end cleanly when disturbed."""

import itertools
import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from dermis import files
from dermis.chip import hdl
from dermis.errors import InputError, SimulatorError
from dermis.processes import children
from dermis.report import output
from scripts.synth import cells as synth_cells
from tb.programs.faults import bench as benches
from tb.programs.faults import trials
from tb.programs.faults.bench import Bench, Run

END_S = 60.0
"""Limit of events that take milliseconds; generous for a loaded machine."""


# ---- the judge sees faults that are put there --------------------------------------------------------------------


LEAVES = "import subprocess; subprocess.Popen(['sleep', '600'], start_new_session=True)"


SCRIPTS = {
    "one_line": ("import sys; print('one line', file=sys.stderr); sys.exit(2)", []),
    "no_line": ("import sys; sys.exit(2)", ["0 lines"]),
    "progress": ("import sys; print('campaign closed,event: 5 of 9 scenes', file=sys.stderr)", []),
    "traceback": ("int('x')", ["exit code 1", "Traceback", "lines"]),
    "orphan": (LEAVES, ["sleep"]),
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_judge_sees_words_codes_and_processes_that_are_wrong(tmp_path: Path, name: str) -> None:
    script, seen = SCRIPTS[name]
    run = Run([sys.executable, "-c", script], tmp_path)
    ended = run.ended()
    assert ended is not None
    faults = benches.judge_words(ended, {0, 2}) + run.orphans(within_s=1.0)
    assert bool(faults) == bool(seen)
    for word in seen:
        assert any(word in fault for fault in faults), faults


def results(out: Path, code: int = 7) -> None:
    """Write a whole set of results of one frame of 2 x 3."""
    out.mkdir(parents=True, exist_ok=True)
    codes = np.full((1, 2, 3), code, np.uint8)
    np.save(out / "codes.npy", codes)
    (out / "codes.csv").write_text(output.csv_of(codes))
    (out / "summary.json").write_text("{}\n")
    (out / "resolved.toml").write_text("")


@pytest.mark.parametrize("code", [0, 3], ids=["done", "failed"])
def test_the_judge_sees_results_that_are_not_whole(tmp_path: Path, code: int) -> None:
    """Those of a run that is done, or of one before it: a run that failed has changed nothing."""
    results(tmp_path)
    before, reference = benches.contents(tmp_path), np.full((1, 2, 3), 7, np.uint8)
    assert not benches.judge_out(tmp_path, before, code, reference)
    (tmp_path / ".partial_1").touch()
    assert benches.judge_out(tmp_path, before, code, reference)
    (tmp_path / ".partial_1").unlink()
    results(tmp_path, 8)
    assert benches.judge_out(tmp_path, before, code, reference)
    os.truncate(tmp_path / "codes.npy", 100)
    assert benches.judge_out(tmp_path, before, code, reference)


# ---- nothing stays ----------------------------------------------------------------------------------------------

STARTS = f"""
import sys, time
from dermis.processes import children
children.Child([sys.executable, "-c", {LEAVES!r}]).wait()
print("at work", flush=True)
time.sleep(600)
"""


def test_sigkill_of_a_command_leaves_none_of_what_it_started(tmp_path: Path) -> None:
    """`sleep` has a session of its own and no parent: only the watchdog finds it."""
    run = Run([sys.executable, "-c", STARTS], tmp_path)
    assert benches.poll(lambda: "at work" in run.said[0].read_text(), END_S)
    assert len(run.pids()) >= 2
    run.send_signal(signal.SIGKILL)
    assert run.ended() is not None
    assert run.orphans(END_S) == []


def test_the_end_of_a_child_is_that_of_all_it_started_also_when_it_has_ended_itself() -> None:
    child = children.Child([sys.executable, "-c", LEAVES])
    child.wait()
    assert len(child.processes()) == 1
    child.end()
    assert not child.processes()


SIGNALLED = """
import os, signal, sys, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
from dermis import cli
import click
@cli.cli.command()
def sleeps() -> None:
    print("at work", flush=True)
    time.sleep(600)
sys.argv[1:] = ["sleeps"]
from dermis.__main__ import main
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_command_answers_a_signal_with_code_and_word(tmp_path: Path, number: signal.Signals) -> None:
    """A command that ends at once, with -15 or -1, leaves its children."""
    run = Run([sys.executable, "-c", SIGNALLED], tmp_path)
    assert benches.poll(lambda: "at work" in run.said[0].read_text(), END_S)
    run.send_signal(number)
    run.send_signal(number)  # a process of a group gets it twice if its parent passes it on
    ended = run.ended()
    assert ended is not None
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert (ended.code, ended.error.strip()) == (128 + number, word)  # click puts a line end behind ^C


# ---- results are whole ------------------------------------------------------------------------------------------


def killed_at(number: int, out: Path) -> int:
    """Put results in `out` from a process that is killed at its n-th rename, and return its exit status."""
    pid = os.fork()
    if pid == 0:
        calls = itertools.count(1)

        def counted(real: Callable[..., None], *arguments: object) -> None:
            if next(calls) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            real(*arguments)

        os.replace, os.rename = partial(counted, os.replace), partial(counted, os.rename)
        try:
            with output._scratch(out) as scratch:
                results(scratch, 9)
                (scratch / "frame.png").write_bytes(b"new")
                output._commit(scratch, out)
        finally:
            os._exit(0)
    return os.waitpid(pid, 0)[1]


@pytest.mark.parametrize("number", range(1, 7))
@pytest.mark.parametrize("new", [True, False], ids=["new", "there"])
def test_a_run_killed_at_any_rename_leaves_the_old_results_or_the_next_one_finds_the_new(
    tmp_path: Path, number: int, new: bool
) -> None:
    """File by file, codes of the new run would stand next to the summary of the old one."""
    out = tmp_path / "out"
    if not new:
        results(out, 7)
        (out / "waves.vcd").write_text("of the run before")
        (out / "notes.txt").write_text("of the user")
    before = benches.contents(out)
    status = killed_at(number, out)
    assert (status == signal.SIGKILL) == (number == 1 or not new)
    with output.place(out):
        after = benches.contents(out)
    if number == 1:
        assert after == before
    else:
        assert benches.judge_results(out, np.full((1, 2, 3), 9, np.uint8)) == []
        assert (out / "frame.png").read_bytes() == b"new"
        assert not (out / "waves.vcd").exists()
    assert (out / "notes.txt").exists() == (not new)
    assert not list(tmp_path.rglob(".*"))


def test_a_number_that_is_not_finite_is_null_in_a_summary() -> None:
    data = {"a": [1.5, np.inf, -np.inf, np.nan], "b": ({"c": np.float64(np.inf)}, "inf", None)}
    assert output.finite(data) == {"a": [1.5, None, None, None], "b": [{"c": None}, "inf", None]}


def test_what_another_run_is_writing_is_not_tidied_away(tmp_path: Path) -> None:
    out = tmp_path / "out"
    results(out)
    with output._scratch(out) as scratch, output.place(out):
        assert scratch.is_dir()
    (out / ".partial_1").mkdir()
    with output.place(out):
        assert not (out / ".partial_1").exists()


# ---- builds and tools -------------------------------------------------------------------------------------------


def test_a_build_that_ends_well_and_makes_nothing_is_not_kept(tmp_path: Path) -> None:
    """A kept build without its program would fail every later run."""

    def nothing(target: Path, log: Path) -> None:
        log.write_text("nothing to do")

    def something(target: Path, log: Path, length: int | None = None) -> None:
        text = 'code\n:file_names 2;\n    "N/A";\n    "<interactive>";\n'
        (target / "sim.vvp").write_text(text[:length])

    cut = partial(something, length=-5)  # truncated, as Icarus leaves it with exit code 0 on a full disk
    for wrong in (cut, nothing):
        with pytest.raises(SimulatorError, match=r"without .*sim\.vvp"):
            hdl._cached(tmp_path / "top", [], "key", wrong, "sim.vvp")
    target = hdl._cached(tmp_path / "top", [], "key", something, "sim.vvp")
    assert hdl._cached(tmp_path / "top", [], "key", nothing, "sim.vvp") == target


def test_a_lock_lasts_until_what_was_started_under_it_is_gone(tmp_path: Path) -> None:
    """Compilers of a killed command would write into the build of the next command."""
    with files.locked(tmp_path / "lock") as lock, children.holding(lock):
        child = children.Child(["sleep", "600"])
    with files.locked(tmp_path / "lock", wait=False) as other:
        assert other is None
    child.end()
    with files.locked(tmp_path / "lock", wait=False) as other:
        assert other is not None


def test_a_tool_that_hangs_is_ended_with_what_it_started(tmp_path: Path) -> None:
    tool = tmp_path / "tool"
    tool.write_text("#!/bin/sh\nsleep 600 &\nsleep 600\n")
    tool.chmod(0o755)
    code, _ = children.output_of([str(tool)], 0.5)
    assert code is None
    with pytest.raises(SimulatorError, match="tool cannot be started"):
        children.output_of([str(tmp_path / "none" / "tool")], 0.5)


@pytest.mark.parametrize("content", [None, b"library (a) {", b"\xff\x00\x9c"])
def test_a_damaged_liberty_is_refused_by_name(tmp_path: Path, content: bytes | None) -> None:
    """A Liberty file without a cell, or one that is not text or no file, is refused with its name."""
    path = tmp_path / "cells.lib"
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=r"cells\.lib"):
        synth_cells.cells(path)


# ---- one trial of each kind, with a real command ------------------------------------------------------------------


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    # By this seed signals come early: no machine is done by then.
    return Bench(tmp_path_factory.mktemp("trials"), seed=718)


LONG = [
    pytest.param(f"{what}_kill", "exit", marks=pytest.mark.long)
    for what in ("rtl.hdl_simulator", "rtl.parent", "cosim.parent")
]


@pytest.mark.parametrize(
    ("wanted", "said"), [*LONG, ("closed.file_300", "exit 2"), ("cosim.alone_int", "exit 130")]
)
def test_a_trial_of_the_campaign(bench: Bench, wanted: str, said: str) -> None:
    trial = next(trial for trial in trials.every() if f".{wanted}" in trial.name)
    faults, note = trial.run(bench)
    assert faults == []
    assert note.startswith(said)
