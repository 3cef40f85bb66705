# SPDX-License-Identifier: Apache-2.0
"""What the model tests share: scenes written on the spot, helpers beside it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

sys.path.insert(0, str(Path(__file__).resolve().parent))


@pytest.fixture
def write_scene(tmp_path: Path) -> Callable[..., Path]:
    """Write a scene file and the files beside it; returns its path."""

    def write(text: str, **files: str | bytes) -> Path:
        for name, content in files.items():
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / name.replace("__", ".")).write_bytes(data)
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def gait_csv(tmp_path: Path) -> Path:
    """205 real pressure frames where they are at hand, else two made ones of the same kind."""
    data = Path(os.environ.get("DERMIS_DATA", ROOT.parent / "shared" / "data"))
    real = data / "fscan_gait_16x16.csv"
    if real.is_file():
        return real
    made = tmp_path / "frames_made.csv"
    frames = [[(7 * i + 3 * f) % 256 for i in range(256)] for f in range(2)]
    made.write_text("".join(",".join(map(str, frame)) + "\n" for frame in frames))
    return made
