# SPDX-License-Identifier: Apache-2.0
"""Plans of given resistances and effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dermis import plan as planning
from dermis import records
from dermis.scene import scene


def made(
    tmp_path: Path,
    ohm: np.ndarray,
    effects: dict[str, object],
    topology: str = "conveyor_mirror",
    seed: int = 0,
) -> records.Plan:
    np.save(tmp_path / "ohm.npy", ohm)
    data = {
        "array": {"rows": ohm.shape[1], "cols": ohm.shape[2]},
        "stimulus": {"kind": "resistance", "file": str(tmp_path / "ohm.npy")},
        "interface": {"topology": topology},
        "effects": effects,
        "run": {"seed": seed},
    }
    return planning.make(scene.from_data(data, tmp_path / "made.toml"))


def ohms(seed: int, *shape: int) -> np.ndarray:
    return 500.0 * 10 ** np.random.default_rng(seed).uniform(0, 2, shape)
