# SPDX-License-Identifier: Apache-2.0
"""Mutation testing of the Verilog: proofs or tests must notice each small change of a module.

Mutants are changes of source text, not of a netlist: they keep the parameters, so that tests run
them at every size, and a survivor is easy to read.
"""

import hashlib
import random
import re
import shutil
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import click

from dermis.chip import hdl
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.places import BUILD, ROOT
from dermis.processes import children
from dermis.report import progress, verdict
from scripts import formal, markdown, templates
from scripts.checkpoint import Checkpoint
from scripts.judged import SHOW, digest, finish

SAMPLE = 12
"""Default number of mutants per module."""
# Time limit of the tests on a mutant: a multiple of that on the unchanged module, and a minimum.
TEST_TIMES, TEST_LEAST_S = 5.0, 30.0
CONTROL_LIMIT_S = 300.0
COMPILE_LIMIT_S = 60.0
SEARCH_LIMIT_S = 20
EQUAL_LIMIT_S = 40


@dataclass(frozen=True)
class Block:
    """Proofs and tests that must notice a fault in one module."""

    proofs: tuple[str, ...] = ()  # names of rtl/formal/*.sby
    tests: tuple[str, ...] = ()  # folders of tb/rtl
    parameters: Mapping[str, int] = field(default_factory=dict)  # sizes of the equivalence check
    clocked: bool = True  # False: combinational
    multiclock: bool = False  # both edges or several clocks
    tests_first: bool = False  # quicker than the proofs
    short: bool = False  # without the long tests


BLOCKS: Mapping[str, Block] = {
    name: Block(**entry)
    for name, entry in tomllib.loads((ROOT / formal.PLACE / "mutants.toml").read_text()).items()
}


def below(module: str, rtl: Path) -> list[str]:
    """Return the modules of a hierarchy below a module."""
    found: list[str] = []
    for name in re.findall(r"^\s*(dermis_\w+)\s", (rtl / f"{module}.v").read_text(), re.MULTILINE):
        # The top names a rule that a parameter breaks by a module that does not exist.
        if name not in found and (rtl / f"{name}.v").is_file():
            found += [name, *(other for other in below(name, rtl) if other not in found)]
    return found


@dataclass(frozen=True)
class Mutant:
    """One change in one place."""

    key: str  # hash of module text and change, which ties a result to a source
    module: str
    line: int
    what: str  # kind of change
    start: int
    end: int  # characters replaced by `new`
    new: str
    shown: str  # the line before and after

    def apply(self, text: str) -> str:
        return text[: self.start] + self.new + text[self.end :]


_BRACKETS = r"\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\)"
# (kind, pattern, replacement of group 1, where {n} is group n); the sources have spaces around operators.
_CHANGES: Sequence[tuple[str, str, str]] = (
    ("== to !=", r"( == )", " != "),
    ("!= to ==", r"( != )", " == "),
    ("&& to ||", r"( && )", " || "),
    ("|| to &&", r"( \|\| )", " && "),
    ("& to |", r"(?<=[\w\]\)}])( & )(?=[~\w({!])", " | "),
    ("| to &", r"(?<=[\w\]\)}])( \| )(?=[~\w({!])", " & "),
    ("^ to |", r"( \^ )", " | "),
    ("+ to -", r"(?<=[\w\]\)}])( \+ )(?!:)", " - "),
    ("- to +", r"(?<=[\w\]\)}])( - )", " + "),
    ("< to >=", r"(?<=[\w\]\)}])( < )(?=[\w{(])", " >= "),
    ("> to <=", r"(?<=[\w\]\)}])( > )(?=[\w{(])", " <= "),
    ("not left out", r"(~)(?=[\w(&|{])", ""),
    ("not left out", r"(!)(?=[\w(&])(?!rst_ni)", ""),
    ("0 to 1", r"\b(1'[bd]0)\b", "1'b1"),
    ("1 to 0", r"\b(1'[bd]1)\b", "1'b0"),
    ("pin to 0", r"\.\w+_n?i\s*\((\w+)\)", "1'b0"),
    ("pin negated", r"\.(?!clk_i\b)\w+_n?i\s*\((\w+)\)", "~{1}"),
    ("constant + 1", r"\b(?!1')((\d+)'([dh])([0-9A-Fa-f]+))\b", "one more"),
    ("condition negated", rf"\bif (?!\(!rst_ni\))({_BRACKETS})", "(!{1})"),
    ("condition always", rf"\bif (?!\(!rst_ni\))({_BRACKETS})", "(1'b1)"),
    ("assignment left out", r"(?<=[\s)])(\w+(?:\[[^\]]*\])? +<= [^;]+;)", ";"),
    ("alternatives swapped", r"(\? ([^?:;\n]+) : ([^?:;\n]+))(?=;)", "? {3} : {2}"),
)
# Comments, code for simulation only and declarations become blanks, which keeps the positions.
_BLANKS = (
    r"//[^\n]*",
    r"^`ifdef .*?^`else$",
    r"^ *(?:localparam|parameter|integer|genvar|input|output)\b[^;]*;",
    r"^ *(?:reg|wire)\b[^;=]*;",
    r"^ *if \([^\n]*\) begin : gen_\w+_error$",  # tests of lint ask for these
)
_WIDTHS = re.compile(r"\[[^\]\n]*\]|\{\([^()]*(?:\([^()]*\))?[^()]*\)\{")


