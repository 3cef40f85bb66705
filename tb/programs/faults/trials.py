# SPDX-License-Identifier: Apache-2.0
"""Six disturbances of small commands that together start every kind of process of dermis."""

import contextlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dermis.files import locked
from tb.programs.faults import bench as benches
from tb.programs.faults.bench import Bench, Run

Found = tuple[list[str], str]
"""Faults in words, and a note."""

THERE_LIMIT_S = 60.0
"""A process of a command is there by then; the slowest, a simulator, takes 4 s on an idle core."""

SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "stop": signal.SIGSTOP, "int": signal.SIGINT}


@dataclass(frozen=True)
class Subject:
    """A command: size and tables of its scene, and options of `dermis run`.

    Without rows each trial has a size that no other one has, so that nothing is built yet. Faults come
    within `at_work_s`, the life of its youngest process on an idle core. `stalls` shortens its limits
    for trials in which a process stands still.
    """

    shape: tuple[int, int, int]
    engine: str
    options: tuple[str, ...] = ()
    at_work_s: float = 1.0
    stalls: Mapping[str, float] | None = None

    def command(self, work: Path, out: Path, number: int = 0) -> list[str]:
        """Write the scene into a directory and return the command."""
        frames, rows, cols = self.shape if self.shape[1] else (1, 5 + number // 40, 5 + number % 40)
        ohm = 500.0 * 10 ** np.random.default_rng(sum(self.shape)).uniform(0, 2, (frames, rows, cols))
        np.save(work / "taxels.npy", ohm)
        late = "comparator_delay = { t_s = 1e-8 }\n" if self.engine == "event" else ""
        text = f'[stimulus]\nkind = "resistance"\nfile = "taxels.npy"\n[run]\nengine = "{self.engine}"\n'
        text += f"[array]\nrows = {rows}\ncols = {cols}\n[effects]\n{late}"
        (work / "scene.toml").write_text(text)
        return ["run", str(work / "scene.toml"), *self.options, "--out", str(out)]


_POOL = {"dermis.processes.pool.STALL_S": 4}
_RTL = {"dermis.engines.rtl.FRAME_LIMIT_S": 4, "dermis.chip.hdl.BUILD_LIMIT_S": 8}
_COSIM = {"dermis.engines.cosim.SLOT_LIMIT_S": 8}
_ICARUS, _VERILATOR, _TWO = ("--simulator", "icarus"), ("--simulator", "verilator"), ("--processes", "2")
SUBJECTS = {
    "closed": Subject((4, 8, 8), "closed"),
    "batch": Subject((400, 16, 16), "event", _TWO, 1.5, _POOL),
    "rtl": Subject((4, 4, 4), "rtl", _ICARUS, 0.4, _RTL),
    "rtl_batch": Subject((6, 4, 4), "rtl", (*_ICARUS, *_TWO), 0.4, _POOL),
    "build": Subject((0, 0, 0), "rtl", _VERILATOR, 5.0, _RTL),
    "cosim": Subject((4, 2, 3), "cosim", (), 2.0, _COSIM),
    "cosim_verilator": Subject((6, 2, 3), "cosim", _VERILATOR, 2.0, _COSIM),
}


@dataclass(frozen=True)
class Trial:
    """A trial: disturbance, subject, what is done, and its number in the list."""

    disturbance: str
    on: str
    what: str
    number: int

    @property
    def name(self) -> str:
        return f"{self.disturbance}.{self.on}.{self.what}.{self.number}"

    @property
    def subject(self) -> Subject:
        return SUBJECTS[self.on]

    def run(self, bench: Bench) -> Found:
        """Disturb a command and judge how it ends."""
        work = bench.place / "trials" / self.name
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        return DISTURBANCES[self.disturbance](self, bench, random.Random(f"{bench.seed} {self.name}"))


def baseline(bench: Bench, name: str) -> np.ndarray | None:
    """Run a subject once undisturbed and return its codes; None where every trial has another scene."""
    if name == "build":
        return None
    place = bench.place / "trials" / f"reference.{name}"
    place.mkdir(parents=True, exist_ok=True)
    with locked(place / "lock"):
        if not (place / "out" / "codes.npy").is_file():
            ended = bench.dermis(SUBJECTS[name].command(place, place / "out"), place).ended()
            if ended is None or ended.code != 0:
                raise RuntimeError(f"{name} does not run undisturbed: {ended}")
    return np.load(place / "out" / "codes.npy")


def earlier(bench: Bench, out: Path) -> None:
    """Put results of an earlier run and a file of the user in a place."""
    baseline(bench, "closed")
    shutil.copytree(bench.place / "trials" / "reference.closed" / "out", out)
    (out / "notes.txt").write_text("of the user\n")


def attempt(
    trial: Trial,
    bench: Bench,
    act: Callable[[Run], set[int]] = lambda run: {0, 2, 3},
    *,
    out: Path | None = None,
    build: Path | None = None,
    arrange: Callable[[Bench, Path], None] = earlier,
    limits: Mapping[str, float] | None = None,
    restore: Callable[[], Any] | None = lambda: None,
    **options: Any,
) -> Found:
    """Start a subject, act on it, judge how it ends, and run it once more undisturbed.

    Parameters
    ----------
    act : disturbs the run, returns the exit codes that are right
    out, build : if they are not those of the trial
    arrange : puts something in the place of OUT; by default results of an earlier run
    limits, options : as for Bench.dermis
    restore : called before the second run; None for no second run
    """
    reference, work = baseline(bench, trial.on), bench.place / "trials" / trial.name
    out = out or work / "out"
    arrange(bench, out)
    before, tables = benches.contents(out), build or bench.place
    run = bench.dermis(trial.subject.command(work, out, trial.number), work, limits, build, **options)
    codes = act(run)
    ended = run.ended()
    faults = run.orphans() + benches.judge_words(ended, codes)
    if ended is not None:
        # Results are there before they are reported on a standard output that fails.
        faults += benches.judge_out(out, before, 0 if "stdout" in options else ended.code, reference)
    for path in tables.glob("*.json"):
        json.loads(path.read_text())  # a half-written table ends the trial as an ERROR
    if restore is not None:
        restore()
        second = bench.dermis(trial.subject.command(work, out, trial.number), work, build=build)
        more = benches.judge_words(second.ended(), {0}) + benches.judge_results(out, reference)
        more += [f"{left} stays" for left in benches.contents(out) if left.startswith(".")]
        more += [f"{path.name} stays" for path in out.parent.glob(f".{out.name}.partial_*")]
        faults += [f"rerun: {fault}" for fault in more + second.orphans()]
    return faults, f"exit {ended.code if ended else 'none'}"


def kill(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Send a signal to a process of a role at a random moment of its life."""
    subject, hit, (wanted, how) = trial.subject, [], trial.what.rsplit("_", 1)
    parent = wanted == "parent"
    limits = subject.stalls if how == "stop" and not parent else None

    def act(run: Run) -> set[int]:
        benches.poll(lambda: run.pids(wanted) or run.poll() is not None, THERE_LIMIT_S)
        time.sleep(draw.uniform(0.0, subject.at_work_s))
        if found := run.pids(wanted):
            hit.extend(pid for pid in [draw.choice(found)] if benches.send(pid, SIGNALS[how]))
        if not hit:  # with short limits a busy machine passes for a hang
            return {0, 3} if limits else {0}
        if parent and how == "stop":
            time.sleep(2.0)
            benches.send(hit[0], signal.SIGCONT)
            return {0}
        if parent:
            return {0, -9} if how == "kill" else {0, 143}
        return {0} if wanted == "watchdog" else {0, 3}

    faults, note = attempt(trial, bench, act, limits=limits)
    return faults, note if hit else "ended before"


def ctrl_c(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Ask a command to end at a random moment: the process alone, its group once, or three times."""
    whom, how = trial.what.split("_")

    def act(run: Run) -> set[int]:
        benches.poll(lambda: len(run.pids()) > 1 or run.poll() is not None, THERE_LIMIT_S)
        time.sleep(draw.uniform(0.0, trial.subject.at_work_s + 1.0))
        for _ in range(3 if whom == "thrice" else 1):
            if whom == "alone":
                benches.send(run.pid, SIGNALS[how])
            elif run.poll() is None:  # as a terminal does
                os.killpg(run.pid, SIGNALS[how])
            time.sleep(0.02)
        return {0, 128 + SIGNALS[how]}

    return attempt(trial, bench, act)


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
    """Run on a disk that is full or read-only: that of OUT, of TMPDIR, or of build/."""
    what, left = trial.what.split("_")
    place, megabytes = bench.place / "trials" / trial.name / "small", 64 if what == "build" else 8
    with small_disk(place, megabytes << 20) as small:
        (small / "tmp").mkdir()

        def arrange(bench: Bench, out: Path) -> None:
            earlier(bench, out)
            if left == "readonly":
                subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True, timeout=20)
            else:
                (small / "filler").write_bytes(bytes(max(0, shutil.disk_usage(small).free - int(left))))

        places = {what: small / what} if what in ("out", "build") else {}
        environment = {"TMPDIR": str(small / "tmp")} if what == "tmpdir" else None
        restore = None if left == "readonly" else (small / "filler").unlink
        return attempt(trial, bench, arrange=arrange, environment=environment, restore=restore, **places)


def stdout(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run with a standard output that is full or closed."""
    if trial.what == "full":
        write = os.open("/dev/full", os.O_WRONLY)
    else:
        read, write = os.pipe()
        os.close(read)
    with open(write, "wb") as out:
        codes = {3} if trial.what == "full" else {1}
        return attempt(trial, bench, lambda run: codes, stdout=out, restore=None)


def limit(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run under a limit of the system: bytes of a file, megabytes of memory, open files."""
    what, size = trial.what.split("_")
    kinds = {"file": resource.RLIMIT_FSIZE, "memory": resource.RLIMIT_AS, "handles": resource.RLIMIT_NOFILE}
    most = int(size) << (20 if what == "memory" else 0)
    return attempt(trial, bench, preexec_fn=partial(resource.setrlimit, kinds[what], (most, most)))


_TOOL = {
    "failing": "#!/bin/sh\necho 'no licence' >&2\nexit 1\n",
    "garbage": "#!/bin/sh\nhead -c 3000 /dev/urandom\nexit 0\n",
    "hanging": "#!/bin/sh\nsleep 1000 & sleep 1000\n",
}


def tool(trial: Trial, bench: Bench, draw: random.Random) -> Found:
    """Run with a tool that is missing, fails, hangs or says the wrong thing."""
    (which, how), shims = trial.what.split("_"), bench.place / "trials" / trial.name / "bin"
    shims.mkdir()
    for directory in ("/usr/local/bin", "/usr/bin", "/bin"):
        for entry in Path(directory).iterdir():
            if entry.name != which and not (shims / entry.name).is_symlink():
                (shims / entry.name).symlink_to(entry)
    if how != "missing":
        (shims / which).write_text(_TOOL[how])
        (shims / which).chmod(0o755)
    limits = {"dermis.report.output.TOOL_LIMIT_S": 2, "dermis.lockstep.ngspice.COMPILE_LIMIT_S": 3}
    path = {"PATH": f"{shims}:{Path(sys.executable).parent}"}
    # A build needs the tool; other commands may not.
    codes = {2, 3} if trial.subject is SUBJECTS["build"] else {0, 2, 3}
    limits |= trial.subject.stalls or {}
    return attempt(trial, bench, lambda run: codes, limits=limits, environment=path)


DISTURBANCES = {function.__name__: function for function in (kill, ctrl_c, disk, stdout, limit, tool)}

TRIALS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def every() -> list[Trial]:
    """Return the trials of the table, in its order."""
    trials: list[Trial] = []
    for disturbance, subjects in TRIALS.items():
        for subject, words in subjects.items():
            for what, _, times in (word.partition("*") for word in words.split()):
                for _ in range(int(times or 1)):
                    trials.append(Trial(disturbance, subject, what, len(trials) + 1))
    return trials
