# SPDX-License-Identifier: Apache-2.0
"""Work-precision diagrams: error against time, log-log, Pareto front and the lines of 1 and 1/2 LSB."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dermis.report.figures import BLUE, GREEN, GREY, ORANGE, RED, save
from tb.programs.accuracy.point import Point, pareto

_COLOURS = (BLUE, GREEN, ORANGE, RED, "#CC79A7", "#56B4E9", "#000000", "#8B6F00", GREY)
_MARKERS = "osD^vP*X<>"


def draw(
    points: Sequence[Point],
    path: Path,
    *,
    title: str,
    time_label: str,
    error_label: str,
    lsb: float,
    floor: float,
    floor_words: str,
    wanted: float | None = None,
) -> None:
    """Draw the points of one work.

    Parameters
    ----------
    points : those of one work
    path : where the PNG goes
    title, time_label, error_label : words, labels with their units
    lsb : one LSB in the unit of the error
    floor : error 0 is drawn here, and the reference's own error is said to lie below
    floor_words : what lies there
    wanted : an error in LSB; the time that it takes, and what a tenth of that time leaves, are said in the picture
    """
    figure = Figure(figsize=(10.5, 6.2), layout="constrained")
    axes = figure.add_subplot()
    names = list(dict.fromkeys(p.method for p in points))
    for i, name in enumerate(names):
        own = sorted((p for p in points if p.method == name), key=lambda p: p.time_s)
        x, y = [p.time_s for p in own], [max(p.error, floor) for p in own]
        peer = name.startswith("peer")
        falls = all(a >= b for a, b in itertools.pairwise(y))
        axes.plot(
            x,
            y,
            marker=_MARKERS[i % len(_MARKERS)],
            color=_COLOURS[i % len(_COLOURS)],
            linestyle="--" if peer else "-" if falls else "",  # a line that turns back says nothing
            linewidth=1.2,
            markersize=7,
            markerfacecolor="none" if peer else None,
            label=name,
        )
    front = pareto(points)
    axes.plot(
        [p.time_s for p in front],
        [max(p.error, floor) for p in front],
        drawstyle="steps-post",
        color="#444444",
        linewidth=6,
        alpha=0.18,
        label="Pareto front",
        zorder=0,
    )
    for point in _apart(front, floor):
        axes.annotate(
            point.setting,
            (point.time_s, max(point.error, floor)),
            textcoords="offset points",
            xytext=(8, 8),
            fontsize=8,
            color="#333333",
        )
    for share, words in ((1.0, "1 LSB"), (0.5, "1/2 LSB")):
        axes.axhline(share * lsb, color=GREY, linewidth=0.9, linestyle=":")
        axes.text(
            0.995,
            share * lsb,
            words,
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            fontsize=9,
        )
    if wanted is not None:
        _tenth(axes, front, wanted, lsb)
    least = min(p.error for p in points)
    bottom = floor / 6 if least < 30 * floor else least / 10
    if bottom < floor:
        axes.axhspan(floor / 10, floor, color="#DDDDDD", alpha=0.6, zorder=-1)
        across = axes.get_yaxis_transform()
        axes.text(0.005, 0.7 * floor, floor_words, transform=across, va="top", fontsize=8, color="#444444")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(bottom, max(4 * lsb, 4 * max(p.error for p in points)))
    axes.set_xlabel(time_label)
    axes.set_ylabel(error_label)
    axes.set_title(title, fontsize=11)
    axes.grid(which="major", linewidth=0.4, alpha=0.6)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    save(figure, path)


def _tenth(axes: Any, front: Sequence[Point], wanted: float, lsb: float) -> None:
    """Say what an accuracy takes, what a tenth of that time leaves, and the same for no error at all."""
    said = []
    for words, error in ((f"{wanted:g} LSB", wanted * lsb), ("every code exact", 0.0)):
        enough = [p for p in front if p.error <= error]
        if not enough:
            continue
        took = enough[0]
        said.append(f"{words}: {seconds_words(took.time_s)} ({took.method}; {took.setting})")
        within = [p for p in front if p.time_s <= took.time_s / 10.0]
        if within:
            said.append(f"   a tenth of that time: {within[-1].error / lsb:.2g} LSB")
        else:
            fast = front[0]
            said.append(
                f"   a tenth of that time: nothing runs so fast; the fastest, {seconds_words(fast.time_s)}, "
                f"is {fast.error / lsb:.2g} LSB off"
            )
    axes.axhline(wanted * lsb, color=RED, linewidth=1, linestyle="--")
    across = axes.get_yaxis_transform()
    axes.text(
        0.995,
        wanted * lsb,
        f"{wanted:g} LSB",
        transform=across,
        ha="right",
        va="bottom",
        fontsize=9,
        color=RED,
    )
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": RED, "alpha": 0.9}
    axes.text(
        0.985,
        0.36,
        "\n".join(said),
        transform=axes.transAxes,
        ha="right",
        va="bottom",
        ma="left",
        fontsize=8.5,
        bbox=box,
    )


def seconds_words(seconds: float) -> str:
    """A time in two digits, in s, ms, us or ns."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{float(f'{seconds / size:.2g}'):g} {unit}"
    return f"{float(f'{seconds / 1e-9:.2g}'):g} ns"


def _apart(front: Sequence[Point], floor: float) -> list[Point]:
    """Points of a front whose words do not run into each other: one of those close together."""
    named: list[Point] = []
    for point in front:
        near = named and point.time_s < 2.0 * named[-1].time_s
        if not (near and max(point.error, floor) > 0.5 * max(named[-1].error, floor)):
            named.append(point)
    return named
