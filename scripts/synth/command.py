# SPDX-License-Identifier: Apache-2.0
"""Synthesis of rtl/ in two cell libraries: mapping, equivalence, static timing, table of sizes.

Every figure is parsed from the output of a tool; a failure or an unexpected warning gives an ERROR
row.
"""

import functools
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.scene.design import ROOT
from dermis.scene.design import load as load_design
from scripts import markdown
from scripts.judged import SHOW, attempt, finish
from scripts.synth.cells import TECHNOLOGIES, Technology
from scripts.synth.equivalence import prove
from scripts.synth.map import RAM, Netlist, Size, map_design, map_once
from scripts.synth.timing import ASYNC, CLOCKS, GATING, SDC, Path_, Timing

DOCS = "docs/synthesis.md"
SIZES = ((8, 8), (16, 16), (64, 64), (16, 1))  # small, the paper's, large, and one column
# Above this number of bits, Yosys takes minutes for a frame memory of latches; it is left out, with a note.
MEMORY_LIMIT_BITS = 20_000


def place(technology: Technology, size: Size, what: str = "") -> Path:
    """Return the directory of a netlist below build/."""
    return ROOT / "build" / "synth" / technology.name / f"{size.name}{what}"


def sdc_periods(sdc: Path = SDC) -> dict[str, float]:
    """Return the default periods of the constraint file in ns; InputError if one is missing."""
    found = dict(re.findall(r"\{ set (\w+)_period ([\d.]+) \}", sdc.read_text()))
    if missing := [clock for clock in CLOCKS if clock not in found]:
        raise InputError(sdc, f"{missing[0]}_period", "not there", "its default, in ns")
    return {clock: float(found[clock]) for clock in CLOCKS}


def netlist_rows(netlist: Netlist, size: Size, suffix: str, *, memory: bool = True) -> list[verdict.Row]:
    """Judge the contents of a flat netlist, with its frame memory or as it is without."""
    intended = size.latches + size.memory_bits * memory
    unreset = size.memory_flops * memory
    latch, n = netlist.technology.latch, netlist
    latches = n.kinds[latch]
    counts = f"{n.latches} latches, {latches} of them {latch}, {intended} intended"
    flops = f"{n.unreset} flops without reset, {unreset} of them at the frame memory"
    error = abs(latches - intended) + abs(n.latches - latches)
    judged = {
        "inferred_latches": (n.inferred_latches,),
        "latch_count_error": (error, counts),
        "unreset_flop_error": (abs(n.unreset - unreset), flops),
        "unmapped_cells": (sum(n.unmapped.values()), ", ".join(sorted(n.unmapped)[:3])),
        "fanout": n.fanout,
    }
    return [
        *(verdict.judge(f"synth.{name}.{suffix}", *found) for name, found in judged.items()),
        verdict.report(f"synth.cells.{suffix}", n.cells, "cells"),
        verdict.report(f"synth.area_um2.{suffix}", n.area_um2, "um2"),
        verdict.report(f"synth.flops.{suffix}", n.flops, "flops", f"and {n.latches} latches"),
    ]


def timing_rows(netlist: Netlist, suffix: str) -> list[verdict.Row]:
    """Judge setup at the slow corner and hold at the fast one, and report the highest clocks."""
    periods, technology = sdc_periods(), netlist.technology
    slow, fast = (
        Timing(technology, corner, netlist.verilog, netlist.directory)
        for corner in (technology.slow, technology.fast)
    )

    def said(at: Timing, path: Path_) -> str:
        early, late = technology.derates(at.corner)
        factor = late if path.kind == "max" else early
        derate = f", delays x {factor:g}" if factor != 1.0 else ""
        return f"corner {at.corner}{derate}; {path}"

    setup = slow.worst(periods)
    untimed = slow.untimed()
    hold = setup if slow == fast else fast.worst(periods)
    rows: list[verdict.Row] = []

    def add(name: str, value: float, unit: str, note: str) -> None:
        rows.append(verdict.measured(f"{name}.{suffix}", value, unit, note))

    add("synth.untimed_pins", len(untimed), "pins", ", ".join(untimed[:3]))
    named = {clock: (f"setup_slack_ns.{clock}", f"hold_slack_ns.{clock}") for clock in CLOCKS}
    named |= {GATING: ("gating_setup_slack_ns", "gating_hold_slack_ns")}
    named |= {ASYNC: ("recovery_slack_ns", "removal_slack_ns")}
    for group, names in named.items():
        tree = "; one gate drives all, before the tree of layout" if group == ASYNC else ""
        worst = (slow, setup[group, "max"]), (fast, hold[group, "min"])
        for name, (at, path) in zip(names, worst, strict=True):
            add(f"synth.{name}", path.slack_ns, "ns", f"{said(at, path)}{tree}")
    skew, width = slow.skew_ns("charge_o*", periods)
    note = f"corner {slow.corner}; rise and fall of a column differ by {width:.2f} ns, a gain of all columns"
    add("synth.charge_skew_ns", skew, "ns", note)
    add("safe.off_ns", slow.to_safe_ns(periods), "ns", f"corner {slow.corner}, from enable_i")
    for clock, path in slow.crossings(periods).items():
        add(f"synth.crossing_slack_ns.{clock}", path.slack_ns, "ns", said(slow, path))
    for clock, (period_ns, path) in slow.highest(periods).items():
        add(f"synth.highest_mhz.{clock}", 1e3 / period_ns, "MHz", said(slow, path))
    return rows


