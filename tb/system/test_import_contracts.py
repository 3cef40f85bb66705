# SPDX-License-Identifier: Apache-2.0
"""Import contracts of pyproject.toml notice an import that breaks them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

LINT = Path(sys.executable).with_name("lint-imports")

FAULTS = {  # by file of the package: what is added to it, and the contract that it breaks
    "array/array.py": ("import dermis.engines.event", "Models know no engine"),
    "records.py": ("import typing\nif typing.TYPE_CHECKING:\n    from dermis.plan import load", "No circle"),
    "array/star_mesh.py": ("def later():\n    from dermis.array import array", "No circle"),
    "scene/design.py": ("def later():\n    import scripts.generate", "The package imports nothing"),
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


@pytest.mark.parametrize("file", FAULTS)
def test_an_import_that_breaks_a_contract_is_noticed(tree: Path, file: str) -> None:
    path, (added, contract) = tree / "models" / "dermis" / file, FAULTS[file]
    text = path.read_text()
    environment = {**os.environ, "PYTHONPATH": f"{tree / 'models'}:{tree}"}
    command = [LINT, "--no-cache"]
    path.write_text(f"{text}\n{added}\n")
    try:
        run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=120)
    finally:
        path.write_text(text)
    broken = [line for line in run.stdout.splitlines() if line.endswith("BROKEN")]
    assert run.returncode == 1
    assert any(contract in line for line in broken), run.stdout + run.stderr
