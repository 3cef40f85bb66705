# SPDX-License-Identifier: Apache-2.0
"""Figures of decoding: error maps correction by correction, a loop before and after, intervals over time."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Decoder, Forces
from dermis.engines import closed
from dermis.records import Plan
from dermis.scene import scene

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Floats = NDArray[np.float64]

TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": 12.0, "width": 13, "length": 13}
CHIP = {
    "row_driver": {"r_ohm": 4.0}, "column_input": {"r_ohm": 2.0}, "lateral": {"r_ohm": 1000.0},
    "mirror_ratio": {"ratio_error": 0.0, "spread": 0.01}, "column_offset": {"v_v": 5e-4}, "sensor_spread": True,
}  # fmt: skip


def error_maps(path: Path) -> None:
    """Draw the error of a round touch after every further correction."""
    plan = planning.make(scene.from_data({"stimulus": TOUCH, "effects": CHIP}, Path("figure")), "closed")
    codes, full = closed.run(plan).codes, Calibration.of_plan(plan)
    nothing = dataclasses.replace(
        full, network={}, factor=1.0, step_a=float(full.step_a.mean()), start_code=0.0
    )
    gain = dataclasses.replace(nothing, step_a=full.step_a, start_code=full.start_code)
    droop = dataclasses.replace(
        gain, network={n: plan.surrounding[n] for n in ("r_row_driven_ohm", "r_row_grounded_ohm")}
    )
    network = dataclasses.replace(full, factor=1.0)
    stages = {"as read": nothing, "+ gain and offset": gain, "+ row droop": droop, "+ all crosstalk": network,
              "+ taxel spread": full}  # fmt: skip
    errors = {name: Decoder(c, 2e-3).decode(codes).force_n[0] - plan.force_n[0] for name, c in stages.items()}
    most = max(np.abs(e).max() for e in errors.values())
    figure, axes = plt.subplots(1, len(errors), figsize=(13, 3.1), layout="constrained")
    for axis, (name, error) in zip(axes, errors.items(), strict=True):
        image = axis.imshow(error, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(f"{name}\nrms {np.sqrt(np.mean(error**2)):.3f} N", fontsize=10)
        axis.set_xticks([0, 15])
        axis.set_yticks([0, 15])
    axes[0].set_ylabel("row")
    axes[0].set_xlabel("column")
    figure.colorbar(image, ax=axes, label="error in N", shrink=0.85)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def loop(path: Path, kept: dict[str, Floats]) -> None:
    """Draw the decoded force against the true one over unseen cycles, before and after."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.8), sharex=True, sharey=True, layout="constrained")
    for axis, name in zip(axes, ("before", "after"), strict=True):
        axis.plot(kept["force"][:, 0, 1], kept[name][:, 0, 1], linewidth=0.9)
        axis.plot([0, 15], [0, 15], "k:", linewidth=0.8)
        axis.set_title(f"{name} the inverse")
        axis.set_xlabel("true force in N")
    axes[0].set_ylabel("decoded force in N")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def intervals(path: Path, plan: Plan, found: Forces) -> None:
    """Draw force and interval of two taxels of worn_fsr_sheet over time."""
    t = 1e3 * plan.drive.t_frame_s * np.arange(plan.frames)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
    for axis, (r, c) in zip(axes, ((7, 8), (4, 8)), strict=True):
        axis.fill_between(t, found.low_n[:, r, c], found.high_n[:, r, c], alpha=0.35, label="interval")
        axis.plot(t, found.force_n[:, r, c], label="decoded")
        axis.plot(t, plan.force_n[:, r, c], "k:", label="true")
        axis.set_title(f"taxel at row {r}, column {c}", fontsize=10)
        axis.set_xlabel("time in ms")
    axes[0].set_ylabel("force in N")
    axes[0].legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def write(directory: Path, plan: Plan, found: Forces, kept: dict[str, Floats]) -> None:
    """Write all figures."""
    directory.mkdir(parents=True, exist_ok=True)
    error_maps(directory / "decode_error_maps.png")
    loop(directory / "decode_loop.png", kept)
    intervals(directory / "decode_intervals.png", plan, found)
