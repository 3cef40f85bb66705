# SPDX-License-Identifier: Apache-2.0
"""Mutation testing of the Verilog: small faults in a module, each of which its proofs or its tests must notice.

The mutants are made in the source, not in a netlist: they keep the parameters, so that tests run them at every size,
and a survivor reads like the mistake it stands for.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click

from dermis import formal, verdict
from dermis.design import ROOT
from dermis.errors import InputError
from dermis.files import write_atomic, write_between
from dermis.hdl import end_session

KILLED_MIN = 95.0
"""Per cent of the mutants that are not equivalent; what survives is listed and argued in docs/mutation.md."""
TEST_LIMIT_S = 90.0
SEARCH_LIMIT_S = 20.0
EQUAL_LIMIT_S = 40


@dataclass(frozen=True)
class Block:
    """One module, and what is meant to notice a fault in it.

    Attributes
    ----------
    proofs : tuple of str
        Names of rtl/formal/proofs.toml.
    tests : tuple of str
        Directories or files of tb/rtl; missing ones are left out.
    modules : tuple of str
        Modules below it, for the equivalence check.
    parameters : mapping
        Small sizes for the equivalence check.
    clocked : bool
        False for a combinational module.
    multiclock : bool
    """

    proofs: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()
    parameters: Mapping[str, int] | None = None
    clocked: bool = True
    multiclock: bool = False


BLOCKS: Mapping[str, Block] = {
    "dermis_sync_ff": Block(("sync_ff",), ("synchronizer",), ("dermis_tech_dff",)),
    "dermis_sync_latch": Block(
        ("sync_latch",), ("synchronizer",), ("dermis_tech_dff", "dermis_tech_latch"), multiclock=True
    ),
    "dermis_gated_counter": Block(("counter",), ("gated_counter",), (), {"CODE_BITS": 3}),
    "dermis_row_scanner": Block(("scanner",), ("row_scanner",), (), {"ROWS": 2, "BREAK_CLOCKS": 2}),
    "dermis_row_buffer": Block(("row_buffer",), ("row_buffer",), (), {"COLS": 2}),
    "dermis_packer": Block(("packer",), ("packer",), ("dermis_crc16",), {"COLS": 2, "CODE_BITS": 3}),
    "dermis_crc16": Block(("packer",), ("packer",), (), clocked=False),
    "dermis_crc8": Block(("spi",), ("spi",), (), clocked=False),
    "dermis_self_test": Block(("self_test",), ("self_test",), (), {"ROWS": 2, "COLS": 3, "CODE_BITS": 3}),
    "dermis_frame_buffer": Block(
        ("frame_buffer",),
        ("frame_buffer",),
        ("dermis_tech_ram", "dermis_tech_sync", "dermis_tech_dff"),
        {"BANK_BYTES": 3},
    ),
    "dermis_register_port": Block(
        ("register_port",), ("register_port",), ("dermis_tech_sync", "dermis_tech_dff")
    ),
    "dermis_registers": Block(("registers",), ("registers",), (), {"ROWS": 2, "COLS": 2, "CODE_BITS": 2}),
    "dermis_spi": Block(
        ("spi",), ("spi",), ("dermis_crc8", "dermis_tech_sync", "dermis_tech_dff"), multiclock=True
    ),
}


@dataclass(frozen=True)
class Mutant:
    """One change of one place.

    Attributes
    ----------
    key : str
        Digest of module text and change, so that a result belongs to a source.
    line : int
    what : str
        Kind of change.
    start, end : int
        Characters replaced by `new`.
    shown : str
        The line before and behind the change.
    """

    key: str
    module: str
    line: int
    what: str
    start: int
    end: int
    new: str
    shown: str

    def apply(self, text: str) -> str:
        """The module's source with the change in it."""
        return text[: self.start] + self.new + text[self.end :]


# (kind, pattern, replacement); group 1 is replaced. Spaces around the operators are this codebase's own style.
_OPERATORS: Sequence[tuple[str, str, str]] = (
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
    ("not left out", r"(!)(?=[\w(&])", ""),
    ("0 to 1", r"\b(1'[bd]0)\b", "1'b1"),
    ("1 to 0", r"\b(1'[bd]1)\b", "1'b0"),
)
_CONSTANT = re.compile(r"\b(\d+)'([dh])([0-9A-Fa-f]+)\b")
_CONDITION = re.compile(r"\bif (\()")
_ASSIGNMENT = re.compile(r"(?<=[\s)])(\w+(?:\[[^\]]*\])? +<= [^;]+;)")
_TERNARY = re.compile(r"(\? )([^?:;\n]+)( : )([^?:;\n]+)(?=;)")


