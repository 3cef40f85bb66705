# SPDX-License-Identifier: Apache-2.0
"""The program behind `make decode`: published tables, and rows that can miss."""

from pathlib import Path

import numpy as np
import pytest

from dermis.decode import crosstalk
from tb.programs.decode import command, published


@pytest.mark.parametrize(("table", "count"), [(4, 144), (6, 165)])
def test_the_published_tables_are_reproduced(table: int, count: int) -> None:
    cells = published.cells(table)
    # Two digits are printed, and the authors' amplifier adds 0.02.
    assert max(map(published.miss, cells)) < 0.06
    assert len(cells) == count


def test_the_solver_leaves_nothing_in_the_worst_published_cell() -> None:
    # 1.56 % after two published steps.
    assert published.ours(*published.WORST) < 1e-6


def test_the_table_is_not_reproduced_with_another_series_resistance() -> None:
    assert max(published.miss(c) for c in published.cells(6, 6.0) if c.part == "classical") > 1


def test_a_solver_that_stops_early_misses_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    assert command.noise_free()["status"] == "PASS"
    solve = crosstalk.solve

    def blunt(network, currents):
        return solve(network, np.asarray(currents) * (1 + 1e-7))

    monkeypatch.setattr(command.crosstalk, "solve", blunt)
    assert command.noise_free()["status"] == "FAIL"


def test_figures_are_drawn(tmp_path: Path) -> None:
    command.error_maps(tmp_path / "maps.png")
    assert (tmp_path / "maps.png").read_bytes().startswith(b"\x89PNG")
