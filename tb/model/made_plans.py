# SPDX-License-Identifier: Apache-2.0
"""Plans of given resistances and effects, and the errors of those that are refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dermis import plan as planning
from dermis import records
from dermis.errors import InputError
from dermis.scene import scene


def refused(call: Callable[..., object], *given: object) -> InputError:
    """Return the error of a call, which must be one line in the promised form."""
    with pytest.raises(InputError) as caught:
        call(*given)
    error, text = caught.value, str(caught.value)
    assert error.exit_code == 2
    assert text.isprintable()  # no line end
    assert text.startswith(f"{error.file}: {error.key} = ")
    assert len(text) < 1500
    return error


def made(
    tmp_path: Path,
    ohm: np.ndarray,
    effects: dict[str, object],
    topology: str = "conveyor_mirror",
    seed: int = 0,
    engine: str | None = None,
) -> records.Plan:
    np.save(tmp_path / "ohm.npy", ohm)
    data = {
        "array": {"rows": ohm.shape[1], "cols": ohm.shape[2]},
        "stimulus": {"kind": "resistance", "file": str(tmp_path / "ohm.npy")},
        "interface": {"topology": topology},
        "effects": effects,
        "run": {"seed": seed},
    }
    return planning.make(scene.from_data(data, tmp_path / "made.toml"), engine)


def ohms(seed: int, *shape: int) -> np.ndarray:
    return 500.0 * 10 ** np.random.default_rng(seed).uniform(0, 2, shape)


def with_break(plan: records.Plan, clocks: int) -> records.Plan:
    return replace(plan, timing=replace(plan.timing, break_clocks=clocks))
