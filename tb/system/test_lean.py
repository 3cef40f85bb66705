# SPDX-License-Identifier: Apache-2.0
"""What a process loads: compiled loops and scenes only where they are needed."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from system_bench import MakePlan

from dermis.engines import cosim

COMPILED = {"numba", "scipy"}


def loaded(text: str) -> set[str]:
    """Return the modules of a log of `-X importtime`."""
    return set(re.findall(r"import time: +\d+ \| +\d+ \| +(\S+)", text))


def of_command(*arguments: str) -> set[str]:
    command = [sys.executable, "-X", "importtime", "-m", "dermis", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return loaded(done.stderr)


def test_the_child_of_a_cosimulation_loads_no_compiled_loop_and_no_scene(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")  # the interpreter in the simulator reads it
    cosim.run(resistance_plan(np.array([[500.0]])), work=tmp_path / "work")
    found = loaded((tmp_path / "work" / "job_0" / "hdl.log").read_text())
    assert {"dermis.chip.bridge", "dermis.lockstep.ngspice", "dermis.engines.cosim_job"} <= found
    scenes = {"pydantic", "matplotlib", "dermis.records", "dermis.scene", "dermis.effects"}
    assert not found & (COMPILED | scenes)


def test_a_cosimulated_run_loads_no_compiled_loop(resistance_plan: MakePlan, tmp_path: Path) -> None:
    resistance_plan(np.array([[500.0]]))
    scene, out = str(tmp_path / "scene.toml"), str(tmp_path / "out")
    found = of_command("run", scene, "--engine", "cosim", "--out", out)
    assert "dermis.engines.cosim_job" in found
    assert not found & COMPILED


def test_help_loads_no_numbers() -> None:
    found = of_command("--help")
    assert "dermis.cli" in found
    assert not found & {*COMPILED, "numpy", "pydantic", "rich", "matplotlib", "asyncio", "multiprocessing"}
