# SPDX-License-Identifier: Apache-2.0
"""Recordings of many kinds are read to the right numbers, or end in a question that names the option."""

import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis.decode import recording, recording_text
from dermis.decode.recording import Layout
from dermis.errors import InputError
from dermis.report import output
from tb.programs.decode import files

SHAPE = (4, 6)
FRAMES = np.round(np.random.default_rng(1).uniform(0, 99, (20, *SHAPE)), 2)
SIZE = {"rows": 4, "cols": 6}
RATE = {"rate_hz": 50.0}


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., recording.Recording]:
    def loaded(content: str | bytes, name: str = "touch.csv", **layout: Any) -> recording.Recording:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = recording.load(path, Layout(**layout))
        loaded.said = " ".join(str(w.message) for w in caught)
        return found

    return loaded


def table(lead: dict[str, list[str]], frames: np.ndarray = FRAMES, names: list[str] | None = None) -> str:
    """Return a csv with leading columns, then the taxels."""
    names = [f"p{k}" for k in range(24)] if names is None else names
    lines = [",".join([*lead, *names])] if names else []
    for n, frame in enumerate(frames):
        lines.append(",".join([*(cells[n] for cells in lead.values()), *(f"{v:g}" for v in frame.ravel())]))
    return "\n".join(lines) + "\n"


def counted(factor: float, start: float = 0) -> list[str]:
    return [f"{start + factor * n:.12g}" for n in range(len(FRAMES))]


@pytest.mark.parametrize("unit", "s sec secs seconds ms msec milliseconds us micros ns nanosec".split())
def test_units_of_time_are_known(unit: str) -> None:
    wanted = {"s": "s", "m": "ms", "u": "us", "n": "ns"}["u" if unit == "micros" else unit[0]]
    assert recording_text.time_unit_of(f"time_{unit}") == wanted


def test_stamps_that_are_missing_or_equal_are_reported(load) -> None:
    stamps = counted(0.02)
    stamps[5], stamps[8] = "", stamps[7]
    found = load(table({"time": stamps}), **SIZE)
    assert found.time_s[5] == pytest.approx(0.1)
    assert "1 of 20 times are missing, the first of frame 5" in load.said
    assert "the first of frame 8" in load.said


def test_a_header_of_numbers_is_no_frame(load) -> None:
    numbers = [str(k) for k in range(24)]
    found = load(table({}, names=numbers), **SIZE, **RATE)
    assert (found.values == FRAMES).all()
    assert "--header" in load.said
    assert (load(table({"": numbers[:20]}, names=numbers), **SIZE, **RATE).values == FRAMES).all()
    assert (load(table({"time": counted(0.02)}, names=numbers), **SIZE).values == FRAMES).all()
    assert len(load(table({}, names=numbers), **SIZE, **RATE, header=False).values) == 21
    # Numbers that go on in the next line may be a frame.
    ramp = 5 * np.arange(4)[:, None] + np.arange(24)
    with pytest.raises(InputError, match="--header"):
        load("\n".join(",".join(map(str, row)) for row in ramp), **SIZE, **RATE)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([f"p{k}" for k in range(23)] + ["p29"], "p0, not 23"),
        ([f"p{k}" for k in range(23)] + ["p3"], "p3 twice"),
        ([f"left_{k}" for k in range(12)] + [f"right_{k}" for k in range(12)], "--part"),
        ([f"c{k}" for k in range(24)], "--rows and --cols"),
        ([f"h{h}_t{k}" for h in range(2) for k in range(12)], "row and column"),
        ([f"s[{h}][{k}]" for h in range(1) for k in range(24)], None),
    ],
)
def test_names_that_do_not_explain_all_end_in_a_question(load, names: list[str], said: str | None) -> None:
    if said is None:
        assert load(table({}, names=names), **SIZE, **RATE).values.shape == (20, *SHAPE)
        return
    with pytest.raises(InputError, match=re.escape(said)):
        load(table({}, names=names), **RATE)


def test_a_file_of_its_own_is_read_back(load) -> None:
    text = output.csv_of(FRAMES, ".6g", 0.02 * np.arange(20))
    found = load(text)
    assert (found.values == FRAMES).all()
    assert found.time_s == pytest.approx(0.02 * np.arange(20))
    assert not load.said
    lines = text.splitlines()
    del lines[10]
    found = load("\n".join(lines))
    assert np.isnan(found.values[2, 1]).all()
    assert np.isfinite(found.values).sum() == FRAMES.size - 6
    assert "frame 2 has no row 1" in load.said


