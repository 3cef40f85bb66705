# SPDX-License-Identifier: Apache-2.0
"""Benchmarks that last: every run is kept, one is blessed, and what became slower or less exact since then is named.

A comparison informs and fails nothing: the correctness of a run is judged by the limits of models/spec.toml. Errors and
ratios, whose two sides were measured in turns in one run, can be compared across machines; times and speeds cannot, and
stand apart with both machines named.
"""

from __future__ import annotations

import datetime
import json
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.table import Table

from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT

BLESSED = ROOT / "models" / "bench_blessed.json"
HISTORY = ROOT / "build" / "bench_history"
MADE_BY = "make bench ARGS=--bless"

Kind = Literal["error", "ratio", "absolute"]


@dataclass(frozen=True)
class Meaning:
    """What a row says: `worse_by` is the factor from which on a change to the worse is named."""

    kind: Kind
    higher_is_better: bool
    worse_by: float


# An error repeats to the last digit on one machine; another's rounding moves one that is rounding by less than 2.
_ERROR = Meaning("error", False, 2.0)
# Two orders 2 % apart are 1.95 and 1.91, and the gate is 1.9.
_ORDER = Meaning("error", True, 1.02)
# Medians of a few runs of the same tree differ by some per cent; nobody looks for the cause of less than a tenth.
_LESS, _MORE = Meaning("ratio", False, 1.1), Meaning("ratio", True, 1.1)
_TIME, _SPEED = Meaning("absolute", False, 1.1), Meaning("absolute", True, 1.1)

