# SPDX-License-Identifier: Apache-2.0
"""Every kind of file is read to the numbers that were written, or asked about; a reader that errs is noticed."""

from pathlib import Path

import numpy as np
import pytest

from dermis.decode import recording, recording_bag, recording_parquet, recording_text
from dermis.errors import InputError
from tb.programs.decode import command, kinds


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
    row = command.kinds_row()
    assert row["status"] == "FAIL"
    assert noticed in row["note"]


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("a.mcap", b"no bag"),
        ("a.db3", b"SQLite format 3\0"),
        ("a.parquet", b"PAR1 no"),
        ("a.csv.gz", b"\x1f\x8b\x08"),
    ],
)
def test_damaged_files_end_in_one_line(tmp_path: Path, file: str, content: bytes) -> None:
    (tmp_path / file).write_bytes(content)
    with pytest.raises(InputError, match="a readable") as error:
        recording.load(tmp_path / file, recording.Layout())
    assert "\n" not in str(error.value)
