# SPDX-License-Identifier: Apache-2.0
"""The program behind `make decode`: published tables, and rows that can miss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dermis.decode import crosstalk
from dermis.decode.recording import Layout, load
from tb.programs.decode import command, figures, published


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


def test_recordings_that_are_not_here_are_skipped(tmp_path: Path) -> None:
    assert {row["status"] for row in command.recordings(None)} == {"SKIP"}
    assert {row["status"] for row in command.recordings(tmp_path)} == {"SKIP"}


@pytest.mark.paper
def test_a_recording_goes_through_the_chip_and_back(tmp_path: Path) -> None:
    """As the public recording is laid out: a frame a line, 256 codes."""
    codes = np.zeros((12, 16, 16), int)
    codes[3:, 4:12, 5:11] = np.arange(9)[:, None, None] * 12
    np.savetxt(tmp_path / "fscan_gait_16x16.csv", codes.reshape(12, 256), fmt="%d", delimiter=",")
    assert load(tmp_path / "fscan_gait_16x16.csv", Layout(rate_hz=31.25)).t_frame_s == pytest.approx(0.032)
    rows = {row["name"]: row for row in command.recordings(tmp_path)}
    assert rows["decode.fscan_16x16.interval_coverage"]["value"] == 1
    corrected = rows["decode.fscan_16x16.corrected.rms_error_n"]["value"]
    assert corrected < 0.03 < rows["decode.fscan_16x16.uncorrected.rms_error_n"]["value"]


def test_figures_are_drawn(tmp_path: Path) -> None:
    figures.error_maps(tmp_path / "maps.png")
    assert (tmp_path / "maps.png").read_bytes().startswith(b"\x89PNG")
