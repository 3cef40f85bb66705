# SPDX-License-Identifier: Apache-2.0
"""Figures of a run: force map, code map, code against force with its fit, and the transient of several taxels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dermis.engines import Result
from dermis.files import atomic
from dermis.records import Plan
from dermis.report import waves

# Okabe and Ito: told apart by the colour-blind as well.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#666666"
DPI = 130


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    FigureCanvasAgg(figure)
    with atomic(path) as file:
        figure.savefig(file, dpi=DPI, format="png")


def _map(figure: Figure, axes: Any, values: NDArray[Any], label: str, title: str, **limits: float) -> None:
    image = axes.imshow(values, cmap="viridis", interpolation="nearest", **limits)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("column")
    axes.set_ylabel("row")
    figure.colorbar(image, ax=axes, label=label, shrink=0.85)


def frame_figure(
    made: Plan, codes: NDArray[Any], fit: tuple[float, float, NDArray[np.float64]] | None, path: Path
) -> None:
    """Draw one run: force and codes of the strongest frame, code against force of all, and the fit's residual.

    Parameters
    ----------
    made : Plan
    codes : [frames, rows, cols]
    fit : slope (codes a newton), offset and residuals of the taxels below saturation, or None
    path : where the PNG goes
    """
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    grid = figure.subplots(2, 2, height_ratios=[1.25, 1])
    frame = int(np.argmax(codes.reshape(codes.shape[0], -1).sum(axis=1, dtype=float)))
    which = f", frame {frame} of {made.frames}" if made.frames > 1 else ""
    code_max = made.timing.code_max
    full_n = 1.2 * float(made.force_of_duty(np.full(made.cols, 0.5)).max())
    if made.force_n is None:
        values, label = made.resistance_ohm[frame], "resistance / ohm"
        values = np.where(np.isfinite(values), values, np.nan)
    else:
        values, label = np.minimum(made.force_n[frame], full_n), "force / N"
    _map(figure, grid[0, 0], values, label, f"What presses{which}")
    _map(figure, grid[0, 1], codes[frame], "code", f"What the chip reports{which}", vmin=0, vmax=code_max)
    curve, rest = grid[1]
    if made.force_n is None:
        curve.set_visible(False)
        rest.set_visible(False)
        save(figure, path)
        return
    force = made.force_n.ravel()
    shown = force <= full_n  # a short is as good as an infinite force
    curve.plot(force[shown], codes.ravel()[shown], ".", color=BLUE, ms=4, label=f"{int(shown.sum())} codes")
    if fit is not None:
        line = np.array([0.0, (code_max - fit[1]) / fit[0]])
        curve.plot(
            line, fit[0] * line + fit[1], "-", color=ORANGE, lw=1, label=f"{fit[0]:.3f} codes/N {fit[1]:+.3f}"
        )
    curve.set_xlabel("force on the taxel / N")
    curve.set_ylabel("code")
    curve.set_ylim(-8, code_max + 13)
    curve.legend(frameon=False, fontsize=8)
    curve.grid(alpha=0.3)
    rest.set_title("Residual of the fit, below saturation", fontsize=10)
    rest.set_xlabel("force on the taxel / N")
    rest.set_ylabel("code - fit / LSB")
    rest.grid(alpha=0.3)
    if fit is not None:
        steps = made.timing.gate_clocks * made.duty_ideal()
        below = np.isfinite(made.force_n) & (steps <= code_max)
        rest.plot(made.force_n[below], fit[2], ".", color=BLUE, ms=4)
        for limit in (-0.5, 0.5):
            rest.axhline(limit, color=GREY, lw=0.8, ls="--")
        most = 1.1 * max(1.0, float(np.abs(fit[2]).max()))
        rest.set_ylim(-most, most)
    else:
        rest.text(0.5, 0.5, "no line to fit", ha="center", transform=rest.transAxes)
    save(figure, path)


def transient_figure(made: Plan, result: Result, path: Path, clocks: int = 40) -> None:
    """Draw the paper's Fig. 11: integrators and charge switches of several taxels of a row, from the preset's release.

    Parameters
    ----------
    made, result : a plan and its recorded co-simulation
    path : where the PNG goes
    clocks : how many clocks to show
    """
    record = result.info["records"][0]
    time_s, v_int = waves.integrator_waves(record, made.cols)
    charge = waves.trace(record, "charge")
    delay = float(record["trace_charge_delay_clocks"])
    t_clk = 1.0 / made.timing.f_clk_hz
    duty = np.minimum(made.duty_ideal()[0], 1.0)
    row = int(np.argmax(duty.sum(axis=1)))
    columns = _spread(duty[row])
    start = row * made.timing.slot_clocks + made.timing.settle_clocks
    first, last = (start - 3) * t_clk, (start + clocks) * t_clk
    figure = Figure(figsize=(11, 1.2 + 1.25 * len(columns)), layout="constrained")
    rows = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    shown = (time_s >= first - t_clk) & (time_s <= last + t_clk)
    for axes, column in zip(rows, columns, strict=True):
        axes.plot((time_s[shown] - start * t_clk) * 1e6, v_int[column][shown], color=BLUE, lw=1)
        axes.axhline(0.0, color=GREY, lw=0.6)
        axes.set_ylabel("v_int / V", color=BLUE)
        pulses = axes.twinx()
        span = np.arange(start - 3, start + clocks + 1)
        bits = [charge[clock - 1] >> column & 1 for clock in span]
        pulses.step((span + delay - start) * t_clk * 1e6, bits, where="post", color=RED, lw=1)
        pulses.set_ylim(-0.1, 4.0)
        pulses.set_yticks([])
        force = "" if made.force_n is None else f"{made.force_n[0, row, column]:.2f} N, "
        axes.set_title(
            f"row {row}, column {column}: {force}x = {duty[row, column]:.3f}, code {result.codes[0, row, column]}",
            fontsize=9,
            loc="left",
        )
        axes.set_xlim(-3 * t_clk * 1e6, clocks * t_clk * 1e6)
    rows[-1].set_xlabel("time since the preset's release / us (blue: integrator, red: charge switch)")
    save(figure, path)


def _spread(duty: NDArray[np.float64], most: int = 4) -> list[int]:
    """Columns whose duties are spread over those of the row, the strongest first."""
    order = np.argsort(-duty, kind="stable")
    order = [int(c) for c in order if duty[c] > 0.01] or [int(order[0])]
    # Duties closer than this are one line in the figure.
    distinct = [c for i, c in enumerate(order) if i == 0 or abs(duty[c] - duty[order[i - 1]]) > 1e-6]
    picks = np.linspace(0, len(distinct) - 1, min(most, len(distinct)))
    return [distinct[round(i)] for i in picks]