def _plus_one(size: str, base: str, digits: str) -> str:
    value = (int(digits, {"h": 16, "d": 10}[base]) + 1) % (1 << int(size))
    return f"{size}'h{value:X}" if base == "h" else f"{size}'d{value}"


def mutants(module: str, text: str) -> list[Mutant]:
    """Return all mutants of the statements of a module; ports, parameters, comments stay."""
    body = text.index(");\n", text.index("module ")) + 2
    plain = text
    for pattern in _BLANKS:
        plain = re.sub(pattern, lambda m: re.sub(r"\S", " ", m[0]), plain, flags=re.MULTILINE | re.DOTALL)
    # Bit ranges and replication counts too: lint checks widths.
    plain = _WIDTHS.sub(lambda m: m[0][0] + " " * (len(m[0]) - 2) + m[0][-1], plain)
    found = []
    for what, pattern, new in _CHANGES:
        for m in re.finditer(pattern, plain):
            if m.start(1) >= body:
                groups = [text[m.start(n) : m.end(n)] for n in range(m.re.groups + 1)]
                changed = _plus_one(*groups[2:]) if what == "constant + 1" else new.format(*groups)
                found.append((m.start(1), what, changed, m.end(1)))
    made = []
    for start, what, new, end in sorted(found):
        line = text.count("\n", 0, start) + 1
        first, last = text.rfind("\n", 0, start) + 1, text.find("\n", end)
        before = " ".join(text[first:last].split())
        behind = " ".join((text[first:start] + new + text[end:last]).split())
        key = hashlib.sha256(f"{module}\0{text}\0{start}\0{end}\0{new}".encode()).hexdigest()[:16]
        made.append(Mutant(key, module, line, what, start, end, new, f"{before}  ->  {behind}"))
    return made


def judges(module: str, rtl: Path) -> str:
    """Return a hash of all that judges mutants of a module: sources, tests, proofs, this file."""
    block, bench, place = BLOCKS[module], ROOT / "tb" / "rtl", ROOT / formal.PLACE
    own = (Path(__file__), Path(__file__).with_name("mutate_plugin.py"), templates.path("equal.sby"))
    files = [*own, *bench.glob("*.py"), place / "mutants.toml"]
    # `top` has the SPI client, and the bench of the self-test.
    files += [path for test in {*block.tests, "top"} for path in (bench / test).glob("*.*")]
    proofs = [formal.proofs()[name] for name in block.proofs]
    files += [place / file for proof in proofs for file in (f"{proof.name}.sby", f"{proof.check}.v")]
    files += place.glob("dermis_*.v") if proofs else []
    names = {module, *below(module, rtl), *(name for proof in proofs for name in proof.modules)}
    files += [*(rtl / f"{name}.v" for name in names), *rtl.glob("*.vh")]
    return digest(sorted(set(files), key=lambda path: (path.name, path.read_bytes())))[:16]


