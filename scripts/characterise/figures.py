# SPDX-License-Identifier: Apache-2.0
"""Pictures of the characterisation: residual, input resistance, settling, mismatch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dermis.chip.sky130 import CORNERS
from dermis.report import verdict
from dermis.report.figures import BLUE, GREEN, GREY, ORANGE, RED, save
from scripts.characterise import benches
from scripts.characterise.benches import BENCHES, Condition
from scripts.characterise.run_all import TYPICAL, Job, Outcome

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


def _of(outcomes: Outcomes, bench: str) -> dict[Condition, Outcome]:
    """Return the results of a bench at all measured conditions with nominal passives and without mismatch."""
    return {
        job.condition: outcome
        for job, outcome in outcomes.items()
        if job.bench == bench
        and not job.numerics
        and not outcome.fault
        and job.condition.sample is None
        and job.condition.corner in CORNERS
    }


def _corner_lines(axes: Any, lines: Mapping[Condition, tuple[Sequence[float], Sequence[float]]]) -> None:
    """A thin line a condition in the colour of its corner, a thick one for typical."""
    for condition, (x, y) in lines.items():
        axes.plot(x, y, color=COLOURS[condition.corner], linewidth=0.7, alpha=0.6)
    if TYPICAL in lines:
        axes.plot(*lines[TYPICAL], color=COLOURS["tt"], linewidth=2.2)
    for corner, colour in COLOURS.items():
        axes.plot([], [], color=colour, label=corner)
    axes.legend(fontsize=8, ncol=5)
    axes.grid(True, alpha=0.3)


def residual(outcomes: Outcomes, path: Path) -> None:
    """Draw the code error against the current of a taxel, by range."""
    figure = Figure(figsize=(13.5, 6.5), layout="constrained")
    for axes, k in zip(figure.subplots(2, 2, sharex=True).flat, (80, 20, 40, 160), strict=True):
        found = _of(outcomes, f"chain_k{k}")
        share = [255 * s for s in benches.SHARES]
        lines = {
            c: (share, benches.code_residual_lsb(o.measured.values, k))
            for c, o in found.items()
            if o.measured is not None
        }
        _corner_lines(axes, lines)
        for name, style in (("sky130.typical.code_inl_lsb", ":"), ("sky130.code_inl_lsb", "--")):
            edge = verdict.limit(name).max
            for side in (-1, 1):
                axes.axhline(side * edge, color=GREY, linestyle=style, linewidth=1)
        axes.set_title(f"k = {k}, {1e6 * benches.chain_full_a(k):g} uA at full scale", fontsize=10)
        axes.set_ylabel("residual / LSB")
        axes.set_xlabel("current of the taxel / codes of full scale")
    save(figure, path)


def input_resistance(outcomes: Outcomes, path: Path) -> None:
    """Draw the input impedance of the conveyor against frequency."""
    figure = Figure(figsize=(8.0, 4.8), layout="constrained")
    axes = figure.subplots()
    lines = {
        c: (benches.R_X_HZ, [o.values[f"r_x_ohm.f{f}"] for f in benches.R_X_HZ])
        for c, o in _of(outcomes, "r_x").items()
    }
    _corner_lines(axes, lines)
    axes.axhline(verdict.limit("sky130.conveyor_r_x_ohm.k80").max, color=GREY, linestyle="--", linewidth=1)
    if lines:
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("input resistance / ohm")
    axes.set_title("Conveyor at 1 mA, 400 pF of the column included", fontsize=10)
    save(figure, path)


def settling(outcomes: Outcomes, path: Path) -> None:
    """Draw the column after a change of rows, from a full to an open taxel."""
    figure = Figure(figsize=(8.0, 4.8), layout="constrained")
    axes = figure.subplots()
    microseconds = [1e-3 * t for t in benches.SETTLING_NS]
    # The final voltage of a column is its offset, so the last value is the reference.
    last = f"settling_v.t{benches.SETTLING_NS[-1]}"
    lines = {
        c: (
            microseconds[:-1],
            [1e6 * abs(o.values[f"settling_v.t{t}"] - o.values[last]) for t in benches.SETTLING_NS[:-1]],
        )
        for c, o in _of(outcomes, "settling_low").items()
    }
    _corner_lines(axes, lines)
    half_code_uv = 1e6 * 0.5 / benches.CODES_A_UNIT["column_offset_v"]
    axes.axhline(half_code_uv, color=GREY, linestyle="--", linewidth=1)
    if lines:
        axes.set_yscale("log")
    axes.set_xlabel("time behind the change of rows / us")
    axes.set_ylabel(f"distance of the column from where it is at {microseconds[-1]:g} us / uV")
    axes.set_title("500 ohm -> 64.25 kohm; dashed: half a code where 16 taxels are pressed", fontsize=10)
    save(figure, path)


def mismatch(outcomes: Outcomes, path: Path) -> None:
    """Histograms over the draws of the mismatch, with the limits."""
    figure = Figure(figsize=(13.5, 9.0), layout="constrained")
    for axes, (name, (factor, words)) in zip(figure.subplots(3, 3).flat, SPREADS.items(), strict=True):
        drawn = [
            factor * o.values[name]
            for job, o in outcomes.items()
            if job.condition.sample is not None and name in BENCHES[job.bench].units and not o.fault
        ]
        axes.hist(drawn, bins=20, color=BLUE)
        try:
            rule = verdict.limit(f"sky130.mismatch.{name}")
        except KeyError:
            rule = None
        for edge in () if rule is None else (rule.min, rule.max):
            if edge is not None:
                axes.axvline(factor * edge, color=RED, linestyle="--", linewidth=1)
        axes.set_xlabel(words)
        if len(drawn) > 1:
            spread = np.std(drawn, ddof=1)
            axes.set_title(f"{np.mean(drawn):.3g} +- {spread:.2g}, {len(drawn)} draws", fontsize=9)
    save(figure, path)


FIGURES = {
    "residual": residual,
    "input_resistance": input_resistance,
    "settling": settling,
    "mismatch": mismatch,
}
