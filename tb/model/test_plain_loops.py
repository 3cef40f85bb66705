# SPDX-License-Identifier: Apache-2.0
"""Compiled loops against the same loops in plain Python, in which every invalid operation raises."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import plain_loops
import pytest
from made_plans import made

from dermis.converter import course
from dermis.errors import SimulatorError


def in_plain_python(out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, plain_loops.__file__, str(out), *options]
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=150)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    out = tmp_path_factory.mktemp("plain") / "codes.npz"
    done = in_plain_python(out)
    assert done.returncode == 0, done.stderr
    return dict(np.load(out))


@pytest.mark.paper  # a world is refused where a packet is twice as large
@pytest.mark.parametrize("name", plain_loops.WORLDS)
def test_plain_python_raises_nothing_and_gives_the_same_codes(name: str, plain: dict, tmp_path: Path) -> None:
    np.testing.assert_array_equal(plain_loops.codes(name, tmp_path), plain[name])


def test_a_seeded_division_by_zero_raises_in_plain_python(tmp_path: Path) -> None:
    done = in_plain_python(tmp_path / "codes.npz", "--seeded")
    assert done.returncode != 0
    assert "divide by zero" in done.stderr
    assert "course.py" in done.stderr


@pytest.mark.parametrize("name", ["moving", "bent_moving"])
def test_an_input_charge_that_is_no_number_is_an_error_behind_every_clip(name: str, tmp_path: Path) -> None:
    topology, on = plain_loops.WORLDS[name]
    plan = made(tmp_path, plain_loops.ohms(), on, topology)
    slots = course.Slots(plan, slice(0, 2))
    slots.terms[1, 0, 5] = np.nan
    with pytest.raises(SimulatorError, match="input charge of row 1"):
        for _ in slots.blocks():
            pass
