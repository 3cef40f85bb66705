# SPDX-License-Identifier: Apache-2.0
"""`dermis accuracy`: measures and draws what accuracy costs in time; rows in build/accuracy.json."""

from __future__ import annotations

import itertools
import math
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from dermis.errors import InputError
from dermis.files import write_atomic, write_between
from dermis.report import verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from dermis.scene import design
from dermis.scene.design import ROOT
from tb.programs.accuracy import converter, figures, frames, transistors
from tb.programs.accuracy.point import Point, from_csv, pareto, point_name, to_csv
from tb.programs.bench import bench, bench_peers

OUT = ROOT / "build" / "accuracy"
DOCS = ROOT / "docs" / "accuracy.md"
BEGIN, END = "<!-- begin: accuracy (written by dermis accuracy --docs) -->", "<!-- end: accuracy -->"

_FIGURES = {
    "converter, no pole": "converter_ideal",
    "converter, amplifier pole": "converter_pole",
    frames.WORK: "frames_effects",
    frames.INTEGRATORS: "frames_integrators",
    transistors.WORK: "channel_sky130",
}
_ASKED_LSB = 0.1
"""What a reader asks of the picture of the frames: what does it take?"""


@dataclass(frozen=True)
class _Axes:
    """How a work is drawn: `floor` is where error 0 stands, with what the reference itself is good for."""

    time: str
    error: str
    lsb: float
    floor: float
    floor_words: str


def _axes(work: str) -> _Axes:
    design_packet_v = design.load().converter.packet_v
    if work == frames.WORK:
        # One code of 256 that is one off would be 0.004 LSB.
        words = "all 256 codes equal those of the 50-digit reference"
        error = "mean |code - reference| / LSB; certified: mean of the stated bound"
        return _Axes("processor time a frame / s", error, 1.0, 1e-3, words)
    if work == transistors.WORK:
        error = (
            f"largest difference of the integrator from the finest run / V  (1 LSB is {design_packet_v:g} V)"
        )
        # What ngspice prints and Newton leaves is some 1e-6 V: no difference is smaller.
        return _Axes("processor time a clock / s", error, design_packet_v, 1e-6, "tolerance of a voltage")
    words = "rounding of the reference as it is returned, in doubles"
    if work == frames.INTEGRATORS:
        error = f"largest error of an integrator in its gate / V  (1 LSB is a packet, {design_packet_v:g} V)"
        # Doubles carry 1e-16 V through 510 clocks of 1 V.
        return _Axes("processor time a frame / s", error, design_packet_v, 1e-14, words)
    packet_v = converter.IDEAL.packet_v
    error = f"largest error of the integrator at clock edges / V  (1 LSB is a packet, {packet_v:g} V)"
    # Doubles carry 1e-16 V through 400 clocks of 0.1 V.
    return _Axes("processor time a clock / s", error, packet_v, 1e-13, words)


def draw(points: Sequence[Point], directory: Path) -> None:
    """A figure a work."""
    directory.mkdir(parents=True, exist_ok=True)
    for work, file in _FIGURES.items():
        own = [p for p in points if p.work == work]
        if not own:
            continue
        axes = _axes(work)
        what = f"{converter.CLOCKS} clocks" if work in converter.CIRCUITS else "one row"
        what = "16 x 16" if work in (frames.WORK, frames.INTEGRATORS) else what
        figures.draw(
            own,
            directory / f"{file}.png",
            title=f"Accuracy against time: {work} ({what})",
            time_label=axes.time,
            error_label=axes.error,
            lsb=axes.lsb,
            floor=axes.floor,
            floor_words=axes.floor_words,
            wanted=_ASKED_LSB if work == frames.WORK else None,
        )


def ratios(points: Sequence[Point]) -> Iterator[Row]:
    """Cosim, and any of our engines, against the peers on one circuit; growth of the error with the step."""
    for work in converter.CIRCUITS:
        own = [p for p in points if p.work == work]
        ours = [p for p in own if p.method.startswith("cosim")]
        every = [p for p in own if not p.method.startswith("peer")]
        short = work.rsplit(", ", 1)[1].replace(" ", "_")
        all_peers: list[Point] = []
        for name in dict.fromkeys(p.method for p in own if p.method.startswith("peer")):
            theirs = [p for p in own if p.method == name]
            all_peers += theirs
            peer = name.rsplit(" ", 1)[1].lower()
            yield from _against(f"{short}.{peer}", ours, theirs)
            yield from _against(f"{short}.any_engine.{peer}", every, theirs)
        if all_peers:
            yield from _against(f"{short}.best_peer", ours, all_peers)
            yield from _against(f"{short}.any_engine.best_peer", every, all_peers)
        steps = [p for p in ours if p.method == "cosim, icarus, step"]
        if len(steps) > 1:
            errors = [p.error for p in steps]
            note = "largest over least error of cosim over all maximum steps"
            yield verdict.measured(f"accuracy.step_ratio.{short}", max(errors) / min(errors), "1", note)


