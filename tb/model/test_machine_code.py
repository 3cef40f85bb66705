# SPDX-License-Identifier: Apache-2.0
"""Compiled loops follow every source that they use."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dermis
from dermis.machine_code import drop_stale
from dermis.places import ROOT
from dermis.skin import Skin

LOOP = """
import numba
from kit import other
from kit.part import double
@numba.njit(cache=True)
def loop(x):
    return double(x)
"""
PART = """
import numba
@numba.njit(cache=True)
def double(x):
    return {factor} * x
"""


@pytest.mark.parametrize("dropped", [True, False])
def test_a_change_in_a_function_that_a_loop_calls_reaches_the_loop(tmp_path: Path, dropped: bool) -> None:
    """Without `drop_stale` numba goes on with the old machine code: the test would notice."""
    kit, found = tmp_path / "kit", []
    kit.mkdir()
    (kit / "loop.py").write_text(LOOP)
    (kit / "other.py").touch()
    for factor in (2, 3):
        (kit / "part.py").write_text(PART.format(factor=factor))
        if dropped:
            drop_stale(kit)
        command = [sys.executable, "-c", "from kit.loop import loop; print(loop(10))"]
        told = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120)
        found.append(int(told.stdout))
    assert found == ([20, 30] if dropped else [20, 20])
    (kit / "beside.py").touch()
    drop_stale(kit)
    assert bool([*kit.glob("__pycache__/*.nbi")]) == dropped, "drops what is stale, and nothing else"
    (kit / "other.py").touch()  # perhaps a constant that the loop took in
    drop_stale(kit)
    assert not [*kit.glob("__pycache__/*.nbi")]


ANNOUNCED = """
import sys, numba
sys.path.insert(0, {models!r})
from dermis import machine_code
machine_code.QUIET_S = 0.0
machine_code.announce()
machine_code.announce()  # once is enough
@numba.njit(cache=True)
def one(x):
    return x + 1
one(1)
"""


def test_a_first_compilation_is_announced_once_and_kept_code_is_loaded_in_silence(tmp_path: Path) -> None:
    (tmp_path / "first.py").write_text(ANNOUNCED.format(models=str(ROOT / "models")))
    said = []
    for _ in range(2):
        command = [sys.executable, "first.py"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120)
        said.append(done.stderr.splitlines())
    assert [line.partition(":")[0] for line in said[0]] == ["compiling once for this processor"]
    assert said[1] == []


def test_after_warm_up_nothing_is_compiled() -> None:
    from numba.core import event

    dermis.warm_up()
    worn = Skin(envs=3, stuck=0.1, effects={"sensor_spread": True, "sensor_creep": True})
    skins = Skin("single_touch"), worn
    with event.install_recorder("numba:compile") as recorder:
        for skin in skins:
            force = np.ones((3, skin.rows, skin.cols), np.float32)
            found = skin.decode(skin.read(force))
            assert np.isfinite(found.force_n).all()
        result = dermis.simulate(force_n=force, effects={"column_input": True}, engine="closed")
        dermis.newtons(result.codes, result, corrected=True)
    assert not recorder.buffer
