# SPDX-License-Identifier: Apache-2.0
"""Batches: the same codes from any number of processes or Dask workers, and a clean end of every kind."""

from __future__ import annotations

import itertools
import operator
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dermis import engines, plan
from dermis.effects import EFFECTS
from dermis.engines import batch
from dermis.errors import InputError, SimulatorError
from dermis.processes import children, pool, watchdog
from dermis.records import Plan
from dermis.scene import scene
from dermis.scene.design import ROOT
from tb.programs.faults import inject

FRAMES, SIZE = 11, 6


@pytest.fixture
def make_plan(tmp_path: Path):
    """A plan of random resistances, with effects by name."""

    def make(engine: str = "event", frames: int = FRAMES, **effects: object) -> Plan:
        ohm = np.exp(np.random.default_rng(7).uniform(np.log(500), np.log(6e4), (frames, SIZE, SIZE)))
        np.save(tmp_path / "ohm.npy", ohm)
        data = {
            "array": {"rows": SIZE, "cols": SIZE},
            "stimulus": {"kind": "resistance", "file": "ohm.npy"},
            "effects": effects,
        }
        return plan.make(scene.from_data(data, tmp_path / "batch.toml"), engine)

    return make


def _in_parts(made: Plan, edges: list[int]) -> np.ndarray:
    parts = [made.part(a, b) for a, b in itertools.pairwise(edges)]
    return np.concatenate([engines.run(part).codes for part in parts])


# Everything that an engine knows beyond its own frame: random numbers, the time of the ripple, the next frame.
ACROSS_FRAMES = {
    "ideal": {},
    "random": dict.fromkeys((e.name for e in EFFECTS.values() if e.random), True),
    "ripple": {"supply_ripple": {"relative": 0.05, "frequency_hz": 1234.0}},
    "motion": {"motion": True},
    "sensor": dict.fromkeys(("sensor_hysteresis", "sensor_creep", "sensor_spread"), True),
    "drawn_once": {"mirror_ratio": {"ratio_error": 0.0, "spread": 0.02}},
}


@pytest.mark.parametrize("kind", ACROSS_FRAMES)
def test_parts_have_the_codes_of_the_whole(make_plan, kind: str) -> None:
    made = make_plan(**ACROSS_FRAMES[kind])
    if lost := engines.refused(made, "event"):
        pytest.skip(f"engine event does not do {', '.join(sorted(lost))} yet")
    whole = engines.run(made).codes
    assert np.array_equal(_in_parts(made, [0, 1, 5, FRAMES]), whole)
    again = made.part(2, 9)
    assert np.array_equal(engines.run(again.part(1, 4)).codes, whole[3:6])


@pytest.mark.parametrize("forgotten", ["first_frame", "next_resistance_ohm"])
def test_a_part_that_forgot_its_place_would_be_seen(make_plan, forgotten: str) -> None:
    made = make_plan(motion=True, supply_ripple={"relative": 0.05, "frequency_hz": 1234.0})
    if lost := engines.refused(made, "event"):
        pytest.skip(f"engine event does not do {', '.join(sorted(lost))} yet")
    part = replace(made.part(4, 7), **{forgotten: None if forgotten.startswith("next") else 0})
    assert not np.array_equal(engines.run(part).codes, engines.run(made).codes[4:7])


def test_the_frame_behind_a_part_is_that_of_the_whole(make_plan) -> None:
    made = make_plan()
    behind = made.next_conductance_s()
    assert np.array_equal(behind[:-1], made.conductance_s(slice(1, None)))
    assert np.array_equal(behind[-1], made.conductance_s(-1))
    part = made.part(3, 7)
    assert part.first_frame == 3
    assert np.array_equal(part.next_conductance_s(), behind[3:7])
    assert np.array_equal(part.next_conductance_s(slice(1, 3)), behind[4:6])
    assert np.array_equal(made.next_conductance_s(slice(2, 5)), behind[2:5])
    for first, stop in ((-1, 2), (3, 3), (0, FRAMES + 1)):
        with pytest.raises(ValueError, match="frames"):
            made.part(first, stop)


