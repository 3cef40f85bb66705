# SPDX-License-Identifier: Apache-2.0
"""A point of a work-precision diagram: a method with a setting, its error and its time."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

HEADINGS = (
    "work",
    "method",
    "setting",
    "error",
    "unit",
    "largest_error_lsb",
    "seconds",
    "least_s",
    "most_s",
    "runs",
)


@dataclass(frozen=True)
class Point:
    """One method at one setting.

    Attributes
    ----------
    work : name of what was simulated.
    method : engine or peer, with its simulator.
    setting : its knobs, in words.
    error : in `unit`: volt of integrator state, or mean |code - reference| in LSB.
    largest_lsb : largest error of a code or count.
    seconds : each run's time, per clock of one converter or per frame.
    """

    work: str
    method: str
    setting: str
    error: float
    unit: str
    largest_lsb: float
    seconds: tuple[float, ...]

    @property
    def time_s(self) -> float:
        """Median of the runs."""
        return statistics.median(self.seconds)

    def row(self) -> tuple[object, ...]:
        """The point's line of the csv, under HEADINGS."""
        least, most = min(self.seconds), max(self.seconds)
        head = (self.work, self.method, self.setting, f"{self.error:.6g}", self.unit, f"{self.largest_lsb:g}")
        return (*head, f"{self.time_s:.6g}", f"{least:.6g}", f"{most:.6g}", len(self.seconds))


def point_name(work: str, method: str, setting: str) -> str:
    """The name of a point's row."""
    name = f"accuracy.{work}.{method}.{setting}"
    return name.replace(": ", "_").replace(", ", ".").replace(" ", "_")


def to_csv(points: Sequence[Point]) -> str:
    """The points as text, one a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    writer.writerows(p.row() for p in points)
    return text.getvalue()


def from_csv(text: str) -> list[Point]:
    """The points of a text of `to_csv`; of each one's runs the least, the median and the most."""
    found = []
    for row in csv.DictReader(io.StringIO(text)):
        seconds = tuple(float(row[name]) for name in ("least_s", "seconds", "most_s"))
        words = row["work"], row["method"], row["setting"]
        found.append(
            Point(*words, float(row["error"]), row["unit"], float(row["largest_error_lsb"]), seconds)
        )
    return found


def pareto(points: Sequence[Point]) -> list[Point]:
    """Points that no other one beats in both error and time, the fastest first."""
    front: list[Point] = []
    least = math.inf
    for point in sorted(points, key=lambda p: (p.time_s, p.error)):
        if point.error < least:
            front.append(point)
            least = point.error
    return front
