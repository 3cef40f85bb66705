# SPDX-License-Identifier: Apache-2.0
"""Batches: the same codes from any number of processes, and a clean end of every kind."""

import operator
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import inject
import numpy as np
import pytest
from made_plans import made, ohms

from dermis import engines
from dermis.engines import batch
from dermis.errors import InputError, SimulatorError
from dermis.processes import children, pool, watchdog
from dermis.records import Plan
from dermis.scene.design import ROOT
from tb.system.system_bench import processes_with

FRAMES, SIZE = 11, 6


@pytest.fixture
def make_plan(tmp_path: Path):
    """A plan of random resistances, with effects by name."""

    def make(engine: str = "event", **effects: object) -> Plan:
        return made(tmp_path, ohms(7, FRAMES, SIZE, SIZE), effects, engine=engine)

    return make


@pytest.fixture(autouse=True)
def _children_that_were_there() -> Iterator[None]:
    """No test here leaves a process; one of an earlier test in this process is not its business."""
    mark = f"{watchdog.VARIABLE}={children.guard()}/"
    before = set(processes_with(mark))
    yield
    assert set(processes_with(mark)) <= before


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_any_number_of_processes_gives_the_same_codes(make_plan, processes: int) -> None:
    plan = make_plan(row_driver=True, comparator_delay=True, comparator_noise={"v_v": 0.01})
    seen: list[int] = []
    result = batch.run(plan, seen.append, processes=processes)
    expected = engines.run(plan)
    assert np.array_equal(result.codes, expected.codes)
    assert np.array_equal(result.info["x"], expected.info["x"])
    assert seen == sorted(seen)
    assert seen[-1] == FRAMES * SIZE
    assert len(seen) >= min(processes, 2)


def _failing(make_plan, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Fails in the engine, since nobody looks on the way in: lines that have not settled, with resistance."""
    monkeypatch.setattr(engines, "check", lambda _: None)
    lines = {"c_row_f": 1e-7, "c_column_f": 1e-7}
    return make_plan(trace={"r_row_ohm": 100.0, "r_column_ohm": 100.0}, line_capacitance=lines)


def test_a_part_that_fails_ends_the_run_with_its_error(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="lines that settle") as raised:
        batch.run(_failing(make_plan, monkeypatch), processes=2)
    assert raised.value.key == "effects.line_capacitance"


DECIDE = (
    "models/design.toml",
    "models/dermis/array/array.py",
    "models/dermis/lockstep/clock_loop.c",
    "models/dermis/lockstep/lockstep.c",
    "models/verilog/skin.sv",
    "models/verilog/skin_main.cpp",
    "rtl/files.f",
    "rtl/dermis_row_scanner.v",
    "rtl/dermis_design.vh",
    "spice/behavioural/conveyor.sp",
    "spice/design.inc",
)


def test_every_kind_of_file_that_decides_about_codes_makes_a_version(tmp_path: Path) -> None:
    for name in ("models", "rtl", "spice"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))

    def version() -> str:
        return batch.fingerprint.__wrapped__(tmp_path / "models" / "dermis", tmp_path)

    first = version()
    assert first == batch.fingerprint.__wrapped__()
    (tmp_path / "models" / "dermis" / "__pycache__").mkdir()
    (tmp_path / "models" / "dermis" / "__pycache__" / "array.pyc").write_bytes(b"made here")
    assert version() == first
    for name in DECIDE:
        text = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(text + b"\n")
        assert version() != first, name
        (tmp_path / name).write_bytes(text)
    assert version() == first


def test_a_worker_that_dies_is_reported(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_run_part", inject.die)
    with pytest.raises(SimulatorError, match=r"frames \d+ to \d+: a worker process died \(exit code 9\)"):
        batch.run(make_plan(), processes=2)


def test_a_worker_that_stands_still_is_ended(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_run_part", inject.stop)
    monkeypatch.setattr(pool, "STALL_S", 1.0)
    monkeypatch.setattr(pool, "LOOK_S", 0.2)
    said = r"frames \d+ to \d+: a worker process used no processor for 1 s"
    with pytest.raises(SimulatorError, match=said):
        batch.run(make_plan(), processes=2)


def test_a_process_that_becomes_another_program_is_seen() -> None:
    """During execve a process has no environment; one that does nothing else was missed in one look of ten."""
    again = 'exec sh -c "$0" "$0"'
    child = children.Child(["sh", "-c", again, again])
    try:
        assert all(child.processes() for _ in range(200))
    finally:
        child.end()


def test_what_cannot_be_sent_back_is_an_error_and_not_the_end_of_a_worker() -> None:
    with pool.workers(1, {}) as executor:
        with pytest.raises(RuntimeError, match="local object"):
            executor.submit(inject.unsendable).result()
        assert executor.submit(operator.add, 1, 2).result() == 3


def test_cosim_is_told_that_it_has_processes_of_its_own(make_plan) -> None:
    with pytest.raises(InputError, match="--processes"):
        batch.run(make_plan("cosim"), processes=2)


SLOW = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for tests in the background
from dermis.engines import batch; from dermis import plan
sys.path.append({str(Path(inject.__file__).parent)!r})
import inject
batch._run_part = inject.sleep
batch.run(plan.load(sys.argv[1], "event"), processes=2)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["ctrl_c", "killed"])
def test_the_workers_end_with_the_run(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "scene.toml").write_text('[stimulus]\nkind = "uniform"\ncode = [1, 2, 3, 4]\n')
    mark = f"DERMIS_TEST_BATCH={tmp_path}"
    run = subprocess.Popen(
        [sys.executable, str(tmp_path / "slow.py"), str(tmp_path / "scene.toml")],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "DERMIS_TEST_BATCH": str(tmp_path)},
    )
    assert run.stderr is not None
    assert run.stderr.readline().startswith("at work")  # two of them may write into one line
    assert len(processes_with(mark)) >= 3
    if how == signal.SIGINT:
        os.killpg(run.pid, how)  # as a terminal does it: to all of them
    else:
        run.kill()
    run.wait(20)
    end = time.monotonic() + 10
    while processes_with(mark) and time.monotonic() < end:
        time.sleep(0.1)
    assert processes_with(mark) == []
