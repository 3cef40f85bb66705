# SPDX-License-Identifier: Apache-2.0
"""Recordings as files of many kinds: names, orders, extra columns, gaps, times and axes, each with its truth."""

import functools
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from dermis.decode import recording
from dermis.errors import InputError
from dermis.report.output import npy_bytes

Choose = Callable[[Sequence[Any]], Any]
T_FRAME_S = 0.02

NAMES = [
    "r{r}c{c}", "row{r1}_col{c1}", "c{c}_r{r}", "taxel_{n}", "P{n:04d}", "p{n1}", "s[{r}][{c}]", "{n}", "x{c}y{r}",
    "hand0_{n} [N]",
]  # fmt: skip
"""Names by row and column from 0 or 1, and by number; `name_of` fills them in."""
EXTRA = [
    "sum", "cop_x", "flags", "imu_0", "index", "Unnamed: 0", "temperature", "seq", "left", "p_max", "q1", "",
]  # fmt: skip
TIMES = {"time": 1, "time_ms": 1e3, "Time [ms]": 1e3, "t_us": 1e6, "stamp_ns": 1e9, "time (s)": 1, "t": 1}


def name_of(form: str, cols: int, r: int, c: int) -> str:
    n = r * cols + c
    return form.format(r=r, c=c, r1=r + 1, c1=c + 1, n=n, n1=n + 1)


def ordered(
    taxels: list[tuple[int, int]], order: str, name: Callable[[int, int], str]
) -> list[tuple[int, int]]:
    """Return taxels, given row by row, in the order of rows, columns, text of their names, or descending."""
    if order == "columns":
        return sorted(taxels, key=lambda at: at[::-1])
    if order == "text":
        return sorted(taxels, key=lambda at: name(*at))
    return taxels[::-1] if order == "descending" else taxels


def lines_of(columns: Sequence[tuple[str, Sequence[str]]], mark: str, named: bool) -> list[str]:
    """Return the lines of a table of named columns of cells, with or without their names."""
    lines = map(mark.join, zip(*(cells for _, cells in columns), strict=True))
    return [*([mark.join(name for name, _ in columns)] if named else []), *lines]


