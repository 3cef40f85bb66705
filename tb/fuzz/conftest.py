# SPDX-License-Identifier: Apache-2.0
"""A directory in which a target's inputs may live."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A directory by its real name: what is written is compared with it."""
    return tmp_path.resolve()
