# SPDX-License-Identifier: Apache-2.0
"""`dermis sweep`: resistance against frequency for the four interfaces, csv and figures."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dermis.converter import vfc
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.ndarrays import Floats
from dermis.places import BUILD
from dermis.report import figures as drawing
from dermis.report import output
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design
from scripts.judged import SHOW, finish
from scripts.sweep import curves
from scripts.sweep.curves import Curve, Reading, straight_line, unlimited


def table(curves: Sequence[Curve]) -> str:
    """Return the sweep as csv, one line per resistance and interface; empty if not measured."""
    lines = []
    for curve in curves:
        some, hz = curve.physical, curve.f_clk_hz
        where = {} if some is None else {int(point): n for n, point in enumerate(some.at)}
        for i, ohm in enumerate(curve.resistance_ohm):
            ideal = _measured(curve, curve.ideal, i)
            real = _measured(curve, some.reading, where[i]) if i in where else dict.fromkeys(ideal, math.nan)
            line = {"topology": curve.topology, "r_ohm": ohm, "x": curve.x[i], **ideal}
            line |= {"f_charge_balance_hz": hz * curve.x[i]}
            line |= {"pulses_charge_balance": curve.pulses_charge_balance[i]}
            line |= {"f_eq3_hz": hz / curve.period_eq3_clocks[i], "pulses_eq3": curve.pulses_eq3[i]}
            line |= {f"physical_{name}": value for name, value in real.items()}
            lines.append({name: _cell(value) for name, value in line.items()})
    return pd.DataFrame(lines).to_csv(index=False)


def _cell(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return "" if math.isnan(value) else repr(round(float(value), 3) if value > 10_000 else float(value))


def _measured(curve: Curve, reading: Reading, i: int) -> dict[str, float]:
    pulses, hz = reading.pulses[i], curve.f_clk_hz
    return {
        "pulses": pulses,
        "code": reading.code[i],
        "f_count_hz": hz * int(pulses) / curve.gate,
        "f_period_hz": hz / reading.period_clocks[i],
        "f_line_hz": hz / reading.line_clocks[i],
    }


LOOKS = {
    "direct": ("direct (Fig. 3)", drawing.BLUE, "o"),
    "conveyor_mirror": ("conveyor + mirror (Fig. 5a)", drawing.ORANGE, "s"),
    "conveyor_mirror_inverted": ("conveyor + mirror, inverted (Fig. 5b)", drawing.GREEN, "^"),
    "multi_output_conveyor": ("multiple-output conveyor (Fig. 6)", "#CC79A7", "D"),
}
"""Label, colour and marker of each interface."""
BALANCE = {"color": "black", "lw": 1.3, "label": "charge balance: f = f_clk x"}
EQ3 = {"color": drawing.RED, "lw": 1.3, "ls": (0, (5, 2)), "label": "eq. (3): f = f_clk / ceil(1/x)"}
OHM, KHZ = "resistance of the taxel R / ohm", "pulse frequency f / kHz"
FORCE = "force on the taxel F = K_f / R / N"

Scale = Callable[[Floats], Floats]
Line = tuple[Floats, Floats]


def _force(ohm: Floats) -> Floats:
    return load_design().sensor.k_force_n_ohm / ohm


def _laws(
    axes: Any, curve: Curve, across: Scale, per_hz: float, end_ohm: float = 0.0, eq3: bool = True
) -> None:
    """Draw charge balance and eq. (3) over the resistances, dense enough to show their steps."""
    ohm = np.geomspace(curve.resistance_ohm[0], end_ohm or curve.resistance_ohm[-1], 20_001)
    duty, clocks = float(curve.x[0] * curve.resistance_ohm[0]) / ohm, 1 << 40
    axes.plot(across(ohm), curve.f_clk_hz * duty * per_hz, **BALANCE)
    if eq3:
        axes.plot(across(ohm), curve.f_clk_hz * vfc.count_restarting(duty, clocks) / clocks * per_hz, **EQ3)


def _marks(
    axes: Any, curves: Sequence[Curve], points: Iterable[Line], most: int = 0, scale: Scale = np.asarray
) -> None:
    """Draw the points of each curve, across and up; with `most`, that number of all curves, each its share.

    Curves that coincide would hide each other.
    """
    for number, (curve, (x, y)) in enumerate(zip(curves, points, strict=True)):
        picks = np.arange(x.size)
        if most:
            place = scale(x)
            wanted = np.linspace(place.min(), place.max(), most)
            picks = np.unique([np.argmin(np.abs(place - w)) for w in wanted])[number :: len(curves)]
        label, colour, marker = LOOKS[curve.topology]
        look = {"color": colour, "mfc": "none", "ms": 5.5, "mew": 1.2, "zorder": 3, "label": label}
        axes.plot(x[picks], y[picks], marker, **look)


def _finish(axes: Any, title: str, across: str, up: str, legend: str = "") -> None:
    axes.set_title(title, fontsize=10)
    axes.set(xlabel=across, ylabel=up)
    axes.grid(alpha=0.3, which="both")
    if legend:
        axes.legend(frameon=False, fontsize=8.5, loc=legend)


def _log_scales(axes: Any, curve: Curve) -> None:
    """Set both axes to logarithmic with readable marks: ohm across, kHz up."""
    low, *_, high = curve.resistance_ohm
    axes.set(xscale="log", yscale="log")
    ohm = [m * 10**e for e in range(8) for m in (1, 2, 5) if low <= m * 10**e <= high]
    axes.set_xticks(ohm, [f"{m / 1000:g} k" if m >= 1000 else f"{m:g}" for m in ohm])
    khz = [20, 50, 100, 200, 500, 1000, 2000]
    axes.set_yticks(khz, [str(m) for m in khz])
    axes.minorticks_off()


def frequency_figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw frequency against resistance and, the paper's Fig. 8, against force, with both laws."""
    figure = Figure(figsize=(10, 4.9), layout="constrained")
    whole, forces = figure.subplots(1, 2)
    for axes, at, unit, scale in ((whole, np.asarray, 1e3, np.log), (forces, _force, 1e6, np.asarray)):
        _laws(axes, curves[0], at, 1 / unit)
        points = [(at(c.resistance_ohm), c.f_clk_hz / c.ideal.period_clocks / unit) for c in curves]
        _marks(axes, curves, points, 40, scale)
    _log_scales(whole, curves[0])
    _finish(whole, "Frequency against resistance", OHM, KHZ, "lower left")
    _finish(forces, "Frequency against force", FORCE, "pulse frequency f / MHz")
    drawing.save(figure, path)


