# SPDX-License-Identifier: Apache-2.0
"""Import contracts of pyproject.toml notice an import that breaks them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

LINT = Path(sys.executable).with_name("lint-imports")

FAULTS = {
    "an engine in a model": (
        "models/dermis/array/array.py",
        "import dermis.engines.event",
        "Models know no engine",
    ),
    "a plan in a type": (
        "models/dermis/records.py",
        "import typing\nif typing.TYPE_CHECKING:\n    from dermis.plan import load",
        "No circle",
    ),
    "a circle inside a room": (
        "models/dermis/array/star_mesh.py",
        "def later():\n    from dermis.array import array",
        "No circle",
    ),
    "a program in the package": (
        "models/dermis/scene/design.py",
        "def later():\n    import scripts.generate",
        "The package imports nothing",
    ),
}


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("tree")
    shutil.copy(ROOT / "pyproject.toml", place)
    for path in (path for top in ("models/dermis", "scripts", "tb") for path in (ROOT / top).rglob("*.py")):
        target = place / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
    return place


def lint(tree: Path) -> tuple[int, str]:
    """Exit code and output of import-linter on a copy of the tree."""
    environment = {**os.environ, "PYTHONPATH": f"{tree / 'models'}:{tree}"}
    run = subprocess.run(
        [LINT, "--no-cache"], cwd=tree, env=environment, capture_output=True, text=True, timeout=120
    )
    return run.returncode, run.stdout + run.stderr


@pytest.mark.parametrize("name", FAULTS)
def test_an_import_that_breaks_a_contract_is_noticed(tree: Path, name: str) -> None:
    file, line, contract = FAULTS[name]
    text = (tree / file).read_text()
    try:
        (tree / file).write_text(f"{text}\n{line}\n")
        code, said = lint(tree)
    finally:
        (tree / file).write_text(text)
    broken = [line for line in said.splitlines() if line.endswith("BROKEN")]
    assert code == 1
    assert any(contract in line for line in broken), said
