# SPDX-License-Identifier: Apache-2.0
"""`dermis accuracy`: measure and draw error against simulation time; rows in
build/accuracy.json.
"""

from __future__ import annotations

import functools
import itertools
import math
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from dermis.errors import InputError
from dermis.files import write_atomic, write_between
from dermis.places import ROOT
from dermis.report import progress, verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from dermis.scene import design
from tb.programs.accuracy import converter, figures, frames
from tb.programs.bench import peers
from tb.programs.bench.measure import Point, busy_row, from_csv, markdown, pareto, to_csv

OUT = ROOT / "build" / "accuracy"
DOCS = ROOT / "docs" / "accuracy.md"
BEGIN, END = "<!-- begin: accuracy (written by dermis accuracy --docs) -->", "<!-- end: accuracy -->"
SHOWN = (
    "accuracy.order",
    "accuracy.outside_certified",
    *(f"accuracy.{kind}.{pole}.best_peer" for kind in ("speed_at_equal_error", "error_at_equal_time")
      for pole in ("no_pole", "amplifier_pole")),
    "accuracy.step_ratio.no_pole",
)  # fmt: skip
"""Rows of the table in the documentation; build/accuracy.json has all."""

FILES = {
    "converter, no pole": "converter_ideal",
    "converter, amplifier pole": "converter_pole",
    frames.WORK: "frames_effects",
    frames.INTEGRATORS: "frames_integrators",
    frames.CHANNEL: "channel_sky130",
}
"""File of each work, csv and figure."""
_ASKED_LSB = 0.1


def draw(points: Sequence[Point], directory: Path) -> None:
    """Draw a figure of each work."""
    directory.mkdir(parents=True, exist_ok=True)
    packet_v, small_v = design.load().converter.packet_v, converter.IDEAL.packet_v
    integrator = "largest error of an integrator / V  (1 LSB is a packet, {:g} V)"
    exact = "rounding of the reference to doubles"
    # Label of the error, LSB, and the floor: one code of 256 off by one is 0.004 LSB; doubles carry
    # 1e-16 V through 400 clocks of 0.1 V and 510 of 1 V; Newton's method leaves some 1e-6 V in
    # transistors.
    kinds = {
        frames.WORK: (
            "mean |code - reference| / LSB; certified: mean of the stated bound", 1.0, 1e-3, "all 256 codes exact"
        ),
        frames.INTEGRATORS: (integrator.format(packet_v), packet_v, 1e-14, exact),
        frames.CHANNEL: (
            f"largest difference from the finest run / V  (1 LSB is {packet_v:g} V)", packet_v, 1e-6, "tolerance"
        ),
    }  # fmt: skip
    for work, file in FILES.items():
        if own := [p for p in points if p.work == work]:
            label, lsb, floor, words = kinds.get(work, (integrator.format(small_v), small_v, 1e-13, exact))
            figures.work_precision(
                own,
                directory / f"{file}.png",
                title=f"Error against time: {work}",
                time_label=f"processor time a {'frame' if work.startswith('frames') else 'clock'} / s",
                error_label=label,
                lsb=lsb,
                floor=floor,
                floor_words=words,
                wanted=_ASKED_LSB if work == frames.WORK else None,
            )


def ratios(points: Sequence[Point]) -> Iterator[Row]:
    """Compare cosim, and any of our engines, with the peers on one circuit; and the error over all
    steps.
    """
    for work in converter.CIRCUITS:
        own = [p for p in points if p.work == work]
        every = [p for p in own if not p.method.startswith("peer")]
        ours = [p for p in every if p.method.startswith("cosim")]
        short = work.rsplit(", ", 1)[1].replace(" ", "_")
        theirs: dict[str, list[Point]] = {}
        for point in own:
            if point.method.startswith("peer"):
                theirs.setdefault(point.method.rsplit(" ", 1)[1].lower(), []).append(point)
        if theirs:
            theirs["best_peer"] = [p for points in theirs.values() for p in points]
        for peer, found in theirs.items():
            yield from _against(f"{short}.{peer}", ours, found)
            yield from _against(f"{short}.any_engine.{peer}", every, found)
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
        return front[0].time_s
    fast, slow = next((p, q) for p, q in itertools.pairwise(front) if q.error <= error < p.error)
    if fast.method != slow.method:
        return slow.time_s
    share = math.log(fast.error / error) / math.log(fast.error / slow.error)
    return fast.time_s * (slow.time_s / fast.time_s) ** share


