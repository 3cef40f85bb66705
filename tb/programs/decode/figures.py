# SPDX-License-Identifier: Apache-2.0
"""Figures of decoding: error maps correction by correction, a loop before and after, intervals over time."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Decoder, Forces
from dermis.engines import closed
from dermis.records import Plan
from dermis.report import figures
from dermis.scene import scene

Floats = NDArray[np.float64]

TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": 12.0, "width": 13, "length": 13}
CHIP = {
    "row_driver": {"r_ohm": 4.0}, "column_input": {"r_ohm": 2.0}, "lateral": {"r_ohm": 1000.0},
    "mirror_ratio": {"ratio_error": 0.0, "spread": 0.01}, "column_offset": {"v_v": 5e-4}, "sensor_spread": True,
}  # fmt: skip


def _panels(count: int, size: tuple[float, float], x: str, y: str) -> tuple[Figure, Any]:
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, count, sharex=True, sharey=True)
    for axis in axes:
        axis.set_xlabel(x)
    axes[0].set_ylabel(y)
    return figure, axes


def error_maps(path: Path) -> None:
    """Draw the error of a round touch after every further correction."""
    plan = planning.make(scene.from_data({"stimulus": TOUCH, "effects": CHIP}, Path("figure")), "closed")
    codes, full = closed.run(plan).codes, Calibration.of_plan(plan)
    step_a = float(full.step_a.mean())
    network = dataclasses.replace(full, factor=1.0)
    rows = {name: plan.surrounding[name] for name in ("r_row_driven_ohm", "r_row_grounded_ohm")}
    stages = {
        "as read": dataclasses.replace(network, network={}, step_a=step_a, start_code=0.0),
        "+ gain and offset": dataclasses.replace(network, network={}),
        "+ row droop": dataclasses.replace(network, network=rows),
        "+ all crosstalk": network,
        "+ taxel spread": full,
    }
    errors = [Decoder(known, 2e-3).decode(codes).force_n[0] - plan.force_n[0] for known in stages.values()]
    most = max(np.abs(e).max() for e in errors)
    figure, axes = _panels(len(errors), (13, 3.1), "column", "row")
    for axis, name, error in zip(axes, stages, errors, strict=True):
        image = axis.imshow(error, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(f"{name}\nrms {np.sqrt(np.mean(error**2)):.3f} N", fontsize=10)
    figure.colorbar(image, ax=axes, label="error in N", shrink=0.85)
    figures.save(figure, path)


def loop(path: Path, kept: dict[str, Floats]) -> None:
    """Draw the decoded force against the true one over unseen cycles, before and after."""
    figure, axes = _panels(2, (8, 3.8), "true force in N", "decoded force in N")
    for axis, name in zip(axes, ("before", "after"), strict=True):
        axis.plot(kept["force"][:, 0, 1], kept[name][:, 0, 1], linewidth=0.9)
        axis.plot([0, 15], [0, 15], "k:", linewidth=0.8)
        axis.set_title(f"{name} the inverse")
    figures.save(figure, path)


def intervals(path: Path, plan: Plan, found: Forces) -> None:
    """Draw force and interval of two taxels of worn_fsr_sheet over time."""
    t = 1e3 * plan.drive.t_frame_s * np.arange(plan.frames)
    figure, axes = _panels(2, (9, 3.6), "time in ms", "force in N")
    for axis, (r, c) in zip(axes, ((7, 8), (4, 8)), strict=True):
        axis.fill_between(t, found.low_n[:, r, c], found.high_n[:, r, c], alpha=0.35, label="interval")
        axis.plot(t, found.force_n[:, r, c], label="decoded")
        axis.plot(t, plan.force_n[:, r, c], "k:", label="true")
        axis.set_title(f"taxel at row {r}, column {c}", fontsize=10)
    axes[0].legend()
    figures.save(figure, path)
