# SPDX-License-Identifier: Apache-2.0
"""The Python on the pages of the documentation runs as it is written there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

PAGES = ("docs/tutorial.md", "docs/howto_design.md", "README.md")


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.paper
def test_every_block_of_a_page_runs_in_order(page: str, tmp_path: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S)
    assert blocks
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(blocks)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=150,
    )
    assert run.returncode == 0, run.stderr[-3000:]


def test_the_scene_of_the_tutorial_runs(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```toml\n(.*?)^```$", text, re.M | re.S)
    (tmp_path / "finger.toml").write_text(block)
    code = "import dermis; print(dermis.simulate('finger.toml').codes.sum())"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=150
    )
    assert int(run.stdout) > 0, run.stderr