def _closing(text: str, opening: int) -> int:
    depth = 0
    for n in range(opening, len(text)):
        depth += {"(": 1, ")": -1}.get(text[n], 0)
        if depth == 0:
            return n
    raise ValueError("no closing bracket")


def mutants(module: str, text: str) -> list[Mutant]:
    """Every mutant of a module's source: its statements only, not its ports, parameters, checks or comments."""
    body = text.index(");\n", text.index("module ")) + 2
    # Comments and declarations are blanked, so that places stay where they are.
    plain = re.sub(r"//[^\n]*", lambda m: " " * len(m.group()), text)
    plain = re.sub(
        r"^ *(?:localparam|parameter|integer|genvar|input|output)\b[^;]*;",
        lambda m: re.sub(r"\S", " ", m.group()),
        plain,
        flags=re.MULTILINE,
    )
    plain = re.sub(
        r"^ *(?:reg|wire)\b[^;=]*;", lambda m: re.sub(r"\S", " ", m.group()), plain, flags=re.MULTILINE
    )
    # Bits that are only named, and the sizes of replications: width arithmetic is lint's.
    plain = re.sub(
        r"\[[^\]\n]*\]|\{\([^()]*(?:\([^()]*\))?[^()]*\)\{",
        lambda m: m.group()[0] + " " * (len(m.group()) - 2) + m.group()[-1],
        plain,
    )
    found: list[tuple[str, int, int, str]] = []
    for what, pattern, new in _OPERATORS:
        found += [(what, m.start(1), m.end(1), new) for m in re.finditer(pattern, plain)]
    for m in _CONSTANT.finditer(plain):
        size, base, digits = int(m.group(1)), m.group(2), m.group(3)
        if size > 1:
            value = (int(digits, 16 if base == "h" else 10) + 1) % (1 << size)
            found.append(
                (
                    "constant + 1",
                    m.start(),
                    m.end(),
                    f"{size}'{base}{value:X}" if base == "h" else f"{size}'d{value}",
                )
            )
    for m in _CONDITION.finditer(plain):
        end = _closing(text, m.start(1))
        if text[m.start(1) : end + 1] != "(!rst_ni)":
            found.append(("condition negated", m.start(1), end + 1, f"(!{text[m.start(1) : end + 1]})"))
            found.append(("condition always", m.start(1), end + 1, "(1'b1)"))
    found += [("assignment left out", m.start(1), m.end(1), ";") for m in _ASSIGNMENT.finditer(plain)]
    for m in _TERNARY.finditer(plain):
        new = text[m.start(1) : m.end(1)] + text[m.start(4) : m.end(4)] + " : " + text[m.start(2) : m.end(2)]
        found.append(("alternatives swapped", m.start(), m.end(), new))
    made = []
    for what, start, end, new in sorted(found, key=lambda place: (place[1], place[0], place[3])):
        if start < body or (what == "not left out" and text[start:].startswith("!rst_ni")):
            continue
        line = text.count("\n", 0, start) + 1
        first, last = text.rfind("\n", 0, start) + 1, text.find("\n", end)
        before = " ".join(text[first:last].split())
        behind = " ".join((text[first:start] + new + text[end:last]).split())
        digest = hashlib.sha256(f"{module}\0{text}\0{start}\0{end}\0{new}".encode()).hexdigest()[:16]
        made.append(Mutant(digest, module, line, what, start, end, new, f"{before}  ->  {behind}"))
    return made


