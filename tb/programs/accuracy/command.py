# SPDX-License-Identifier: Apache-2.0
"""`dermis accuracy` measures and draws error against simulation time, `dermis accuracy-chip`
resolution against conversion time of the chip; rows in build/accuracy.json and
build/accuracy_chip.json.
"""

from __future__ import annotations

import itertools
import math
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from dermis.errors import DermisError, InputError
from dermis.files import write_atomic, write_between
from dermis.places import ROOT
from dermis.report import progress, verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from tb.programs.accuracy import chip, converter, figures, frames
from tb.programs.accuracy.figures import Scale
from tb.programs.accuracy.points import Method, Point, from_csv, measure, pareto, points_csv, to_csv
from tb.programs.bench import peers
from tb.programs.bench.measure import busy_row, markdown

OUT = ROOT / "build" / "accuracy"
DOCS = ROOT / "docs" / "accuracy.md"
BEGIN, END = "<!-- begin: accuracy (written by dermis accuracy --docs) -->", "<!-- end: accuracy -->"
SHOWN = (
    "accuracy.order",
    *(f"accuracy.{kind}.{pole}.best_peer" for kind in ("speed_at_equal_error", "error_at_equal_time")
      for pole in ("no_pole", "amplifier_pole")),
    "accuracy.step_ratio.no_pole",
)  # fmt: skip
"""Rows of the table in the documentation; build/accuracy.json has all."""

FILES = {
    "converter, no pole": "converter_ideal",
    "converter, amplifier pole": "converter_pole",
    frames.WORK: "frames_effects",
}
"""File of each work, csv and figure."""
# The floors: doubles carry 1e-16 V through 400 clocks of 0.1 V; one code of 256 off by one is
# 0.004 LSB.
_INTEGRATOR = Scale(
    "clock",
    f"largest error of the integrator / V  (1 LSB is a packet, {converter.IDEAL.packet_v:g} V)",
    converter.IDEAL.packet_v,
    1e-13,
    "rounding of the reference to doubles",
)
_CODES = Scale(
    "frame",
    "mean |code - reference| / LSB",
    1.0,
    1e-3,
    "all 256 codes exact",
    wanted=0.1,
)


def draw(points: Sequence[Point], directory: Path) -> None:
    """Draw a figure of each work."""
    directory.mkdir(parents=True, exist_ok=True)
    for work, file in FILES.items():
        if own := [p for p in points if p.work == work]:
            scale = _CODES if work == frames.WORK else _INTEGRATOR
            figures.work_precision(own, scale, directory / f"{file}.png")


def ratios(points: Sequence[Point]) -> Iterator[Row]:
    """Compare cosim, and any of our engines, with the best of the peers on one circuit; and the
    error over all steps.
    """
    for work in converter.CIRCUITS:
        own = [p for p in points if p.work == work]
        theirs = [p for p in own if p.method.startswith("peer")]
        every = [p for p in own if not p.method.startswith("peer")]
        ours = [p for p in every if p.method.startswith("cosim")]
        short = work.rsplit(", ", 1)[1].replace(" ", "_")
        if theirs and ours:
            yield from _against(f"{short}.best_peer", ours, theirs)
            yield from _against(f"{short}.any_engine.best_peer", every, theirs)
        errors = [p.error for p in ours if p.method == "cosim, icarus, step"]
        if len(errors) > 1:
            note = "largest over least error of cosim over all maximum steps"
            yield verdict.measured(f"accuracy.step_ratio.{short}", max(errors) / min(errors), "1", note)


def time_at(front: Sequence[Point], error: float) -> float | None:
    """Return the time at which a front reaches an error; None if it never does.

    Between two settings of one method it interpolates in the logarithms; between two methods it
    takes the slower.
    """
    if error < front[-1].error:
        return None
    if error >= front[0].error:
        return front[0].seconds
    fast, slow = next((p, q) for p, q in itertools.pairwise(front) if q.error <= error < p.error)
    if fast.method != slow.method:
        return slow.seconds
    share = math.log(fast.error / error) / math.log(fast.error / slow.error)
    return fast.seconds * (slow.seconds / fast.seconds) ** share


