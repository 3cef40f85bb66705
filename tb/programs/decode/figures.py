# SPDX-License-Identifier: Apache-2.0
"""Figure of decoding: error maps correction by correction."""

import dataclasses
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dermis import plan as planning
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Decoder
from dermis.engines import closed
from dermis.report import figures
from dermis.scene import scene

TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": 12.0, "width": 13, "length": 13}
CHIP = {
    "row_driver": {"r_ohm": 4.0}, "column_input": {"r_ohm": 2.0}, "lateral": {"r_ohm": 1000.0},
    "mirror_ratio": {"ratio_error": 0.0, "spread": 0.01}, "column_offset": {"v_v": 5e-4}, "sensor_spread": True,
}  # fmt: skip


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
    figure = Figure(figsize=(13, 3.1), layout="constrained")
    axes = figure.subplots(1, len(errors), sharex=True, sharey=True)
    axes[0].set(xlabel="column", ylabel="row")
    for axis, name, error in zip(axes, stages, errors, strict=True):
        image = axis.imshow(error, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(f"{name}\nrms {np.sqrt(np.mean(error**2)):.3f} N", fontsize=10)
    figure.colorbar(image, ax=axes, label="error in N", shrink=0.85)
    figures.save(figure, path)