def sample(every: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """So many of them by chance, the same for the same seed, in the order of the source."""
    if count >= len(every):
        return list(every)
    chosen = random.Random(seed).sample(range(len(every)), count)
    return [every[n] for n in sorted(chosen)]


def _compiles(source: Path, rtl: Path, block: Block) -> bool:
    command = ["iverilog", "-g2005", "-t", "null", "-s", source.stem, f"-I{rtl}", str(source)]
    command += [str(rtl / f"{module}.v") for module in block.modules]
    done = subprocess.run(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=30, check=False
    )
    return done.returncode == 0


def _overlay(rtl: Path, mutant: Mutant, work: Path) -> Path:
    """A directory of sources that differs from rtl/ in the one module."""
    tree = work / "rtl"
    tree.mkdir(parents=True)
    for path in [*rtl.glob("*.v"), *rtl.glob("*.vh")]:
        (tree / path.name).symlink_to(path.resolve())
    target = tree / f"{mutant.module}.v"
    target.unlink()
    target.write_text(mutant.apply((rtl / target.name).read_text()))
    return tree


def _noticed_by_proof(block: Block, tree: Path, key: str) -> tuple[str | None, bool]:
    """The theorem with a counterexample, and True; or the proof that no longer goes through, and False."""
    doubt = None
    for name in block.proofs:
        proof = formal.proofs().get(name)
        if proof is None:
            continue
        quick = dataclasses.replace(
            proof, limit_s=SEARCH_LIMIT_S, parameters={**proof.parameters, **proof.small}, also=()
        )
        for mode in ("theorems", "prove"):
            outcome = formal.run(quick, mode, rtl=tree, where="mutate/proofs", suffix=f"_{key}")
            shutil.rmtree(outcome.work, ignore_errors=True)
            if outcome.status == "FAIL":
                return f"proof {name}.{outcome.failed[0] if outcome.failed else '?'}", True
        # A run that did not end in time says nothing.
        if outcome.status == "UNKNOWN":
            doubt = f"proof {name}, which no longer goes through"
    return doubt, False


def _killed_by_test(block: Block, tree: Path, work: Path) -> str | None:
    places = [ROOT / "tb" / "rtl" / test for test in block.tests]
    places = [place for place in places if place.exists()]
    if not places:
        return None
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "dermis.mutate_plugin",
        "-x",
        "-q",
        "-k",
        "not verilator",
        *map(str, places),
    ]
    environment = {**os.environ, "DERMIS_MUTANT_RTL": str(tree), "DERMIS_MUTANT_WORK": str(work)}
    log = work / "pytest.log"
    with log.open("wb") as out:
        child = subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = child.wait(TEST_LIMIT_S)
        except subprocess.TimeoutExpired:
            return "test (too slow)"
        finally:
            end_session(child)
    if code == 0:
        return None
    if code != 1:
        return None
    failed = re.findall(r"^FAILED \S*?::(\w+)", log.read_text(errors="replace"), re.MULTILINE)
    return f"test {failed[0] if failed else '?'}"


def _ports(rtl: Path, module: str, block: Block, work: Path) -> dict[str, dict[str, Any]]:
    """Ports of the module at the sizes of the equivalence check, from Yosys."""
    sizes = " ".join(f"-chparam {k} {v}" for k, v in (block.parameters or {}).items())
    sources = " ".join(str(rtl / f"{m}.v") for m in (module, *block.modules))
    out = work / "ports.json"
    script = f"read_verilog -I{rtl} {sources}; hierarchy -top {module} {sizes}; proc; write_json {out}"
    subprocess.run(
        ["yosys", "-q", "-p", script],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=60,
        check=True,
    )
    made = json.loads(out.read_text())["modules"]
    return next(
        iter(value for name, value in made.items() if module in name and value["attributes"].get("top"))
    )["ports"]


def _equal_checker(ports: Mapping[str, Mapping[str, Any]], block: Block, module: str) -> str:
    def width(port: Mapping[str, Any]) -> str:
        return f"[{len(port['bits']) - 1}:0] " if len(port["bits"]) > 1 else ""

    inputs = {name: port for name, port in ports.items() if port["direction"] == "input"}
    outputs = {name: port for name, port in ports.items() if port["direction"] != "input"}
    clock = "global" if block.multiclock else "clk_i"
    lines = ["module check_equal (", ",\n".join(f"input wire {width(p)}{n}" for n, p in inputs.items()), ");"]
    sizes = ", ".join(f".{k} ({v})" for k, v in (block.parameters or {}).items())
    for side in ("right", "wrong"):
        lines += [f"wire {width(p)}{side}_{n};" for n, p in outputs.items()]
        pins = [f".{n} ({n})" for n in inputs] + [f".{n} ({side}_{n})" for n in outputs]
        name = module if side == "right" else f"{module}_mutant"
        lines.append(f"{name} {f'#({sizes}) ' if sizes else ''}u_{side} ({', '.join(pins)});")
    if block.multiclock:
        lines.append("(* gclk *) reg global;")
    if block.clocked:
        lines += ["reg started_q = 1'b0;", f"always @(posedge {clock}) started_q <= 1'b1;"]
    same = " && ".join(f"right_{n} == wrong_{n}" for n in outputs)
    lines.append("always @* begin")
    if block.clocked:
        lines.append("if (!started_q) assume (!rst_ni);")
    lines += [f"same: assert ({same});", "end", "endmodule", ""]
    return "\n".join(lines)