def code_figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw the paper's Fig. 9: code against force, its end enlarged, and residuals."""
    figure = Figure(figsize=(10, 7.6), layout="constrained")
    (whole, foot), (ideal, physical) = figure.subplots(2, 2, height_ratios=[1.25, 1])
    first = curves[0]
    low, high = (float(first.resistance_ohm[end]) for end in (0, -1))
    near = min(1.55 * low, high)
    for axes, end, at in ((whole, high, _force), (foot, near, np.asarray)):
        _laws(axes, first, at, first.gate / first.f_clk_hz, end)
        below = first.resistance_ohm <= end
        _marks(axes, curves, [(at(c.resistance_ohm[below]), c.ideal.code[below]) for c in curves], 48)
    foot.set(xlim=(0.985 * low, near), ylim=(0.3 * first.gate, 0.52 * first.gate))
    _finish(whole, "Code against force", FORCE, f"code (pulses in {first.gate} clocks)", "upper left")
    gap = np.abs(first.ideal.pulses - first.pulses_eq3).max()
    _finish(foot, f"The laws differ by up to {gap} counts just above {low:g} ohm", OHM, "code")

    steps = f"charge balance, {first.gate} x / LSB"
    _marks(ideal, curves, [(c.gate * c.x, c.ideal.code - c.gate * c.x) for c in curves], 120)
    for limit in (-0.5, 0.5):
        ideal.axhline(limit, color=drawing.GREY, lw=0.8, ls="--")
    ideal.set_ylim(-1.1, 1.1)
    _finish(ideal, "Ideal blocks: code less charge balance (dashed: rounding)", steps, "residual / LSB")

    drawn = [curve for curve in curves if curve.physical is not None]

    def duty(curve: Curve) -> Floats:
        return curve.gate * curve.x[curve.physical.at]

    points = [(duty(c), c.gate / c.physical.reading.line_clocks - duty(c)) for c in drawn]
    _marks(physical, drawn, points, 200)
    for curve in drawn:
        colour = LOOKS[curve.topology][1]
        physical.plot(duty(curve), curve.gate * curve.physical.x - duty(curve), color=colour, lw=1)
    title = "Physical blocks: f from all pulse times less charge balance"
    _finish(physical, title, steps, "difference / LSB")
    physical.text(0.03, 0.06, "lines: array solve and gains", transform=physical.transAxes, fontsize=8.5)
    physical.set_visible(bool(drawn))
    for axes in (ideal, physical):
        axes.axhline(0.0, color="black", lw=0.8)
    drawing.save(figure, path)