def _at(front: Sequence[Point], error: float) -> float | None:
    """Time at which a front reaches an error; None where it never does.

    Between two settings of one method on a straight line in the logarithms; between two methods there is none.
    """
    if error < front[-1].error:
        return None
    if error >= front[0].error:
        return front[0].time_s
    pairs = itertools.pairwise(front)
    fast, slow = next((p, q) for p, q in pairs if q.error <= error < p.error)
    if fast.method != slow.method:
        return slow.time_s
    share = math.log(fast.error / error) / math.log(fast.error / slow.error)
    return fast.time_s * (slow.time_s / fast.time_s) ** share


def _against(name: str, ours: Sequence[Point], theirs: Sequence[Point]) -> Iterator[Row]:
    front = pareto(ours)
    speed = [(p.time_s / t, p) for p in pareto(theirs) if (t := _at(front, p.error)) is not None]
    if speed:
        ratio, at = min(speed, key=lambda pair: pair[0])
        note = "their time over ours to their error, the least over their front: "
        note += f"{at.method}, {at.setting}, {at.error:.2g} V"
        yield verdict.measured(f"accuracy.speed_at_equal_error.{name}", ratio, "1", note)
    else:
        yield verdict.error(f"accuracy.speed_at_equal_error.{name}", "none of our settings is as exact", "1")
    gains = []
    for point in pareto(theirs):
        within = [p.error for p in front if p.time_s <= point.time_s]
        if within:
            gains.append(point.error / max(min(within), 1e-16))
    if gains:
        note = f"their error over our least in no more time, the least over the {len(gains)} points of their front"
        yield verdict.measured(f"accuracy.error_at_equal_time.{name}", min(gains), "1", note)
    else:
        yield verdict.error(f"accuracy.error_at_equal_time.{name}", "none of our settings is as fast", "1")


def order_rows(work: Path) -> Iterator[Row]:
    """The order of convergence of the closed loop with an amplifier pole, which gates; and gear's, which is why not."""
    errors, orders = converter.orders(work)
    told = ", ".join(
        f"{e:.3g} V at {converter.step_words(h)}"
        for e, h in zip(errors, converter.ORDER_STEPS_S, strict=True)
    )
    note = f"least of {', '.join(f'{o:.3f}' for o in orders)}; {told}"
    yield verdict.judge("accuracy.order", min(orders), note)


def missing_rows() -> Iterator[Row]:
    """Peers that were not measured, and why."""
    for peer in bench_peers.GUESTS:
        if reason := bench_peers.missing(peer):
            yield verdict.skip(f"accuracy.peer.{peer}", reason)


def point_rows(points: Sequence[Point]) -> Iterator[Row]:
    """A row of error and time a point."""
    for p in points:
        least, most = min(p.seconds), max(p.seconds)
        note = f"{p.setting}; {p.time_s:.3g} s ({least:.3g} .. {most:.3g}, {len(p.seconds)} runs); "
        note += f"codes off by {p.largest_lsb:g} at most"
        yield verdict.report(point_name(p.work, p.method, p.setting), p.error, p.unit, note)


def table(points: Sequence[Point], rows: Sequence[Row]) -> str:
    """The tables of docs/accuracy.md."""
    lines = [
        f"Machine: {machine_line()}. Medians of {max(len(p.seconds) for p in points)} runs in turns.",
        "",
    ]
    for work in _FIGURES:
        own = [p for p in points if p.work == work]
        if not own:
            continue
        front = set(pareto(own))
        per = "frame" if work in (frames.WORK, frames.INTEGRATORS) else "clock"
        lines += [f"### {work.capitalize()}", "", f"![{work}](figures/accuracy_{_FIGURES[work]}.png)", ""]
        lines += [
            f"| method | setting | error, {own[0].unit} | largest of a code, LSB | s a {per} | on the front |"
        ]
        lines += ["|---|---|--:|--:|--:|---|"]
        for p in sorted(own, key=lambda p: p.time_s):
            mark = "yes" if p in front else ""
            lines.append(
                f"| {p.method} | {p.setting} | {p.error:.3g} | {p.largest_lsb:g} | {p.time_s:.3g} | {mark} |"
            )
        lines.append("")
    lines += ["### Ratios and gates", "", "| row | value | limit | status | note |", "|---|--:|---|---|---|"]
    for row in rows:
        value = "" if row["value"] is None else f"{row['value']:.4g}"
        low = "" if row["min"] is None else f"at least {row['min']:g}"
        high = "" if row["max"] is None else f"at most {row['max']:g}"
        lines.append(f"| `{row['name']}` | {value} | {low}{high} | {row['status']} | {row['note']} |")
    return "\n".join(lines)


