# SPDX-License-Identifier: Apache-2.0
"""Figures: one scale for both maps, portrait arrays, and bins in place of millions of points."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

import dermis
from dermis.report import comparison, figures


def drawn(tmp_path: Path, newtons: np.ndarray) -> tuple[Figure, dict[str, Any]]:
    result = dermis.simulate(force_n=newtons, engine="closed")
    path, fit = tmp_path / "frame.png", comparison.fit_residual(result.plan, result.codes)
    figure = figures.frame_figure(result.plan, result.codes, fit, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    return figure, {axes.get_label(): axes for axes in figure.axes}


def points(figure: Figure) -> int:
    return sum(len(line.get_xdata()) for axes in figure.axes for line in axes.lines)


def words(figure: Figure) -> set[str]:
    """Marks of the scales."""
    return {text.get_text() for bar in figure.axes for text in bar.get_yticklabels()}


def test_few_codes_are_drawn_one_by_one_and_many_are_counted_in_cells(tmp_path: Path) -> None:
    forces = np.random.default_rng(1).uniform(0, 14.9, (figures.POINTS_MAX // 256, 16, 16))
    figure, axes = drawn(tmp_path, forces)
    assert points(figure) > 2 * forces.size, "each code twice, and the lines"
    many = np.concatenate([forces] * 3)
    figure, axes = drawn(tmp_path, many)
    assert points(figure) < 100, "lines only"
    for name in ("curve", "rest"):
        (cells,) = [c for c in axes[name].collections if isinstance(c, PolyCollection)]
        assert cells.get_array().sum() == many.size, "no code is lost"


@pytest.mark.paper
def test_both_maps_have_one_scale_that_says_newtons_and_codes(tmp_path: Path) -> None:
    force = np.array([[[0.0, 7.5, 15.0, 40.0]] * 4])
    figure, axes = drawn(tmp_path, force)
    press, codes = (axes[name].images[0] for name in ("press", "codes"))
    assert press.get_clim() == codes.get_clim() == (0, 255)
    # 7.5 N are 127.5 counts; a code is a whole number.
    assert np.abs(press.get_array() - codes.get_array()).max() <= 0.5
    assert {"0  (0 N)", "255  (15 N)"} <= words(figure)


@pytest.mark.paper
def test_a_light_touch_fills_the_scales(tmp_path: Path) -> None:
    figure, axes = drawn(tmp_path, np.linspace(0, 1.5, 256).reshape(1, 16, 16))
    assert axes["press"].images[0].get_clim() == axes["codes"].images[0].get_clim() == (0, 31)
    assert axes["curve"].get_xlim()[1] < 2
    assert "31  (1.82 N)" in words(figure)


@pytest.mark.paper
def test_curves_are_as_wide_as_maps_and_scale_and_end_at_full_force(tmp_path: Path) -> None:
    figure, axes = drawn(tmp_path, np.linspace(0, 14, 256).reshape(1, 16, 16))
    assert axes["rest"].get_window_extent().x1 > 0.97 * figure.bbox.width
    assert [text.get_text() for text in axes["rest"].get_xticklabels()][-1] == "15"


@pytest.mark.parametrize(("rows", "cols"), [(60, 21), (4, 16), (16, 16), (1, 16), (16, 1)])
def test_maps_of_any_shape_fill_their_place(rows: int, cols: int, tmp_path: Path) -> None:
    figure, axes = drawn(tmp_path, np.full((1, rows, cols), 5.0))
    box, whole = axes["codes"].get_window_extent(), figure.bbox
    # Square taxels, and a map that takes a sixth of the figure in one direction at least.
    assert box.width / cols == pytest.approx(box.height / rows, rel=0.02)
    assert max(box.width / whole.width, box.height / whole.height) > 0.16