def _overlay(rtl: Path, name: str, mutant: Mutant | None = None) -> tuple[Path, Path]:
    """Return a new directory for a run, and in it the sources of rtl/, one of them mutated or none."""
    work = BUILD / "mutate" / "work" / name
    shutil.rmtree(work, ignore_errors=True)
    tree = work / "rtl"
    tree.mkdir(parents=True)
    for path in [*rtl.glob("*.v"), *rtl.glob("*.vh")]:
        text = path.read_text()
        changed = mutant is not None and path.stem == mutant.module
        (tree / path.name).write_text(mutant.apply(text) if changed else text)
    return work, tree


def _noticed_by_proof(block: Block, tree: Path, key: str) -> tuple[str | None, bool]:
    """Return a refuted theorem and True, or a proof that no longer succeeds and False."""
    doubt = None
    for name in block.proofs:
        proof = formal.proofs()[name]
        for task, keep in (("search", list(proof.theorems)), (proof.quick, [])):
            outcome = formal.run(
                proof, task, keep, limit_s=SEARCH_LIMIT_S, rtl=tree, where="mutate/proofs", suffix=f"_{key}"
            )
            shutil.rmtree(outcome.work, ignore_errors=True)
            if outcome.status == "FAIL":
                return f"proof {name}.{outcome.failed[0] if outcome.failed else '?'}", True
        # A timeout proves nothing.
        if outcome.status == "UNKNOWN":
            doubt = f"proof {name}, which no longer succeeds"
    return doubt, False


def _run_tests(block: Block, tree: Path, work: Path, limit_s: float) -> int | None:
    """Run the tests on the sources of `tree`; return their exit code, None after a timeout."""
    if not block.tests:
        return 0
    command = [sys.executable, "-m", "pytest", "-p", "scripts.mutate_plugin"]
    command += ["-x", "-q", "-m", "not long" if block.short else "", "-k", "not verilator"]
    command += [str(ROOT / "tb" / "rtl" / test) for test in block.tests]
    environment = {"DERMIS_MUTANT_RTL": str(tree), "DERMIS_MUTANT_WORK": str(work)}
    return children.run_child(command, ROOT, work / "pytest.log", limit_s, environment)


def control(module: str, rtl: Path) -> float:
    """Return the seconds of the tests on the unchanged module; SimulatorError if they fail."""
    work, tree = _overlay(rtl, f"control_{module}")
    start = time.perf_counter()
    code = _run_tests(BLOCKS[module], tree, work, CONTROL_LIMIT_S)
    if code != 0:
        said = f"take more than {CONTROL_LIMIT_S:g} s" if code is None else f"end with exit code {code}"
        raise SimulatorError(f"the tests of the unchanged {module} {said}", work / "pytest.log")
    shutil.rmtree(work, ignore_errors=True)
    return time.perf_counter() - start


def _noticed_by_test(block: Block, tree: Path, work: Path, limit_s: float) -> tuple[str | None, bool]:
    """Return a failing test and True, or a note of a timeout and False."""
    code = _run_tests(block, tree, work, limit_s)
    if code is None:
        return f"tests, which timed out after {limit_s:.0f} s", False
    if code != 1:
        return None, False
    log = (work / "pytest.log").read_text(errors="replace")
    failed = re.findall(r"^FAILED \S*?::(\w+)", log, re.MULTILINE)
    return f"test {failed[0] if failed else '?'}", True


_AFTER_RESET = """
  reg started_q = 1'b0;
  always @(posedge {clock}) started_q <= 1'b1;
  always @* if (!started_q) assume (!rst_ni);
endmodule"""