def _against(name: str, ours: Sequence[Point], theirs: Sequence[Point]) -> Iterator[Row]:
    front = pareto(ours)
    row = f"accuracy.speed_at_equal_error.{name}"
    if speed := [(p.time_s / t, p) for p in pareto(theirs) if (t := time_at(front, p.error)) is not None]:
        ratio, at = min(speed, key=lambda pair: pair[0])
        note = "their time over ours at equal error, the lowest over their front: "
        yield verdict.measured(row, ratio, "1", f"{note}{at.method}, {at.setting}, {at.error:.2g} V")
    else:
        yield verdict.error(row, "none of our settings is as exact", "1")
    row = f"accuracy.error_at_equal_time.{name}"
    within = {p: [q.error for q in front if q.time_s <= p.time_s] for p in pareto(theirs)}
    if gains := [p.error / max(min(errors), 1e-16) for p, errors in within.items() if errors]:
        note = f"their error over ours at equal time, the lowest over the {len(gains)} points of their front"
        yield verdict.measured(row, min(gains), "1", note)
    else:
        yield verdict.error(row, "none of our settings is as fast", "1")


def point_rows(points: Sequence[Point]) -> Iterator[Row]:
    """Yield a row of error and time for each point."""
    for p in points:
        spread = f"{p.time_s:.3g} s ({min(p.seconds):.3g} .. {max(p.seconds):.3g}, {len(p.seconds)} runs)"
        note = f"{p.setting}; {spread}; codes off by {p.largest_lsb:g} at most"
        yield verdict.report(p.name, p.error, p.unit, note)


def _copy_figures() -> None:
    for file in FILES.values():
        target = ROOT / "docs" / "figures" / f"accuracy_{file}.png"
        if target.exists():  # the pages show some of them
            shutil.copyfile(OUT / f"{file}.png", target)


def _refuse_contradictions(
    quick: bool, repeat: int | None, docs: bool, redraw: bool, only: str | None
) -> None:
    """Refuse options that would be ignored, or would publish a part of the measurement as the
    whole.

    Raises
    ------
    InputError
        --redraw with options of a measurement, --docs of a part, --quick with a part that it skips.
    """
    given = {"--quick": quick, "--repeat": repeat is not None, "--only": only is not None}
    if redraw and (ignored := [name for name, on in given.items() if on]):
        raise InputError("command line", "--redraw", f"with {' and '.join(ignored)}", "it by itself")
    if docs and (quick or only):
        raise InputError("command line", "--docs", "with --quick or --only", "a whole run")
    if quick and repeat is not None:
        raise InputError("command line", "--quick and --repeat", repeat, "one of the two")
    if quick and only == "sky130":
        raise InputError(
            "command line", "--only sky130", "with --quick", "a run without --quick, which skips it"
        )


PARTS = ("order", "converter", "frames", "sky130")


@click.command("accuracy")
@click.option("--quick", is_flag=True, help="Fewer settings, one run each, without part sky130.")
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
            _copy_figures()
        return 0
    repeat = repeat or (1 if quick else 3)
    points: list[Point] = []
    rows = [busy_row("accuracy.busy_cores")]
    parts = [part for part in PARTS if only in (None, part) and not (quick and part == "sky130")]
    shown = progress.slots("accuracy", len(parts), "parts")
    with shown as show, tempfile.TemporaryDirectory(prefix="accuracy_") as scratch:
        work = Path(scratch)
        for done, part in enumerate(parts):
            tell = functools.partial(show, done)
            tell(part)
            if part == "order":
                rows.append(converter.order_row(work))
            elif part == "converter":
                more, failed = converter.measured(work, repeat, quick, tell)
                points += more
                rows += [*failed, *ratios(more)]
                missing = {peer: peers.missing(peer) for peer in peers.GUESTS}
                rows += [verdict.skip(f"accuracy.peer.{peer}", why) for peer, why in missing.items() if why]
            elif part == "frames":
                more, gates = frames.measured(work / "frames", repeat, quick, tell)
                points += more
                rows += gates
            else:
                more, gates = frames.channel(work / "channel", tell)
                points += more
                rows += gates
    for work_name, file in FILES.items():
        if own := [p for p in points if p.work == work_name]:
            write_atomic(OUT / f"{file}.csv", to_csv([p.columns() for p in own]))
    draw(points, OUT)
    every = [*rows, *point_rows(points)]
    verdict.write_rows("accuracy", every)
    verdict.print_rows(every, "Accuracy against simulation time")
    if docs:
        write_between(DOCS, BEGIN, END, f"Machine: {machine_line()}.\n\n{markdown(rows, SHOWN)}")
        _copy_figures()
        click.echo("written: docs/accuracy.md")
    return verdict.exit_code(rows)
