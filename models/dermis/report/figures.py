# SPDX-License-Identifier: Apache-2.0
"""Figures of a run: force and code maps, code against force with its fit, transients."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dermis.engines import Result
from dermis.files import atomic
from dermis.records import Plan
from dermis.report import waves

# Okabe and Ito: distinct for colour-blind readers as well.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#666666"
COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "black", "#56B4E9", "#8B6F00", GREY)
DPI = 130
Fit = tuple[float, float, NDArray[np.float64]]

POINTS_MAX = 5000
"""Most points drawn one by one; more are counted in bins."""


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    FigureCanvasAgg(figure)
    with atomic(path) as file:
        figure.savefig(file, dpi=DPI, format="png")


def cloud(axes: Any, x: NDArray[Any], y: NDArray[Any], label: str) -> None:
    """Draw points; more than `POINTS_MAX` as their number in each cell of a grid."""
    if x.size <= POINTS_MAX:
        axes.plot(x, y, ".", color=BLUE, ms=4, label=label)
        return
    cells = axes.hexbin(x, y, gridsize=200, cmap="Blues", norm="log", mincnt=1, vmin=0.3, rasterized=True)
    axes.figure.colorbar(cells, ax=axes, label=f"{label} in each cell")


def _layout(rows: int, cols: int) -> tuple[list[list[str]], tuple[float, float]]:
    """Return places of maps and curves, and the size of the figure, for the shape of an array."""
    if rows > 1.5 * cols:
        return [["press", "codes", "curve"], ["press", "codes", "rest"]], (12, 6.2)
    if cols > 1.5 * rows:
        return [["press", "curve"], ["codes", "rest"]], (12, 5.4)
    return [["press", "codes"], ["curve", "rest"]], (11, 7.6)


def _top(made: Plan, codes: NDArray[Any]) -> int:
    """Return the code at the end of the scales: full scale, halved while every code, read or ideal, is below half."""
    top = made.timing.code_max
    most = max(codes.max(initial=0), made.timing.gate_clocks * made.duty_ideal().max(initial=0.0))
    while top > 15 and most < top // 2:
        top //= 2
    return top


def strongest(codes: NDArray[Any]) -> tuple[int, str]:
    """Return the frame with the largest sum of codes, and its words behind a title; "" for the only frame."""
    frame = int(np.argmax(codes.reshape(len(codes), -1).sum(axis=1, dtype=float)))
    return frame, f", frame {frame} of 0 to {len(codes) - 1}" if len(codes) > 1 else ""


def frame_figure(made: Plan, codes: NDArray[Any], fit: Fit | None, path: Path) -> Figure:
    """Draw one run as PNG: stimulus and codes of the strongest frame on one scale, code against force, residual.

    `codes` are [frames, rows, cols]; `fit` is slope (codes a newton), offset and residuals of the taxels below
    saturation, or None.
    """
    places, size = _layout(made.rows, made.cols)
    figure = Figure(figsize=size, layout="constrained")
    if places[0] == ["press", "codes"]:
        # Each row is laid out by itself, so that the lower one is as wide as maps and colour scale.
        parts = figure.subfigures(2, 1, height_ratios=[1.3, 1])
        axes = {name: found for part, row in zip(parts, places, strict=True)
                for name, found in part.subplot_mosaic([row]).items()}  # fmt: skip
    else:
        parts, axes = [figure], figure.subplot_mosaic(places)
    frame, which = strongest(codes)
    code_max, top = made.timing.code_max, _top(made, codes)
    steps = made.timing.gate_clocks * made.part(frame, frame + 1).duty_ideal()[0]
    maps = {"press": np.minimum(steps, code_max), "codes": codes[frame]}
    ticks = [round(top * part / 4) for part in range(5)]
    ideal_n = made.force_of_duty(np.outer(ticks, np.ones(made.cols)) / made.timing.gate_clocks)
    # Columns of another k have forces of their own for a code.
    alike = bool((ideal_n == ideal_n[:, :1]).all())
    stimulus = "Stimulus: force on the taxel" if alike else "Stimulus: ideal code of the force, by its column"
    titles = f"{stimulus}{which}", f"Code that the chip reports{which}"
    for (name, values), title in zip(maps.items(), titles, strict=True):
        image = axes[name].imshow(values, cmap="viridis", interpolation="nearest", vmin=0, vmax=top)
        axes[name].set(xlabel="column", ylabel="row")
        axes[name].set_title(title, fontsize=10)
        axes[name].locator_params(integer=True, min_n_ticks=1)
    both = [axes["press"], axes["codes"]]
    bar = parts[0].colorbar(image, ax=both, ticks=ticks, label="code (ideal force)" if alike else "code")
    forces = [f"  ({force:.3g} N)" if alike else "" for force in ideal_n[:, 0]]
    bar.ax.set_yticklabels(list(map("{}{}".format, ticks, forces)), fontsize=8)
    _curves(made, codes, top, fit, axes["curve"], axes["rest"])
    save(figure, path)
    return figure


def _curves(made: Plan, codes: NDArray[Any], top: int, fit: Fit | None, curve: Any, rest: Any) -> None:
    """Draw code against force of every taxel with the fitted line, and the residual."""
    full_n = float(made.force_of_duty(np.full(made.cols, top / made.timing.gate_clocks)).max())
    if not math.isfinite(full_n):  # no force reaches full scale: as far as there are forces
        full_n = max(1.0, float(made.force_n.max(initial=0.0, where=np.isfinite(made.force_n))))
    ticks = [n for n in MaxNLocator(6).tick_values(0.0, full_n) if 0 <= n < 0.93 * full_n] + [full_n]
    force = made.force_n.ravel()
    shown = np.isfinite(force) & (force <= 1.2 * full_n)  # a short is as good as an infinite force
    if shown.any():
        cloud(curve, force[shown], codes.ravel()[shown], f"{int(shown.sum())} of {force.size} codes")
    if fit is not None:
        line, label = np.array([0.0, (top - fit[1]) / fit[0]]), f"{fit[0]:.3f} codes/N {fit[1]:+.3f}"
        curve.plot(line, fit[0] * line + fit[1], color=ORANGE, lw=1, label=label)
    curve.set(ylim=(-0.03 * top, 1.05 * top), ylabel="code")
    curve.set_title("Code against force", fontsize=10)
    if curve.get_legend_handles_labels()[0]:
        curve.legend(frameon=False, fontsize=8, loc="lower right")
    rest.set_title("Residual of the fit, below saturation", fontsize=10)
    rest.set_ylabel("code - fit / LSB")
    for axes in (curve, rest):
        limits = -0.02 * full_n, 1.02 * force[shown].max(initial=full_n)
        axes.set(xlabel="force on the taxel / N", xlim=limits, xticks=ticks)
        axes.set_xticklabels([f"{n:.3g}" for n in ticks])
        axes.grid(alpha=0.3)
    if fit is None:
        rest.set_yticks([])
        rest.text(0.5, 0.5, "no line to fit", ha="center", transform=rest.transAxes)
        return
    below = np.isfinite(made.force_n) & (made.timing.gate_clocks * made.duty_ideal() <= made.timing.code_max)
    cloud(rest, made.force_n[below], fit[2], f"{int(below.sum())} codes")
    for limit in (-0.5, 0.5):
        rest.axhline(limit, color=GREY, lw=0.8, ls="--")
    most = 1.1 * max(1.0, float(np.abs(fit[2]).max()))
    rest.set_ylim(-most, most)


def transient_figure(made: Plan, result: Result, path: Path) -> None:
    """Draw the paper's Fig. 11 as PNG: integrators and charge switches of taxels of a row after the preset.

    `result` is a recorded co-simulation.
    """
    record = result.info["records"][0]
    time_s, v_int = waves.integrator_waves(record, made.cols)
    charge, preset = record["trace"]["charge"], record["trace"]["preset"]
    delay = record["charge_delay_clocks"]
    t_clk = 1.0 / made.timing.f_clk_hz
    duty = np.minimum(made.duty_ideal()[0], 1.0)
    row = int(np.argmax(duty.sum(axis=1)))
    columns = _spread(duty[row])
    start = [n + 1 for n in range(1, len(preset)) if preset[n - 1] and not preset[n]][row]
    clocks = min(40, len(charge) - start)  # a short gate in the last row
    first, last = (start - 3) * t_clk, (start + clocks) * t_clk
    figure = Figure(figsize=(11, 1.2 + 1.45 * len(columns)), layout="constrained")
    rows = figure.subplots(len(columns), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    shown = (time_s >= first - t_clk) & (time_s <= last + t_clk)
    low, high = float(v_int[columns][:, shown].min()), float(v_int[columns][:, shown].max())
    span = np.arange(start - 3, start + clocks + 1)
    # The switch is drawn in a separate band below all voltages.
    top, bottom = low - 0.12 * (high - low), low - 0.32 * (high - low)
    for axes, column in zip(rows, columns, strict=True):
        axes.plot((time_s[shown] - start * t_clk) * 1e6, v_int[column][shown], color=BLUE, lw=1.2)
        axes.axhline(0.0, color=GREY, lw=0.6)
        bits = np.array([charge[clock - 1] >> column & 1 for clock in span])
        at = (span + delay - start) * t_clk * 1e6
        axes.fill_between(at, bottom, np.where(bits, top, bottom), step="post", color=ORANGE, lw=0)
        force, code = made.force_n[0, row, column], result.codes[0, row, column]
        words = f"row {row}, column {column}: {force:.2f} N, x = {duty[row, column]:.3f}, code {code}"
        axes.set_title(words, fontsize=9, loc="left")
        axes.set(xlim=(-3 * t_clk * 1e6, clocks * t_clk * 1e6), ylabel="v_int / V")
    rows[0].set_title("line: integrator; bar: charge switch on", fontsize=9, loc="right")
    rows[-1].set_xlabel("time after the release of the preset / us")
    save(figure, path)


def _spread(duty: NDArray[np.float64], most: int = 4) -> list[int]:
    """Return columns whose duties are spread over those of the row, the strongest first."""
    order = np.argsort(-duty, kind="stable")
    order = [int(c) for c in order if duty[c] > 0.01] or [int(order[0])]
    # Duties closer than this are one line in the figure.
    distinct = [c for i, c in enumerate(order) if i == 0 or abs(duty[c] - duty[order[i - 1]]) > 1e-6]
    picks = np.linspace(0, len(distinct) - 1, min(most, len(distinct)))
    return [distinct[round(i)] for i in picks]
