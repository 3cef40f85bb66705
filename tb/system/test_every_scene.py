# SPDX-License-Identifier: Apache-2.0
"""Every scene that comes with the project, through every engine: codes, or one line that names an engine that can."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from dermis import engines, plan
from dermis.design import ROOT
from dermis.errors import InputError
from dermis.plan import ENGINES

SCENES = sorted((ROOT / "models" / "scenes").glob("*.toml"))

# A frame takes these seconds; tb/system/test_rtl_engine.py and test_cosim.py run what they can do.
SLOW = ("rtl", "cosim")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_runs_or_is_refused_with_an_engine_that_can(path: Path, engine: str) -> None:
    said = _run(path, engine)
    if said:
        assert engine != "event"  # it does everything
        assert "\n" not in said
        assert set(re.findall(r"engine (\w+)", said)) & set(ENGINES) - {engine}, said


def _run(path: Path, engine: str) -> str:
    """Run a frame of a scene; what was said when it was refused, else nothing."""
    try:
        made = plan.load(path, engine)
        engines.check(made)
        if engine not in SLOW:
            part = made.part(0, 1)
            codes = engines.run(part).codes
            assert codes.shape == part.resistance_ohm.shape
            assert codes.dtype == np.uint8
    except InputError as error:
        return str(error)
    return ""
