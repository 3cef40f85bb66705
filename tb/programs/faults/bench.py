# SPDX-License-Identifier: Apache-2.0
"""Where commands fail: a copy of the tree, commands started in it, and what may be wrong with how one ended."""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dermis.processes import children, watchdog
from dermis.report import output
from dermis.scene.design import ROOT

END_LIMIT_S = 240.0
"""A command that has not ended by then hangs: the longest takes 15 s on an idle core."""

GONE_LIMIT_S = 30.0
"""As long may what a command started outlive it: the watchdog needs milliseconds, on a loaded machine seconds."""

PARTS = ("models", "rtl", "spice")
"""What of the tree commands need; results and builds go to the copy's own build/."""


@dataclass
class Ended:
    """A command that has ended: its exit code, and what it said."""

    code: int
    out: str
    error: str


class Run:
    """A command that was started in a tree.

    Parameters
    ----------
    command : what is run
    tree : the tree that it belongs to, and its working directory
    work : directory for what it says
    environment : variables beside those of this process
    options : as for subprocess.Popen
    """

    def __init__(
        self,
        command: Sequence[str],
        tree: Path,
        work: Path,
        environment: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        token = secrets.token_hex(6)
        self.said = work / f"{token}.out", work / f"{token}.err"
        variables = {"PYTHONPATH": str(tree / "models"), **(environment or {})}
        with self.said[0].open("wb") as out, self.said[1].open("wb") as error:
            where = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": error}
            self.child = children.Child(command, variables, cwd=tree, **(where | options))

    def processes(self) -> list[int]:
        """What it is and what it started, in whatever session and whoever its parent is now, its watchdogs included."""
        return sorted(pid for pid, _ in watchdog.marked(self.child.mark))

    def wait(self, limit_s: float = END_LIMIT_S) -> Ended | None:
        """Wait for its end; None if it hangs, and then end it."""
        try:
            code = self.child.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.end()
            return None
        out, error = (path.read_text(errors="replace") for path in self.said)
        return Ended(code, out, error)

    def orphans(self, within_s: float = GONE_LIMIT_S) -> list[str]:
        """What is left after its end, ended here."""
        last = time.monotonic() + within_s
        while (left := self.processes()) and time.monotonic() < last:
            time.sleep(0.02)
        names = [role(pid) for pid in left]
        self.end()
        return names

    def end(self) -> None:
        """End it and all it started."""
        self.child.end()


def role(pid: int) -> str:
    """What a process of a command is, by its command line."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return "gone"
    text = " ".join(words)
    for name, sign in ROLES.items():
        if re.search(sign, text):
            return name
    return Path(words[0]).name or "forked"


ROLES = {
    "watchdog": r"watchdog\.py",
    "cosim_child": r"dermis\.engines\.cosim_hdl",
    "hdl_simulator": r"(^|/)vvp\b|/Vdermis_top|/Vskin|/Vtop\b",
    "worker": r"-m dermis\.pool|-m dermis\.workers|multiprocessing\.spawn|multiprocessing-fork",
    "dask_scheduler": r"dask_scheduler",
    "dask_worker": r"dask_worker",
    "compiler": r"verilator_bin|cc1plus|g\+\+|/make |^make |iverilog|ivlpp|/ivl\b|collect2|/ld\b|/as\b",
    "yosys": r"yosys|abc",
    "ngspice": r"(^|/)ngspice\b",
    "sta": r"(^|/)sta\b",
    "parent": r"-m dermis\b|dermis\.faults\.launch|bin/dermis",
}


@dataclass
class Bench:
    """A tree for trials.

    Attributes
    ----------
    tree : copy of the project's sources, with its own build/
    seed : of everything that a trial draws
    """

    tree: Path
    seed: int = 0
    references: dict[str, np.ndarray] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)
    running: list[Run] = field(default_factory=list)
    ended: bool = False

    def copy(self) -> None:
        """Bring the sources over; builds of an earlier copy stay where their content is the same."""
        self.tree.mkdir(parents=True, exist_ok=True)
        for part in PARTS:
            shutil.rmtree(self.tree / part, ignore_errors=True)
            ignore = shutil.ignore_patterns("__pycache__", ".*")
            shutil.copytree(ROOT / part, self.tree / part, ignore=ignore)

    def forget_builds(self) -> None:
        """Take builds of another run away: a trial that disturbs one would find it done."""
        shutil.rmtree(self.tree / "build" / "models", ignore_errors=True)

    def end(self) -> None:
        """End every command that is running in it, and start no more."""
        self.ended = True
        for run in list(self.running):
            run.end()

    def random(self, name: str) -> random.Random:
        """Numbers of a trial, whatever other trials draw."""
        return random.Random(hashlib.sha256(f"{self.seed} {name}".encode()).digest())

    def work(self, name: str) -> Path:
        """An empty directory for a trial."""
        work = self.tree / "trials" / name
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        return work

    def dermis(
        self, arguments: Sequence[str], work: Path, changes: Sequence[str] = (), **options: Any
    ) -> Run:
        """Start the command line, with changes of tb.programs.faults.launch."""
        head = [sys.executable, "-m", "dermis"]
        if changes:
            head = [sys.executable, "-m", "tb.programs.faults.launch", *changes, "--"]
        return self.start([*head, *arguments], work, **options)

    def start(self, command: Sequence[str], work: Path, **options: Any) -> Run:
        """Start any command in the tree."""
        run = Run(command, self.tree, work, **options)
        self.running.append(run)
        if self.ended:
            run.end()
        return run


# ---- the judge --------------------------------------------------------------------------------------------------

_PROGRESS = re.compile(r"[\w.,\- ]+: (\d+ of \d+ [\w ]+|.* \.\.\.)")
_BAD_WORDS = re.compile(
    r"Traceback \(most recent call last\)|Exception ignored|resource_tracker|Fatal Python error|"
    r"Segmentation fault|has a defect|Exception in thread|was never awaited"
)


def contents(directory: Path) -> dict[str, str]:
    """Digest of every file below a directory, by name; empty where there is none."""
    if not directory.is_dir():
        return {}
    return {
        str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }


def judge_words(ended: Ended, code_is: Iterable[int]) -> list[str]:
    """What is wrong with an exit code and with what was said.

    Parameters
    ----------
    ended : the command
    code_is : exit codes that are right
    """
    faults = []
    if ended.code not in code_is:
        faults.append(f"exit code {ended.code}, not {' or '.join(map(str, sorted(code_is)))}")
    if bad := _BAD_WORDS.search(ended.error + ended.out):
        faults.append(f"says {bad.group()!r}")
    lines = [
        line for line in ended.error.splitlines() if line.strip() and not _PROGRESS.fullmatch(line.strip())
    ]
    # A killed command says nothing; one that was interrupted, stopped by a simulator or refuses says one line.
    wanted = {0: 0, 1: 0}.get(ended.code, 0 if ended.code < 0 else 1)
    if len(lines) != wanted:
        faults.append(f"{len(lines)} lines on standard error in place of {wanted}: {' | '.join(lines)[:160]}")
    return faults


def judge_out(out: Path, before: Mapping[str, str], ended: Ended, reference: np.ndarray | None) -> list[str]:
    """What is wrong with a directory of results: it has all of a run, or what it had before.

    Parameters
    ----------
    out : the directory
    before : its contents before the run
    ended : the run
    reference : codes of an undisturbed run, or None where codes are not looked at
    """
    now = contents(out)
    hidden = [name for name in now if name.startswith(".")]
    if not hidden and now == dict(before) and ended.code != 0:
        return []
    # Asked to end while it put its results in place, a command first has all of them there.
    if ended.code not in (0, 1, 129, 130, 143) and ended.code >= 0:
        changed = sorted(name for name in {*now, *before} if now.get(name) != before.get(name))
        return [f"exit code {ended.code}, and {', '.join(changed)[:120]} changed"]
    # Killed outright it may have left what it was writing, by a hidden name, but nothing in the place of results.
    seen = {name: digest for name, digest in now.items() if name not in hidden}
    if ended.code < 0 and seen == dict(before):
        return []
    return judge_results(out, reference) + ([f"leaves {hidden[0]}"] if hidden and ended.code >= 0 else [])


def judge_results(out: Path, reference: np.ndarray | None) -> list[str]:
    """What is wrong with a whole set of results."""
    faults = [f"{name} is missing" for name in output.ALWAYS if not (out / name).is_file()]
    if faults:
        return faults
    try:
        codes = np.load(out / "codes.npy")
        json.loads((out / "summary.json").read_text())
        lines = (out / "codes.csv").read_text().splitlines()
    except (ValueError, OSError) as error:
        return [f"half-written: {error}"]
    if len(lines) != 1 + codes.shape[0] * codes.shape[1]:
        faults.append("codes.csv and codes.npy are not of one run")
    if reference is not None and not np.array_equal(codes, reference):
        faults.append("codes differ from those of an undisturbed run")
    return faults


def judge_tables(tree: Path) -> list[str]:
    """What is wrong with the tables in build/."""
    faults = []
    for path in (tree / "build").glob("*.json"):
        try:
            json.loads(path.read_text())
        except ValueError:
            faults.append(f"{path.name} is half-written")
        except OSError:  # replaced meanwhile by another command
            continue
    return faults


def poll(what: Callable[[], Any], limit_s: float, step_s: float = 0.01) -> Any:
    """What a function gives, once it gives something; None if it does not within a limit."""
    last = time.monotonic() + limit_s
    while time.monotonic() < last:
        if found := what():
            return found
        time.sleep(step_s)
    return None


def send(pid: int, number: signal.Signals) -> bool:
    """Send a signal; whether the process was there."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True