def _copy_figures(docs: bool) -> None:
    for file in _FIGURES.values() if docs else ():
        shutil.copyfile(OUT / f"{file}.png", ROOT / "docs" / "figures" / f"accuracy_{file}.png")


def _refuse_contradictions(
    quick: bool, repeat: int | None, docs: bool, redraw: bool, only: str | None
) -> None:
    """Refuse what would be ignored, or would put a part of the measurement in the place of the whole.

    Raises
    ------
    InputError
        --redraw with what it does not read, --docs of a part, --quick with what it leaves out.
    """
    measured = {"--quick": quick, "--repeat": repeat is not None, "--only": only is not None}
    if redraw and (ignored := [name for name, given in measured.items() if given]):
        raise InputError("command line", "--redraw", f"with {' and '.join(ignored)}", "it by itself")
    if docs and (quick or only):
        raise InputError("command line", "--docs", "with --quick or --only", "a whole run")
    if quick and repeat is not None:
        raise InputError("command line", "--quick and --repeat", repeat, "one of the two")
    if quick and only == "sky130":
        raise InputError(
            "command line", "--only sky130", "with --quick", "a run without --quick, which skips it"
        )


@click.command("accuracy")
@click.option("--quick", is_flag=True, help="Fewer settings, once each, and none of --only sky130.")
@click.option("--repeat", type=click.IntRange(1, 99), help="Runs of each setting; default 3, with --quick 1.")
@click.option("--docs", is_flag=True, help="Also write docs/accuracy.md and docs/figures/accuracy_*.png.")
@click.option(
    "--redraw", is_flag=True, help="Only draw the figures again, from the csv files of the last run."
)
@click.option("--only", type=click.Choice(["order", "converter", "frames", "sky130"]), help="One part.")
def accuracy_command(quick: bool, repeat: int | None, docs: bool, redraw: bool, only: str | None) -> int:
    """What accuracy costs in simulation time: error against time, drawn, in build/accuracy."""

    def tell(words: str) -> None:
        click.echo(words, err=True)

    _refuse_contradictions(quick, repeat, docs, redraw, only)
    if redraw:
        files = [OUT / f"{file}.csv" for file in _FIGURES.values()]
        draw([point for file in files if file.exists() for point in from_csv(file.read_text())], OUT)
        _copy_figures(docs)
        return 0
    repeat = repeat or (1 if quick else 3)
    with tempfile.TemporaryDirectory(prefix="accuracy_") as scratch:
        work = Path(scratch)
        rows = [bench.busy_row("accuracy.busy_cores")]
        rows += order_rows(work) if only in (None, "order") else []
        points: list[Point] = []
        if only in (None, "converter"):
            more, failed = converter.measure(work, repeat, quick, tell)
            points += more
            rows += failed
        if only in (None, "frames"):
            more, gates = frames.measure(work / "frames", repeat, quick, tell)
            points += more
            rows += gates
        if only in (None, "sky130") and not quick:
            more, missing = transistors.measure(work / "channel", tell)
            points += more
            rows += missing
    if only in (None, "converter"):
        rows += [*ratios(points), *missing_rows()]
    if points:
        for work, file in _FIGURES.items():
            if own := [p for p in points if p.work == work]:
                write_atomic(OUT / f"{file}.csv", to_csv(own))
        draw(points, OUT)
    verdict.write_rows("accuracy", [*rows, *point_rows(points)])
    verdict.print_rows([*rows, *point_rows(points)], "What accuracy costs in time")
    if docs:
        write_between(DOCS, BEGIN, END, table(points, rows))
        _copy_figures(docs)
        click.echo("written: docs/accuracy.md")
    return verdict.exit_code(rows)