def _against(name: str, ours: Sequence[Point], theirs: Sequence[Point]) -> Iterator[Row]:
    front = pareto(ours)
    row = f"accuracy.speed_at_equal_error.{name}"
    if speed := [(p.seconds / t, p) for p in pareto(theirs) if (t := time_at(front, p.error)) is not None]:
        ratio, at = min(speed, key=lambda pair: pair[0])
        note = "their time over ours at equal error, the lowest over their front: "
        yield verdict.measured(row, ratio, "1", f"{note}{at.method}, {at.setting}, {at.error:.2g} V")
    else:
        yield verdict.error(row, "none of our settings is as exact", "1")
    row = f"accuracy.error_at_equal_time.{name}"
    within = [(p, [q.error for q in front if q.seconds <= p.seconds]) for p in pareto(theirs)]
    if gains := [p.error / max(min(errors), 1e-16) for p, errors in within if errors]:
        note = f"their error over ours at equal time, the lowest over the {len(gains)} points of their front"
        yield verdict.measured(row, min(gains), "1", note)
    else:
        yield verdict.error(row, "none of our settings is as fast", "1")


def _refuse_contradictions(
    quick: bool, repeat: int | None, docs: bool, redraw: bool, only: str | None
) -> None:
    """Refuse options that would be ignored, or would publish a part of the measurement as the
    whole.

    Raises
    ------
    InputError
        --redraw with options of a measurement, --docs of a part, --quick with --repeat.
    """
    given = {"--quick": quick, "--repeat": repeat is not None, "--only": only is not None}
    if redraw and (ignored := [name for name, on in given.items() if on]):
        raise InputError("command line", "--redraw", f"with {' and '.join(ignored)}", "it by itself")
    if docs and (quick or only):
        raise InputError("command line", "--docs", "with --quick or --only", "a whole run")
    if quick and repeat is not None:
        raise InputError("command line", "--quick and --repeat", repeat, "one of the two")


def _copy_figures(out: Path, files: Sequence[str]) -> None:
    """Copy the figures that a page shows."""
    for file in files:
        target = ROOT / "docs" / "figures" / f"accuracy_{file}.png"
        if target.exists():
            shutil.copyfile(out / f"{file}.png", target)


def _measured(batches: dict[str, list[Method]], repeat: int) -> tuple[list[Point], list[Row]]:
    """Run all methods by work, with progress; return points, and ERROR rows of failures."""
    points: list[Point] = []
    failed: list[Row] = []
    done = itertools.count()
    runs = sum(method.runs(repeat) for methods in batches.values() for method in methods)
    with progress.slots("accuracy", runs, "runs") as show:
        for work, methods in batches.items():
            more, wrong = measure(work, methods, repeat, lambda words: show(next(done), words))
            points += more
            failed += wrong
    return points, failed


PARTS = ("order", "converter", "frames")