def test_bounds_cover_every_frame_once_in_parts_of_limited_size(make_plan) -> None:
    made = make_plan()
    for workers in (1, 2, 3, 50):
        edges = batch.bounds(made, workers)
        assert [f for a, b in edges for f in range(a, b)] == list(range(FRAMES))
    long = replace(made, resistance_ohm=np.broadcast_to(made.resistance_ohm[:1], (10**6, SIZE, SIZE)))
    assert max((b - a) * SIZE * SIZE for a, b in batch.bounds(long, 2)) <= 2**18


@pytest.fixture(autouse=True)
def _children_that_were_there() -> Iterator[None]:
    """No test here leaves a process; one of an earlier test in this process is not its business."""
    mark = f"{watchdog.VARIABLE}={children.guard()}/"
    before = set(_sleepers(mark))
    yield
    assert set(_sleepers(mark)) <= before


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_any_number_of_processes_gives_the_same_codes(make_plan, processes: int) -> None:
    made = make_plan(row_driver=True, comparator_delay=True, comparator_noise={"v_v": 0.01})
    seen: list[int] = []
    result = batch.run(made, seen.append, processes=processes)
    expected = engines.run(made)
    assert np.array_equal(result.codes, expected.codes)
    assert np.array_equal(result.info["x"], expected.info["x"])
    assert seen == sorted(seen)
    assert seen[-1] == FRAMES * SIZE
    assert len(seen) >= min(processes, 2)


def test_a_dask_cluster_gives_the_same_codes(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    made = make_plan(auto={})
    seen: list[int] = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        result = batch.run(made, seen.append, scheduler=cluster.scheduler_address)
        with pytest.raises(InputError, match="lines that settle before the gate"):
            batch.run(_failing(make_plan, monkeypatch), scheduler=cluster.scheduler_address)
    expected = engines.run(made)
    assert np.array_equal(result.codes, expected.codes)
    for name in ("decided", "level_1", "everything", "effects"):
        assert result.info["filter"][name] == expected.info["filter"][name]
    assert seen[-1] == FRAMES * SIZE


def test_a_scheduler_that_is_not_there_is_a_mistake_of_the_user(
    make_plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "CONNECT_S", 1)
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(InputError, match="--scheduler"):
            batch.run(make_plan(), scheduler=address)


class _Client:
    """A client of Dask, as far as `batch.cluster` uses one, that has one worker and whose scheduler then fails."""

    def __init__(self, fails: str) -> None:
        self.fails = fails
        self.status = "running"
        self.scheduler = self
        self.workers = {"tcp://127.0.0.1:2": 1}

    def __enter__(self) -> _Client:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def identity(self) -> None:
        pass

    def shutdown(self, wait: bool = True) -> None:
        pass

    def wait_for_workers(self, number: int, timeout: float) -> None:
        pass

    def nthreads(self) -> dict[str, int]:
        if self.fails == "at_once":
            raise OSError("Timed out trying to connect")
        return self.workers

    def get_executor(self, **_: object) -> _Client:
        return self

    def scheduler_info(self) -> dict[str, dict[str, int]]:
        return {"workers": self.workers}

    def sync(self, function: object, callback_timeout: float) -> None:
        from distributed.comm import CommClosedError

        broken = {"closed": CommClosedError, "refused": ConnectionRefusedError, "no_answer": TimeoutError}
        if self.fails in broken:
            raise broken[self.fails]("in <TCP (closed)>")


@pytest.mark.parametrize(
    ("fails", "said"),
    [
        ("at_once", "is gone"),
        ("closed", "is gone"),
        ("refused", "is gone"),
        ("status", "is gone"),
        ("no_answer", "has not answered for 8 s"),
        ("no_worker", "has had no worker for 8 s"),
    ],
)
def test_a_look_at_a_cluster_says_in_one_line_what_has_failed(
    monkeypatch: pytest.MonkeyPatch, fails: str, said: str
) -> None:
    """An error of the connection itself, as a scheduler goes while it is asked, was a traceback."""
    distributed = pytest.importorskip("distributed")
    client = _Client(fails)
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: client)
    monkeypatch.setattr(batch, "WORKER_S", 8)
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    address = "tcp://127.0.0.1:8786"

    def watched() -> None:
        with batch.cluster(address) as (_, workers, look):
            assert workers == 1
            if fails == "status":
                client.status = "closed"
            if fails == "no_worker":
                client.workers = {}
                for _ in range(5):  # 8 s are over at the sixth look, 10 s behind the first
                    look()
                    now[0] += batch.LOOK_S
            look()

    with pytest.raises(SimulatorError) as raised:
        watched()
    assert str(raised.value) == f"the scheduler {address} {said}"