def equivalence_row(netlist: Netlist, size: Size, suffix: str) -> verdict.Row:
    proof = prove(netlist, size.parameters, netlist.directory / "equivalence")
    name = f"synth.not_equivalent.{suffix}"
    note = f"{proof.state_bits} state bits, {proof.outputs} functions"
    note += f", {proof.unpaired} state bits without a partner are free" if proof.unpaired else ""
    if proof.proved is None:
        return verdict.error(name, f"not decided; {note}; {proof.said}")
    return verdict.judge(name, 0 if proof.proved else 1, note if proof.proved else f"{note}; {proof.said}")


def synthesise(technology: Technology, size: Size, *, equivalence: bool = True) -> list[verdict.Row]:
    """Map one size in one library; return the rows that judge it."""
    suffix, rows, made = f"{technology.name}.{size.name}", list[verdict.Row](), None
    start = time.perf_counter()
    with attempt(rows, f"synth.netlist.{suffix}"):
        made = map_once(technology, size.parameters, place(technology, size), fresh=True)
        rows += netlist_rows(made, size, suffix)
    if made:
        with attempt(rows, f"synth.timing.{suffix}"):
            rows += timing_rows(made, suffix)
    if made and equivalence:
        with attempt(rows, f"synth.not_equivalent.{suffix}"):
            rows.append(equivalence_row(made, size, suffix))
    with attempt(rows, f"synth.blocks.{suffix}"):
        whole = map_design(technology, size.parameters, place(technology, size), hierarchical=True)
        name = f"synth.area_by_blocks_um2.{suffix}"
        rows.append(verdict.report(name, whole.area_um2, "um2", "hierarchy kept"))
        # Of each module, submodules and all instances included.
        for name, block in sorted(whole.blocks.items(), key=lambda item: -item[1]["area_um2"]):
            note = f"{block['instances']} instances: {block['cells']} cells, {block['flops']} flops"
            name = f"synth.block_um2.{name}.{suffix}"
            rows.append(verdict.report(name, block["area_um2"], "um2", note))
    seconds = time.perf_counter() - start
    rows.append(verdict.report(f"synth.seconds.{suffix}", seconds, "s", "all of the above"))
    return rows


def constraint_rows() -> list[verdict.Row]:
    """Judge the clock period of the constraint file against the design."""
    wanted = 1e9 / load_design().converter.f_clk_hz
    error, note = abs(sdc_periods()["clk"] - wanted), f"{SDC.name} against {wanted:g} ns of design.toml"
    return [verdict.judge("synth.clk_period_error_ns", error, note)]


def size_rows(technology: Technology, size: Size) -> list[verdict.Row]:
    """Map a size without its frame memory, then one bank; the highest clocks are those with memory.

    Above MEMORY_LIMIT_BITS the memory is a black box in the timing, and its area is scaled from a
    smaller bank.
    """
    suffix, rows = f"{technology.name}.{size.name}", list[verdict.Row]()
    whole = size.memory_bits <= MEMORY_LIMIT_BITS

    def fmax(made: Netlist) -> list[verdict.Row]:
        directory = made.directory / "sizes"
        at = Timing(technology, technology.slow, made.verilog, directory, black_boxes=not whole)
        return [
            verdict.measured(f"synth.highest_mhz.{clock}.{suffix}", 1e3 / period_ns, "MHz", str(path))
            for clock, (period_ns, path) in at.highest(sdc_periods()).items()
        ]

    with attempt(rows, f"synth.netlist.{suffix}.no_memory"):
        directory = place(technology, size, "_no_memory")
        made = map_design(technology, size.parameters, directory, black_box_memory=True)
        own = netlist_rows(made, size, f"{suffix}.no_memory", memory=False)
        rows += own if whole else own + fmax(made)
    with attempt(rows, f"synth.memory_um2.{suffix}"):
        words = size.bank_bytes if whole else MEMORY_LIMIT_BITS // 16
        bank = map_design(technology, {"WORDS": words}, place(technology, size, "_bank"), top=RAM)
        per_bit = bank.area_um2 / bank.latches
        note = "two banks" if whole else f"from {bank.latches} bits, {per_bit:.1f} um2 each"
        rows.append(verdict.report(f"synth.memory_um2.{suffix}", per_bit * size.memory_bits, "um2", note))
    if whole:
        with attempt(rows, f"synth.netlist.{suffix}"):
            made = map_once(technology, size.parameters, place(technology, size))
            rows += netlist_rows(made, size, suffix) + fmax(made)
    return rows


