# SPDX-License-Identifier: Apache-2.0
"""A checkpoint returns the finished pieces of the same code, and nothing else."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from scripts import workers
from scripts.checkpoint import Checkpoint


def test_only_the_same_stamp_returns_the_pieces(tmp_path: Path) -> None:
    path = tmp_path / "new" / "state.json"
    Checkpoint(path, "code").put("a", {"value": 0.1})
    assert Checkpoint(path, "code").pieces == {"a": {"value": 0.1}}
    assert Checkpoint(path, "other code").pieces == {}
    assert Checkpoint(path, "code", fresh=True).pieces == {}


def test_a_piece_is_written_within_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Checkpoint(tmp_path / "state.json", "code")
    store.put("a", 1, now=False)
    assert Checkpoint(store.path, "code").pieces == {}
    monkeypatch.setattr("scripts.checkpoint._SAVE_S", 0.0)
    store.put("b", 2, now=False)
    assert Checkpoint(store.path, "code").pieces == {"a": 1, "b": 2}


@pytest.mark.parametrize("text", ["", "[]", '{"stamp": "code"}', '{"stamp": "code", "pieces": 3}', "\0"])
def test_a_foreign_file_is_ignored(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    store = Checkpoint(path, "code")
    assert store.pieces == {}
    store.put("a", 1)
    assert json.loads(path.read_text()) == {"stamp": "code", "pieces": {"a": 1}}


def test_a_run_that_ended_goes_on_and_keeps_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def run_until(last: int) -> None:
        """Stand in for `workers.run`, interrupted at a task."""

        def run(tasks: Iterable[workers.Task], *_: object, **__: object) -> Iterator[tuple]:
            for number, task in enumerate(tasks):
                (n,) = task.arguments
                if n == last:
                    raise KeyboardInterrupt
                asked.append(n)
                yield number, workers.Outcome(1 / n) if n else workers.Outcome(fault="hangs")

        monkeypatch.setattr(workers, "run", run)

    tasks = {str(n): workers.Task(pow, (n,)) for n in (1, 2, 0, 4)}
    run_until(0)
    with pytest.raises(KeyboardInterrupt):
        Checkpoint(tmp_path / "state.json", "code").run(tasks, 1)
    run_until(-1)
    again = Checkpoint(tmp_path / "state.json", "code")
    assert again.pieces == {"1": 1.0, "2": 0.5}
    assert again.run(tasks, 1) == {"0": "hangs"}
    assert Checkpoint(again.path, "code").pieces == {"1": 1.0, "2": 0.5, "4": 0.25}
    assert asked == [1, 2, 0, 4]
