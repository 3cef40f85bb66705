# SPDX-License-Identifier: Apache-2.0
"""Synthesis of rtl/ in two cell libraries: mapping, equivalence, static timing, table of sizes.

Every figure is parsed from the output of a tool; a failure or an unexpected warning gives an ERROR
row.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from dermis.errors import InputError, SimulatorError, one_line
from dermis.files import write_between
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from dermis.scene.design import load as load_design
from scripts.synth.cells import TECHNOLOGIES, Technology
from scripts.synth.equivalence import prove
from scripts.synth.map import RAM, Netlist, Size, map_design, map_once
from scripts.synth.timing import CLOCKS, SDC, Path_, analyse, crossings, highest, unargued

DOCS = "docs/synthesis.md"
BLOCKS = "blocks"
MARKS = {
    name: (f"<!-- begin: {name} (written by dermis synth --docs) -->", f"<!-- end: {name} -->")
    for name in ("synth", BLOCKS)
} | {
    "sizes": ("<!-- begin: sizes (written by dermis synth --sizes --docs) -->", "<!-- end: sizes -->"),
    "gl": ("<!-- begin: gl (written by dermis gl --docs) -->", "<!-- end: gl -->"),
}
# Small, the paper's, large, and one column.
SIZES = ((8, 8), (16, 16), (64, 64), (16, 1))
# Above this number of bits, frame memory in flip-flops takes Yosys minutes; it is left out, with a
# note.
MEMORY_LIMIT_BITS = 20_000


def default_size() -> Size:
    """Return the size of models/design.toml."""
    array, timing = load_design().array, load_design().timing
    return Size(array.rows, array.cols, timing.code_bits)


def place(technology: Technology, size: Size, what: str = "") -> Path:
    """Return the directory of a netlist below build/."""
    return ROOT / "build" / "synth" / technology.name / f"{size.name}{what}"


def sdc_periods(sdc: Path = SDC) -> dict[str, float]:
    """Return the default periods of the constraint file in ns.

    Raises
    ------
    InputError
        One of them is missing.
    """
    text = sdc.read_text()
    found = {}
    for clock in CLOCKS:
        match = re.search(rf"\{{ set {clock}_period ([\d.]+) \}}", text)
        if match is None:
            raise InputError(sdc, f"{clock}_period", "not there", "its default, in ns")
        found[clock] = float(match.group(1))
    return found


def attempt(rows: list[Row], name: str, work: Callable[[], list[Row]]) -> None:
    """Add the rows of `work`, or an ERROR row with its failure."""
    try:
        rows += work()
    except SimulatorError as error:
        rows.append(verdict.error(name, one_line(str(error), 300)))


def netlist_rows(netlist: Netlist, size: Size, suffix: str, memory_bits: int | None = None) -> list[Row]:
    """Judge the contents of a flat netlist."""
    words = size.memory_bits if memory_bits is None else memory_bits
    tech = netlist.technology
    latches = netlist.kinds[tech.latch]
    unmapped = ", ".join(sorted(netlist.unmapped)[:3])
    return [
        verdict.judge(f"synth.inferred_latches.{suffix}", netlist.inferred_latches),
        verdict.judge(
            f"synth.latch_count_error.{suffix}",
            abs(latches - size.latches) + abs(netlist.latches - latches),
            f"{netlist.latches} latches, {latches} of them {tech.latch}, {size.latches} intended",
        ),
        verdict.judge(
            f"synth.unreset_flop_error.{suffix}",
            abs(netlist.unreset - words),
            f"{netlist.unreset} flops without reset, {words} bits of frame memory",
        ),
        verdict.judge(f"synth.unmapped_cells.{suffix}", sum(netlist.unmapped.values()), unmapped),
        verdict.judge(f"synth.fanout.{suffix}", netlist.fanout[0], netlist.fanout[1]),
        verdict.report(f"synth.cells.{suffix}", netlist.cells, "cells"),
        verdict.report(f"synth.area_um2.{suffix}", netlist.area_um2, "um2"),
        verdict.report(
            f"synth.flops.{suffix}", netlist.flops, "flops", f"{netlist.unreset} of them frame memory"
        ),
    ]


def _shown(path: Path_) -> str:
    return f"{path.start} to {path.end}, {len(path.cells)} cells"


def _corner(technology: Technology, corner: str, kind: str) -> str:
    """Return the name of a corner and its derate."""
    early, late = technology.derates(corner)
    factor = late if kind == "max" else early
    return f"corner {corner}" + (f", delays x {factor:g}" if factor != 1.0 else "")


def timing_rows(technology: Technology, netlist: Netlist, suffix: str) -> list[Row]:
    """Judge setup at the slow corner and hold at the fast one, and report the highest clocks."""
    periods = sdc_periods()
    clk_ns, sck_ns = periods["clk"], periods["sck"]
    rows: list[Row] = []
    slow = analyse(
        technology, technology.slow, netlist.verilog, netlist.directory, clk_ns=clk_ns, sck_ns=sck_ns
    )
    fast = slow
    if technology.fast != technology.slow:
        fast = analyse(
            technology, technology.fast, netlist.verilog, netlist.directory, clk_ns=clk_ns, sck_ns=sck_ns
        )
    left = unargued(technology, technology.slow, netlist.directory)
    rows.append(verdict.judge(f"synth.untimed_pins.{suffix}", len(left), ", ".join(left[:3])))
    for clock in CLOCKS:
        for name, kind, paths, corner in (
            ("setup", "max", slow, technology.slow),
            ("hold", "min", fast, technology.fast),
        ):
            path = paths[clock, kind]
            rows.append(
                verdict.judge(
                    f"synth.{name}_slack_ns.{clock}.{suffix}",
                    path.slack_ns,
                    f"{_corner(technology, corner, kind)}; {_shown(path)}",
                )
            )
    across = crossings(
        technology, technology.slow, netlist.verilog, netlist.directory, clk_ns=clk_ns, sck_ns=sck_ns
    )
    for clock, path in across.items():
        note = f"{_corner(technology, technology.slow, 'max')}; {_shown(path)}"
        rows.append(verdict.judge(f"synth.crossing_slack_ns.{clock}.{suffix}", path.slack_ns, note))
    found = highest(
        technology, technology.slow, netlist.verilog, netlist.directory, clk_ns=clk_ns, sck_ns=sck_ns
    )
    for clock in CLOCKS:
        one = found[clock]
        rows.append(
            verdict.measured(
                f"synth.highest_mhz.{clock}.{suffix}",
                one.mhz,
                "MHz",
                f"{_corner(technology, technology.slow, 'max')}; {_shown(one.path)}",
            )
        )
    return rows


def equivalence_rows(technology: Technology, netlist: Netlist, size: Size, suffix: str) -> list[Row]:
    """Judge the equivalence of netlist and Verilog."""
    proof = prove(
        technology, size.parameters, netlist.verilog, netlist.json, netlist.directory / "equivalence"
    )
    name = f"synth.not_equivalent.{suffix}"
    note = f"{proof.state_bits} state bits, {proof.outputs} functions"
    if proof.unpaired:
        note += f", {proof.unpaired} state bits without a partner are free"
    if proof.proved is None:
        return [verdict.error(name, f"not decided; {note}; {proof.said}")]
    return [verdict.judge(name, 0 if proof.proved else 1, note if proof.proved else f"{note}; {proof.said}")]


@dataclass
class Outcome:
    """Result of one run: rows, and the netlists that were made."""

    technology: Technology
    size: Size
    rows: list[Row]
    flat: Netlist | None = None
    hierarchical: Netlist | None = None
    seconds: float = 0.0


def synthesise(
    technology: Technology, size: Size, *, blocks: bool = True, timing: bool = True, equivalence: bool = True
) -> Outcome:
    """Map one size in one library and judge the result."""
    suffix = f"{technology.name}.{size.name}"
    rows: list[Row] = []
    outcome = Outcome(technology, size, rows)
    start = time.perf_counter()

    def make() -> list[Row]:
        outcome.flat = map_once(technology, size.parameters, place(technology, size), fresh=True)
        return netlist_rows(outcome.flat, size, suffix)

    def split() -> list[Row]:
        outcome.hierarchical = map_design(
            technology, size.parameters, place(technology, size), hierarchical=True
        )
        total = outcome.hierarchical.area_um2
        return [verdict.report(f"synth.area_by_blocks_um2.{suffix}", total, "um2", "hierarchy kept")]

    attempt(rows, f"synth.netlist.{suffix}", make)
    flat = outcome.flat
    if flat is not None and timing:
        attempt(rows, f"synth.timing.{suffix}", lambda: timing_rows(technology, flat, suffix))
    if flat is not None and equivalence:
        attempt(
            rows, f"synth.not_equivalent.{suffix}", lambda: equivalence_rows(technology, flat, size, suffix)
        )
    if blocks:
        attempt(rows, f"synth.blocks.{suffix}", split)
    outcome.seconds = time.perf_counter() - start
    rows.append(verdict.report(f"synth.seconds.{suffix}", outcome.seconds, "s", "all of the above"))
    return outcome


def constraint_rows() -> list[Row]:
    """Judge the clock period of the constraint file against the design."""
    wanted = 1e9 / load_design().converter.f_clk_hz
    error = abs(sdc_periods()["clk"] - wanted)
    return [
        verdict.judge("synth.clk_period_error_ns", error, f"{SDC.name} against {wanted:g} ns of design.toml")
    ]


# ---- sizes ------------------------------------------------------------------------------------------------------


@dataclass
class SizeLine:
    """One line of the table of sizes; None if not measured."""

    technology: str
    size: Size
    cells: int | None = None
    flops: int | None = None
    area_um2: float | None = None
    memory_um2: float | None = None
    clk_mhz: float | None = None
    sck_mhz: float | None = None
    whole: bool = True


def size_line(technology: Technology, size: Size, limit_s: float) -> tuple[SizeLine, list[Row]]:
    """Map a size without its frame memory, then one bank; the highest clocks are those with memory.

    Above MEMORY_LIMIT_BITS the memory is a black box in the timing, and its area is scaled from a
    smaller bank.
    """
    suffix = f"{technology.name}.{size.name}"
    line = SizeLine(technology.name, size)
    rows: list[Row] = []
    whole = size.memory_bits <= MEMORY_LIMIT_BITS
    line.whole = whole

    def bare() -> list[Row]:
        made = map_design(
            technology,
            size.parameters,
            place(technology, size, "_no_memory"),
            black_box_memory=True,
            limit_s=limit_s,
        )
        line.cells, line.flops, line.area_um2 = made.cells, made.flops, made.area_um2
        own = netlist_rows(made, size, f"{suffix}.no_memory", memory_bits=0)
        if not whole:
            own += fmax(made)
        return own

    def memory() -> list[Row]:
        bank = map_design(
            technology,
            {"WORDS": size.bank_bytes if whole else MEMORY_LIMIT_BITS // 16},
            place(technology, size, "_bank"),
            top=RAM,
            limit_s=limit_s,
        )
        per_bit = bank.area_um2 / bank.flops
        line.memory_um2 = per_bit * size.memory_bits
        note = "two banks" if whole else f"from {bank.flops} bits, {per_bit:.1f} um2 each"
        return [verdict.report(f"synth.memory_um2.{suffix}", line.memory_um2, "um2", note)]

    def fmax(made: Netlist) -> list[Row]:
        periods = sdc_periods()
        found = highest(
            technology,
            technology.slow,
            made.verilog,
            made.directory / "sizes",
            clk_ns=periods["clk"],
            sck_ns=periods["sck"],
            black_boxes=not whole,
        )
        line.clk_mhz, line.sck_mhz = found["clk"].mhz, found["sck"].mhz
        return [
            verdict.measured(f"synth.highest_mhz.{c}.{suffix}", found[c].mhz, "MHz", _shown(found[c].path))
            for c in CLOCKS
        ]

    def full() -> list[Row]:
        made = map_once(technology, size.parameters, place(technology, size), limit_s=limit_s)
        return netlist_rows(made, size, suffix) + fmax(made)

    attempt(rows, f"synth.netlist.{suffix}.no_memory", bare)
    attempt(rows, f"synth.memory_um2.{suffix}", memory)
    if whole:
        attempt(rows, f"synth.netlist.{suffix}", full)
    return line, rows


# ---- docs -------------------------------------------------------------------------------------------------------


def _number(value: float | None, digits: int = 0, scale: float = 1.0) -> str:
    return "not measured" if value is None else f"{value * scale:.{digits}f}"


def sizes_table(lines: Sequence[SizeLine]) -> str:
    """Return the table of sizes as Markdown."""
    out = [
        "| library | size | memory bits | cells | flops | area, mm2 | with memory, mm2 | clk, MHz "
        "| SCK, MHz | memory timed |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|---|",
    ]
    for line in lines:
        both = None if line.area_um2 is None or line.memory_um2 is None else line.area_um2 + line.memory_um2
        out.append(
            f"| {line.technology} | {line.size.name} | {line.size.memory_bits} | {_number(line.cells)} "
            f"| {_number(line.flops)} | {_number(line.area_um2, 4, 1e-6)} | {_number(both, 4, 1e-6)} "
            f"| {_number(line.clk_mhz, 1)} | {_number(line.sck_mhz, 1)} | {'yes' if line.whole else 'no'} |"
        )
    return "\n".join(out)


def verdict_table(rows: Sequence[Row]) -> str:
    """Return verdict rows as Markdown."""
    out = ["| name | value | unit | limit | status | note |", "|---|--:|---|---|---|---|"]
    for row in rows:
        bounds = (("≥", row["min"]), ("≤", row["max"]))
        limit = ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)
        value = "" if row["value"] is None else f"{row['value']:.6g}"
        note = row["note"].replace("|", "\\|")
        out.append(f"| `{row['name']}` | {value} | {row['unit']} | {limit} | {row['status']} | {note} |")
    return "\n".join(out)


def blocks_table(outcomes: Sequence[Outcome]) -> str:
    """Return cells, area, flops and latches of every module with its submodules, over all
    instances.
    """
    out = [
        "| library | module | instances | cells | area, um2 | share | flops | latches |",
        "|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    for outcome in outcomes:
        made = outcome.hierarchical
        if made is None:
            continue
        blocks = sorted(made.blocks.items(), key=lambda item: -item[1]["area_um2"])
        for name, block in blocks:
            out.append(
                f"| {outcome.technology.name} | `{name}` | {block['instances']:.0f} | {block['cells']:.0f} "
                f"| {block['area_um2']:.0f} | {block['area_um2'] / made.area_um2:.1%} | {block['flops']:.0f} "
                f"| {block['latches']:.0f} |"
            )
    return "\n".join(out)


def write_docs(name: str, content: str) -> None:
    """Write a table between its marks in docs/synthesis.md."""
    begin, end = MARKS[name]
    write_between(ROOT / DOCS, begin, end, content)


# ---- commands ---------------------------------------------------------------------------------------------------


def technologies(name: str) -> list[Technology]:
    """Return the technologies of an option."""
    return list(TECHNOLOGIES.values()) if name == "both" else [TECHNOLOGIES[name]]


@click.command("synth")
@click.option(
    "--tech",
    type=click.Choice([*TECHNOLOGIES, "both"]),
    default="both",
    show_default=True,
    help="Cell library.",
)
@click.option("--rows", type=click.IntRange(1, 128), help="Rows of the array; default: models/design.toml.")
@click.option(
    "--cols", type=click.IntRange(1, 128), help="Columns of the array; default: models/design.toml."
)
@click.option("--code-bits", type=click.IntRange(1, 16), help="Bits of a code; default: models/design.toml.")
@click.option("--sync-latch", is_flag=True, help="Use the flip-flop + latch synchronizers.")
@click.option(
    "--sizes", is_flag=True, help="Map 8x8, 16x16, 64x64 and 16x1 instead; report area and highest clocks."
)
@click.option("--no-proof", is_flag=True, help="Skip the equivalence proof.")
@click.option("--docs", is_flag=True, help=f"Also write the tables of {DOCS}.")
@children.ending()
def synth_command(
    tech: str,
    rows: int | None,
    cols: int | None,
    code_bits: int | None,
    sync_latch: bool,
    sizes: bool,
    no_proof: bool,
    docs: bool,
) -> int:
    """Map rtl/ to cells, prove equivalence, analyse timing; write build/synth.json."""
    chosen = technologies(tech)
    own = any(option is not None for option in (rows, cols, code_bits)) or sync_latch
    if docs and (tech != "both" or own or no_proof):
        raise InputError("command line", "--docs", "a partial run", "a run with all options at default")
    if sizes and own:
        raise InputError("command line", "--sizes", "with a size", "one of both")
    for technology in chosen:
        for corner in technology.corners:
            technology.liberty(corner)
    if sizes:
        return _sizes_command(chosen, docs)
    base = default_size()
    size = Size(rows or base.rows, cols or base.cols, code_bits or base.code_bits, sync_latch)
    judged = constraint_rows()
    outcomes = []
    with progress.slots("synth", len(chosen), "libraries") as tell:
        for done, technology in enumerate(chosen):
            tell(done, f"{size.name} in {technology.name}")
            outcomes.append(synthesise(technology, size, equivalence=not no_proof))
            judged += outcomes[-1].rows
    verdict.write_rows("synth", judged)
    verdict.print_rows(judged, f"Synthesis of {size.name}, before layout")
    click.echo(blocks_table(outcomes))
    if docs and verdict.exit_code(judged) == 0:
        write_docs("synth", verdict_table(judged))
        write_docs(BLOCKS, blocks_table(outcomes))
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(judged)


def _sizes_command(chosen: Sequence[Technology], docs: bool) -> int:
    lines: list[SizeLine] = []
    judged: list[Row] = []
    bits = load_design().timing.code_bits
    runs = [(technology, Size(*size, bits)) for technology in chosen for size in SIZES]
    with progress.slots("synth", len(runs), "sizes") as tell:
        for done, (technology, size) in enumerate(runs):
            tell(done, f"{size.name} in {technology.name}")
            line, made = size_line(technology, size, limit_s=900.0)
            lines.append(line)
            judged += made
    verdict.write_rows("synth_sizes", judged)
    verdict.print_rows(judged, "Synthesis of sizes, before layout")
    click.echo(sizes_table(lines))
    if docs and verdict.exit_code(judged) == 0:
        write_docs("sizes", sizes_table(lines))
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(judged)
