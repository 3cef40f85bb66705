# SPDX-License-Identifier: Apache-2.0
"""The Python on the pages of the documentation runs as it is written there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

PAGES = ("docs/tutorial.md", "docs/howto_design.md", "docs/sky130.md", "README.md")


def python(folder: Path, code: str) -> str:
    """Run code in a folder, warnings as errors; return its output."""
    command = [sys.executable, "-W", "error", "-c", code]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=150)
    assert run.returncode == 0, run.stderr[-3000:]
    return run.stdout


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.paper
def test_every_block_of_a_page_runs_in_order(page: str, tmp_path: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S)
    assert blocks
    python(tmp_path, "\n".join(blocks))


def test_the_scene_of_the_tutorial_runs(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```toml\n(.*?)^```$", text, re.M | re.S)
    (tmp_path / "finger.toml").write_text(block)
    assert int(python(tmp_path, "import dermis; print(dermis.simulate('finger.toml').codes.sum())")) > 0
