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
from pathlib import Path

import numpy as np

from dermis.chip import netlist
from dermis.engines import batch
from dermis.errors import SimulatorError
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import load as load_design
from scripts.characterise import runs
from scripts.checkpoint import Checkpoint
from scripts.sweep import curves as sweep
from scripts.sweep.curves import Curve, Reading

POINTS = 8
"""A packet costs about 20 ms, so a point at 500 ohm takes as long as all others together."""


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
    laid, title = sweep.in_frames(ohm, 1, 1), f"{points} resistances in transistors"
    plans = {t: sweep.make_plan(out / "scenes", t, laid, {}, title, "sky130") for t in topologies}
    kept = Checkpoint(out / "kept.json", batch.fingerprint())
    curves: list[Curve] = []
    rows: list[Row] = []
    slots = plans[topologies[0]].frames * plans[topologies[0]].rows
    with progress.slots("sweeping", slots * len(plans)) as show:
        for number, (topology, made) in enumerate(plans.items()):
            name, work = f"{topology} {_circuits(made)}", out / "work" / topology
            if name not in kept.pieces:
                try:
                    begun = number * slots
                    reading = sweep.read(made, points, lambda done, begun=begun: show(begun + done), work)
                except SimulatorError as error:
                    key = f"sweep.transistor_linearity_lsb.{topology}"
                    rows.append(verdict.error(key, str(error), "lsb"))
                    continue
                shutil.rmtree(work)  # a successful run can be repeated from its scene
                kept.put(name, {what: values.tolist() for what, values in vars(reading).items()})
            show((number + 1) * slots)
            reading = Reading(**{what: np.array(values) for what, values in kept.pieces[name].items()})
            curves.append(sweep.make_curve(made, ohm, reading))
            rows += judge(curves[-1])
    return curves, rows, len(curves) < len(plans)


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


def judge(curve: Curve) -> list[Row]:
    """Return the rows of one interface: gain, offset, and largest distance from a straight line."""
    name, reading = curve.topology, sweep.unlimited(curve.ideal)
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