@pytest.mark.parametrize(
    ("array", "layout"),
    [
        (np.moveaxis(FRAMES, 0, 2), SIZE),
        (FRAMES.reshape(20, 24), SIZE),
        (np.moveaxis(FRAMES, 0, 2), {"axes": ("rows", "cols", "frames")}),
        (FRAMES.transpose(0, 2, 1), {"axes": ("frames", "cols", "rows")}),
        (np.stack([0 * FRAMES, FRAMES]).reshape(2, 20, 24), {"axes": (1, "frames", "taxels"), **SIZE}),
    ],
)
def test_axes_are_recognised_or_named(load, tmp_path: Path, array: np.ndarray, layout: dict) -> None:
    np.save(tmp_path / "made.npy", array)
    found = load((tmp_path / "made.npy").read_bytes(), "touch.npy", **layout, **RATE)
    assert (found.values == FRAMES).all()


@pytest.mark.parametrize("shape", [(4, 4, 4), (4, 8, 32), (20, 2, 256), (3, 2, 4, 4), (16, 4)])
def test_axes_that_cannot_be_known_are_asked_for(load, tmp_path: Path, shape: tuple) -> None:
    np.save(tmp_path / "made.npy", np.arange(np.prod(shape)).reshape(shape))
    with pytest.raises(InputError, match="--axes"):
        load((tmp_path / "made.npy").read_bytes(), "touch.npy", **RATE)


def test_the_times_of_an_npz_are_found(load, tmp_path: Path) -> None:
    np.savez(tmp_path / "made.npz", force=FRAMES, time_ms=20 * np.arange(20), note=np.array("left"))
    for key in (None, "force"):
        found = load((tmp_path / "made.npz").read_bytes(), "touch.npz", key=key, **SIZE)
        assert (found.values == FRAMES).all()
        assert found.time_s == pytest.approx(0.02 * np.arange(20))


@pytest.mark.parametrize("coding", ["utf-16-le", "utf-16-be", "utf-32", "utf-8-sig"])
def test_codings(load, coding: str) -> None:
    assert (load(table({"time [\u00b5s]": counted(20_000)}).encode(coding), **SIZE).values == FRAMES).all()


def test_a_missing_cell_is_held_or_refused(load) -> None:
    lines = table({"time": counted(0.02)}).replace(f"{FRAMES[3, 0, 5]:g}", "N/A", 1)
    assert load(lines, **SIZE, gaps="hold").values[3, 0, 5] == FRAMES[2, 0, 5]
    with pytest.raises(InputError, match="frame 3, row 0, column 5"):
        load(lines, **SIZE, gaps="refuse")


def test_no_drawn_file_is_read_wrongly_without_a_warning(tmp_path: Path) -> None:
    counts = files.count(tmp_path, 120)
    assert counts["right"] > counts["refused"] + counts["warned"]


def test_damaged_files_end_in_one_line(tmp_path: Path) -> None:
    draw = random.Random(3)
    pieces = [b"", b"Frame 3\n", b"# x\n", b"\n\n", b'"', b"[", b"]", b",", b"time,", b"\0"]
    pieces += [b"9" * 400, b"12:00:00", b"MVP"]
    layouts = (Layout(), Layout(4, 6, **RATE), Layout(part=1), Layout(skip=1, **RATE), Layout(time_key="0"))
    said: list[str] = []
    for _ in range(150):
        content = bytearray(files.text_file(lambda options: draw.choice(list(options)))[0])
        for _ in range(draw.choice([1, 2, 5])):
            at = draw.randrange(len(content) + 1)
            content[at : at + draw.choice([0, 1, 60])] = draw.choice(pieces)
        (tmp_path / "damaged.csv").write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                recording.load(tmp_path / "damaged.csv", draw.choice(layouts))
            except InputError as error:
                said.append(str(error))
    assert 0 < len(said) < 150
    assert not any("\n" in line for line in said)


def test_a_reader_that_ignores_names_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_written(self, first: str, numbers: np.ndarray, word: str) -> tuple:
        return np.arange(len(numbers)), len(numbers), True

    monkeypatch.setattr(recording_text.Table, "_flat", as_written)
    with pytest.raises(AssertionError):
        files.count(tmp_path, 120, shrink=False)
