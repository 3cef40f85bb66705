# SPDX-License-Identifier: Apache-2.0
"""Every kind of file is read to the numbers that were written, or asked about; a reader that errs is noticed."""

import random
from pathlib import Path

import numpy as np
import pytest

from dermis.decode import recording, recording_bag, recording_parquet, recording_text
from dermis.errors import InputError
from tb.programs.decode import command, files, kinds


@pytest.mark.parametrize("name", kinds.CASES)
def test_a_kind_of_file(tmp_path: Path, name: str) -> None:
    assert kinds.fault(kinds.CASES[name], tmp_path) is None


@pytest.mark.parametrize(
    ("module", "name", "wrong", "noticed"),
    [
        (recording_bag, "_multi_array", lambda path, layout, data, size: data, "Int16MultiArray, padding"),
        (recording_bag, "_image", lambda path, said: said["data"].reshape(said["height"], -1), "32FC1"),
        (recording_text, "STAMP", recording_text.re.compile("never"), "labels with times"),
        (recording_text, "time_unit_of", lambda name: "s", "time_ms"),
        (recording_parquet.Columns, "_parts", lambda self, name, lists: {}, "Parquet, rows of lists"),
        (recording, "_gaps", lambda path, frames, gaps: np.nan_to_num(frames), "missing cell -"),
    ],
)
def test_a_reader_that_errs_is_noticed(monkeypatch: pytest.MonkeyPatch, module, name, wrong, noticed) -> None:
    monkeypatch.setattr(module, name, wrong)
    monkeypatch.setattr(kinds, "CASES", {kind: kinds.CASES[kind] for kind in ("stamps in ns", noticed)})
    row = command.kinds_row()
    assert row["status"] == "FAIL"
    assert noticed in row["note"]


@pytest.mark.parametrize("unit", "s sec secs seconds ms msec milliseconds us micros ns nanosec".split())
def test_units_of_time_are_known(unit: str) -> None:
    wanted = {"s": "s", "m": "ms", "u": "us", "n": "ns"}["u" if unit == "micros" else unit[0]]
    assert recording_text.time_unit_of(f"time_{unit}") == wanted


def test_no_drawn_file_is_read_wrongly_without_a_warning(tmp_path: Path) -> None:
    counts = files.count(tmp_path, 120)
    assert counts["right"] > counts["refused"] + counts["warned"]


def test_texts_with_damage_end_in_one_line(tmp_path: Path) -> None:
    draw = random.Random(3)
    pieces = [b"", b"Frame 3\n", b"# x\n", b"\n\n", b'"', b"[", b"]", b",", b"time,", b"\0"]
    pieces += [b"9" * 400, b"12:00:00", b"MVP"]
    options = {}, kinds.SIZE | kinds.RATE, {"part": 1}, {"skip": 1} | kinds.RATE, {"time_key": "0"}
    said: list[str] = []
    for _ in range(150):
        content = bytearray(files.text_file(lambda options: draw.choice(list(options)))[0])
        for _ in range(draw.choice([1, 2, 5])):
            at = draw.randrange(len(content) + 1)
            content[at : at + draw.choice([0, 1, 60])] = draw.choice(pieces)
        (tmp_path / "damaged.csv").write_bytes(content)
        found, words = files.read(tmp_path / "damaged.csv", draw.choice(options))
        said += [words] if isinstance(found, InputError) else []
    assert 0 < len(said) < 150
    assert not any("\n" in line for line in said)


def test_a_reader_that_ignores_names_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_written(self, first: str, numbers: np.ndarray, word: str) -> tuple:
        return np.arange(len(numbers)), len(numbers), True

    monkeypatch.setattr(recording_text.Table, "_flat", as_written)
    with pytest.raises(AssertionError):
        files.count(tmp_path, 120, shrink=False)
