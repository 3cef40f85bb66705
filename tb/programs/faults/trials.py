# SPDX-License-Identifier: Apache-2.0
"""Ten disturbances of small commands that together start every kind of process of dermis."""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dermis.files import locked
from tb.programs.faults import bench as benches
from tb.programs.faults.bench import Bench, Ended, Run

Found = tuple[list[str], str]
"""Faults in words, and a note."""

ROLE_LIMIT_S = 60.0
"""A process of a command is there by then; the slowest, a simulator, takes 4 s on an idle core."""


@dataclass(frozen=True)
class Subject:
    """A command.

    Attributes
    ----------
    name : str
    scene : str
        Tables of its scene, written with resistances [frames, rows, cols] of `shape`; without rows, each
        trial has a size that no other one has, so that nothing is built yet.
    options : of `dermis run`
    at_work_s : float
        Lifetime of its youngest process on an idle core; faults come within it.
    stalls : tuple of str
        Changes that shorten its limits, for trials in which a process stands still.
    """

    name: str
    shape: tuple[int, int, int]
    scene: str
    options: tuple[str, ...] = ()
    at_work_s: float = 1.0
    stalls: tuple[str, ...] = ()

    def command(self, work: Path, out: Path, number: int = 0) -> list[str]:
        """Write the scene into a directory and return the command."""
        frames, rows, cols = self.shape if self.shape[1] else (1, 5 + number // 40, 5 + number % 40)
        ohm = 500.0 * 10 ** np.random.default_rng(sum(self.shape)).uniform(0, 2, (frames, rows, cols))
        np.save(work / "taxels.npy", ohm)
        stimulus = '[stimulus]\nkind = "resistance"\nfile = "taxels.npy"\n' * ("[stimulus]" not in self.scene)
        text = f"[array]\nrows = {rows}\ncols = {cols}\n{stimulus}{self.scene}\n"
        (work / "scene.toml").write_text(text)
        return ["run", str(work / "scene.toml"), *self.options, "--out", str(out)]


def _engine(name: str, effects: str = "") -> str:
    return f'[run]\nengine = "{name}"\n[effects]\n{effects}'


_POOL = ("dermis.processes.pool:STALL_S=4",)
_RTL = ("dermis.engines.rtl:FRAME_LIMIT_S=4", "dermis.chip.hdl:BUILD_LIMIT_S=8")
_COSIM = ("dermis.engines.cosim:SLOT_LIMIT_S=8",)
_ICARUS, _VERILATOR, _TWO = ("--simulator", "icarus"), ("--simulator", "verilator"), ("--processes", "2")
_LATE = _engine("event", "comparator_delay = { t_s = 1e-8 }")
SUBJECTS = {
    subject.name: subject
    for subject in (
        Subject("closed", (4, 8, 8), _engine("closed")),
        Subject("batch", (400, 16, 16), _LATE, _TWO, 1.5, _POOL),
        Subject("rtl", (4, 4, 4), _engine("rtl"), _ICARUS, 0.4, _RTL),
        Subject("verilator", (1500, 4, 4), _engine("rtl"), _VERILATOR, 0.4, _RTL),
        Subject("rtl_batch", (6, 4, 4), _engine("rtl"), (*_ICARUS, *_TWO), 0.4, _POOL),
        Subject("build", (0, 0, 0), _engine("rtl"), _VERILATOR, 5.0, _RTL),
        Subject("cosim", (4, 2, 3), _engine("cosim"), (), 2.0, _COSIM),
        Subject("cosim_verilator", (6, 2, 3), _engine("cosim"), _VERILATOR, 2.0, _COSIM),
    )
}


@dataclass(frozen=True)
class Trial:
    """A trial; its name is disturbance, subject, what is done and a number, with dots between."""

    name: str

    @property
    def subject(self) -> Subject:
        """The command that is disturbed."""
        return SUBJECTS[self.name.split(".")[1]]

    @property
    def what(self) -> list[str]:
        """The words of what is done."""
        return self.name.split(".")[2].split("_")

    @property
    def number(self) -> int:
        """The number in the list."""
        return int(self.name.rpartition(".")[2])

    def run(self, bench: Bench) -> Found:
        """Disturb a command and judge how it ends."""
        return DISTURBANCES[self.name.partition(".")[0]](self, bench, bench.random(self.name))


def baseline(bench: Bench, subject: Subject) -> np.ndarray | None:
    """Run a subject once undisturbed and return its codes; None where every trial has another
    scene.
    """
    if subject.name not in SUBJECTS or subject.name == "build":
        return None
    place = bench.tree / "trials" / f"reference.{subject.name}"
    place.mkdir(parents=True, exist_ok=True)
    with locked(place / "lock"):
        if not (place / "out" / "codes.npy").is_file():
            ended = bench.dermis(SUBJECTS[subject.name].command(place, place / "out"), place).ended()
            if ended is None or ended.code != 0:
                raise RuntimeError(f"{subject.name} does not run undisturbed: {ended}")
    return np.load(place / "out" / "codes.npy")


def earlier(bench: Bench, out: Path) -> None:
    """Put results of an earlier run and a file of the user in a place."""
    baseline(bench, SUBJECTS["closed"])
    shutil.copytree(bench.tree / "trials" / "reference.closed" / "out", out)
    (out / "notes.txt").write_text("of the user\n")


_OURS = re.compile(r"interrupted|terminated|models/dermis/(?!__(main|init)__\.py\", line \d\b)\w")
"""A word, or a line of the package after the first of the modules that Python loads for `-m
dermis`.
"""


def attempt(
    trial: Trial,
    bench: Bench,
    act: Callable[[Run], set[int]] = lambda run: {0, 2, 3},
    *,
    subject: Subject | None = None,
    work: Path | None = None,
    out: Path | None = None,
    tree: Path | None = None,
    arrange: Callable[[Bench, Path], None] = earlier,
    changes: Sequence[str] = (),
    says: str = "",
    again: Subject | None = None,
    restore: Callable[[], Any] | None = lambda: None,
    **options: Any,
) -> Found:
    """Start a subject, act on it, judge how it ends, and run it once more undisturbed.

    Parameters
    ----------
    act : disturbs the run, returns the exit codes that are right
    work, out, tree : directory of the trial, OUT, and a copy of the sources, if they are not new
    arrange : puts something in the place of OUT; by default results of an earlier run
    changes : of tb.programs.faults.launch
    says : what the message of a failed run must match
    again, restore : subject of the second run, and what is called before it; None for no second run
    options : of Run
    """
    subject = subject or trial.subject
    reference, work = baseline(bench, subject), work or bench.work(trial.name)
    out = out or work / "out"
    arrange(bench, out)
    before = benches.contents(out)
    run = bench.dermis(subject.command(work, out, trial.number), work, changes, tree, **options)
    codes = act(run)
    ended = run.ended()
    faults = run.orphans()
    if ended is not None and ended.code < 0 and 128 - ended.code in codes and not _OURS.search(ended.error):
        ended = Ended(128 - ended.code, ended.out, "interrupted")  # before the first line of the package
    faults += benches.judge_words(ended, codes)
    if ended is not None:
        if ended.code == 0 and (out / "notes.txt").exists() != ("notes.txt" in before):
            faults.append("notes.txt of the user is gone")
        if ended.code not in (0, 1) and not re.search(says, ended.error):
            faults.append(f"does not name {says}: {ended.error.strip()[-120:]}")
        # Results are there before they are reported on a standard output that fails.
        faults += benches.judge_out(out, before, 0 if "stdout" in options else ended.code, reference)
    faults += benches.judge_tables(tree or bench.tree)
    if restore is not None:
        restore()
        second = bench.dermis((again or subject).command(work, out, trial.number), work, tree=tree)
        more = benches.judge_words(second.ended(), {0}) + benches.judge_results(out, reference)
        more += [f"{left} stays" for left in benches.contents(out) if left.startswith(".")]
        more += [f"{path.name} stays" for path in out.parent.glob(f".{out.name}.partial_*")]
        faults += [f"rerun: {fault}" for fault in more + second.orphans()]
    return faults, f"exit {ended.code if ended else 'none'}"


# ---- the ten disturbances


def kill(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Send a signal to a process of a role at a random moment of its life."""
    subject, hit, (wanted, how) = trial.subject, [], "_".join(trial.what).rsplit("_", 1)
    number, parent = SIGNALS[how], wanted == "parent"
    changes = subject.stalls if how == "stop" and not parent else ()

    def act(run: Run) -> set[int]:
        benches.poll(lambda: run.pids(wanted) or run.poll() is not None, ROLE_LIMIT_S)
        time.sleep(draw.uniform(0.0, subject.at_work_s))
        if found := run.pids(wanted):
            hit.extend(pid for pid in [draw.choice(found)] if benches.send(pid, number))
        if not hit:  # with short limits a busy machine passes for a hang
            return {0, 3} if changes else {0}
        if parent and how == "stop":
            time.sleep(2.0)
            benches.send(hit[0], signal.SIGCONT)
            return {0}
        if parent:
            return {0, -9} if how == "kill" else {0, 143}
        return {0} if wanted == "watchdog" else {0, 3}

    # A rerun takes longer than the run that was killed.
    restore = None if trial.number % 3 else lambda: None
    faults, note = attempt(trial, bench, act, changes=changes, restore=restore)
    return faults, note if hit else "ended before"


def ctrl_c(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Ask a command to end at a random moment: Ctrl-C of one process or of the group, SIGTERM,
    SIGHUP.
    """
    how = trial.what[0]
    number = {"term": signal.SIGTERM, "hangup": signal.SIGHUP}.get(how, signal.SIGINT)

    def act(run: Run) -> set[int]:
        if how != "early":
            benches.poll(lambda: len(run.pids()) > 1 or run.poll() is not None, 5.0)
        time.sleep(draw.uniform(0.0, 0.6 if how == "early" else trial.subject.at_work_s + 1.0))
        for _ in range(3 if how == "thrice" else 1):
            if how in ("alone", "early", "hangup"):
                benches.send(run.pid, number)
            elif run.poll() is None:  # as a terminal does
                os.killpg(run.pid, number)
            time.sleep(0.02)
        return {0, 128 + number}

    return attempt(trial, bench, act)


def commit(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Kill a command, or fail it, at the n-th call with which it moves results into place, over
    earlier ones or not.
    """
    call, fault, n, *new = trial.what
    codes = {"kill": {0, -9}, "term": {0, 143}}.get(fault, {0, 2, 3})
    arrange = (lambda bench, out: None) if new else earlier
    left, changes, work = [], [f"os:{call}!{n}={fault}"], bench.work(trial.name)

    def restore() -> None:
        left.extend((work / "out").glob(".complete_*"))

    faults, note = attempt(
        trial, bench, lambda run: codes, arrange=arrange, changes=changes, work=work, restore=restore
    )
    if left:  # between its renames the whole set lies hidden, and the next run finishes
        faults = [f for f in faults if f.startswith("rerun") or not re.search("missing|different|changed", f)]
    return faults, note


@contextlib.contextmanager
def small_disk(where: Path, size: int) -> Iterator[Path]:
    """Mount a file system of some bytes."""
    where.mkdir(parents=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "dermis_faults", str(where)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=20)
    if done.returncode:
        raise PermissionError(done.stderr.strip())
    try:
        yield where
    finally:
        subprocess.run(["umount", "--lazy", str(where)], check=False, timeout=20)


def disk(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run on a full disk: of OUT, of TMPDIR, or of build/; or without a standard output."""
    what, left = trial.what
    if what == "stdout":
        write = os.open("/dev/full", os.O_WRONLY) if left == "full" else _closed_pipe()
        with open(write, "wb") as stdout:
            codes = {3} if left == "full" else {1}
            return attempt(trial, bench, lambda run: codes, stdout=stdout, restore=None)
    work = bench.work(trial.name)
    with small_disk(work / "small", (64 if what == "build" else 8) << 20) as small:
        (small / "tmp").mkdir()

        def arrange(bench: Bench, out: Path) -> None:
            earlier(bench, out)
            (small / "filler").write_bytes(bytes(max(0, shutil.disk_usage(small).free - int(left))))

        return attempt(
            trial,
            bench,
            arrange=arrange,
            work=work,
            out=small / "out" if what == "out" else None,
            tree=bench.copy(small / "tree") if what == "build" else None,
            environment={"TMPDIR": str(small / "tmp")} if what == "tmpdir" else None,
            says="No space left|no room is left",
            restore=(small / "filler").unlink,
        )


def _closed_pipe() -> int:
    read, write = os.pipe()
    os.close(read)
    return write


def limit(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run under a limit of the system: bytes of a file, megabytes of memory, open files."""
    what, size = trial.what
    kinds = {"file": resource.RLIMIT_FSIZE, "memory": resource.RLIMIT_AS, "handles": resource.RLIMIT_NOFILE}
    most = int(size) << (20 if what == "memory" else 0)
    return attempt(trial, bench, preexec_fn=partial(resource.setrlimit, kinds[what], (most, most)))


def read_only(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run where nothing can be written: a read-only disk, a file as OUT, a directory as a
    result.
    """
    what, work = trial.what[0], bench.work(trial.name)
    with contextlib.ExitStack() as places:
        small = work / "small"
        if what in ("out", "tree"):
            places.enter_context(small_disk(small, 64 << 20))

        def arrange(bench: Bench, out: Path) -> None:
            earlier(bench, out)
            if what == "file":
                shutil.rmtree(out)
                out.write_text("a file\n")
            elif what == "directory":
                (out / "codes.npy").unlink()
                (out / "codes.npy").mkdir()
            else:
                subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True, timeout=20)

        out = small / "out" if what == "out" else None
        tree = bench.copy(small) if what == "tree" else None
        where = {"work": work, "out": out, "tree": tree}
        return attempt(trial, bench, lambda run: {2, 3}, arrange=arrange, restore=None, **where)


CUTS = {"nothing": 0.0, "little": 0.02, "half": 0.52, "most": 0.99}
"""Ways to cut a file of frames, and the share of its bytes that is left."""


def frames(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Read a file of frames that is cut, or deleted while the command starts."""
    kind, what, work = trial.name.split(".")[1], trial.what[0], bench.work(trial.name)
    path, codes = work / f"f.{kind}", np.random.default_rng(3).integers(100, 256, (6, 4, 5)).astype(np.uint8)

    def write() -> None:
        if kind == "csv":
            np.savetxt(path, codes.reshape(6, -1), "%d", ",")
        elif kind == "npy":
            np.save(path, codes)
        else:
            np.savez_compressed(path, codes=codes)

    def act(run: Run) -> set[int]:
        if what in CUTS:
            return {0, 2} if (kind, what) == ("csv", "most") else {2}  # a number with fewer digits
        time.sleep(draw.uniform(0.0, 3.0))
        path.unlink()
        return {0, 2}

    write()
    if what in CUTS:
        path.write_bytes(path.read_bytes()[: int(CUTS[what] * path.stat().st_size)])
    stimulus = f'[stimulus]\nkind = "frames"\nfile = "{path.name}"\nunit = "codes"\n'
    subject = Subject("frames", codes.shape, stimulus + _engine("closed"))
    return attempt(trial, bench, act, subject=subject, work=work, says=re.escape(path.name), restore=write)


_TOOL = {
    "failing": "#!/bin/sh\necho 'no licence' >&2\nexit 1\n",
    "garbage": "#!/bin/sh\nhead -c 3000 /dev/urandom\nexit 0\n",
    "crashing": "#!/bin/sh\nkill -SEGV $$\n",
    "hanging": "#!/bin/sh\nsleep 1000 & sleep 1000\n",
    "old": '#!/bin/sh\necho "$0 version 0.0.1 (1987)"\nexit 0\n',
    "empty": "",
}


def tool(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run with a tool that is missing, fails, hangs or says the wrong thing."""
    (which, how), subject, work = trial.what, trial.subject, bench.work(trial.name)
    shims = work / "bin"
    shims.mkdir()
    for directory in ("/usr/local/bin", "/usr/bin", "/bin"):
        for entry in Path(directory).iterdir():
            if entry.name != which and not (shims / entry.name).is_symlink():
                (shims / entry.name).symlink_to(entry)
    if how != "missing":
        (shims / which).write_text(_TOOL[how])
        (shims / which).chmod(0o755)
    limits = "dermis.report.output:TOOL_LIMIT_S=2", "dermis.chip.ngspice:COMPILE_LIMIT_S=3"
    path = {"PATH": f"{shims}:{Path(sys.executable).parent}"}
    # A build needs the tool; other commands may not.
    codes = {2, 3} if subject.name == "build" else {0, 2, 3}
    changes = (*subject.stalls, *limits)
    return attempt(trial, bench, lambda run: codes, changes=changes, work=work, environment=path)


def two(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run a command twice at once in one tree, into one OUT or two; or kill the first."""
    subject, (how, *_) = trial.subject, trial.what
    reference, runs, faults = baseline(bench, subject), [], []
    works = [bench.work(f"{trial.name}.{which}") for which in "ab"]
    outs = [works[0 if how == "same" else n] / "out" for n in range(2)]
    for work, out in zip(works, outs, strict=True):
        runs.append(bench.dermis(subject.command(work, out, trial.number), work))
        time.sleep(draw.uniform(0.0, 0.3))
    if killed := how == "killed":
        time.sleep(draw.uniform(0.5, subject.at_work_s + 2.0))
        benches.send(runs[0].pid, signal.SIGKILL)
    for run, out in zip(runs, outs, strict=True):
        ended = run.ended()
        faults += benches.judge_words(ended, {0, -9} if killed and run is runs[0] else {0}) + run.orphans()
        if ended is not None and ended.code == 0:
            faults += benches.judge_results(out, reference)
    hidden = [left for out in outs for left in benches.contents(out) if left.startswith(".")]
    faults += [] if killed else [f"{left} stays" for left in hidden]
    return faults + benches.judge_tables(bench.tree), "the second done" if killed else "both done"


CLUSTER_LIMIT_S = 60.0
"""A scheduler and its workers are there by then; in 3 s on an idle core."""

_SHORT_TTL = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"}
"""A scheduler moves the part of a silent worker after this time instead of five minutes."""


@contextlib.contextmanager
def dask_cluster(bench: Bench, work: Path) -> Iterator[tuple[str, Run, list[Run]]]:
    """Start a scheduler and two workers: its address, the scheduler, the workers."""
    file, python = work / "scheduler.json", (sys.executable, "-m")
    place = ["--scheduler-file", str(file), "--no-dashboard"]
    own = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler, workers = Run([*python, *own, *place], bench.tree, work, _SHORT_TTL), []
    try:
        if not benches.poll(lambda: file.is_file() and file.read_text().endswith("}"), CLUSTER_LIMIT_S):
            raise RuntimeError("no scheduler of Dask has started")
        for number in range(2):
            own = ["distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1"]
            own += ["--local-directory", str(work / f"worker_{number}")]
            workers.append(Run([*python, *own, *place], bench.tree, work))
        log = scheduler.said[1]
        if not benches.poll(lambda: log.read_text().count("Register worker") > 1, CLUSTER_LIMIT_S):
            raise RuntimeError("no two workers of Dask have started")
        yield json.loads(file.read_text())["address"], scheduler, workers
    finally:
        for run in (*workers, scheduler):
            run.end()


def cluster(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Send a signal to the scheduler, a worker or both workers of a Dask cluster at a random moment of
    a run on it.
    """
    (whom, how), work, over, missed = trial.what, bench.work(trial.name), [], []
    with dask_cluster(bench, work) as (address, scheduler, workers):

        def says(words: str) -> bool:
            return words in scheduler.said[1].read_text()

        def act(run: Run) -> set[int]:
            if not benches.poll(lambda: says("Receive client connection"), CLUSTER_LIMIT_S):
                missed.append(f"does not reach the scheduler within {CLUSTER_LIMIT_S:g} s")
            time.sleep(draw.uniform(0.0, trial.subject.at_work_s))
            if run.poll() is not None or says("Remove client"):  # then it has all its results
                over.append(True)
            hit = {"scheduler": [scheduler], "worker": workers[:1], "workers": workers}[whom]
            sent = [benches.send(other.pid, SIGNALS[how]) for other in hit]
            missed.extend([] if all(sent) else ["the cluster had ended by itself"])
            # The second worker takes over: at once, or after the time of _SHORT_TTL.
            return {0} if over or whom == "worker" else {3}

        there = replace(trial.subject, options=("--scheduler", address))
        changes = ("dermis.engines.batch:WORKER_S=8",)
        faults, note = attempt(
            trial, bench, act, subject=there, again=trial.subject, changes=changes, work=work
        )
    return faults + missed, "ended before" if over else note


SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "stop": signal.SIGSTOP}
DISTURBANCES = {
    function.__name__: function
    for function in (kill, ctrl_c, commit, disk, limit, read_only, frames, tool, two, cluster)
}

# Disturbance -> subject -> what is done, and how often. A signal comes at another moment each time.
TRIALS = {
    "kill": {
        "closed": "parent_kill*2 parent_term parent_stop",
        "batch": "parent_kill*3 parent_term*2 worker_kill*8 worker_term*4 worker_stop watchdog_kill",
        "rtl": "parent_kill*3 parent_term hdl_simulator_kill*7 hdl_simulator_term*4 hdl_simulator_stop "
        "watchdog_kill",
        "verilator": "hdl_simulator_kill*4 hdl_simulator_term*2 hdl_simulator_stop",
        "rtl_batch": "worker_kill*3 worker_term hdl_simulator_kill*3 hdl_simulator_term",
        "build": "parent_kill parent_term compiler_kill*2 compiler_stop",
        "cosim": "parent_kill*5 parent_term*2 parent_stop hdl_simulator_kill*17 "
        "hdl_simulator_term*9 hdl_simulator_stop*2 watchdog_kill watchdog_term",
        "cosim_verilator": "parent_kill parent_term hdl_simulator_kill*5 hdl_simulator_term*2",
    },
    "ctrl_c": {
        "closed": "early*3 group",
        "batch": "group alone thrice hangup",
        "rtl": "group term",
        "build": "group",
        "cosim": "group alone thrice hangup term",
    },
    "commit": {
        "closed": "replace_kill_1 replace_kill_2 replace_kill_5 replace_kill_7 rename_kill_1 rename_kill_2_new "
        "replace_term_4 replace_EIO_4",
    },
    "disk": {
        "closed": "out_0 out_40000 tmpdir_0 build_0 stdout_full stdout_closed",
        "batch": "tmpdir_0",
        "rtl": "build_0 build_200000 tmpdir_0",
        "cosim": "out_0 build_0 build_200000 tmpdir_0",
        "build": "build_3000000",
    },
    "limit": {
        "closed": "file_300 file_20000 memory_500",
        "batch": "memory_700 memory_1200 handles_16",
        "cosim": "file_20000 memory_700 memory_1200",
    },
    "read_only": {"closed": "out tree file_for_out directory_for_codes", "cosim": "tree"},
    "frames": dict.fromkeys(("csv", "npy", "npz"), " ".join((*CUTS, "deleted"))),
    "tool": {
        "rtl": "iverilog_missing iverilog_failing iverilog_garbage iverilog_crashing iverilog_hanging iverilog_old "
        "iverilog_empty vvp_missing vvp_failing vvp_garbage vvp_crashing vvp_hanging",
        "cosim": "vvp_missing vvp_garbage vvp_hanging",
        "build": "g++_missing g++_garbage make_garbage make_hanging",
        "closed": "ngspice_missing ngspice_garbage ngspice_hanging",
    },
    "two": {"closed": "same_out", "batch": "other_out", "rtl": "other_out", "cosim": "same_out killed"}
    | {"build": "killed"},
    "cluster": {
        "batch": "scheduler_kill*2 scheduler_term scheduler_stop worker_kill*2 worker_term worker_stop "
        "workers_kill*2 workers_term workers_stop",
    },
}


def every() -> list[Trial]:
    """Return all trials."""
    names: list[str] = []
    for disturbance, subjects in TRIALS.items():
        for subject, words in subjects.items():
            for what, _, times in (word.partition("*") for word in words.split()):
                for _ in range(int(times or 1)):
                    names.append(f"{disturbance}.{subject}.{what}.{len(names) + 1}")
    return [Trial(name) for name in names]
