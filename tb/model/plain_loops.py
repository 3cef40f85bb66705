# SPDX-License-Identifier: Apache-2.0
"""Codes of small scenes by the compiled loops or, with NUMBA_DISABLE_JIT=1, by the same loops in plain Python.

`python plain_loops.py FILE` writes them into FILE (npz). Plain Python raises at every invalid operation, division by
zero and overflow of one number, which vector code cannot tell from those of unused lanes.
"""

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from made_plans import made

from dermis import effects
from dermis.converter import course, noise
from dermis.engines import event
from dermis.scene.design import load

_LINES = {"lateral": {"r_ohm": 1e3}, "row_driver": {"r_ohm": 5.0, "grounded_r_ohm": 3.0}}
_INPUTS = _LINES | {"column_input": {"r_ohm": 2.0}, "column_offset": {"v_v": 2e-3}}
_TRACES = {"trace": {"r_row_ohm": 1.0, "r_column_ohm": 2.0}}
_CAPACITANCE = {"line_capacitance": {"c_row_f": 2e-9, "c_column_f": 3e-9, "c_taxel_f": 1e-12}}
_MOVING = {"motion": True, "supply_ripple": {"relative": 0.05, "frequency_hz": 3e3}}
_BENT = {"mirror_lag": {"q_c": 2e-10}, "range_switch": {"r_ohm": 300.0, "v_overdrive_v": 0.2}}
_SLOW = {"integrator_gain": {"gain_dc": 200.0, "r_in_ohm": 1e6}, "integrator_bandwidth": {"gbw_hz": 3e6}}
_NARROW = {"integrator_range": {"v_max_v": 0.6, "v_min_v": -0.6}}
_LATE = {"comparator_delay": {"t_s": 5e-8}, "comparator_hysteresis": {"v_v": 0.02}}
_NOISE = {name: True for name, effect in effects.EFFECTS.items() if effect.random}

# Topology and effects. Together they take every branch of the loops, line by line (test_plain_loops.py).
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "ideal": ("conveyor_mirror", {}),
    "lines": ("conveyor_mirror", _LINES),
    "inputs": ("conveyor_mirror", _INPUTS),
    "traces": ("conveyor_mirror", _INPUTS | _TRACES),
    "row_traces": ("conveyor_mirror", _LINES | {"trace": {"r_row_ohm": 1.0, "r_column_ohm": 0.0}}),
    "capacitance": ("conveyor_mirror", _INPUTS | _CAPACITANCE),
    "moving": ("conveyor_mirror", _INPUTS | _MOVING),
    "bent": ("conveyor_mirror", _BENT),
    "bent_moving": ("multi_output_conveyor", _INPUTS | _BENT | _MOVING | _CAPACITANCE),
    "slow": ("conveyor_mirror", _SLOW),
    "narrow": ("conveyor_mirror", _NARROW),
    "narrow_slow": ("conveyor_mirror_inverted", _SLOW | _NARROW | _LATE),
    "late": ("conveyor_mirror", _LATE),
    "noise": ("conveyor_mirror", _NOISE),
    "noise_slow": ("conveyor_mirror", _NOISE | _SLOW | _NARROW | _LATE | _MOVING),
    "columns": ("direct", {"integrator_gain": {"gain_dc": 1e4, "r_in_ohm": 1e9}} | _LINES | _NARROW),
}  # fmt: skip


def ohms() -> np.ndarray:
    """Taxels [2 frames, 3 rows, 4 columns] from open to overloaded, one of them a short in one frame."""
    ohm = 600.0 * 10 ** np.random.default_rng(7).uniform(0, 2, (2, 3, 4))
    ohm[0, 0, 1], ohm[1, 2, 3], ohm[0, 1, 2] = np.inf, 20.0, 1e9
    return ohm


def codes(name: str, scratch: Path) -> np.ndarray:
    """Codes of one world through engine event."""
    topology, on = WORLDS[name]
    return event.run(made(scratch, ohms(), on, topology)).codes


def main(path: str) -> None:
    """Write the codes of every world into `path`."""
    assert os.environ.get("NUMBA_DISABLE_JIT") == "1"
    for name in ("_mix", "uniform", "_keys"):
        # Integers of a hash may wrap around, which numpy calls an overflow of a single number.
        setattr(noise, name, np.errstate(over="ignore")(getattr(noise, name)))
    if "--seeded" in sys.argv:  # a fault: what the mirror divides by is 0 and its quotient is not used
        course.approach = lambda x, y, t: np.float64(0.0)
    load()
    with np.errstate(divide="raise", over="raise", invalid="raise"), tempfile.TemporaryDirectory() as scratch:
        found = {name: codes(name, Path(scratch)) for name in WORLDS}
    np.savez(path, **found)


if __name__ == "__main__":
    main(sys.argv[1])
