# SPDX-License-Identifier: Apache-2.0
"""One seed, one result to the last bit: however often, wherever, in what order and in how many parts it is run."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import repeat

SCENES = ("noisy_channel", "nonideal_channel", "printed_traces:event")
SCENES += ("humming_supply", "worn_fsr_sheet", "quarter_code_fingertip")


@pytest.fixture(scope="module")
def here() -> dict[str, str]:
    """Digests of the scenes in this process, with all that its other tests left in it."""
    return {name: repeat.digest(repeat.numbers(repeat.load(name))) for name in SCENES}


@pytest.mark.parametrize(
    ("scenes", "threads", "hash_seed", "locale", "zone"),
    [(SCENES, "1", "1", "C", "UTC"), (SCENES[::-1], "4", "2", "tr_TR.UTF-8", "Asia/Kathmandu")],
    ids=["1 thread", "4 threads"],
)
def test_another_process_gets_every_bit_the_same(
    here: dict[str, str], tmp_path: Path, scenes: Any, threads: str, hash_seed: str, locale: str, zone: str
) -> None:
    """Digests of a process elsewhere, in another order and environment."""
    changed = {"OPENBLAS_NUM_THREADS": threads, "PYTHONHASHSEED": hash_seed, "LC_ALL": locale, "TZ": zone}
    done = subprocess.run(
        [sys.executable, repeat.__file__, *scenes], cwd=tmp_path, env=os.environ | changed,
        capture_output=True, text=True, timeout=150,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == here


@pytest.mark.parametrize(
    "name", ["noisy_channel", "humming_supply", "worn_fsr_sheet", "press_and_release", "moving_finger"]
)
def test_parts_of_a_run_are_the_run(name: str) -> None:
    made = repeat.load(name)
    assert made.frames > 3
    whole = repeat.numbers(made)
    for cuts in ([1], list(range(1, made.frames)), [made.frames // 2]):
        parts = repeat.joined(made, cuts)
        assert {k for k in whole if not np.array_equal(whole[k], parts[k], equal_nan=True)} == set(), cuts
