# SPDX-License-Identifier: Apache-2.0
"""Figures of error against time: work-precision diagrams of the simulator, and resolution curves of
the chip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, NullLocator

from dermis.report.figures import COLOURS, GREY, RED, end_labels, save
from dermis.scene import design
from tb.programs.accuracy import chip
from tb.programs.accuracy.points import Point, pareto

_MARKERS = "osD^vP*X<>"


# ---- the simulator ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scale:
    """Texts and limits of the axes of a work-precision diagram.

    Attributes
    ----------
    unit_of_time : clock or frame
    error : label of the error, with its unit
    lsb : one LSB in the unit of the error
    floor : value at which error 0 is drawn, above the reference's own error
    floor_words : meaning of the floor
    wanted : an error in LSB; the subtitle gives its time, and the error at a tenth of that time
    """

    unit_of_time: str
    error: str
    lsb: float
    floor: float
    floor_words: str
    wanted: float | None = None


def work_precision(points: Sequence[Point], scale: Scale, path: Path) -> None:
    """Draw error against time of the points of one work, with the Pareto front; peers have open
    markers.
    """
    figure = Figure(figsize=(11.5, 6.2), layout="constrained")
    axes = figure.add_subplot()
    floor, lsb, wanted = scale.floor, scale.lsb, scale.wanted
    for i, name in enumerate(dict.fromkeys(p.method for p in points)):
        own = [p for p in points if p.method == name]
        axes.plot(
            [p.seconds for p in own], [max(p.error, floor) for p in own], _MARKERS[i % len(_MARKERS)],
            color=COLOURS[i % len(COLOURS)], ms=7, mfc="none" if name.startswith("peer") else None, label=name,
        )  # fmt: skip
    front = pareto(points)
    steps = {"drawstyle": "steps-post", "color": "#444444", "linewidth": 6, "alpha": 0.18, "zorder": 0}
    axes.plot([p.seconds for p in front], [max(p.error, floor) for p in front], label="Pareto front", **steps)
    at_edge = {"transform": axes.get_yaxis_transform(), "fontsize": 8}
    lines = [(1.0, "1 LSB", GREY), (0.5, "1/2 LSB", GREY)]
    for share, words, colour in [*lines, *([(wanted, f"{wanted:g} LSB", RED)] if wanted else [])]:
        axes.axhline(share * lsb, color=colour, linewidth=0.9, linestyle=":")
        axes.text(0.995, share * lsb, words, color=colour, ha="right", va="bottom", **at_edge)
    axes.set_xscale("log")
    axes.set_yscale("log")
    least = min(p.error for p in points)
    bottom = floor / 6 if least < 30 * floor else least / 10
    if bottom < floor:
        axes.axhspan(floor / 10, floor, color="#DDDDDD", alpha=0.6, zorder=-1)
        axes.text(0.005, 0.7 * floor, f"0: {scale.floor_words}", va="top", color="#444444", **at_edge)
    axes.set_ylim(bottom, max(4 * lsb, 4 * max(p.error for p in points)))
    axes.set_xlabel(f"processor time a {scale.unit_of_time} / s")
    axes.set_ylabel(scale.error)
    title = [f"Error against time: {points[0].work}", *(_tenth(front, wanted, lsb) if wanted else [])]
    axes.set_title("\n".join(title), fontsize=10, loc="left")
    axes.grid(which="major", linewidth=0.4, alpha=0.6)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    save(figure, path)


def _tenth(front: Sequence[Point], wanted: float, lsb: float) -> list[str]:
    """Return the time of an accuracy and of exact codes, each with the error in a tenth of that
    time.
    """
    said = []
    for words, error in ((f"{wanted:g} LSB", wanted * lsb), ("every code exact", 0.0)):
        enough = [p for p in front if p.error <= error]
        if enough:
            took = enough[0]
            within = [p for p in front if p.seconds <= took.seconds / 10.0]
            left = f"{within[-1].error / lsb:.2g} LSB" if within else "no method is so fast"
            said.append(
                f"{words}: {seconds_words(took.seconds)} ({took.setting}); in a tenth of that: {left}"
            )
    return said


def seconds_words(seconds: float) -> str:
    """Return a time in two digits, in s, ms, us or ns."""
    return EngFormatter("s", places=None)(float(f"{seconds:.2g}")).replace("\N{MICRO SIGN}", "u")


# ---- the chip ---------------------------------------------------------------------------------------------------


def _curves(
    axes: Any, points: Sequence[chip.Point], x: Callable[[chip.Point], float], by_clock: bool = False
) -> None:
    """Draw bits of each curve with its spread over seeds, its name at its end; or of each clock,
    with a legend.
    """

    def name(p: chip.Point) -> str:
        return f"{1e-6 * p.f_clk_hz:g} MHz" if by_clock else p.curve

    ends = []
    points = sorted(points, key=lambda p: p.f_clk_hz)
    for colour, kind in zip(COLOURS, dict.fromkeys(map(name, points)), strict=False):
        own = sorted((p for p in points if name(p) == kind), key=x)
        at, bits = [x(p) for p in own], np.array([p.bits for p in own])
        around = [bits - [p.bits_least for p in own], [p.bits_most for p in own] - bits]
        style = {"marker": "o", "markersize": 3, "linewidth": 1.2, "capsize": 1.5, "color": colour}
        axes.errorbar(at, bits, yerr=around, label=kind, **style)
        ends.append((at[-1], float(bits[-1]), kind, colour))
    axes.grid(True, alpha=0.3)
    axes.set_ylabel("effective resolution / bits")
    if by_clock:  # all end at one height
        axes.legend(fontsize=8, loc="lower right", frameon=False)
        return
    axes.figure.draw_without_rendering()
    end_labels(axes, ends)


def _star(axes: Any, x: float) -> None:
    axes.plot(x, chip.PAPER_BITS, "*", markersize=15, color=RED, zorder=5)
    place = {"textcoords": "offset points", "xytext": (10, -12), "fontsize": 8, "color": RED}
    axes.annotate("the paper", (x, chip.PAPER_BITS), **place)


def resolution(points: Sequence[chip.Point], path: Path) -> None:
    """Draw bits against gate length at the paper's clock, effect by effect, and against row time by
    clock.
    """
    figure = Figure(figsize=(15, 5.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        axes.set_ylim(2.5, 15.5)
    left.set_xscale("log", base=2)
    right.set_xscale("log")
    _curves(left, [p for p in points if p.f_clk_hz == chip.PAPER_HZ], lambda p: p.gate_clocks)
    gates = [chip.gate_of(n) for n in chip.BITS]
    by_formula = [chip.formula(chip.PAPER_HZ, g) for g in gates]
    left.plot(gates, by_formula, "x", color=GREY, ms=5)
    left.text(gates[-1], 2.8, "x: quantisation and noise by formula", fontsize=8, color=GREY, ha="right")
    wanted = chip.PAPER_BITS + np.log2(10.0)
    for bits, words, colour in (
        (wanted, "0.1 LSB of 8 bits", RED),
        *((chip.drifted(k), f"reference {k} K off its calibration (formula)", GREY) for k in (1, 30)),
    ):
        left.axhline(bits, color=colour, linestyle=":", linewidth=1)
        left.text(14, bits + 0.08, words, fontsize=8, color=colour)
    left.set_title("\n".join(["Gate at 5 MHz, engine event, median of three seeds", *_gates(points, wanted)]),
                   fontsize=9, loc="left")  # fmt: skip
    left.set_xlabel("gate / clocks")
    full = [p for p in points if p.curve == chip.FULL]
    _curves(right, full, lambda p: 1e6 * p.slot_s, by_clock=True)
    for name, slot_s in chip.SLOTS_S.items():
        right.axvline(1e6 * slot_s, color=GREY, linestyle=":", linewidth=1)
        right.text(1e6 * slot_s, 15.3, name + " ", rotation=90, fontsize=8, ha="right", va="top", color=GREY)
    right.set_title("All effects, by clock (frame rates: 16 rows)", fontsize=9, loc="left")
    right.set_xlabel("time of one row / us: 23 us to settle and the gate")
    _star(left, chip.gate_of(chip.PAPER_BITS))
    _star(right, 125)
    save(figure, path)


def _gates(points: Sequence[chip.Point], wanted: float) -> list[str]:
    """Return the gate for `wanted` bits, and the error with a tenth of it."""
    said = []
    for words, curve in (("without the range switch", chip.SETTLED), ("all effects", chip.FULL)):
        gate = chip.gate_for(points, curve, wanted)
        if gate is None:
            best = max(p.bits for p in chip.curve_of(points, curve))
            said.append(f"0.1 LSB, {words}: never; at best {2.0 ** (chip.PAPER_BITS - best):.2f} LSB")
            continue
        lsb = 2.0 ** (chip.PAPER_BITS - chip.bits_at(points, curve, gate / 10.0))
        time = seconds_words(gate / chip.PAPER_HZ)
        said.append(f"0.1 LSB, {words}: {gate:.0f} clocks, {time}; in a tenth of that: {lsb:.2g} LSB")
    return said


def frame_rates(points: Sequence[chip.Point], path: Path) -> None:
    """Draw bits against frame rate for each array size, one panel a clock."""
    figure = Figure(figsize=(15, 5), layout="constrained")
    full_n = design.load().sensor.force_max_n
    for axes, f in zip(figure.subplots(1, 3, sharey=True), (5e6, 20e6, 50e6), strict=True):
        curve = chip.curve_of(points, chip.FULL, f)
        for colour, size in zip(COLOURS, chip.SIZES, strict=False):
            rate = [chip.frame_hz(size, p.slot_s) for p in curve]
            axes.plot(rate, [p.bits for p in curve], color=colour, label=f"{size}x{size}", linewidth=1.3)
        axes.set_xscale("log")
        axes.set_xlabel("frames a second, 23 us to settle")
        axes.set_title(f"{1e-6 * f:g} MHz", fontsize=10)
        axes.grid(True, alpha=0.3)
        if f == chip.PAPER_HZ:
            axes.set_ylabel("effective resolution / bits, all effects")
            axes.legend(fontsize=8, loc="lower left", frameon=False)
            _star(axes, 500)
    right = axes.secondary_yaxis(
        "right", functions=(lambda b: full_n / 2.0**b, lambda n: np.log2(full_n / np.maximum(n, 1e-9)))
    )
    right.set_ylabel("step of the equivalent quantiser / N")
    right.yaxis.set_minor_locator(NullLocator())
    right.set_yticks([1, 0.3, 0.1, 0.03, 0.01])
    right.yaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:g}"))
    save(figure, path)