MEANINGS: dict[str, Meaning | None] = {
    "accuracy.order": _ORDER,
    "array.exponent": _LESS,
    "batch.speed_ratio": _MORE,
    "closed.difference": _ERROR,
    "closed.frames_per_s": _SPEED,
    "closed.speed_ratio": _MORE,
    "cosim.clock_us": _TIME,
    "cosim.clocks_per_s": _SPEED,
    "cosim.count_error": _ERROR,
    "cosim.edge_error_v": _ERROR,
    "cosim.error_ratio": None,  # says nothing that the error itself does not
    "cosim.frame_code_error_lsb": _ERROR,
    "cosim.frame_s": _TIME,
    "cosim.ngspice_share": None,  # neither more nor less of it is better
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
"""By the beginning of a row's name."""


def meaning(name: str) -> Meaning | None:
    """What a row says, by the longest beginning of its name that is known; None if it is not compared.

    Raises
    ------
    KeyError
        Nobody has said what becomes better or worse about it.
    """
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        if (head := ".".join(parts[:end])) in MEANINGS:
            return MEANINGS[head]
    raise KeyError(f"bench_history.MEANINGS has no entry for {name}")


@dataclass(frozen=True)
class Change:
    """A row that became worse by `factor`; None where an error was exactly 0."""

    name: str
    kind: Kind
    unit: str
    before: float
    now: float
    factor: float | None

    def __str__(self) -> str:
        """In words."""
        by = "was exact" if self.factor is None else f"{self.factor:.3g} times worse"
        return f"{self.name}: {self.before:.4g} -> {self.now:.4g} {self.unit} ({by})"


def _worse(before: Mapping[str, Any], now: Mapping[str, Any], what: Meaning) -> tuple[bool, float | None]:
    """Whether a row became worse, and by what factor."""
    a, b = float(before["value"]), float(now["value"])
    if what.kind == "error" and not what.higher_is_better and a == 0.0:
        return b > 0.0, None
    if a <= 0.0 or b <= 0.0:
        return False, None
    factor = a / b if what.higher_is_better else b / a
    if not factor > what.worse_by:
        return False, factor
    # Runs that overlap with the blessed ones are no change, however far the medians are apart.
    runs_a, runs_b = before.get("runs") or [a], now.get("runs") or [b]
    apart = max(runs_b) < min(runs_a) if what.higher_is_better else min(runs_b) > max(runs_a)
    return apart, factor


def changes(rows: Sequence[Row], blessed: Mapping[str, Any]) -> list[Change]:
    """What became worse than the blessed result: errors first, then ratios, then times; the largest factor first."""
    found = []
    for row in rows:
        before, what = blessed["rows"].get(row["name"]), meaning(row["name"])
        if what is None or before is None or row["value"] is None:
            continue
        worse, factor = _worse(before, row, what)
        if worse:
            found.append(Change(row["name"], what.kind, row["unit"], before["value"], row["value"], factor))
    order = {"error": 0, "ratio": 1, "absolute": 2}
    return sorted(found, key=lambda c: (order[c.kind], -(c.factor or math.inf)))


def unmeasured(rows: Sequence[Row], blessed: Mapping[str, Any]) -> list[str]:
    """Blessed rows that a run has no value of."""
    have = {row["name"] for row in rows if row["value"] is not None}
    return [name for name in blessed["rows"] if name not in have and meaning(name) is not None]


# ---- files ------------------------------------------------------------------------------------------------------


def record(rows: Sequence[Row], machine: str, tree: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """A run as it is kept: when, where, which tree (a hash of what decides about results), how, and its values."""
    kept = {
        row["name"]: {key: row[key] for key in ("value", "unit", "status", "runs") if key in row}
        for row in rows
        if row["value"] is not None
    }
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"made": now, "machine": machine, "tree": tree, "options": dict(options), "rows": kept}


def keep(run: Mapping[str, Any], directory: Path | None = None) -> Path:
    """Write a run into the history and return where; two of one second have names of their own."""
    directory = HISTORY if directory is None else directory
    stem = run["made"].replace(":", "").replace("+0000", "Z")
    path = next(
        p for n in range(1000) if not (p := directory / f"{stem}{f'_{n}' if n else ''}.json").exists()
    )
    write_atomic(path, json.dumps(run, indent=1, allow_nan=False) + "\n")
    return path


def history(directory: Path | None = None) -> list[dict[str, Any]]:
    """The runs that were kept, the oldest first."""
    found = [_read(path) for path in (HISTORY if directory is None else directory).glob("*.json")]
    return sorted(found, key=lambda run: run["made"])


def blessed(path: Path | None = None) -> dict[str, Any] | None:
    """The blessed run; None if there is none."""
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
        raise InputError(path, "file", f"{type(error).__name__}: {error}", f"what {MADE_BY} writes") from None
    return run


def bless(run: Mapping[str, Any], rows: Sequence[Row], path: Path | None = None) -> None:
    """Make a run the one that others are compared with.

    Raises
    ------
    InputError
        A row of it is FAIL or ERROR.
    """
    path = BLESSED if path is None else path
    if wrong := [row["name"] for row in rows if row["status"] in ("FAIL", "ERROR")]:
        raise InputError("command line", "--bless", wrong[0], "a run in which nothing is FAIL or ERROR")
    write_atomic(path, json.dumps(run, indent=1, allow_nan=False) + "\n")


# ---- words ------------------------------------------------------------------------------------------------------

_HEADINGS: dict[Kind, str] = {
    "error": "less exact",
    "ratio": "slower, by ratios that were measured in pairs",
    "absolute": "times and memory, for information",
}


def report(rows: Sequence[Row], machine: str, before: Mapping[str, Any] | None, whole: bool) -> Iterator[str]:
    """The comparison in lines; `whole` if the run was to measure everything."""
    if before is None:
        yield f"no blessed result to compare with; {MADE_BY} writes {BLESSED.relative_to(ROOT)}"
        return
    found = changes(rows, before)
    compared = sum(
        row["value"] is not None and row["name"] in before["rows"] and meaning(row["name"]) is not None
        for row in rows
    )
    yield f"Against the result blessed {before['made']}, tree {before['tree']}: {compared} rows compared."
    if before["machine"] != machine:
        yield f"  Another machine: blessed on {before['machine']}; now on {machine}."
    for kind, heading in _HEADINGS.items():
        own = [change for change in found if change.kind == kind]
        yield f"  {heading}: {'nothing' if not own else ''}"
        yield from (f"    {change}" for change in own)
    if whole and (lost := unmeasured(rows, before)):
        yield f"  not measured now: {', '.join(lost)}"


def summary(rows: Sequence[Row], before: Mapping[str, Any] | None) -> list[Row]:
    """The comparison as rows of the table: how many entries became worse, and their names. They fail nothing."""
    names: dict[Kind, str] = {"error": "less_exact", "ratio": "slower_by_ratio", "absolute": "slower"}
    if before is None:
        return [verdict.skip(f"blessed.{name}", "nothing is blessed") for name in names.values()]
    found = changes(rows, before)
    made = []
    for kind, name in names.items():
        own = [change for change in found if change.kind == kind]
        note = "; ".join(str(change) for change in own) or "none"
        note += f"; against {before['made']}" + (f" on {before['machine']}" if kind == "absolute" else "")
        made.append(verdict.report(f"blessed.{name}", len(own), "rows", note))
    return made


def print_history(runs: Sequence[Mapping[str, Any]], most: int = 6) -> None:
    """The last runs beside each other, and the median of all, for the rows that are compared."""
    shown = runs[-most:]
    table = Table(title="History of the benchmark", box=box.SIMPLE_HEAD, title_justify="left")
    table.add_column("name")
    table.add_column("unit")
    for run in shown:
        table.add_column(f"{run['made'][:16]}\n{run['tree']}", justify="right")
    table.add_column(f"median of {len(runs)}", justify="right")
    names = dict.fromkeys(name for run in runs for name in run["rows"] if meaning(name) is not None)
    for name in names:
        every = [run["rows"].get(name) for run in runs]
        measured = [row for row in every if row is not None]
        middle = statistics.median(row["value"] for row in measured)
        cells = ["" if row is None else f"{row['value']:.4g}" for row in every[-most:]]
        table.add_row(name, measured[-1]["unit"], *cells, f"{middle:.4g}")
    console = Console()
    (console if console.is_terminal else Console(width=170)).print(table)
