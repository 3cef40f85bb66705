# SPDX-License-Identifier: Apache-2.0
"""docs/howto_effect.md: its changes make a complete effect of a copy of the package, and its test passes there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from dermis.scene.design import ROOT

PAGE = ROOT / "docs" / "howto_effect.md"


def test_the_page_adds_a_complete_effect(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    skip = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "models", tmp_path / "models", ignore=skip)
    for name in ("test_effects.py", "made_plans.py"):
        shutil.copy(ROOT / "tb" / "model" / name, tmp_path)
    (tmp_path / "page.diff").write_text("".join(re.findall(r"^```diff\n(.*?)^```", text, re.M | re.S)))
    # The place of a change moves with its file; every line of its context must be there.
    run(tmp_path, "git", "apply", "page.diff")
    found = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    (tmp_path / "test_page.py").write_text("".join(found))
    tests = [
        "test_page.py",
        "test_effects.py",
        "-k",
        "(preset_charge and not closed_reads) or packet_left or refuses",
    ]
    said = run(tmp_path, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)
    passed = re.search(r"(\d+) passed", said)
    assert passed is not None
    assert int(passed[1]) >= 6, said


def run(work: Path, *command: str) -> str:
    """Run a command on the copy, which must succeed."""
    # A copy would be compiled anew, which takes longer than a few taxels in plain Python.
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    environment |= {"PYTHONPATH": str(work / "models"), "GIT_CEILING_DIRECTORIES": str(work.parent)}
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, timeout=170)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
