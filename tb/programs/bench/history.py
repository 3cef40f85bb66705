# SPDX-License-Identifier: Apache-2.0
"""History of the benchmark: every run is kept, one is blessed, and later runs name the rows that
became worse.

A comparison never fails a run; models/spec.toml has the limits. Errors, and ratios of times
measured in turns, compare across machines. Times and speeds do not; they are listed separately with
both machines.
"""

from __future__ import annotations

import datetime
import json
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table

from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.places import ROOT
from dermis.report import verdict
from dermis.report.verdict import Row

BLESSED = ROOT / "models" / "bench_blessed.json"
HISTORY = ROOT / "build" / "bench_history"
MADE_BY = "make bench ARGS=--bless"

KINDS = {
    "error": ("less_exact", "less exact"),
    "ratio": ("slower_by_ratio", "slower, by ratios that were measured in pairs"),
    "absolute": ("slower", "times and memory, for information"),
}
"""Kinds of rows: the name of their summary row and their heading."""


class Meaning(NamedTuple):
    """Kind of a row, its good direction, and the factor from which a change to the worse is
    named.
    """

    kind: str
    higher_is_better: bool
    worse_by: float


# An error repeats to the last digit on one machine; rounding on another moves one that is rounding
# by less than 2.
_ERROR = Meaning("error", False, 2.0)
# Medians of a few runs of the same tree differ by a few per cent.
_LESS, _MORE = Meaning("ratio", False, 1.1), Meaning("ratio", True, 1.1)
_TIME, _SPEED = Meaning("absolute", False, 1.1), Meaning("absolute", True, 1.1)

MEANINGS: dict[str, Meaning | None] = {
    "accuracy.order": Meaning("error", True, 1.02),  # 2 % below 1.95 is 1.91, and the limit is 1.9
    "array.exponent": _LESS,
    "batch.speed_ratio": _MORE,
    "closed.difference": _ERROR,
    "closed.frames_per_s": _SPEED,
    "closed.speed_ratio": _MORE,
    "cosim.clocks_per_s": _SPEED,
    "cosim.count_error": _ERROR,
    "cosim.edge_error_v": _ERROR,
    "cosim.frame_code_error_lsb": _ERROR,
    "cosim.frame_s": _TIME,
    "cosim.speed_ratio": _MORE,
    "effects_off.time_ratio": _LESS,
    "event.certificate_time_ratio": _LESS,
    "event.cost_per_taxel_ratio": _LESS,
    "event.frames_per_s": _SPEED,
    "machine": None,
    "memory_mb": _TIME,
    "peer": None,  # not ours
    "rtl.frames_per_s": _SPEED,
    "setup.second_call_s": _TIME,
}
"""By the beginning of a row's name; None is not compared."""


def meaning(name: str) -> Meaning | None:
    """Return the meaning of a row, by the longest beginning of its name; None if it is not
    compared.

    Raises
    ------
    KeyError
        `MEANINGS` has no entry for it.
    """
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        if (head := ".".join(parts[:end])) in MEANINGS:
            return MEANINGS[head]
    raise KeyError(f"history.MEANINGS has no entry for {name}")


class Change(NamedTuple):
    """A row that became worse by `factor`; None where an error was exactly 0."""

    name: str
    kind: str
    unit: str
    before: float
    now: float
    factor: float | None

    def __str__(self) -> str:
        """Return the change in words."""
        by = "was exact" if self.factor is None else f"{self.factor:.3g} times worse"
        return f"{self.name}: {self.before:.4g} -> {self.now:.4g} {self.unit} ({by})"


def _worse(before: Mapping[str, Any], now: Mapping[str, Any], what: Meaning) -> tuple[bool, float | None]:
    """Return True if a row became worse, and by what factor."""
    a, b = float(before["value"]), float(now["value"])
    if what.kind == "error" and not what.higher_is_better and a == 0.0:
        return b > 0.0, None
    if a <= 0.0 or b <= 0.0:
        return False, None
    factor = a / b if what.higher_is_better else b / a
    if not factor > what.worse_by:
        return False, factor
    # If the runs overlap with the blessed ones, it is not a change, whatever the medians.
    runs_a, runs_b = before.get("runs") or [a], now.get("runs") or [b]
    return (max(runs_b) < min(runs_a) if what.higher_is_better else min(runs_b) > max(runs_a)), factor


def _compared(rows: Sequence[Row], blessed: Mapping[str, Any]) -> Iterator[tuple[Row, Any, Meaning]]:
    for row in rows:
        before, what = blessed["rows"].get(row["name"]), meaning(row["name"])
        if what is not None and before is not None and row["value"] is not None:
            yield row, before, what


def changes(rows: Sequence[Row], blessed: Mapping[str, Any]) -> list[Change]:
    """Return the rows worse than blessed: errors, then ratios, then times; the largest factor
    first.
    """
    found = []
    for row, before, what in _compared(rows, blessed):
        worse, factor = _worse(before, row, what)
        if worse:
            found.append(Change(row["name"], what.kind, row["unit"], before["value"], row["value"], factor))
    return sorted(found, key=lambda c: (list(KINDS).index(c.kind), -(c.factor or math.inf)))


