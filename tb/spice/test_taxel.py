# SPDX-License-Identifier: Apache-2.0
"""The taxel cell against a nodal solve written out by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from dermis.scene.design import Design


def nodal(design: Design, lateral_ohm: float) -> dict[str, float]:
    """Solve the circuit of taxel__dc: nodes are the inner electrodes 00, 01, 10, 11."""
    inner = [(0, 2, 10.0), (1, 3, 10.0), *((a, b, lateral_ohm) for a, b in ((0, 1), (2, 3), (0, 2), (1, 3)))]
    to_volts = [(0, 500.0, 0.5), (1, 2000.0, 0.5), (2, 1000.0, 0.0), (3, design.array.r_floor_ohm, 0.0)]
    to_volts += [(2, 5.0, 0.0), (3, 5.0, 0.0)]
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    for a, b, ohm in inner:
        matrix[[a, b, a, b], [a, b, b, a]] += np.array([1, 1, -1, -1]) / ohm
    for node, ohm, volt in to_volts:
        matrix[node, node] += 1 / ohm
        right[node] += volt / ohm
    v = np.linalg.solve(matrix, right)
    inner_v = dict(zip(("v_inner_00", "v_inner_01", "v_inner_10"), v[:3], strict=True))
    return {"i_col_0": v[2] / 5, "i_col_1": v[3] / 5, **inner_v}


@pytest.mark.parametrize("dut", [{}, {"r_lateral_ohm": 100.0}, {"r_lateral_ohm": 1e18}])
def test_four_cells_make_the_array_of_a_nodal_solve(measure: Callable, design: Design, dut: dict) -> None:
    got = measure("taxel__dc", dut=dut)
    want = nodal(design, dut.get("r_lateral_ohm", design.array.r_lateral_ohm))
    for name, value in want.items():
        # A linear deck with reltol 1e-9; 1e18 ohm of lateral beside gmin costs two digits more.
        assert got[name] == pytest.approx(value, rel=1e-7, abs=0), name
