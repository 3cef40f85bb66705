# SPDX-License-Identifier: Apache-2.0
"""Compiled loops follow every source that they use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dermis.machine_code import drop_stale

LOOP = """
import numba
from part import double
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
    (tmp_path / "loop.py").write_text(LOOP)
    found = []
    for factor in (2, 3):
        (tmp_path / "part.py").write_text(PART.format(factor=factor))
        if dropped:
            drop_stale(tmp_path)
        command = [sys.executable, "-c", "from loop import loop; print(loop(10))"]
        told = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120
        )  # a first compilation takes some seconds
        found.append(int(told.stdout))
    assert found == ([20, 30] if dropped else [20, 20])
    drop_stale(tmp_path)
    assert bool([*tmp_path.glob("__pycache__/*.nbi")]) == dropped, "drops what is stale, and nothing else"
