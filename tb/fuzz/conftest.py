# SPDX-License-Identifier: Apache-2.0
"""A directory for inputs."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Return a directory by its real path, with which written paths are compared."""
    return tmp_path.resolve()
