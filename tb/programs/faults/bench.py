# SPDX-License-Identifier: Apache-2.0
"""Commands with a build/ of their own, and the judge of how a disturbed command ends."""

import json
import os
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dermis.processes import children, watchdog
from dermis.report import output
from scripts import workers

END_LIMIT_S = 240.0
"""A command that has not ended by then hangs; the longest takes 15 s on an idle core."""

GONE_LIMIT_S = 30.0
"""Processes of a command may outlive it by this time on a loaded machine; the watchdog needs milliseconds."""

ROLES = {
    "watchdog": r"watchdog\.py",
    "hdl_simulator": r"(^|/)vvp\b|/Vdermis_top|/Vskin|/Vtop\b",
    "worker": r"-m dermis\.processes\.pool",
    "compiler": r"verilator_bin|cc1plus|g\+\+|/make |^make |iverilog|ivlpp|/ivl\b|collect2|/ld\b|/as\b",
    "parent": r"dermis\.__main__",
}


@dataclass
class Ended:
    code: int
    out: str
    error: str


class Run(children.Child):
    """A command that was started in a directory; its output goes to files there."""

    def __init__(self, command: Sequence[str], work: Path, **options: Any) -> None:
        token = secrets.token_hex(6)
        self.said = work / f"{token}.out", work / f"{token}.err"
        for number in children.SIGNALS:  # a shell ignores SIGINT for background commands, nohup SIGHUP
            if signal.getsignal(number) is signal.SIG_IGN:
                signal.signal(number, lambda *_: None)  # no handler outlives exec
        with self.said[0].open("wb") as out, self.said[1].open("wb") as error:
            options = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": error} | options
            super().__init__(command, cwd=work, **options)

    def pids(self, wanted: str = "") -> list[int]:
        """Return the command and everything it started, its watchdogs too, or those of a role."""
        found = sorted(pid for pid, _ in watchdog.marked(self.mark))
        return [pid for pid in found if not wanted or role(pid) == wanted]

    def ended(self) -> Ended | None:
        """Wait for the end; None if it hangs."""
        try:
            code = self.wait(END_LIMIT_S * workers.busy())
        except subprocess.TimeoutExpired:
            self.end()
            return None
        return Ended(code, *(path.read_text(errors="replace") for path in self.said))

    def orphans(self, within_s: float = GONE_LIMIT_S) -> list[str]:
        """Return a fault if processes outlive the command, and end them."""
        poll(lambda: not self.pids(), within_s)
        names = [role(pid) for pid in self.pids()]
        self.end()
        return [f"leaves {', '.join(names)[:120]}"] if names else []


def role(pid: int) -> str:
    """Return the role of a process by its command line."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return "gone"
    found = (name for name, sign in ROLES.items() if re.search(sign, " ".join(words)))
    return next(found, Path(words[0]).name or "forked")


@dataclass(frozen=True)
class Bench:
    """A directory of trials, their builds, and the seed of random moments."""

    place: Path
    seed: int = 0

    def dermis(
        self,
        words: Sequence[str],
        work: Path,
        limits: Mapping[str, float] | None = None,
        build: Path | None = None,
        **options: Any,
    ) -> Run:
        """Start the command line with its own build/; `limits` sets values of modules."""
        start = f"import dermis.places, pathlib; dermis.places.BUILD = pathlib.Path({str(build or self.place)!r})\n"
        for name, value in (limits or {}).items():
            start += f"import {name.rpartition('.')[0]}; {name} = {value}\n"
        start += "import dermis.__main__; dermis.__main__.main()"
        return Run([sys.executable, "-c", start, *words], work, **options)


# ---- the judge: each function returns faults in words

_PROGRESS = re.compile(r"[\w.,\- ]+: (\d+ of \d+ [\w ]+|.* \.\.\.)")
_BAD_WORDS = re.compile(
    r"Traceback \(most recent call last\)|Exception ignored|resource_tracker|Fatal Python error|"
    r"Segmentation fault|has a defect|Exception in thread|was never awaited"
)


def contents(directory: Path) -> dict[str, bytes]:
    """Return the bytes of every file below a directory."""
    files = sorted(path for path in directory.rglob("*") if path.is_file()) if directory.is_dir() else []
    return {str(p.relative_to(directory)): p.read_bytes() for p in files}


def judge_words(ended: Ended | None, codes: Collection[int]) -> list[str]:
    """Judge exit code and output: one line on standard error, none for codes 0 and 1, no traceback."""
    if ended is None:
        return ["hangs"]
    faults = []
    if ended.code not in codes:
        faults.append(f"exit code {ended.code}, not {' or '.join(map(str, sorted(codes)))}")
    if bad := _BAD_WORDS.search(ended.error + ended.out):
        faults.append(f"says {bad.group()!r}")
    said = [line.strip() for line in ended.error.splitlines()]
    lines = [line for line in said if line and not _PROGRESS.fullmatch(line)]
    wanted = 0 if ended.code in (0, 1) or ended.code < 0 else 1
    if len(lines) != wanted:
        faults.append(f"{len(lines)} lines on standard error instead of {wanted}: {' | '.join(lines)[:160]}")
    return faults


def judge_out(out: Path, before: Mapping[str, bytes], code: int, reference: np.ndarray | None) -> list[str]:
    """Judge OUT: a whole new set of results, or its contents before the run."""
    now = contents(out)
    hidden = [name for name in now if name.startswith(".")]
    if not hidden and now == dict(before) and code != 0:
        return []
    # A command that is asked to end while it moves its results into place finishes that first.
    if code not in (0, 1, 129, 130, 143) and code >= 0:
        changed = sorted(name for name in {*now, *before} if now.get(name) != before.get(name))
        return [f"exit code {code}, and {', '.join(changed)[:120]} changed"]
    # A killed command may leave hidden files.
    if code < 0 and {name: now[name] for name in now if name not in hidden} == dict(before):
        return []
    lost = [f"{name} of the user is gone" for name in {"notes.txt"} & before.keys() - now.keys()]
    return judge_results(out, reference) + lost + [f"leaves {n}" for n in hidden[:1] if code >= 0]


def judge_results(out: Path, reference: np.ndarray | None) -> list[str]:
    """Judge a whole set of results, with codes of an undisturbed run if they are known."""
    if missing := [f"{name} is missing" for name in output.ALWAYS if not (out / name).is_file()]:
        return missing
    try:
        codes = np.load(out / "codes.npy")
        json.loads((out / "summary.json").read_text())
        lines = (out / "codes.csv").read_text().splitlines()
    except (ValueError, OSError) as error:
        return [f"half-written: {error}"]
    faults = []
    if len(lines) != 1 + codes.shape[0] * codes.shape[1]:
        faults.append("codes.csv and codes.npy are of different runs")
    if reference is not None and not np.array_equal(codes, reference):
        faults.append("codes differ from those of an undisturbed run")
    return faults


def poll(what: Callable[[], Any], limit_s: float, step_s: float = 0.02) -> Any:
    """Return the first true value of a function, None at the limit."""
    last = time.monotonic() + limit_s
    while time.monotonic() < last:
        if found := what():
            return found
        time.sleep(step_s)
    return None


def send(pid: int, number: signal.Signals) -> bool:
    """Send a signal; False if the process is gone."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True