def _equivalent(module: str, block: Block, rtl: Path, tree: Path, work: Path) -> bool | None:
    """Whether module and mutant give the same outputs for ever after a reset; None when not decided in time."""
    checker = work / "check_equal.v"
    checker.write_text(_equal_checker(_ports(rtl, module, block, work), block, module))
    mutant = work / f"{module}_mutant.v"
    mutant.write_text(
        re.sub(rf"\bmodule {module}\b", f"module {module}_mutant", (tree / f"{module}.v").read_text())
    )
    sources = [checker, mutant, *(rtl / f"{m}.v" for m in (module, *block.modules))]
    lines = ["[options]", "mode prove", "aigsmt z3", f"timeout {EQUAL_LIMIT_S}"]
    lines += ["multiclock on"] if block.multiclock else []
    lines += ["[engines]", "abc scorr; pdr", "[script]", *(f"read -formal {s.name}" for s in sources)]
    lines += [
        "prep -flatten -top check_equal",
        "chtype -set $shift t:$shiftx",
        "[files]",
        *map(str, sources),
        str(rtl / "dermis_design.vh"),
    ]
    job = work / "equal.sby"
    job.write_text("\n".join(lines) + "\n")
    outcome = formal.run_sby(job, work / "equal", EQUAL_LIMIT_S)
    return {"PASS": True, "FAIL": False}.get(outcome.status)


def try_mutant(mutant: Mutant, rtl: Path, by: Sequence[str]) -> dict[str, Any]:
    """Fate of one mutant: stillborn, killed (by what), equivalent, survives or undecided."""
    block = BLOCKS[mutant.module]
    work = ROOT / "build" / "mutate" / "work" / mutant.key
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    start = time.perf_counter()
    killer: str | None = None
    try:
        tree = _overlay(rtl, mutant, work)
        if not _compiles(tree / f"{mutant.module}.v", tree, block):
            fate = "stillborn"
        else:
            sure = False
            if "proofs" in by:
                killer, sure = _noticed_by_proof(block, tree, mutant.key)
            if not sure and "tests" in by and (test := _killed_by_test(block, tree, work)):
                killer, sure = test, True
            fate = "killed"
            if not sure:
                # A proof is also stopped by a change that only its lemmas see.
                same = _equivalent(mutant.module, block, rtl, tree, work)
                fate = (
                    "undecided"
                    if same is None
                    else "equivalent"
                    if same
                    else "killed"
                    if killer
                    else "survives"
                )
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return {**asdict(mutant), "fate": fate, "by": killer, "seconds": round(time.perf_counter() - start, 2)}


def _row(module: str, results: Sequence[Mapping[str, Any]]) -> verdict.Row:
    fates = [result["fate"] for result in results]
    killed, judged = fates.count("killed"), sum(f in ("killed", "survives", "undecided") for f in fates)
    rate = 100.0 * killed / judged if judged else None
    by_test = sum(str(result["by"]).startswith("test") for result in results)
    note = f"{len(results)} tried: {killed} killed ({by_test} by tests), {fates.count('equivalent')} equivalent, "
    note += f"{fates.count('survives') + fates.count('undecided')} survive, {fates.count('stillborn')} do not compile"
    status = "ERROR" if rate is None else "PASS" if rate >= KILLED_MIN else "FAIL"
    return {
        "name": f"mutate.{module}",
        "value": rate,
        "unit": "%",
        "min": KILLED_MIN,
        "max": None,
        "status": status,
        "note": note,
    }


BEGIN, END = "<!-- dermis mutate --docs: begin -->", "<!-- end -->"


def table(every: Mapping[str, int], results: Sequence[Mapping[str, Any]]) -> str:
    """The table of docs/mutation.md and the list of what survives; `every` is how many mutants a module has."""
    lines = [
        "| module | mutants | tried | killed by a proof | killed by a test | equivalent | survive | killed |"
    ]
    lines.append("|---|---|---|---|---|---|---|---|")
    left: list[str] = []
    for module, count in every.items():
        mine = [r for r in results if r["module"] == module and r["fate"] != "stillborn"]
        proof = sum(r["fate"] == "killed" and str(r["by"]).startswith("proof") for r in mine)
        test = sum(r["fate"] == "killed" and str(r["by"]).startswith("test") for r in mine)
        same = sum(r["fate"] == "equivalent" for r in mine)
        over = [r for r in mine if r["fate"] in ("survives", "undecided")]
        judged = proof + test + len(over)
        rate = f"{100 * (proof + test) / judged:.0f} %" if judged else "not run"
        lines.append(
            f"| {module} | {count} | {len(mine)} | {proof} | {test} | {same} | {len(over)} | {rate} |"
        )
        left += [f"- `rtl/{module}.v:{r['line']}` ({r['fate']}, {r['what']}): `{r['shown']}`" for r in over]
    killed = sum(r["fate"] == "killed" for r in results)
    judged = killed + sum(r["fate"] in ("survives", "undecided") for r in results)
    lines += ["", f"{killed} of {judged} mutants that are not equivalent are killed.", "", *left]
    return "\n".join(lines).rstrip()


