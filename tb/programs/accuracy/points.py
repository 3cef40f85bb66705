# SPDX-License-Identifier: Apache-2.0
"""Points of a work-precision diagram: a method with a setting, its error and its time."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dermis.errors import DermisError
from dermis.report import verdict
from dermis.report.verdict import Row


@dataclass(frozen=True)
class Outcome:
    """One run of a method: error, largest error of a code or count in LSB, seconds; the unit of the
    error.
    """

    error: float
    largest_lsb: float
    seconds: float
    unit: str = "V"


@dataclass(frozen=True)
class Method:
    """A method with a setting; a slow one runs once."""

    name: str
    setting: str
    run: Callable[[], Outcome]
    slow: bool = False

    def runs(self, repeat: int) -> int:
        """Return the number of its runs."""
        return 1 if self.slow else repeat


@dataclass(frozen=True)
class Point:
    """One method at one setting, a line of the csv.

    Attributes
    ----------
    work : name of what was simulated.
    method : engine or peer, with its simulator.
    setting : its options, in words.
    error : in `unit`: volt at the clock edges, or mean |code - reference| in LSB.
    largest_error_lsb : largest error of a code or count.
    seconds : processor time per clock of one converter or per frame, median of the runs.
    least_s, most_s, runs : its spread, and the number of runs.
    """

    work: str
    method: str
    setting: str
    error: float
    unit: str
    largest_error_lsb: float
    seconds: float
    least_s: float
    most_s: float
    runs: int

    def row(self) -> Row:
        """Return the row of error and time."""
        note = f"{self.setting}; {self.seconds:.3g} s ({self.least_s:.3g} .. {self.most_s:.3g}, {self.runs} runs)"
        note += f"; codes off by {self.largest_error_lsb:g} at most"
        return verdict.report(row_name(self.work, self.method, self.setting), self.error, self.unit, note)


def row_name(work: str, method: str, setting: str) -> str:
    """Return the name of a point's row."""
    name = f"accuracy.{work}.{method}.{setting}"
    return name.replace(": ", "_").replace(", ", ".").replace(" ", "_")


def to_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of equal headings as csv."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def points_csv(points: Sequence[Point]) -> str:
    """Return points as csv, numbers with six digits."""
    lines = [asdict(point).items() for point in points]
    return to_csv([{k: f"{v:.6g}" if isinstance(v, float) else v for k, v in line} for line in lines])


def from_csv(text: str) -> list[Point]:
    """Return the points of a csv."""
    texts = ("work", "method", "setting", "unit")
    lines = csv.DictReader(io.StringIO(text))
    return [Point(**{k: v if k in texts else float(v) for k, v in line.items()}) for line in lines]


def pareto(points: Sequence[Point]) -> list[Point]:
    """Return the Pareto front, the fastest point first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def measure(
    work: str, methods: Sequence[Method], repeat: int, tell: Callable[[str], None]
) -> tuple[list[Point], list[Row]]:
    """Run every method `repeat` times in turns, so that other load on the machine affects all of
    them.

    A method that fails is an ERROR row with the reason, named after `work`; its point is missing.
    """
    found: dict[int, list[Outcome]] = {}
    failed: list[Row] = []
    for turn in range(repeat):
        for number, method in enumerate(methods):
            if turn >= method.runs(repeat):
                continue
            tell(f"{work}, {method.name}, {method.setting}, {turn + 1} of {method.runs(repeat)}")
            try:
                outcome = method.run()
            except DermisError as failure:
                failed.append(verdict.error(row_name(work, method.name, method.setting), str(failure)))
            else:
                found.setdefault(number, []).append(outcome)
    points = []
    for number, runs in found.items():
        one, seconds = runs[0], [run.seconds for run in runs]
        spread = (statistics.median(seconds), min(seconds), max(seconds), len(runs))
        method = methods[number]
        points.append(Point(work, method.name, method.setting, one.error, one.unit, one.largest_lsb, *spread))
    return points, failed
