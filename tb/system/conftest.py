# SPDX-License-Identifier: Apache-2.0
"""Plans for tests of whole commands; the modules of this room can be imported by name."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from dermis import plan
from dermis.chip import hdl
from dermis.processes import pool
from dermis.records import Plan
from scripts import lint
from scripts.markdown import filled

sys.path.insert(0, str(Path(__file__).resolve().parent))

from deck_bench import DeckReader
from system_bench import MakePlan


@pytest.fixture
def resistance_plan(tmp_path: Path) -> MakePlan:
    """Make the cosim plan of resistances [rows, cols] or [frames, rows, cols] in ohm."""

    def make(ohm: np.ndarray, topology: str = "conveyor_mirror", effects: str = "", more: str = "") -> Plan:
        ohm = np.asarray(ohm, dtype=float)
        np.save(tmp_path / "taxels.npy", ohm)
        scene = tmp_path / "scene.toml"
        scene.write_text(
            f'title = "test"\n[array]\nrows = {ohm.shape[-2]}\ncols = {ohm.shape[-1]}\n'
            '[stimulus]\nkind = "resistance"\nfile = "taxels.npy"\n'
            f'[interface]\ntopology = "{topology}"\n{more}\n[effects]\n{effects}\n'
        )
        return plan.load(scene, "cosim")

    return make


@pytest.fixture
def faulty_chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str, str], None]:
    """Change one place in a file of rtl/ for later runs of this test."""

    def change(file: str, right: str, wrong: str) -> None:
        sources = lint.rtl_sources()
        at = next(i for i, source in enumerate(sources) if source.name == file)
        text = filled(sources[at].read_text(), {right: wrong}, file)
        sources[at] = tmp_path / file
        sources[at].write_text(text)
        monkeypatch.setattr(hdl, "rtl_sources", lambda: sources)

    return change


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DeckReader]:
    """A process that reads decks without the Verilog."""
    with pool.workers(1) as executor:
        yield DeckReader(executor, tmp_path_factory.mktemp("decks"))
