# SPDX-License-Identifier: Apache-2.0
"""Table and figures of docs/characterise.md: residual, input resistance, settling, mismatch."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dermis.chip import spice_batch
from dermis.chip.sky130 import CORNERS
from dermis.report import verdict
from dermis.report.figures import BLUE, GREEN, GREY, ORANGE, RED, save
from dermis.report.output import machine_line
from dermis.scene.design import ROOT
from scripts import markdown
from scripts.characterise import benches
from scripts.characterise.benches import BENCHES
from scripts.characterise.results import Series, limit_of
from scripts.characterise.runs import TYPICAL, Job, Outcome, Runs

DOCS = ROOT / "docs" / "characterise.md"
FIGURES = ROOT / "docs" / "figures"

COLOURS = dict(zip(CORNERS, ("black", RED, BLUE, GREEN, ORANGE), strict=True))
SPREADS = {
    "column_offset_v": (1e6, "offset of a column in its gate / uV"),
    "amplifier_offset_v": (1e3, "offset of an amplifier by itself / mV"),
    "chain_gain_error.k80": (100, "gain of conveyor and mirror, error / %"),
    "chain_code_inl_lsb.k80": (1, "conveyor and mirror, largest residual against 1/R / LSB"),
    "packet_error.sink": (100, "packet, error / %"),
    "preset_error_v.sink": (1e3, "preset, error / mV"),
    "comparator_delay_s": (1e9, "delay of the comparator / ns"),
    "comparator_offset_v": (1e3, "offset of the comparator / mV"),
    "reference_error": (100, "unit of the reference, error / %"),
}
"""Quantities whose mismatch is drawn: factor from SI, and words."""

Outcomes = Mapping[Job, Outcome]


def table(found: Sequence[Series], runs: Runs) -> str:
    """Return every row: least, typical, most, limits, the worst place."""
    measured = [o.measured for o in runs.outcomes.values() if o.measured is not None]
    seconds, climbed = sum(m.seconds for m in measured), sum(bool(m.rungs) for m in measured)
    failed = sum(bool(o.fault) for o in runs.outcomes.values())
    told = (
        f"{len(runs.outcomes)} runs of ngspice {spice_batch.version()}, {seconds / 60:.0f} minutes of wall clock in "
        f"ngspice, with other work beside them ({machine_line()}); "
        f"{climbed} needed a further rung of the ladder, {failed} ended as ERROR. "
        "A row again: `dermis characterise --only sky130.ROW` and the condition under *worst*."
    )
    rows = []
    for one in found:
        row, values = one.row(), one.values.values()
        numbers = (min(values, default=None), one.typical, max(values, default=None))
        cells = ["" if number is None else f"{number:.3g}" for number in numbers]
        cells += [markdown.limits(row["min"], row["max"]), row["unit"], row["status"]]
        rows.append([one.name, *cells, f"`{one.worst}`" if values else ""])
    head = ("row", "least", "typical", "most", "limit", "unit", "status", "worst")
    text = textwrap.fill(told, 100, break_long_words=False, break_on_hyphens=False)
    return "\n".join([text, "", markdown.table(head, rows, "---|--:|--:|--:|---|---|---|---")])


def _corner_lines(
    axes: Any, outcomes: Outcomes, bench: str, across: Sequence[float], up: Callable[[Outcome], Any]
) -> bool:
    """Draw a line a condition in the colour of its corner, thick for typical; return True if any."""
    drawn = False
    for job, outcome in outcomes.items():
        condition = job.condition
        if job.bench != bench or job.numerics or outcome.fault or outcome.measured is None:
            continue
        if condition.sample is None and condition.corner in CORNERS:
            look = {"linewidth": 2.2} if condition == TYPICAL else {"linewidth": 0.7, "alpha": 0.6}
            axes.plot(across, up(outcome), color=COLOURS[condition.corner], **look)
            drawn = True
    for corner, colour in COLOURS.items():
        axes.plot([], [], color=colour, label=corner)
    axes.legend(fontsize=8, ncol=5)
    axes.grid(True, alpha=0.3)
    return drawn


def residual(outcomes: Outcomes, figure: Figure) -> None:
    """Draw the code error against the current of a taxel, by range."""
    for axes, k in zip(figure.subplots(2, 2, sharex=True).flat, (80, 20, 40, 160), strict=True):
        _corner_lines(
            axes,
            outcomes,
            f"chain_k{k}",
            [255 * share for share in benches.SHARES],
            lambda o, k=k: benches.code_residual_lsb(o.measured.values, k),
        )
        for name, style in (("sky130.typical.code_inl_lsb", ":"), ("sky130.code_inl_lsb", "--")):
            for side in (-1, 1):
                axes.axhline(side * verdict.limit(name).max, color=GREY, linestyle=style, linewidth=1)
        axes.set_title(f"k = {k}, {1e6 * benches.chain_full_a(k):g} uA at full scale", fontsize=10)
        axes.set_ylabel("residual / LSB")
        axes.set_xlabel("current of the taxel / codes of full scale")


def input_resistance(outcomes: Outcomes, figure: Figure) -> None:
    """Draw the input impedance of the conveyor against frequency."""
    axes, f_hz = figure.subplots(), benches.R_X_HZ
    if _corner_lines(axes, outcomes, "r_x", f_hz, lambda o: [o.values[f"r_x_ohm.f{f}"] for f in f_hz]):
        axes.set(xscale="log", yscale="log")
    axes.axhline(verdict.limit("sky130.conveyor_r_x_ohm.k80").max, color=GREY, linestyle="--", linewidth=1)
    axes.set(xlabel="frequency / Hz", ylabel="input resistance / ohm")
    axes.set_title("Conveyor at 1 mA, 400 pF of the column included", fontsize=10)


def settling(outcomes: Outcomes, figure: Figure) -> None:
    """Draw the column after a change of rows, from a full to an open taxel."""
    axes, (*times, end) = figure.subplots(), benches.SETTLING_NS

    def distance(outcome: Outcome) -> list[float]:
        # The final voltage of a column is its offset, so the last value is the reference.
        last = outcome.values[f"settling_v.t{end}"]
        return [1e6 * abs(outcome.values[f"settling_v.t{t}"] - last) for t in times]

    if _corner_lines(axes, outcomes, "settling_low", [1e-3 * t for t in times], distance):
        axes.set_yscale("log")
    half_code_uv = 1e6 * 0.5 / benches.CODES_A_UNIT["column_offset_v"]
    axes.axhline(half_code_uv, color=GREY, linestyle="--", linewidth=1)
    axes.set_xlabel("time behind the change of rows / us")
    axes.set_ylabel(f"distance of the column from where it is at {1e-3 * end:g} us / uV")
    axes.set_title("500 ohm -> 64.25 kohm; dashed: half a code where 16 taxels are pressed", fontsize=10)


def mismatch(outcomes: Outcomes, figure: Figure) -> None:
    """Draw histograms over the draws of the mismatch, with the limits."""
    for axes, (name, (factor, words)) in zip(figure.subplots(3, 3).flat, SPREADS.items(), strict=True):
        drawn = [
            factor * o.values[name]
            for job, o in outcomes.items()
            if job.condition.sample is not None and name in BENCHES[job.bench].units and not o.fault
        ]
        axes.hist(drawn, bins=20, color=BLUE)
        rule = limit_of(f"mismatch.{name}")
        for edge in () if rule is None else (rule.min, rule.max):
            if edge is not None:
                axes.axvline(factor * edge, color=RED, linestyle="--", linewidth=1)
        axes.set_xlabel(words)
        if len(drawn) > 1:
            spread = np.std(drawn, ddof=1)
            axes.set_title(f"{np.mean(drawn):.3g} +- {spread:.2g}, {len(drawn)} draws", fontsize=9)


DRAWN: dict[str, tuple[Callable[[Outcomes, Figure], None], tuple[float, float]]] = {
    "residual": (residual, (13.5, 6.5)),
    "input_resistance": (input_resistance, (8.0, 4.8)),
    "settling": (settling, (8.0, 4.8)),
    "mismatch": (mismatch, (13.5, 9.0)),
}
"""Figures with their size in inches."""


def write(found: Sequence[Series], runs: Runs) -> None:
    markdown.write(DOCS, "table", "characterise", table(found, runs))
    for name, (draw, size) in DRAWN.items():
        figure = Figure(figsize=size, layout="constrained")
        draw(runs.outcomes, figure)
        save(figure, Path(FIGURES / f"characterise_{name}.png"))