def _equivalent(module: str, block: Block, rtl: Path, tree: Path, work: Path) -> bool | None:
    """Return True if module and mutant have equal outputs after a reset; None after a timeout."""
    files = [rtl / f"{other}.v" for other in below(module, rtl)]
    for side, source in (("right", rtl), ("wrong", tree)):
        text = re.sub(rf"\bmodule {module}\b", f"module {side}", (source / f"{module}.v").read_text())
        if side == "right" and block.multiclock:
            text = text.replace("endmodule", "(* gclk *) reg global;\nendmodule")
        if side == "right" and block.clocked:
            clock = "global" if block.multiclock else "clk_i"
            text = text.replace("endmodule", _AFTER_RESET.format(clock=clock))
        (work / f"{side}.v").write_text(text)
    job = work / "equal.sby"
    given = {"names": [file.name for file in files], "parameters": block.parameters}
    read = [work / "right.v", work / "wrong.v", *files, rtl / "dermis_design.vh"]
    given["files"] = [formal.from_place(file) for file in read]
    job.write_text(templates.text("equal.sby", limit_s=EQUAL_LIMIT_S, multiclock=block.multiclock, **given))
    outcome = formal.run_sby(job, work / "equal", EQUAL_LIMIT_S)
    return {"PASS": True, "FAIL": False}.get(outcome.status)


def fate(doubts: Sequence[str], same: bool | None) -> tuple[str, str | None]:
    """Return the fate of a mutant that no counterexample and no failing test has killed, and its reason.

    `doubts` are proofs that fail without one and tests that timed out, `same` is the result of the equivalence check.
    """
    if same:
        return "equivalent", None
    said = "; ".join(doubts) or None
    if same is None or any(doubt.startswith("tests") for doubt in doubts):
        return "undecided", said
    # Not equivalent, and its proof no longer succeeds: killed by the proof.
    return ("killed", said) if doubts else ("survives", None)


def try_mutant(mutant: Mutant, rtl: Path, by: Sequence[str], limit_s: float = TEST_LEAST_S) -> dict[str, Any]:
    """Try one mutant; return its fate: stillborn, killed, equivalent, survives or undecided."""
    start = time.perf_counter()
    work, tree = _overlay(rtl, mutant.key, mutant)
    end, killer = "stillborn", None
    try:
        sources = [tree / f"{name}.v" for name in (mutant.module, *below(mutant.module, tree))]
        command = ["iverilog", "-g2005", "-t", "null", "-s", mutant.module, f"-I{tree}", *map(str, sources)]
        code = children.run_child(command, work, work / "compile.log", COMPILE_LIMIT_S)
        if code == 0:
            end, killer = _judge(mutant, rtl, tree, work, by, limit_s)
        elif code is None:
            end, killer = "undecided", f"iverilog, which timed out after {COMPILE_LIMIT_S:g} s"
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return {**asdict(mutant), "fate": end, "by": killer, "seconds": round(time.perf_counter() - start, 2)}


def _judge(
    mutant: Mutant, rtl: Path, tree: Path, work: Path, by: Sequence[str], limit_s: float
) -> tuple[str, str | None]:
    block, doubts = BLOCKS[mutant.module], list[str]()
    for kind in ("tests", "proofs") if block.tests_first else ("proofs", "tests"):
        if kind not in by:
            continue
        if kind == "tests":
            said, sure = _noticed_by_test(block, tree, work, limit_s)
        else:
            said, sure = _noticed_by_proof(block, tree, mutant.key)
        if sure:
            return "killed", said
        doubts += [said] if said else []
    # A change that only breaks a lemma also stops a proof.
    return fate(doubts, _equivalent(mutant.module, block, rtl, tree, work))


def _summary(results: Sequence[Mapping[str, Any]]) -> tuple[float | None, str]:
    """Return the killed share of the mutants that are not equivalent (undecided is alive), and the numbers by fate."""
    count = Counter(result["fate"] for result in results)
    tests = sum(result["fate"] == "killed" and result["by"].startswith("test ") for result in results)
    judged = count["killed"] + count["survives"] + count["undecided"]
    return count["killed"] / judged if judged else None, (
        f"{len(results)} tried: {count['killed']} killed ({tests} by tests), "
        f"{count['equivalent']} equivalent, {count['survives']} survive, {count['undecided']} undecided, "
        f"{count['stillborn']} do not compile"
    )


