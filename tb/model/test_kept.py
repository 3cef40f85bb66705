# SPDX-License-Identifier: Apache-2.0
"""What a long run has finished is there again for the same code, and for nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts.checkpoint import Kept


def test_pieces_are_taken_up_by_the_same_stamp_alone(tmp_path: Path) -> None:
    path = tmp_path / "new" / "state.json"
    Kept(path, "code").put("a", {"value": 0.1})
    assert Kept(path, "code").pieces == {"a": {"value": 0.1}}
    assert Kept(path, "other code").pieces == {}
    assert Kept(path, "code", fresh=True).pieces == {}


def test_a_piece_may_wait_for_the_file_but_not_for_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = Kept(tmp_path / "state.json", "code")
    kept.put("a", 1, now=False)
    assert Kept(kept.path, "code").pieces == {}
    monkeypatch.setattr("scripts.checkpoint._SAVE_S", 0.0)
    kept.put("b", 2, now=False)
    assert Kept(kept.path, "code").pieces == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"stamp": "code"}', '{"stamp": "code", "pieces": 3}', "\0"]
)
def test_a_file_that_is_none_of_ours_counts_for_nothing(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    kept = Kept(path, "code")
    assert kept.pieces == {}
    kept.put("a", 1)
    assert json.loads(path.read_text()) == {"stamp": "code", "pieces": {"a": 1}}