@click.command()
@click.argument("modules", nargs=-1, metavar="[MODULE]...")
@click.option(
    "--sample", "count", type=click.IntRange(1), default=40, show_default=True, help="Mutants a module."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Of the sample.")
@click.option(
    "--by",
    type=click.Choice(["proofs", "tests", "both"]),
    default="both",
    show_default=True,
    help="What may kill.",
)
@click.option(
    "--limit",
    "limit_s",
    type=float,
    default=1800.0,
    show_default=True,
    help="Seconds; the rest is done by the next call.",
)
@click.option("--docs", is_flag=True, help="Write the table of docs/mutation.md from all results.")
@click.option("--fresh", is_flag=True, help="Forget earlier results.")
@click.option(
    "--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Mutants at a time."
)
@click.option(
    "--rtl", type=click.Path(exists=True, file_okay=False, path_type=Path), help="Sources instead of rtl/."
)
def mutate_command(
    modules: tuple[str, ...],
    count: int,
    seed: int,
    by: str,
    limit_s: float,
    fresh: bool,
    workers: int,
    rtl: Path | None,
    docs: bool,
) -> int:
    """Put small faults into the Verilog: proofs or tests must notice each. Results are kept, so that a run goes on."""
    from dermis import progress

    for name in modules:
        if name not in BLOCKS:
            raise InputError("command line", "MODULE", name, f"one of {', '.join(BLOCKS)}")
    source = ROOT / "rtl" if rtl is None else rtl.resolve()
    killers = ("proofs", "tests") if by == "both" else (by,)
    chosen = list(modules or BLOCKS)
    stores = {name: ROOT / "build" / "mutate" / f"{name}_{by}.json" for name in chosen}
    known: dict[str, dict[str, Any]] = {}
    for store in stores.values():
        if store.exists() and not fresh:
            known |= json.loads(store.read_text())
    wanted: list[Mutant] = []
    for name in chosen:
        wanted += sample(mutants(name, (source / f"{name}.v").read_text()), count, seed)
    todo = [mutant for mutant in wanted if mutant.key not in known]
    end = time.monotonic() + limit_s

    def work(mutant: Mutant) -> dict[str, Any] | None:
        return None if time.monotonic() > end else try_mutant(mutant, source, killers)

    with progress.slots("mutants", len(todo), "mutants") as done, ThreadPoolExecutor(workers) as pool:
        try:
            for n, result in enumerate(pool.map(work, todo), 1):
                if result is not None:
                    known[result["key"]] = result
                    mine = {key: r for key, r in known.items() if r["module"] == result["module"]}
                    write_atomic(stores[result["module"]], json.dumps(mine, indent=1) + "\n")
                done(n)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    rows = []
    for name in chosen:
        results = [known[m.key] for m in wanted if m.module == name and m.key in known]
        rows.append(_row(name, results))
        missing = sum(m.module == name and m.key not in known for m in wanted)
        if missing:
            rows[-1] = {
                **rows[-1],
                "status": "ERROR",
                "note": f"{missing} not tried yet: call again; {rows[-1]['note']}",
            }
        for result in results:
            if result["fate"] in ("survives", "undecided"):
                click.echo(
                    f"{result['fate']}: rtl/{name}.v:{result['line']}: {result['what']}: {result['shown']}"
                )
    if docs:
        texts = {name: (source / f"{name}.v").read_text() for name in chosen}
        every = {name: len(mutants(name, text)) for name, text in texts.items()}
        tried = [known[m.key] for m in wanted if m.key in known]
        write_between(ROOT / "docs" / "mutation.md", BEGIN, END, table(every, tried))
    verdict.write_rows("mutate", rows)
    verdict.print_rows(rows, f"Mutants (seed {seed})")
    return verdict.exit_code(rows)
