# SPDX-License-Identifier: Apache-2.0
"""A mirror ratio of its own in every column: the codes are those of scenes with that ratio everywhere."""

import tomllib
from typing import Any

import numpy as np
import pytest

import dermis

K = [20, 40, 80, 160]


def simulated(engine: str, **interface: Any) -> dermis.Result:
    # Icarus builds in a second; Verilator compiles C++.
    options = {"simulator": "icarus"} if engine == "rtl" else {}
    on = {"row_driver": True, "column_offset": True, "mirror_ratio": True}
    ohm = np.full((2, 4), 2100.0)
    return dermis.simulate(resistance_ohm=ohm, engine=engine, effects=on, interface=interface, **options)


@pytest.mark.parametrize(
    "engine",
    ["closed", "event", *(pytest.param(e, marks=pytest.mark.timeout(300)) for e in ("rtl", "cosim"))],
)
@pytest.mark.parametrize("topology", ["conveyor_mirror", "multi_output_conveyor"])
def test_every_column_reads_as_if_all_had_its_ratio(engine: str, topology: str) -> None:
    codes = simulated(engine, topology=topology, k_column=K).codes
    alike = [simulated("closed", topology=topology, k=k).codes for k in K]
    want = np.stack([of_k[..., c] for c, of_k in enumerate(alike)], axis=-1)
    assert np.array_equal(codes, want)
    assert np.unique(codes).size == len(K)


def test_a_saved_scene_has_the_ratios() -> None:
    saved = tomllib.loads(simulated("closed", k_column=K).plan.resolved_toml())
    assert saved["interface"]["k_column"] == K
    assert "k_column" not in tomllib.loads(simulated("closed").plan.resolved_toml())["interface"]