def text_file(choose: Choose) -> tuple[bytes, dict[str, Any], np.ndarray, np.ndarray]:
    """Return a text, options, the true values [frames, rows, cols] and times in seconds."""
    rows, cols = choose([(4, 4), (3, 5), (4, 6), (8, 8), (2, 16), (6, 3)])
    frames = choose([1, 2, 5, 16, 18])
    rng = np.random.default_rng(choose(range(50)))
    values = np.round(rng.uniform(0, 200, (frames, rows, cols)), choose([0, 0, 2]))
    number = np.arange(frames) + np.cumsum(rng.random(frames) < 0.2) * choose([0, 1])
    time = number * T_FRAME_S + choose([0.0, 100.0])
    mark = choose([",", ";", "\t", " ", ", "])
    point = choose([".", ".", ","]) if mark in (";", "\t") else "."
    options: dict[str, Any] = {"rows": rows, "cols": cols} if choose([True, True, False]) else {}

    def shown(value: float) -> str:
        return ("nan" if np.isnan(value) else f"{value:.6g}").replace(".", point)

    taxels = list(np.ndindex(rows, cols))
    kind = choose(["names", "names", "names", "no names", "rows", "blocks"])
    if choose([False, False, True]):
        values[rng.integers(frames), rng.integers(rows), rng.integers(cols)] = np.nan
    if kind in ("rows", "blocks"):
        part = choose(["", "# frame {}", "Frame {}"]) if kind == "blocks" else None
        # A file of one whole frame does not say that it had two.
        away = choose([0, 0, 1, rows] if frames > 2 else [0, 0, 1])
        lines, lost = [], set(rng.choice(frames * rows, away, replace=False).tolist())
        for n in range(frames):
            if part is not None and (n > 0 or part):
                lines.append(part.format(n))
            lines += [mark.join(map(shown, values[n, r])) for r in range(rows) if n * rows + r not in lost]
        values.reshape(-1, cols)[list(lost)] = np.nan
        if part is not None:  # a block of fewer lines is a lost frame
            values[[k // rows for k in lost]] = np.nan
        options["rate_hz"] = 1 / T_FRAME_S
        return "\n".join(lines).encode(), options, values, T_FRAME_S * np.arange(frames)
    name = functools.partial(name_of, choose(NAMES), cols)
    order = choose(["rows", "columns", "descending", "text", "shuffled"]) if kind == "names" else "rows"
    taxels = ordered(taxels, order, name)
    if order == "shuffled":
        rng.shuffle(taxels)
    columns = [(name(r, c), [shown(v) for v in values[:, r, c]]) for r, c in taxels]
    for _ in range(choose([0, 0, 1, 2])):
        at = choose([0, len(columns), len(columns) // 2])
        numbers = 0.5 * np.arange(frames), rng.uniform(0, 9, frames)
        counter, random = ([shown(v) for v in column] for column in numbers)
        cells = choose([counter, random, ["palm"] * frames, ["0"] * frames])
        columns.insert(at, (choose(EXTRA), cells))
    if kind == "names" and choose([True, True, False]):
        title = choose(list(TIMES))
        stamps = [f"{t * TIMES[title]:.9g}".replace(".", point) for t in time]
        columns.insert(choose([0, len(columns)]), (title, stamps))
    else:
        options["rate_hz"], time = 1 / T_FRAME_S, T_FRAME_S * np.arange(frames)
    # Without names, one column less and another one more cannot be known.
    if choose([False] * 9 + [True]) and kind == "names":
        del columns[choose(range(len(columns)))]
    lines = lines_of(columns, mark, kind == "names")
    coding = choose(["utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"])
    return "\n".join(lines).encode(coding), options, values, time


def array_file(choose: Choose) -> tuple[bytes, dict[str, Any], np.ndarray, np.ndarray]:
    """Return an npy file with its axes in any order, options, and the truth, as `text_file`."""
    shape = choose([(20, 4, 4), (4, 4, 4), (9, 3, 5), (5, 8, 2), (3, 4, 6), (16, 4, 4), (6, 4, 6)])
    values = np.random.default_rng(choose(range(50))).uniform(0, 200, shape)
    axes = choose([(0, 1, 2), (1, 2, 0)])
    told = values if choose([True, False]) else values.reshape(len(values), -1)
    array = told.transpose(axes) if told.ndim == 3 else told.T if axes[0] else told
    options: dict[str, Any] = {"rows": shape[1], "cols": shape[2]} if choose([True, False]) else {}
    options |= {"rate_hz": 1 / T_FRAME_S}
    return npy_bytes(array), options, values, T_FRAME_S * np.arange(len(values))


def read(path: Path, options: dict[str, Any]) -> tuple[recording.Recording | InputError, str]:
    """Return a recording and its warnings, or the error and its line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = recording.load(path, recording.Layout(**options))
        except InputError as error:
            return error, str(error)
    return found, " ".join(str(said.message) for said in caught)


def outcome(path: Path, options: dict[str, Any], values: np.ndarray, time_s: np.ndarray) -> str:
    """Read a file; return right, refused, warned or wrong. A reading with a warning may be wrong."""
    found, said = read(path, options)
    if isinstance(found, InputError):
        assert "--" in said or "line" in said, f"a refusal without a remedy: {said}"
        return "refused"
    wanted = np.where(np.isnan(values).all(axis=0), 0, values)
    # Nine digits of a time of 100 s.
    if np.array_equal(found.values, wanted, equal_nan=True) and np.allclose(
        found.time_s, time_s - time_s[0], atol=2e-6, rtol=0
    ):
        return "right"
    return "warned" if said else "wrong"


def count(directory: Path, examples: int, shrink: bool = True) -> dict[str, int]:
    """Draw files with Hypothesis and count the outcomes; a wrong one ends with its smallest example."""
    counts = dict.fromkeys(("right", "refused", "warned", "wrong"), 0)
    phases = (Phase.generate, Phase.shrink) if shrink else (Phase.generate,)

    @settings(
        max_examples=examples, phases=phases, deadline=None, database=None, derandomize=True,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.data())
    def drawn(data: st.DataObject) -> None:
        def choose(options: Sequence[Any]) -> Any:
            return data.draw(st.sampled_from(options))

        text = choose([True, True, True, False])
        content, options, values, time_s = (text_file if text else array_file)(choose)
        path = directory / ("drawn.csv" if text else "drawn.npy")
        path.write_bytes(content)
        said = outcome(path, options, values, time_s)
        counts[said] += 1
        assert said != "wrong", (options, content[:2000])

    drawn()
    return counts
