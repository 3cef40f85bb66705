# SPDX-License-Identifier: Apache-2.0
"""Time measurement of the benchmarks, and their point type: a method with a setting, its error
and its time.
"""

from __future__ import annotations

import csv
import io
import math
import os
import signal
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dermis import plan
from dermis.errors import DermisError, SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from dermis.scene.design import load as load_design


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process and its children to one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})  # on most machines the first one serves interrupts
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the main thread when the block takes longer."""

    def ring(signum: int, frame: Any) -> None:
        raise TimeoutError(f"took more than {seconds:g} s")

    handler = signal.signal(signal.SIGALRM, ring)
    timer = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer)  # pytest uses it for its own limit
        signal.signal(signal.SIGALRM, handler)


def cpu_once(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the value of one call and its processor time in seconds, children included."""
    begin = cpu_time.cpu_used_s()
    value = work()
    return value, cpu_time.cpu_used_s() - begin


def time_ratios(
    first: Callable[[], Any], second: Callable[[], Any], repeat: int, scale: float = 1.0
) -> list[float]:
    """Return processor time of `first` over that of `second`, measured in pairs, times `scale`."""
    first(), second()  # compiles and fills caches
    return [scale * cpu_time.cpu_seconds(first) / cpu_time.cpu_seconds(second) for _ in range(repeat)]


def busy_row(name: str) -> Row:
    """Return a row with the number of cores that other processes use, measured over one second."""

    def ticks() -> tuple[int, int]:
        numbers = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
        return sum(numbers), numbers[3] + numbers[4]  # idle, and waiting for a disk

    total, idle = ticks()
    time.sleep(1.0)
    after, idle_after = ticks()
    busy = (os.cpu_count() or 1) * (1.0 - (idle_after - idle) / max(1, after - total))
    note = "other work is running: speeds are too low" if busy > 0.2 else "nothing else is running"
    return verdict.report(name, round(busy, 2), "cores", f"in the second before; {note}")


def random_plan(work: Path, frames: int, engine: str, size: int | None = None, **effects_on: Any) -> Plan:
    """Return frames of resistances spread evenly in log R over the sensor's range, always the same
    ones.
    """
    design = load_design()
    low, high = math.log(design.sensor.r_min_ohm), math.log(design.sensor.r_max_ohm)
    rows, cols = (size, size) if size else (design.array.rows, design.array.cols)
    work.mkdir(parents=True, exist_ok=True)
    file = work / f"resistance_{frames}_{rows}x{cols}.npy"
    if not file.exists():
        np.save(file, np.exp(np.random.default_rng(2026).uniform(low, high, (frames, rows, cols))))
    data = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "resistance", "file": file.name},
        "effects": effects_on,
    }
    return plan.make(scene.from_data(data, work / "random.toml"), engine)


def markdown(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return the rows of some names, or of names below them, as a Markdown table."""
    lines = ["| row | value | unit | limit | status | note |", "|---|--:|---|---|---|---|"]
    for row in rows:
        if not any(row["name"] == name or row["name"].startswith(name + ".") for name in names):
            continue
        value = "" if row["value"] is None else f"{row['value']:.4g}"
        limits = (("at least", row["min"]), ("at most", row["max"]))
        limit = ", ".join(f"{word} {bound:g}" for word, bound in limits if bound is not None)
        note = row["note"].replace("|", "\\|")
        lines.append(f"| `{row['name']}` | {value} | {row['unit']} | {limit} | {row['status']} | {note} |")
    return "\n".join(lines)


# ---- points -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """One method at one setting.

    Attributes
    ----------
    work : name of what was simulated.
    method : engine or peer, with its simulator.
    setting : its options, in words.
    error : in `unit`: volt of integrator state, or mean |code - reference| in LSB.
    largest_lsb : largest error of a code or count.
    seconds : time of each run, per clock of one converter or per frame.
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

    @property
    def name(self) -> str:
        """Name of the row."""
        return row_name(self.work, self.method, self.setting)

    def columns(self) -> dict[str, Any]:
        """Return the cells of the csv by heading."""
        return {
            "work": self.work, "method": self.method, "setting": self.setting,
            "error": f"{self.error:.6g}", "unit": self.unit, "largest_error_lsb": f"{self.largest_lsb:g}",
            "seconds": f"{self.time_s:.6g}", "least_s": f"{min(self.seconds):.6g}",
            "most_s": f"{max(self.seconds):.6g}", "runs": len(self.seconds),
        }  # fmt: skip


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


def from_csv(text: str) -> list[Point]:
    """Return the points of a csv; the runs of each are its lowest, median and largest time."""
    return [
        Point(
            row["work"], row["method"], row["setting"], float(row["error"]), row["unit"],
            float(row["largest_error_lsb"]), tuple(float(row[n]) for n in ("least_s", "seconds", "most_s")),
        )
        for row in csv.DictReader(io.StringIO(text))
    ]  # fmt: skip


def pareto(points: Sequence[Point]) -> list[Point]:
    """Return the Pareto front, the fastest point first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.time_s, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


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
    """A method with a setting: `run` returns outcomes by work; a slow one runs once."""

    name: str
    setting: str
    run: Callable[[], Mapping[str, Outcome]]
    slow: bool = False


def measure(
    work: str, methods: Sequence[Method], repeat: int, tell: Callable[[str], None]
) -> tuple[list[Point], list[Row]]:
    """Run every method `repeat` times in turns, so that other load on the machine affects all of
    them.

    A method that fails is an ERROR row with the reason, named after `work`; its point is missing.
    """
    found: dict[tuple[str, int], list[Outcome]] = {}
    failed: list[Row] = []
    for turn in range(repeat):
        for number, method in enumerate(methods):
            if turn and method.slow:
                continue
            tell(f"{work}, {method.name}, {method.setting}, {turn + 1} of {repeat}")
            try:
                for where, outcome in method.run().items():
                    found.setdefault((where, number), []).append(outcome)
            except (SimulatorError, DermisError) as failure:
                failed.append(verdict.error(row_name(work, method.name, method.setting), str(failure)))
    points = [
        Point(
            where, methods[number].name, methods[number].setting, runs[0].error, runs[0].unit,
            runs[0].largest_lsb, tuple(run.seconds for run in runs),
        )
        for (where, number), runs in found.items()
    ]  # fmt: skip
    return points, failed