def transistor_figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw frequency against resistance, and its residual to a straight line."""
    figure = Figure(figsize=(10, 4.9), layout="constrained")
    whole, rest = figure.subplots(1, 2)
    _laws(whole, curves[0], np.asarray, 1e-3, eq3=False)
    _marks(whole, curves, [(c.resistance_ohm, c.f_clk_hz / c.ideal.line_clocks / 1e3) for c in curves])
    _log_scales(whole, curves[0])
    _finish(whole, "f against R, channels in transistors (tt, 27 C)", OHM, KHZ, "lower left")

    left = []
    for curve in curves:
        reading, x = unlimited(curve.ideal), curve.gate * curve.x
        gain, offset, _ = straight_line(curve, reading)
        left.append((x, curve.gate / reading.line_clocks - gain * x - offset))
    _marks(rest, curves, left)
    rest.set_xscale("log")
    marks = (2, 5, 10, 20, 50, 100, 255)
    rest.set_xticks(marks, [str(mark) for mark in marks])
    rest.minorticks_off()
    title = "f against 1/R less a straight line of its own"
    _finish(rest, title, "charge balance, 510 x / LSB", "residual / LSB")
    drawing.save(figure, path)


POINTS_MAX = 4096
FIGURES = {
    "behavioural": {"sweep_frequency.png": frequency_figure, "sweep_code.png": code_figure},
    "sky130": {"sweep_transistors.png": transistor_figure},
}
FILES = {"sweep.csv", *(name for named in FIGURES.values() for name in named)}


@click.command("sweep", context_settings=SHOW)
@click.option("--points", type=click.IntRange(8, POINTS_MAX), help="Number of resistances; 256, sky130 8.")
@click.option("--topology", type=click.Choice(TOPOLOGIES), multiple=True, help="This interface (repeatable).")
@click.option("--view", type=click.Choice(list(FIGURES)), default="behavioural", help="View of the blocks.")
@click.option("--out", type=click.Path(), help="Directory for results; default below build/.")
@click.option("--plot/--no-plot", default=True, help="Draw the figures.")
@click.option("--physical/--no-physical", default=True, help="Also sweep with the physical defaults.")
def sweep_command(
    points: int | None, topology: tuple[str, ...], view: str, out: str | None, plot: bool, physical: bool
) -> int:
    """Sweep resistance against frequency, by ngspice and the real Verilog, for the four interfaces.

    sweep.csv and the figures go into OUT, the verdict table into build/sweep.json, in transistors
    into build/sweep_sky130.json.
    """
    name = "sweep" if view == "behavioural" else f"sweep_{view}"
    place = output.prepare(BUILD / name if out is None else out)
    chosen = tuple(dict.fromkeys(topology)) or TOPOLOGIES
    if view == "behavioural":
        points = points or 256
        made, rows, failed = curves.run(chosen, points, place, with_physical=physical)
    else:
        if not physical:
            allowed = "only with --view behavioural, whose blocks are ideal or have physical defaults"
            raise InputError("command line", "--no-physical", f"--view {view}", allowed)
        points = points or curves.POINTS_TRANSISTORS
        made, rows, failed = curves.run_transistors(chosen, points, place)
    for file in FILES:
        (place / file).unlink(missing_ok=True)  # no file of an earlier sweep stays
    if made:
        write_atomic(place / "sweep.csv", table(made))
        for file, draw in FIGURES[view].items() if plot else ():
            draw(made, place / file)
    title = f"{points} resistances, {len(chosen)} interfaces: Verilog and ngspice ({view} blocks)"
    code = finish(name, rows, title)
    click.echo(f"table, figures and scenes are in {os.path.relpath(place)}")
    return SimulatorError.exit_code if failed else code