def record(rows: Sequence[Row], machine: str, tree: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run as it is kept: time, machine, hash of the tree, options and values."""
    kept = {
        row["name"]: {key: row[key] for key in ("value", "unit", "status", "runs") if key in row}
        for row in rows
        if row["value"] is not None
    }
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"made": now, "machine": machine, "tree": tree, "options": dict(options), "rows": kept}


def keep(run: Mapping[str, Any], directory: Path | None = None) -> Path:
    """Write a run into the history and return its path; two in the same second get different
    names.
    """
    directory = HISTORY if directory is None else directory
    stem = run["made"].replace(":", "").replace("+0000", "Z")
    names = (directory / f"{stem}{f'_{n}' if n else ''}.json" for n in range(1000))
    path = next(path for path in names if not path.exists())
    write_atomic(path, json.dumps(run, indent=1, allow_nan=False) + "\n")
    return path


def history(directory: Path | None = None) -> list[dict[str, Any]]:
    """Return the kept runs, the oldest first."""
    found = [_read(path) for path in (HISTORY if directory is None else directory).glob("*.json")]
    return sorted(found, key=lambda run: run["made"])


def blessed(path: Path | None = None) -> dict[str, Any] | None:
    """Return the blessed run; None if there is none."""
    path = BLESSED if path is None else path
    return _read(path) if path.exists() else None


def _read(path: Path) -> dict[str, Any]:
    try:
        run = json.loads(path.read_text())
        wrong = [key for key in ("made", "machine", "tree") if not isinstance(run[key], str)]
        for row in run["rows"].values():
            wrong += [v for v in (row["value"], *row.get("runs", [])) if not isinstance(v, int | float)]
        if wrong:
            raise ValueError(wrong[0])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            path, "file", f"{type(error).__name__}: {error}", f"the output of {MADE_BY}"
        ) from None
    return run


def bless(run: Mapping[str, Any], rows: Sequence[Row], path: Path | None = None) -> None:
    """Make a run the reference of later runs.

    Raises
    ------
    InputError
        A row of it is FAIL or ERROR.
    """
    if wrong := [row["name"] for row in rows if row["status"] in ("FAIL", "ERROR")]:
        raise InputError("command line", "--bless", wrong[0], "a run without FAIL or ERROR")
    write_atomic(BLESSED if path is None else path, json.dumps(run, indent=1, allow_nan=False) + "\n")


def report(rows: Sequence[Row], machine: str, before: Mapping[str, Any] | None, whole: bool) -> Iterator[str]:
    """Yield the comparison in lines; `whole`: the run should have measured every row."""
    if before is None:
        yield f"no blessed result to compare with; {MADE_BY} writes {BLESSED.relative_to(ROOT)}"
        return
    found, compared = changes(rows, before), len(list(_compared(rows, before)))
    yield f"Against the result blessed {before['made']}, tree {before['tree']}: {compared} rows compared."
    if before["machine"] != machine:
        yield f"  Another machine: blessed on {before['machine']}; now on {machine}."
    for kind, (_, heading) in KINDS.items():
        own = [change for change in found if change.kind == kind]
        yield f"  {heading}: {'' if own else 'nothing'}"
        yield from (f"    {change}" for change in own)
    have = {row["name"] for row in rows if row["value"] is not None}
    lost = [name for name in before["rows"] if name not in have and _known(name)]
    if whole and lost:
        yield f"  not measured now: {', '.join(lost)}"


def _known(name: str) -> bool:
    """Return True for a row that is compared; a file may have rows of an earlier version."""
    try:
        return meaning(name) is not None
    except KeyError:
        return False


def summary(rows: Sequence[Row], before: Mapping[str, Any] | None) -> list[Row]:
    """Return the comparison as rows: the number of rows that became worse, and their names. They
    never fail.
    """
    if before is None:
        return [verdict.skip(f"blessed.{name}", "nothing is blessed") for name, _ in KINDS.values()]
    made = []
    for kind, (name, _) in KINDS.items():
        own = [change for change in changes(rows, before) if change.kind == kind]
        note = "; ".join(str(change) for change in own) or "none"
        note += f"; against {before['made']}" + (f" on {before['machine']}" if kind == "absolute" else "")
        made.append(verdict.report(f"blessed.{name}", len(own), "rows", note))
    return made


def print_history(runs: Sequence[Mapping[str, Any]], most: int = 6) -> None:
    """Print the last runs in columns, and the median of all, for the rows that are compared."""
    table = Table(title="History of the benchmark", box=box.SIMPLE_HEAD, title_justify="left")
    table.add_column("name")
    table.add_column("unit")
    for run in runs[-most:]:
        table.add_column(f"{run['made'][:16]}\n{run['tree']}", justify="right")
    table.add_column(f"median of {len(runs)}", justify="right")
    for name in dict.fromkeys(name for run in runs for name in run["rows"] if _known(name)):
        every = [run["rows"].get(name) for run in runs]
        present = [row for row in every if row is not None]
        cells = ["" if row is None else f"{row['value']:.4g}" for row in every[-most:]]
        middle = statistics.median(row["value"] for row in present)
        table.add_row(name, present[-1]["unit"], *cells, f"{middle:.4g}")
    console = Console()
    (console if console.is_terminal else Console(width=170)).print(table)
