# SPDX-License-Identifier: Apache-2.0
"""Progress of long commands: rate, time left and what is running, on a terminal and without one."""

import io
import re

import pytest
from rich.console import Console

from dermis.report import progress


@pytest.mark.parametrize(
    ("done", "seconds", "said"),
    [(500, 2, "250 frames/s"), (2, 4, "30 frames/min"), (1, 7200, "0.5 frames/h"), (0, 5, ""), (3, 0, "")],
)
def test_rate_is_in_the_unit_that_gives_a_whole_number(done: int, seconds: float, said: str) -> None:
    assert progress.rate(done, seconds, "frames") == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.4, "0 s"), (119, "119 s"), (300, "5 min"), (7300, "2 h 2 min"), (5 * 3600, "5 h 0 min")],
)
def test_durations_are_in_words(seconds: float, said: str) -> None:
    assert progress.duration(seconds) == said


def test_without_a_terminal_lines_come_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter([0.0, 4.0, 11.0, 15.0, 40.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.slots("sim", 100) as tell:
        for done in (10, 20, 30, 80):
            tell(done, f"case {done}")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "sim: 20 of 100 row slots, 1.82 row slots/s, 44 s left, now case 20",
        "sim: 80 of 100 row slots, 2 row slots/s, 10 s left, now case 80",
    ]


def test_on_a_terminal_a_bar_shows_them(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(progress, "Console", lambda **_: Console(file=screen, force_terminal=True, width=150))
    with progress.slots("sim", 100) as tell:
        tell(50, "single_touch")
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", screen.getvalue())
    assert "50 of 100" in text
    assert "row slots/" in text
    assert "single_touch" in text