def _failing(make_plan, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Fails in the engine, since nobody looks on the way in: lines that have not settled, with resistance."""
    monkeypatch.setattr(engines, "check", lambda _: None)
    lines = {"c_row_f": 1e-7, "c_column_f": 1e-7}
    return make_plan(trace={"r_row_ohm": 100.0, "r_column_ohm": 100.0}, line_capacitance=lines)


def test_a_part_that_fails_ends_the_run_with_its_error(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="lines that settle before the gate") as raised:
        batch.run(_failing(make_plan, monkeypatch), processes=2)
    assert raised.value.key == "effects.line_capacitance"


def test_another_version_of_the_package_is_refused(make_plan) -> None:
    with pytest.raises(SimulatorError, match="another version"):
        batch._run_part(make_plan().part(0, 1), "an old one", False, {})


DECIDE = (
    "models/design.toml",
    "models/dermis/array/array.py",
    "models/dermis/engines/event.py",
    "models/dermis/chip/lockstep.c",
    "models/verilog/files.f",
    "models/verilog/skin.sv",
    "models/verilog/skin_main.cpp",
    "models/verilog/values.vh",
    "rtl/files.f",
    "rtl/dermis_row_scanner.v",
    "rtl/dermis_design.vh",
    "spice/array/taxel.sp",
    "spice/behavioural/blocks.inc",
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
    with pytest.raises(
        SimulatorError, match=r"frames \d+ to \d+: a worker process used no processor for 1 s"
    ):
        batch.run(make_plan(), processes=2)


def test_what_cannot_be_sent_back_is_an_error_and_not_the_end_of_a_worker() -> None:
    with pool.workers(1, {}) as executor:
        with pytest.raises(RuntimeError, match="local object"):
            executor.submit(inject.unsendable).result()
        assert executor.submit(operator.add, 1, 2).result() == 3


def test_errors_cross_a_process_whole() -> None:
    for error in (InputError("f.toml", "a.b", -1.0, "more"), SimulatorError("it broke", "a.log")):
        again = pickle.loads(pickle.dumps(error))
        assert (str(again), vars(again)) == (str(error), vars(error))


def test_cosim_is_told_that_it_has_processes_of_its_own(make_plan) -> None:
    with pytest.raises(InputError, match="--processes"):
        batch.run(make_plan("cosim"), processes=2)


def test_a_worker_has_one_thread(make_plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with pool.workers(1, pool.ONE_THREAD) as executor:
        assert executor.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


SLOW = """
import sys
from dermis.engines import batch; from dermis import plan
from tb.programs.faults import inject
batch._run_part = inject.sleep
batch.run(plan.load(sys.argv[1], "event"), processes=2)
"""


def _sleepers(text: str) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and text.encode() in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        # A process that ended while it was looked at.
        except OSError:
            continue
    return found


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
    assert len(_sleepers(mark)) >= 3
    if how == signal.SIGINT:
        os.killpg(run.pid, how)  # as a terminal does it: to all of them
    else:
        run.kill()
    run.wait(20)
    end = time.monotonic() + 10
    while _sleepers(mark) and time.monotonic() < end:
        time.sleep(0.1)
    assert _sleepers(mark) == []