def table(rows: Sequence[verdict.Row], results: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return the rows of the modules, their survivors and their equivalent mutants."""
    lists: dict[str, list[str]] = {"Not killed": [], "Equivalent, decided at the size given": []}
    left, alike = lists.values()
    for module, tried in results.items():
        size = ", ".join(f"{k} {v}" for k, v in BLOCKS[module].parameters.items()) or "only size"
        for r in tried:
            where, change = f"- `rtl/{module}.v:{r['line']}`", f"{r['what']}): `{r['shown']}`"
            if r["fate"] == "equivalent":
                alike.append(f"{where} ({size}, {change}")
            elif r["fate"] not in ("killed", "stillborn"):
                left.append(f"{where} ({r['fate']}, {change}")
    said = "".join("\n".join(["", f"{name}:", "", *lines, ""]) for name, lines in lists.items() if lines)
    return f"{markdown.rows_table(rows)}\n{said}"


@click.command(context_settings=SHOW)
@click.argument("modules", nargs=-1, metavar="[MODULE]...", type=click.Choice([*BLOCKS]))
@click.option("--sample", "count", type=click.IntRange(1), default=SAMPLE, help="Mutants per module.")
@click.option("--seed", type=int, default=1, help="Random seed of the sample.")
@click.option("--limit", "limit_s", type=float, default=1800.0, help="Seconds; the next call continues.")
@click.option("--fresh", is_flag=True, help="Discard earlier results.")
@click.option("--workers", type=click.IntRange(1, 64), default=2, help="Parallel runs.")
def mutate_command(
    modules: tuple[str, ...], count: int, seed: int, limit_s: float, fresh: bool, workers: int
) -> int:
    """Mutate the Verilog; proofs or tests must notice. A new call continues an earlier one.

    The table of the results is in build/mutation.md.
    """
    hdl.prepare("icarus")
    formal.tools()
    rtl, place = ROOT / "rtl", BUILD / "mutate"
    chosen: dict[str, list[Mutant]] = {}
    for name in modules or BLOCKS:
        every = mutants(name, (rtl / f"{name}.v").read_text())
        # A random sample, fixed by the seed, in the order of the source.
        places = random.Random(seed).sample(range(len(every)), min(count, len(every)))
        chosen[name] = [every[n] for n in sorted(places)]
    kept = {name: Checkpoint(place / f"{name}.json", judges(name, rtl), fresh=fresh) for name in chosen}
    todo = [mutant for name, made in chosen.items() for mutant in made if mutant.key not in kept[name].pieces]
    end = time.monotonic() + limit_s
    failed: dict[str, str] = {}

    def check(name: str) -> float:
        try:
            return control(name, rtl) if time.monotonic() < end else 0.0
        except SimulatorError as error:
            failed[name] = str(error)
            return 0.0

    def work(mutant: Mutant) -> dict[str, Any] | None:
        if time.monotonic() > end or mutant.module in failed:
            return None
        limit = max(TEST_LEAST_S, TEST_TIMES * seconds[mutant.module])
        return try_mutant(mutant, rtl, ("proofs", "tests"), limit)

    with progress.slots("mutants", len(todo), "mutants") as done, children.threads(workers) as pool:
        names = list(dict.fromkeys(mutant.module for mutant in todo))
        seconds = dict(zip(names, pool.map(check, names), strict=True))
        for n, result in enumerate(pool.map(work, todo), 1):
            if result is not None:
                kept[result["module"]].put(result["key"], result)
            done(n, todo[n].module if n < len(todo) else "")
    rows, results = [], {}
    for name, made in chosen.items():
        found = results[name] = [kept[name].pieces[m.key] for m in made if m.key in kept[name].pieces]
        share, note = _summary(found)
        row = verdict.report(f"mutate.{name}", share, "ratio", note)
        if missing := len(made) - len(found):
            why = failed.get(name, "call again to continue")
            row |= {"status": "ERROR", "note": f"{missing} not tried: {why}; {note}"}
        rows.append(row)
    every = [result for found in results.values() for result in found]
    share, note = _summary(every)
    whole = verdict.judge("mutate.killed", share, f"{len(chosen)} of {len(BLOCKS)} modules, {note}")
    rows.append(whole | {"status": "ERROR"} if len(every) < sum(map(len, chosen.values())) else whole)
    write_atomic(BUILD / "mutation.md", table(rows, results))
    return finish("mutate", rows, f"Mutants (seed {seed}); build/mutation.md lists those not killed")
