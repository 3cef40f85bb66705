# SPDX-License-Identifier: Apache-2.0
"""Makes the bench runner importable and gives every test a copy of spice/ to run in."""

import itertools
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from ngspice_batch import Bench, run

from dermis.scene import design as design_module
from dermis.scene.design import Design


@pytest.fixture(scope="session")
def design() -> Design:
    """The values of models/design.toml, which the decks see as spice/design.inc."""
    return design_module.load()


@pytest.fixture
def measure(tmp_path: Path) -> Callable[..., dict[str, float]]:
    """Run a bench by name, changed as `Bench` says, and return its measures."""
    numbers = itertools.count()

    def run_bench(name: str, limit_s: float = 60.0, **changes: object) -> dict[str, float]:
        return run(Bench(name, **changes).write(tmp_path / str(next(numbers))), limit_s)

    return run_bench
