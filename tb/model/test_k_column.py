# SPDX-License-Identifier: Apache-2.0
"""A mirror ratio of its own in every column: the codes are those of scenes with that ratio everywhere."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import engines, plan
from dermis.records import Plan
from dermis.scene import scene

K = [20, 40, 80, 160]


def made(engine: str, **interface: Any) -> Plan:
    data = {
        "array": {"rows": 2, "cols": 4},
        "stimulus": {"kind": "uniform", "r_ohm": 2100.0},
        "interface": interface,
        "effects": {"row_driver": True, "column_offset": True, "mirror_ratio": True},
    }
    return plan.make(scene.from_data(data, Path("made.toml")), engine)


@pytest.mark.parametrize(
    "engine",
    ["closed", "event", *(pytest.param(e, marks=pytest.mark.timeout(300)) for e in ("rtl", "cosim"))],
)
@pytest.mark.parametrize("topology", ["conveyor_mirror", "multi_output_conveyor"])
def test_every_column_reads_as_if_all_had_its_ratio(engine: str, topology: str) -> None:
    # Icarus builds in a second; Verilator compiles C++.
    options = {"simulator": "icarus"} if engine == "rtl" else {}
    codes = engines.run(made(engine, topology=topology, k_column=K), **options).codes
    alike = [engines.run(made("closed", topology=topology, k=k)).codes for k in K]
    want = np.stack([of_k[..., c] for c, of_k in enumerate(alike)], axis=-1)
    assert np.array_equal(codes, want)
    assert np.unique(codes).size == len(K)


def test_a_saved_scene_has_the_ratios() -> None:
    saved = tomllib.loads(made("closed", k_column=K).resolved_toml())
    assert saved["interface"]["k_column"] == K
    assert "k_column" not in tomllib.loads(made("closed").resolved_toml())["interface"]
