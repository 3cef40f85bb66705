# SPDX-License-Identifier: Apache-2.0
"""Batch runs of ngspice: a time limit, the retry ladder, and a finite number or an error for every `.meas`.

The exit code of ngspice is no evidence: it is 0 when a `.meas` fails, and when a transient stops
early and its measurements look plausible.
"""

import functools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dermis.errors import SimulatorError, tool_path
from dermis.lockstep import ladder, netlist_faults
from dermis.processes.children import output_of, run_child

_TOOL = "ngspice", "ngspice 39 or later"
_MEAS = re.compile(r"^\.meas\s+(\w+)\s+(\w+)\s.*$", re.MULTILINE | re.IGNORECASE)
_PRINT = re.compile(r"^print\s+(\w+)\s*$", re.MULTILINE | re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_RESULT = re.compile(rf"^(\w+)\s*=\s+({_NUMBER})\b", re.MULTILINE | re.IGNORECASE)
_ABORT = re.compile(
    r"^.*(?:timestep too small|no convergence|simulation\(s\) aborted|analysis failed|iteration limit|"
    r"matrix is singular).*$",
    re.MULTILINE | re.IGNORECASE,
)
_ERROR = re.compile(
    r"^.*(?:\berror\b|fatal|singular matrix|unknown subckt|no such|undefined|out of interval).*$",
    re.MULTILINE | re.IGNORECASE,
)
# The check of ngspice against the v.._max of a model (`.options warn=1`): a line for each device, pair and step.
_EXCEEDED = re.compile(
    rf"^Instance: (\S+) Model: \S+(?: Time: ({_NUMBER}))? \|?(V\w+)\|?=({_NUMBER}) has exceeded \w+=({_NUMBER}).*\n",
    re.MULTILINE,
)
_SPARE_V = 0.11
"""A stretch this little beyond a limit has no time: 0.12 V of a class, 10 mV of them in its models."""
# A resistor that is always beyond its limit: its line, the last one of a step, ends the step. Time has six digits,
# 0.1 us of 20 ms; the volts have the time within 10 us, to 0.1 ns.
_STEP, _PERIOD_S = "r_every_step", 1e-5
_STEPS = (
    ".model every_step r bv_max=0.1",
    f"b_every_step every_step 0 v=1+time/{_PERIOD_S}-floor(time/{_PERIOD_S})",
    f"{_STEP} every_step 0 every_step 1k",
)
_CHECKED = re.compile(r"^\.options .*\bwarn=1\b", re.MULTILINE)
_TIME = re.compile(rf"time\s*=\s*({_NUMBER})", re.IGNORECASE)
# ngspice takes two OpenMP threads for transistors and ignores OMP_NUM_THREADS. On a busy machine they wait for each
# other by spinning, and a deck takes ten times as long.
_ENVIRONMENT = {"NGSPICE_MEAS_PRECISION": "15", "OMP_THREAD_LIMIT": "1"}
_SECTION = re.compile(r"^\s*\.(?:control|end)\b", re.MULTILINE | re.IGNORECASE)
_GUESSED = re.compile(r"^\t(\d+)\t(\S+)\tvoltage", re.MULTILINE)


@dataclass(frozen=True)
class Measured:
    """Results of a deck: of each `.meas` by its name in lower case, and failed attempts before (docs/ladder.md)."""

    values: Mapping[str, float]
    retries: tuple[ladder.Retry, ...]
    exceeded: Mapping[str, tuple[float, float]]
    """Device and pair of terminals that went beyond a v.._max of its model -> largest volts, longest seconds more
    than _SPARE_V beyond (inf where it stands)."""


@functools.cache
def version() -> str:
    """Return the version of ngspice, "unknown" if it prints none."""
    said = output_of([tool_path(*_TOOL), "--version"], 20.0)[1]
    found = re.search(r"ngspice-([\w.]+)", said)
    return found[1] if found else "unknown"


def run(deck: Path, limit_s: float = 60.0, level: ladder.Level = ladder.PLAIN) -> Measured:
    """Run a deck and return each `.meas`, and each `print name` of its control section.

    Parameters
    ----------
    deck : its folder receives the deck as run, ``<name>.run.sp``, and the log, ``<name>.log``
    limit_s : wall-clock limit of every attempt
    level : first rung of the ladder, higher where the lower rungs are known to fail

    InputError without ngspice on the path, or for two subcircuits of one name; SimulatorError if it stopped on every
    rung, took too long, or a measurement is missing.
    """
    tool = tool_path(*_TOOL)
    rungs = ladder.Climb(deck.stem, level)
    values, exceeded = ladder.climb(lambda level: _attempt(tool, deck, limit_s, level), rungs)
    return Measured(values, tuple(rungs.retries), exceeded)


def _exceeded(said: str) -> dict[str, tuple[float, float]]:
    """Return what `Measured.exceeded` has, from the lines of ngspice's check."""
    found: dict[str, tuple[float, float]] = {}
    began: dict[str, float] = {}  # device and pair -> begin of its violation, while that lasts
    beyond: set[str] = set()  # devices and pairs in violation at this step
    for device, said_time, pair, volts, limit in _EXCEEDED.findall(said):
        if device == _STEP:
            fine = (abs(float(volts)) - 1.0) * _PERIOD_S
            time = fine + _PERIOD_S * round((float(said_time or 0.0) - fine) / _PERIOD_S)
            began = {name: began.get(name, time) for name in beyond}
            for name, begin in began.items():
                most, longest = found[name]
                # A violation of the operating point has no end.
                found[name] = most, max(longest, time - begin if begin else math.inf)
            beyond = set()
            continue
        name, size = f"{device} {pair}", abs(float(volts))
        most, longest = found.get(name, (0.0, 0.0))
        found[name] = max(most, size), longest
        if size > float(limit) + _SPARE_V:
            beyond.add(name)
    return found


def _attempt(
    tool: str, deck: Path, limit_s: float, level: ladder.Level
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    log = deck.with_suffix(".log")
    text = deck.read_text()
    wanted = [name.lower() for _, name in _MEAS.findall(text)]
    printed = [name.lower() for name in _PRINT.findall(text)]
    # ngspice prints 7 digits of a measurement; of a formula it prints NGSPICE_MEAS_PRECISION digits.
    text = _MEAS.sub(r"\g<0>\n.meas \1 full_\2 param='\2'", text)
    start, extra = ladder.START[level.start], list(level.option_lines)
    extra += _STEPS if _CHECKED.search(text) else ()
    if start.guess:
        extra += _guess(tool, deck, text, extra, limit_s)
        start = ladder.START[0]
    said, code = _ngspice(tool, deck, _with(text, extra, [start.optran]), limit_s)
    netlist_faults.refuse_redefinition(said)
    exceeded, said = _exceeded(said), _EXCEEDED.sub("", said)
    if found := _ABORT.search(said):
        time = _TIME.search(said)
        steps = time is not None or "initial timepoint" in said
        at, phase = float(time[1]) if time else 0.0, "steps" if steps else "start"
        raise ladder.Abort(phase, _trouble(said, found[0]), at, ladder.node_of(said), log)
    values = {name.lower(): float(value) for name, value in _RESULT.findall(said)}
    missing = [n for n in wanted if not (math.isfinite(values.get(n, math.nan)) and f"full_{n}" in values)]
    missing += [n for n in printed if not math.isfinite(values.get(n, math.nan))]
    if missing:
        error = _ERROR.search(said)
        why = f": {error[0].strip()}" if error else ""
        raise SimulatorError(f"ngspice, {deck.stem}: did not measure {', '.join(missing)}{why}", log)
    if code:
        raise SimulatorError(f"ngspice, {deck.stem}: exit code {code}", log)
    found = {name: values[f"full_{name}"] for name in wanted} | {name: values[name] for name in printed}
    return found, exceeded


def _ngspice(tool: str, deck: Path, text: str, limit_s: float) -> tuple[str, int]:
    """Run a text in the folder of a deck; return the output of ngspice and its exit code."""
    log, work = deck.with_suffix(".log"), deck.with_suffix(".run.sp")
    work.write_text(text)
    log.unlink(missing_ok=True)
    code = run_child([tool, "-b", work.name], deck.parent, log, limit_s, _ENVIRONMENT)
    said = log.read_text(errors="replace")
    if code is None:
        raise SimulatorError(f"ngspice, {deck.stem}: not done after {limit_s:g} s", log)
    if code < 0:
        raise SimulatorError(f"ngspice, {deck.stem}: ended by signal {-code}", log)
    return said, code


def _with(text: str, lines: list[str], commands: list[str]) -> str:
    """Put lines after those of a deck, and commands before those of its control section."""
    found = _SECTION.search(text)
    at = found.start() if found else len(text)
    block = "\n".join([*lines, ".control", *commands, ".endc", ""])
    return text[:at] + block + text[at:]


def _guess(tool: str, deck: Path, text: str, extra: list[str], limit_s: float) -> list[str]:
    """Return nodesets from the end of a hidden transient, which Newton's method has to confirm."""
    raw = deck.with_suffix(".guess")
    raw.unlink(missing_ok=True)
    ramp = next(rung for rung in ladder.START if rung.guess)
    commands = [ramp.optran, "op", "set filetype=ascii", f"write {raw.name}", "quit"]
    _ngspice(tool, deck, _with(text, extra, commands), limit_s)
    if not raw.exists():
        return []
    head, _, table = raw.read_text().partition("Values:\n")
    numbers = table.split()[1:]
    return [
        f".nodeset {name if name.startswith('v(') else f'v({name})'}={numbers[int(index)]}"
        for index, name in _GUESSED.findall(head)
    ]


def _trouble(text: str, complaint: str) -> str:
    """Return the complaint of ngspice with its time and node."""
    parts = [complaint.strip()]
    for pattern in (r"time\s*=\s*[\d.e+-]+", r"trouble with [^\n;]+", r"singular matrix:[^\n]+"):
        found = re.search(pattern, text, re.IGNORECASE)
        if found and found[0] not in parts[0]:
            parts.append(found[0].strip())
    return "; ".join(parts)