def write_docs(command: str, **contents: str) -> None:
    """Write tables of a command between their marks in docs/synthesis.md."""
    for name, content in contents.items():
        markdown.write(ROOT / DOCS, name, command, content)
    click.echo(f"written: {DOCS}")


def sizes_table(rows: Sequence[verdict.Row]) -> str:
    """Return a line of Markdown for each library and size of `dermis synth --sizes`."""
    value = {row["name"].removeprefix("synth."): row["value"] for row in rows}
    cells = (key.split(".", 1)[1] for key in value if key.startswith("cells."))
    lines = []
    for name in dict.fromkeys(key.removesuffix(".no_memory") for key in cells):
        count, flops, core = (value[f"{what}.{name}.no_memory"] for what in ("cells", "flops", "area_um2"))
        timed = f"area_um2.{name}" in value
        whole = value[f"area_um2.{name}"] if timed else core + value[f"memory_um2.{name}"]
        clocks = (f"{value[f'highest_mhz.{clock}.{name}']:.1f}" for clock in ("clk", "sck"))
        areas = (f"{1e-6 * area:.4f}" for area in (core, whole))
        lines.append((*name.split("."), str(count), str(flops), *areas, *clocks, "yes" if timed else "no"))
    head = "library|size|cells|flops|area, mm2|with memory, mm2|clk, MHz|SCK, MHz|memory timed".split("|")
    return markdown.table(head, lines, "---|---|--:|--:|--:|--:|--:|--:|---")


def size_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the options of `dermis synth` and `dermis gl`: library, size, tables of the docs.

    The command gets the libraries, the size, and True if one of these is not the default.
    """

    @functools.wraps(command)
    def call(tech: str, sync_latch: bool, code_bits: int | None = None, **more: Any) -> int:
        design, rows, cols = load_design(), more.pop("rows"), more.pop("cols")
        size = (rows or design.array.rows, cols or design.array.cols, code_bits or design.timing.code_bits)
        chosen = [TECHNOLOGIES[name] for name in (TECHNOLOGIES if tech == "both" else (tech,))]
        return command(chosen, Size(*size, sync_latch), bool(rows or cols or code_bits or sync_latch), **more)

    default = "default: models/design.toml."
    for option in (
        click.option("--docs", is_flag=True, help=f"Also write the tables of {DOCS}."),
        click.option("--sync-latch", is_flag=True, help="Use the flip-flop + latch synchronizers."),
        click.option("--cols", type=click.IntRange(1, 128), help=f"Columns of the array; {default}"),
        click.option("--rows", type=click.IntRange(1, 128), help=f"Rows of the array; {default}"),
        click.option(
            "--tech", type=click.Choice([*TECHNOLOGIES, "both"]), default="both", help="Cell library."
        ),
    ):
        call = option(call)
    return call


@click.command("synth", context_settings=SHOW)
@size_options
@click.option("--code-bits", type=click.IntRange(1, 16), help="Bits of a code; default: models/design.toml.")
@click.option("--sizes", is_flag=True, help="Map four array sizes instead; report area and clocks.")
@click.option("--no-proof", is_flag=True, help="Skip the equivalence proof.")
@children.ending()
def synth_command(
    chosen: list[Technology], size: Size, own: bool, sizes: bool, no_proof: bool, docs: bool
) -> int:
    """Map rtl/ to cells, prove equivalence, analyse timing; write build/synth.json."""
    if docs and (len(chosen) < len(TECHNOLOGIES) or own or no_proof):
        raise InputError("command line", "--docs", "a partial run", "a run with all options at default")
    if sizes and own:
        raise InputError("command line", "--sizes", "with a size", "one of both")
    for technology in chosen:
        for corner in technology.corners:
            technology.liberty(corner)
    judged: list[verdict.Row] = [] if sizes else constraint_rows()
    wanted = [Size(*one, size.code_bits) for one in SIZES] if sizes else [size]
    runs = [(technology, one) for technology in chosen for one in wanted]
    with progress.slots("synth", len(runs), "runs") as tell:
        for done, (technology, one) in enumerate(runs):
            tell(done, f"{one.name} in {technology.name}")
            if sizes:
                judged += size_rows(technology, one)
            else:
                judged += synthesise(technology, one, equivalence=not no_proof)
    title = "Synthesis of sizes" if sizes else f"Synthesis of {size.name}"
    code = finish("synth_sizes" if sizes else "synth", judged, f"{title}, before layout")
    if code == 0 and docs and sizes:
        write_docs("synth --sizes", sizes=sizes_table(judged))
    elif code == 0 and docs:
        blocks = [row for row in judged if row["name"].startswith("synth.block_um2.")]
        whole = markdown.rows_table(row for row in judged if row not in blocks)
        write_docs("synth", synth=whole, blocks=markdown.rows_table(blocks))
    return code
