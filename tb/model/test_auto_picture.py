# SPDX-License-Identifier: Apache-2.0
"""The picture of time against exactness: what its points are, and that it is drawn."""

from __future__ import annotations

from pathlib import Path

from tb.programs import auto_picture


def test_points_of_a_scene(tmp_path: Path) -> None:
    points = {p.way: p for p in auto_picture.measure(["humming_supply"])}
    assert set(points) == set(auto_picture.WAYS)
    assert all(p.seconds > 0 for p in points.values())
    assert points["auto"].different == points["everything"].different == 0.0
    # Engine closed has no ripple, which moves most codes of this scene.
    assert points["closed"].different > 0.5
    auto_picture.draw(list(points.values()), tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
