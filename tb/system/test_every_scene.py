# SPDX-License-Identifier: Apache-2.0
"""Every scene that comes with the project, through every engine: codes, or one line that names an engine that can."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dermis import engines, plan
from dermis.engines import event
from dermis.errors import InputError
from dermis.records import ENGINES, Plan
from dermis.scene.design import ROOT

SCENES = sorted((ROOT / "models" / "scenes").glob("*.toml"))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_runs_or_is_refused_with_an_engine_that_can(path: Path, engine: str) -> None:
    said = _run(path, engine)
    if said:
        assert engine != plan.load(path).engine, "the scene's own engine cannot run it"
        assert engine != "event"  # it does everything
        # All that rtl leaves to event is random: the noise of one scene, and what auto adds to another.
        assert engine != "rtl" or path.stem in ("noisy_channel", "quarter_code_fingertip")
        assert "\n" not in said
        assert set(re.findall(r"engine (\w+)", said)) & set(ENGINES) - {engine}, said


def _run(path: Path, engine: str) -> str:
    """Run a frame of a scene; what was said when it was refused, else nothing."""
    try:
        made = plan.load(path, engine)
        engines.check(made)
        # ngspice takes minutes for sheets of this size: test_cosim_effects.py compares small ones with event.
        if engine != "cosim":
            _compare(made)
    except InputError as error:
        return str(error)
    return ""


def _compare(made: Plan) -> None:
    """Read the frame that is pressed hardest; the Verilog at most one code away from engine event."""
    pressed = made.fullest_frame()
    part = made.part(pressed, pressed + 1)
    # Icarus: where nothing is built yet, Verilator's compiler takes longer than one frame does.
    options = {"simulator": "icarus"} if part.engine == "rtl" else {}
    codes = engines.run(part, **options).codes
    assert codes.shape == part.resistance_ohm.shape
    assert codes.dtype == np.min_scalar_type(made.timing.code_max)
    assert codes.any()
    if part.engine == "rtl":
        expected = event.run(replace(part, engine="event")).codes
        # A count may fall either side of a half in another engine's rounding.
        assert np.abs(codes.astype(int) - expected).max() <= 1
        assert np.mean(codes != expected) < 0.01  # 0 today; 1 apart at every other taxel is a wrong preset
