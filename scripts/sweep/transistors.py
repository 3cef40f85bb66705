# SPDX-License-Identifier: Apache-2.0
"""`dermis sweep --view sky130`: frequency against resistance through channels in transistors, and
the line through it.

Each resistance is a single taxel: one row, one column and one frame, which starts settled. Finished
interfaces are kept; an interrupted run continues with the others.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dermis.chip import netlist
from dermis.engines import batch
from dermis.errors import SimulatorError
from dermis.records import Plan
from dermis.report import figures, progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import load as load_design
from scripts.characterise import runs
from scripts.checkpoint import Checkpoint
from scripts.sweep import curves as sweep
from scripts.sweep.curves import Curve, Reading

POINTS = 8
"""A packet costs about 20 ms, so a point at 500 ohm takes as long as all others together."""

FIGURE = "sweep_transistors.png"


def run(topologies: Sequence[str], points: int, out: Path) -> tuple[list[Curve], list[Row], bool]:
    """Sweep some interfaces in transistors (tt, 27 C).

    Parameters
    ----------
    topologies : names of dermis.scene.design.TOPOLOGIES
    points : resistances in the sweep
    out : directory for scenes, logs, kept readings and the decks of a failed run

    Returns
    -------
    curves of the interfaces that were read, verdict rows, and whether a simulator failed
    """
    ohm = sweep.resistances(points, load_design())
    laid = sweep.in_frames(ohm, 1, 1)
    plans = {
        topology: sweep.make_plan(
            out / "scenes", topology, laid, {}, f"{points} resistances in transistors", "sky130"
        )
        for topology in topologies
    }
    kept = Checkpoint(out / "kept.json", batch.fingerprint())
    curves: list[Curve] = []
    rows: list[Row] = []
    failed = False
    total = sum(made.frames * made.rows for made in plans.values())
    begun = 0
    with progress.slots("sweeping", total) as show:
        for topology, made in plans.items():
            name = f"{topology} {_circuits(made)}"
            if name not in kept.pieces:
                work = out / "work" / topology
                try:
                    reading = sweep.read(made, points, lambda slots, begun=begun: show(begun + slots), work)
                except SimulatorError as error:
                    rows.append(
                        verdict.error(f"sweep.transistor_linearity_lsb.{topology}", str(error), "lsb")
                    )
                    failed = True
                    begun += made.frames * made.rows
                    continue
                shutil.rmtree(work)  # a successful run can be repeated from its scene
                kept.put(name, {what: values.tolist() for what, values in vars(reading).items()})
            begun += made.frames * made.rows
            show(begun)
            reading = Reading(**{what: np.array(values) for what, values in kept.pieces[name].items()})
            curves.append(sweep.make_curve(made, ohm, reading))
            rows += judge(curves[-1])
    return curves, rows, failed


def _circuits(made: Plan) -> str:
    """Return a hash of the circuits of a plan, of ngspice and its models, which the hash of the
    package leaves out.
    """
    levels = [1.0] + [0.0] * (made.rows - 1) + [1.0] + [0.0] * made.cols
    text = hashlib.sha256()
    for frame in range(made.frames):
        lines = netlist.frame_deck(made, frame, levels).lines
        text.update(runs.key(runs.resolved("\n".join(lines))).encode())
    return text.hexdigest()[:24]


def _free(reading: Reading) -> Reading:
    """Return the readings without those at f_clk/2, where the synchronizer limits the rate."""
    return replace(reading, line_clocks=np.where(reading.line_clocks > 2.0, reading.line_clocks, np.nan))


def judge(curve: Curve) -> list[Row]:
    """Return the rows of one interface: gain, offset, and largest distance from a straight line."""
    name, reading = curve.topology, _free(curve.ideal)
    fit = sweep.straight_line(curve, reading)
    free = np.isfinite(reading.line_clocks)
    line = f"straight line of f against 1/R, {free.sum()} resistances below f_clk/2"
    key = f"sweep.transistor_linearity_lsb.{name}"
    if fit is None:
        return [verdict.error(key, "fewer than three resistances have two pulses", "lsb")]
    gain, offset, residual = fit
    return [
        verdict.report(f"sweep.transistor_gain_error_percent.{name}", 100.0 * (gain - 1.0), "%", line),
        verdict.report(f"sweep.transistor_offset_lsb.{name}", offset, "lsb", line),
        verdict.judge(key, residual, line),
    ]


def figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw frequency against resistance beside the law of charge balance, and what is left of a
    straight line.
    """
    drawing = Figure(figsize=(10, 4.9), layout="constrained")
    whole, rest = drawing.subplots(1, 2)
    ohm = curves[0].resistance_ohm
    sweep.draw_law(whole, curves[0], float(ohm[0]), float(ohm[-1]))
    for curve in curves:
        measured = np.isfinite(curve.ideal.line_clocks)
        colour, marker = sweep.LOOKS[curve.topology]
        look: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "mfc": "none",
            "label": sweep.LABELS[curve.topology],
        }
        f_hz = curve.f_clk_hz / curve.ideal.line_clocks[measured]
        whole.plot(ohm[measured], f_hz / 1e3, ls="", **look)
        reading = _free(curve.ideal)
        if (fit := sweep.straight_line(curve, reading)) is not None:
            steps = curve.gate * curve.x
            left = curve.gate / reading.line_clocks - fit[0] * steps - fit[1]
            rest.plot(steps, left, ls="", **look)
    whole.set_xlabel("resistance of the taxel R / ohm")
    whole.set_ylabel("pulse frequency f / kHz")
    whole.set_title("f against R, channels in transistors (tt, 27 C)", fontsize=10)
    whole.legend(frameon=False, fontsize=8.5, loc="lower left")
    rest.set_xscale("log")
    rest.set_xticks(
        [2, 5, 10, 20, 50, 100, 255], labels=["2", "5", "10", "20", "50", "100", "255"], minor=False
    )
    rest.minorticks_off()
    rest.set_xlabel("charge balance, 510 x / LSB")
    rest.set_ylabel("residual / LSB")
    rest.set_title("f against 1/R less a straight line of its own", fontsize=10)
    for axes in (whole, rest):
        axes.grid(alpha=0.3, which="both")
    figures.save(drawing, path)
