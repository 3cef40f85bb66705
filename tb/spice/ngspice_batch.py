# SPDX-License-Identifier: Apache-2.0
"""Runs a bench of spice/bench through ngspice in batch mode and returns what it measured, or says why not."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dermis.design import ROOT
from dermis.errors import InputError, SimulatorError

SPICE = ROOT / "spice"
SECTIONS = ("include", "options", "parameters", "stimulus", "dut", "measure", "control")

_MEAS = re.compile(r"^\.meas\s+(\w+)\s+(\w+)\s.*$", re.MULTILINE | re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_RESULT = re.compile(rf"^(\w+)\s*=\s+({_NUMBER})\b", re.MULTILINE | re.IGNORECASE)
_ABORT = re.compile(
    r"^.*(?:timestep too small|no convergence|simulation\(s\) aborted|analysis failed|iteration limit).*$",
    re.MULTILINE | re.IGNORECASE,
)
_ERROR = re.compile(
    r"^.*(?:\berror\b|fatal|singular matrix|unknown subckt|no such|undefined).*$",
    re.MULTILINE | re.IGNORECASE,
)


@dataclass(frozen=True)
class Bench:
    """One bench, with what a test changes about it.

    Attributes
    ----------
    name : file name in spice/bench without its suffix.
    dut : parameters for every instance named ``xdut...``; one that the bench itself sets there stays as it is.
    params : values for the bench's own ``.param`` lines.
    edits : {path below spice/: ((old, new), ...)}, netlist faults; each `old` must occur exactly once.
    options : text for one more ``.options`` line after the bench's own.
    """

    name: str
    dut: Mapping[str, float] = field(default_factory=dict)
    params: Mapping[str, float] = field(default_factory=dict)
    edits: Mapping[str, Sequence[tuple[str, str]]] = field(default_factory=dict)
    options: str = ""

    def write(self, folder: Path) -> Path:
        """Copy spice/ to `folder`, apply the changes there and return the deck."""
        shutil.copytree(SPICE, folder, dirs_exist_ok=True)
        for path, pairs in self.edits.items():
            text = (folder / path).read_text()
            for old, new in pairs:
                if text.count(old) != 1:
                    raise ValueError(f"{path}: {old!r} occurs {text.count(old)} times, not once")
                text = text.replace(old, new)
            (folder / path).write_text(text)
        deck = folder / "bench" / f"{self.name}.sp"
        deck.write_text(self._changed(deck.read_text()))
        return deck

    def _changed(self, text: str) -> str:
        for key, value in self.params.items():
            text, count = re.subn(rf"(?m)^\.param {key} = .*$", f".param {key} = {value!r}", text)
            if count != 1:
                raise ValueError(f"{self.name}: {count} lines .param {key}")
        out: list[str] = []
        lines = text.splitlines()
        found = not self.dut
        for i, line in enumerate(lines):
            if self.options and line.startswith("* parameters"):
                out.append(f".options {self.options}")
            out.append(line)
            if line.startswith("xdut") and self.dut:
                j = i + 1
                while lines[j].startswith("+"):
                    j += 1
                have = set(re.findall(r"(\w+)\s*=", " ".join(lines[i:j])))
                out += [f"+ {k}={v!r}" for k, v in self.dut.items() if k not in have]
                found = True
        if not found:
            raise ValueError(f"{self.name}: no instance xdut")
        return "\n".join(out) + "\n"


def run(deck: Path, limit_s: float = 60.0) -> dict[str, float]:
    """Run a deck and return ``{name: value}`` for every ``.meas`` in it.

    Parameters
    ----------
    deck : Path
        Its folder receives what is run, ``<name>.run.sp``, and the log, ``<name>.log``.
    limit_s : float
        Wall-clock limit.

    Raises
    ------
    InputError
        No ngspice on the path.
    SimulatorError
        ngspice stopped, took too long, or did not measure something. It exits with 0 nearly always, so every name
        that the deck measures must come back as a finite number.
    """
    tool = shutil.which("ngspice")
    if tool is None:
        raise InputError("PATH", "ngspice", "missing", "ngspice 39 or later; `make setup` installs it")
    log = deck.with_suffix(".log")
    text = deck.read_text()
    wanted = [name.lower() for _, name in _MEAS.findall(text)]
    # ngspice prints 7 digits of what it finds, whatever it is asked; of a formula it prints as many as asked.
    text = _MEAS.sub(r"\g<0>\n.meas \1 full_\2 param='\2'", text)
    work = deck.with_suffix(".run.sp")
    work.write_text(text)
    environment = {**os.environ, "NGSPICE_MEAS_PRECISION": "15"}
    with log.open("w") as out:
        process = subprocess.Popen(
            [tool, "-b", work.name],
            cwd=deck.parent,
            stdout=out,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            raise SimulatorError(f"ngspice, {deck.stem}: not done after {limit_s:g} s", log) from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    text = log.read_text(errors="replace")
    if process.returncode < 0:
        raise SimulatorError(f"ngspice, {deck.stem}: ended by signal {-process.returncode}", log)
    if abort := _ABORT.search(text):
        raise SimulatorError(f"ngspice, {deck.stem}: {_trouble(text, abort[0])}", log)
    values = {name.lower(): float(value) for name, value in _RESULT.findall(text)}
    missing = [n for n in wanted if not (math.isfinite(values.get(n, math.nan)) and f"full_{n}" in values)]
    if missing:
        error = _ERROR.search(text)
        why = f": {error[0].strip()}" if error else ""
        raise SimulatorError(f"ngspice, {deck.stem}: did not measure {', '.join(missing)}{why}", log)
    if process.returncode:
        raise SimulatorError(f"ngspice, {deck.stem}: exit code {process.returncode}", log)
    return {name: values[f"full_{name}"] for name in wanted}


def _trouble(text: str, complaint: str) -> str:
    """Return ngspice's complaint with the time and the node it names, which may stand on other lines."""
    parts = [complaint.strip()]
    for pattern in (r"time\s*=\s*[\d.e+-]+", r"trouble with [^\n;]+"):
        found = re.search(pattern, text, re.IGNORECASE)
        if found and found[0] not in parts[0]:
            parts.append(found[0].strip())
    return "; ".join(parts)
