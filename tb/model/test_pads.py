# SPDX-License-Identifier: Apache-2.0
"""Resistance of pads and of the return of grounded rows, against the nodal reference and by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import engines, plan
from dermis.array.array import Network, column_currents
from dermis.errors import InputError
from dermis.records import Plan
from dermis.scene import scene
from scripts.characterise.results import pads_row
from tb.reference import nodal


def made(effects: dict[str, Any], engine: str | None = "closed", size: int = 8, **more: Any) -> Plan:
    data = {"array": {"rows": size, "cols": size}, "stimulus": {"kind": "uniform", "r_ohm": 500.0}}
    return plan.make(scene.from_data(data | {"effects": effects} | more, Path("made.toml")), engine)


def drawn(rng: np.random.Generator) -> Network:
    rows, cols = rng.integers(1, 6, 2)
    g = 10 ** rng.uniform(-6, -2, (rows, cols))
    g[rng.random(g.shape) < 0.2] = 0.0
    driven = rng.choice([0.0, 10 ** rng.uniform(-2, 2)])
    fields = {
        "r_row_driven_ohm": driven,
        "r_row_grounded_ohm": rng.choice([driven, 0.0, 10 ** rng.uniform(-2, 2), np.inf]),
        "r_column_ohm": rng.choice([0.0, 1.0, 10 ** rng.uniform(-2, 2)], cols),
        "r_return_ohm": 10 ** rng.uniform(-2, 2),
    }
    if rng.random() < 0.5:
        fields |= {"v_column_offset_v": rng.normal(0, 1e-3, cols), "i_leak_a": rng.normal(0, 1e-8, cols)}
    for name in ("g_lateral_row_s", "r_trace_row_ohm", "r_trace_column_ohm"):
        if rng.random() < 0.3:
            fields[name] = 10 ** rng.uniform(-3, 0)
    return Network(g, 0.5, **fields)


def test_a_shared_return_equals_the_nodal_reference() -> None:
    moved = 0
    for seed in range(40):
        network = drawn(np.random.default_rng(seed))
        want = nodal.column_currents(network)
        (driven, error), (rest, rest_error) = nodal.bounded(network)
        current, bound = driven + (0.0 if rest is None else rest), error + rest_error
        # 1e-30 A: currents of open arrays, where the bound is relative to nothing.
        assert (np.abs(current - want) <= bound + 1e-30).all(), seed
        # A sum of a few hundred terms rounds to some 1e-15 of the largest.
        assert np.abs(current - want).max() <= 1e-13 * np.abs(want).max() + 1e-30, seed
        # Far above rounding, far below any code.
        moved += not np.allclose(want, column_currents(replace(network, r_return_ohm=0.0)), rtol=1e-6, atol=0)
    assert moved > 10


def test_rows_of_the_wrapper_read_full_scale_through_their_pads() -> None:
    """150 ohm is the pad that the wrapper does not use."""
    assert pads_row()["status"] == "PASS"
    through_150 = pads_row(150.0)
    assert (through_150["status"], through_150["value"]) == ("FAIL", 75)


def test_a_pad_is_the_same_resistance_in_driver_and_input() -> None:
    pads = made({"pad": {"r_row_ohm": 3.0, "r_column_ohm": 2.0}})
    series = made({"row_driver": {"r_ohm": 3.0}, "column_input": {"r_ohm": 2.0}})
    assert np.array_equal(engines.run(pads).codes, engines.run(series).codes)
    assert pads.active_fields() == {"r_pad_row_ohm", "r_pad_column_ohm"}


@pytest.mark.parametrize(
    ("other", "topology"),
    [
        ({"line_capacitance": True}, "conveyor_mirror"),
        ({"mirror_lag": True, "mux_leakage": True}, "conveyor_mirror"),
        ({"integrator_gain": True, "row_driver": True}, "direct"),
        ({"integrator_bandwidth": True, "row_driver": True}, "direct"),
    ],
)
def test_a_return_is_refused_where_only_a_deck_follows_it(other: dict[str, Any], topology: str) -> None:
    together = made({"return": True} | other, "event", 4, interface={"topology": topology})
    names = "|".join(other)
    with pytest.raises(InputError, match=rf"effects\.return = on together with ({names}): .*engine cosim"):
        engines.check(together)