@click.command("accuracy")
@click.option("--quick", is_flag=True, help="Fewer settings, one run each.")
@click.option("--repeat", type=click.IntRange(1, 99), help="Runs of each setting; default 3, with --quick 1.")
@click.option("--docs", is_flag=True, help="Also write the table and figures of docs/accuracy.md.")
@click.option(
    "--redraw", is_flag=True, help="Draw the figures from the csv files of the last run; measure nothing."
)
@click.option("--only", type=click.Choice(PARTS), help="Run one part.")
def accuracy_command(quick: bool, repeat: int | None, docs: bool, redraw: bool, only: str | None) -> int:
    """Measure and draw error against simulation time, in build/accuracy."""

    _refuse_contradictions(quick, repeat, docs, redraw, only)
    if redraw:
        files = [OUT / f"{file}.csv" for file in FILES.values()]
        draw([point for file in files if file.exists() for point in from_csv(file.read_text())], OUT)
        if docs:
            _copy_figures(OUT, list(FILES.values()))
        return 0
    parts = [only] if only else PARTS
    rows, points = [busy_row("accuracy.busy_cores")], []
    with tempfile.TemporaryDirectory(prefix="accuracy_") as scratch:
        work = Path(scratch)
        if "order" in parts:
            rows.append(converter.order_row(work))
            if not only:
                verdict.print_rows(rows, "First: the order of convergence")
        every = frames.Frames(work / "frames")
        batches = converter.batches(work, quick) if "converter" in parts else {}
        if "frames" in parts:
            batches[frames.WORK] = list(every.methods(quick))
        points, failed = _measured(batches, repeat or (1 if quick else 3))
        rows += [*failed, *ratios(points)]
        if "converter" in parts:
            missing = {peer: peers.missing(peer) for peer in peers.GUESTS}
            rows += [verdict.skip(f"accuracy.peer.{peer}", why) for peer, why in missing.items() if why]
    for name, file in FILES.items():
        if own := [p for p in points if p.work == name]:
            write_atomic(OUT / f"{file}.csv", points_csv(own))
    draw(points, OUT)
    shown = [*rows, *(point.row() for point in points)]
    verdict.write_rows("accuracy", shown)
    verdict.print_rows(shown, "Accuracy against simulation time")
    if docs:
        write_between(DOCS, BEGIN, END, f"Machine: {machine_line()}.\n\n{markdown(rows, SHOWN)}")
        _copy_figures(OUT, list(FILES.values()))
        click.echo("written: docs/accuracy.md")
    return verdict.exit_code(rows)


# ---- the chip ---------------------------------------------------------------------------------------------------

CHIP_BEGIN, CHIP_END = "<!-- begin: chip (written by dermis accuracy-chip --docs) -->", "<!-- end: chip -->"
CHIP_SHOWN = tuple(
    f"accuracy_chip.{name}"
    for name in (
        "paper_point_bits",
        "formula_difference_bits",
        "droop_cost_bits",
        "residue_gain_bits",
        "waiting_ends_clocks.5mhz",
        "energy_nj",
        "energy_per_bit_nj",
    )
)
CHIP_FIGURES = {"chip_resolution": figures.resolution, "chip_frame_rates": figures.frame_rates}


def chip_rows(out: Path) -> list[Row]:
    """Make every curve, the csv of each and the figures in a directory; return the rows."""
    out.mkdir(parents=True, exist_ok=True)
    current, reason = None, ""
    try:
        current = chip.channel_current()
    except DermisError as error:
        reason = f"no supply current was measured: {error}"
    every = [chip.gate_of(n) for n in chip.BITS]
    gates, reading = chip.gate_points(), chip.read_points(chip.READINGS, every)
    drooping = chip.read_points(chip.DROOP, every, chip.frame_duty)
    curves = {"gate": gates, "ways": reading, "droop": drooping, "split": list(chip.split())}
    for name, points in curves.items():
        text = to_csv([chip.cells(p, current and current.typical) for p in points])
        write_atomic(out / f"chip_{name}.csv", text)
    for name, draw_figure in CHIP_FIGURES.items():
        draw_figure(gates, out / f"{name}.png")
    return chip.rows_of(gates, reading, drooping) + chip.energy_rows(gates, current, reason)


@click.command("accuracy-chip")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Directory for csv and figures; default build/accuracy."
)
@click.option("--docs", is_flag=True, help="Also write the table and the figures of docs/accuracy.md.")
def accuracy_chip_command(out: Path | None, docs: bool) -> int:
    """Measure resolution against conversion time on the chip: curves, csv and figures."""
    out = OUT if out is None else out
    rows = chip_rows(out)
    verdict.write_rows("accuracy_chip", rows)
    verdict.print_rows(rows, "Conversion time against resolution")
    if docs:
        write_between(DOCS, CHIP_BEGIN, CHIP_END, markdown(rows, CHIP_SHOWN))
        _copy_figures(out, list(CHIP_FIGURES))
    return verdict.exit_code(rows)
