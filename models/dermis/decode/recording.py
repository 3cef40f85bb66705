# SPDX-License-Identifier: Apache-2.0
"""Read a recording of any tactile array: text, npy, npz or HDF5, with time, units and missing taxels."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.errors import InputError, optional, quoted
from dermis.scene.schema import read_bytes
from dermis.scene.stimulus import FILE_BYTES_MAX, VALUES_MAX, npy_array, npz_member

Floats = NDArray[np.float64]

UNITS = ("codes", "newtons", "kpa", "ohm")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME = re.compile(r"[%#]?(.*[./ _])?(time|t|stamp|timestamp|secs?|seconds)([ _.\[(].*)?", re.IGNORECASE)
_NUMBERED = re.compile(r"(.*?)\[?\d+\D*")
# Half a frame: beyond it the nearest whole number of frames is another.
_TIME_SPREAD = 0.5
"""Part of the median by which a step of time may differ before frames count as lost."""


@dataclass(frozen=True)
class Layout:
    """Layout that a file does not state; None: taken from the file.

    Attributes
    ----------
    rows, cols : int or None
    key : str or None
        Array of an npz or HDF5 file.
    time_key : str or None
        Array of the times in such a file, or header of the column of a text.
    skip : int or None
        Leading columns of a text that are no taxels.
    time_unit : str or None
        One of TIME_UNITS.
    rate_hz : float or None
        Frames a second; overrules times in the file.
    missing : float or None
        Value of a place without a taxel; NaN counts as well.
    """

    rows: int | None = None
    cols: int | None = None
    key: str | None = None
    time_key: str | None = None
    skip: int | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    missing: float | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a recording.

    Attributes
    ----------
    values : ndarray
        [frames, rows, cols] in the unit of the file; 0 where there is no taxel.
    time_s : ndarray
        [frames] from the first frame.
    present : ndarray of bool
        [rows, cols].
    time_from : str
        Where the times come from.
    """

    values: Floats
    time_s: Floats
    present: NDArray[np.bool_]
    time_from: str

    @property
    def t_frame_s(self) -> float:
        """Median time from frame to frame in seconds."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0


def load(path: str | Path, layout: Layout, option: str = "FILE") -> Recording:
    """Read a recording; `option` names it in a message if there is no such file.

    Raises
    ------
    InputError
        The file cannot be read, contradicts the layout, or leaves a question open; the line names the option that
        answers it.
    """
    path = Path(path)
    data = read_bytes(path, FILE_BYTES_MAX, ("command line", option, str(path)))
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz", ".h5", ".hdf5"):
        values, time = _binary(path, data, suffix, layout)
        named = False
    else:
        values, time, named = _text(path, data, layout)
    frames = _shaped(path, values, layout, named or time is not None)
    absent = np.isnan(frames).all(axis=0)
    if layout.missing is not None:
        absent |= (frames == layout.missing).all(axis=0)
    frames = np.where(absent, 0.0, frames)
    if not np.isfinite(frames).all():
        n, r, c = np.argwhere(~np.isfinite(frames))[0]
        where = f"frame {n}, row {r}, column {c}"
        allowed = "a finite number; a place without a taxel has none in any frame"
        raise InputError(path, where, float(frames[n, r, c]), allowed)
    if absent.all():
        raise InputError(path, "--missing", layout.missing, "a value that some taxel does not always have")
    time_s, source = _times(path, time, len(frames), layout)
    return Recording(frames, time_s, ~absent, source)


def _binary(path: Path, data: bytes, suffix: str, layout: Layout) -> tuple[Floats, Floats | None]:
    if suffix == ".npy":
        return np.asarray(_parsed(path, lambda: npy_array(data, path.name, "biuf")), dtype=float), None
    names = (layout.key, layout.time_key)
    if suffix == ".npz":
        values = _parsed(path, lambda: npz_member(data, path.name, names[0]))
        time = None if names[1] is None else _parsed(path, lambda: npz_member(data, path.name, names[1]))
    else:
        values, time = _hdf5(path, *names)
    return np.asarray(values, dtype=float), None if time is None else np.asarray(time, dtype=float)


def _parsed(path: Path, read: Any) -> Any:
    try:
        return read()
    except InputError as error:
        option = " (option --key)" if error.key == "key" else ""
        raise InputError(path, error.key, error.value, error.allowed + option) from None
    except MemoryError:
        raise
    except Exception as error:  # parsers of zip, headers and types raise whatever they like on garbage
        raise InputError(path, "file", type(error).__name__, f"a readable file ({error})") from None


def _hdf5(path: Path, key: str | None, time_key: str | None) -> tuple[Any, Any]:
    h5py = optional("h5py", "recordings")
    try:
        with h5py.File(path, "r") as file:
            found: dict[str, Any] = {}
            file.visititems(lambda name, item: found.update({name: item}) if hasattr(item, "dtype") else None)
            numeric = {n: i for n, i in found.items() if i.dtype.kind in "iuf"}
            large = [n for n, i in numeric.items() if i.ndim >= 2]
            if key is None and len(large) == 1:
                key = large[0]
            if key not in numeric:
                listed = ", ".join(large[:10]) or "none of numbers in two dimensions"
                raise InputError(path, "--key", key, f"a data set of the file: {listed}")
            if numeric[key].size > VALUES_MAX:
                raise InputError(path, key, list(numeric[key].shape), f"at most {VALUES_MAX} values")
            if time_key is not None and time_key not in numeric:
                raise InputError(path, "--time-key", time_key, "a data set: " + ", ".join(list(numeric)[:10]))
            return numeric[key][()], None if time_key is None else numeric[time_key][()]
    except OSError as error:
        raise InputError(path, "file", str(error), "a readable HDF5 file") from None


def _text(path: Path, data: bytes, layout: Layout) -> tuple[Floats, Floats | None, bool]:
    """Return values [lines, taxels], times [lines], and True if the columns have names."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            path, f"byte {error.start}", "no text in UTF-8", "csv, npy, npz or HDF5 by its suffix"
        ) from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise InputError(path, "lines", 0, "at least one line of numbers")
    # The last line has no header's words; a decimal comma needs another separator.
    sample = lines[-1][1]
    mark = next((m for m in (";", "\t", ",") if m in sample), None)
    if mark in (";", "\t") and "." not in sample:
        lines = [(n, line.replace(",", ".")) for n, line in lines]
    headers: list[str] = []
    while lines and (
        lines[0][1].lstrip().startswith("#") or not any(_is_number(c) for c in _cells(lines[0][1], mark))
    ):
        headers.append(lines.pop(0)[1])
    if not lines:
        raise InputError(path, "lines", "a header only", "at least one line of numbers")
    names, trailing = _names(path, headers, [line for _, line in lines], mark, layout)
    first = _cells(lines[0][1], mark)
    width = len(first) - trailing
    times, taxels = _columns(path, names, first[:width], layout)
    if len(lines) * len(taxels) > VALUES_MAX:
        raise InputError(path, "values", len(lines) * len(taxels), f"at most {VALUES_MAX}")
    wanted = taxels if times is None else [times, *taxels]
    table = np.empty((len(lines), len(wanted)))
    for i, (number, line) in enumerate(lines):
        cells = _cells(line, mark)
        if len(cells) - trailing != width:
            said = f"{len(cells) - trailing} values"
            raise InputError(path, f"line {number}", said, f"{width} values, as the first line")
        try:
            if times is not None and not _is_number(cells[times]):
                cells[times] = _stamp(cells[times])
            table[i] = [float(cells[k]) if cells[k] else np.nan for k in wanted]
        except ValueError:
            k = next(k for k in wanted if cells[k] and not _is_number(cells[k]))
            allowed = "a number; --skip N leaves out leading columns"
            raise InputError(path, f"line {number}, value {k + 1}", quoted(cells[k]), allowed) from None
    return (table, None, bool(names)) if times is None else (table[:, 1:], table[:, 0], bool(names))


def _names(
    path: Path, headers: list[str], lines: list[str], mark: str | None, layout: Layout
) -> tuple[list[str], bool]:
    """Return the names of the columns, if any, and True if every line ends with a separator."""
    width = len(_cells(lines[0], mark))
    names = next((n for h in reversed(headers) if len(n := _cells(h.lstrip("# "), mark)) == width), None)
    trailing = bool(mark) and all(line.rstrip().endswith(str(mark)) for line in lines)
    if names:
        return (names[:-1], True) if trailing and not names[-1] else (names, False)
    header = next((h for h in reversed(headers) if not h.lstrip().startswith("#")), None)
    if header is None:
        known = layout.rows * layout.cols if layout.rows and layout.cols else None
        return [], trailing and (not _square(width) if known is None else known != width)
    names = _cells(header, mark)
    if trailing and len(names) == width - 1:
        return names, True
    if "[" in lines[0] and len(names) < width:
        # A list in one column, as ROS tools write arrays.
        k, count = len(_cells(lines[0].split("[")[0], mark)) - 1, width - len(names) + 1
        if k < len(names):
            return [*names[:k], *(f"{names[k]}{n}" for n in range(count)), *names[k + 1 :]], False
    raise InputError(
        path, "header", f"{len(names)} names", f"{width}, as many as the line below it has values"
    )


def _stamp(cell: str) -> str:
    """Return seconds for a date and time of ISO 8601; other text unchanged."""
    try:
        time = datetime.fromisoformat(cell)
    except ValueError:
        return cell
    return repr((time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp())


def _cells(line: str, mark: str | None) -> list[str]:
    return [cell.strip(' \t"[]()') for cell in (line.split(mark) if mark else line.split())]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _columns(path: Path, names: list[str], first: list[str], layout: Layout) -> tuple[int | None, list[int]]:
    """Return the column of the time, if there is one, and those of the taxels."""
    width, taxels = len(first), layout.rows * layout.cols if layout.rows and layout.cols else None
    skip = layout.skip
    if skip is None and names:
        # Taxels are the largest group of names that differ in a number alone.
        groups: dict[str, list[int]] = {}
        for k, name in enumerate(names):
            if (match := _NUMBERED.fullmatch(name)) and not _TIME.fullmatch(name):
                groups.setdefault(re.sub(r"\d+", "", match[1]), []).append(k)
        largest = max(groups.values(), key=len, default=[])
        if largest and largest == list(range(largest[0], width)):
            skip = largest[0]
    if skip is None and taxels is not None and width >= taxels:
        skip = width - taxels
    if skip is None and layout.cols and width == layout.cols:
        skip = 0
    if skip is None:
        skip = 0 if _square(width) else 1 if _square(width - 1) and width > 2 else None
    if skip is None or skip >= width:
        raise InputError(
            path, "columns", width, "--rows and --cols, or --skip for the leading columns that are no taxels"
        )
    if layout.time_key is not None:
        if layout.time_key not in names:
            raise InputError(
                path, "--time-key", layout.time_key, "a name of the header: " + ", ".join(names[:8])
            )
        return names.index(layout.time_key), list(range(skip, width))
    named = [
        k for k in range(min(skip, len(names))) if _TIME.fullmatch(names[k]) and _is_number(_stamp(first[k]))
    ]
    if not named and not names and skip >= 1 and _is_number(first[0]):
        named = [0]
    return named[0] if named else None, list(range(skip, width))


def _square(count: int) -> bool:
    return count > 0 and round(count**0.5) ** 2 == count


def _shaped(path: Path, values: Floats, layout: Layout, by_line: bool) -> Floats:
    """Return values as [frames, rows, cols]; `by_line`: a line is known to be a frame."""
    if not values.size:
        raise InputError(path, "shape", list(values.shape), "at least one frame")
    rows, cols, allowed = layout.rows, layout.cols, "--rows and --cols of the array"
    if values.ndim == 3:
        found = values.shape[1:]
        if (rows or found[0], cols or found[1]) != found:
            raise InputError(
                path, "shape", list(values.shape), f"[frames, {rows}, {cols}], or other --rows and --cols"
            )
        return values
    if values.ndim != 2:
        raise InputError(path, "shape", list(values.shape), "[frames, rows, cols] or [frames, rows x cols]")
    count = values.shape[1]
    if rows is None and cols is None and _square(count):
        rows = cols = round(count**0.5)
        if not by_line and len(values) % count == 0:
            question = (
                f"--rows {rows} --cols {cols} if a line is a frame, --cols {count} and --rows if it is a row"
            )
            raise InputError(path, "shape", list(values.shape), question)
    elif rows is None and cols is not None and count % cols == 0 and count != cols:
        rows = count // cols
    elif cols is None and rows is not None and count % rows == 0:
        cols = count // rows
    if rows is None or cols is None:
        raise InputError(path, "columns", f"{count} taxels", allowed)
    if count == rows * cols:
        return values.reshape(-1, rows, cols)
    if count == cols and len(values) % rows == 0:
        return values.reshape(-1, rows, cols)
    raise InputError(path, "columns", f"{count} taxels", f"{rows * cols}, as --rows {rows} --cols {cols} say")


def _times(path: Path, time: Floats | None, frames: int, layout: Layout) -> tuple[Floats, str]:
    if layout.rate_hz is not None:
        return np.arange(frames) / layout.rate_hz, "option --rate"
    if frames == 1:
        return np.zeros(1), "a single frame"
    if time is None:
        raise InputError(path, "time", "not in the file", "--rate in frames a second, or --time-key")
    if time.size != frames:
        raise InputError(path, "time", f"{time.size} times", f"{frames}, one a frame; or --rate")
    time = time.ravel()
    step = np.diff(time)
    if not (np.isfinite(step).all() and (step > 0).all()):
        at = int(np.argmin(np.where(np.isfinite(step), step, -np.inf)))
        raise InputError(
            path, f"time of frame {at + 1}", float(time[at + 1]), "later than the frame before; or --rate"
        )
    unit = layout.time_unit
    median = float(np.median(step))
    if unit is None:
        # ROS stamps are nanoseconds of this century; seconds between frames are below one.
        unit = "ns" if time[0] > 1e17 else "s" if median < 1 else None
    if unit is None:
        raise InputError(path, "time", f"steps of {median:g}", "--time-unit " + ", ".join(TIME_UNITS))
    lost = np.abs(step / median - 1) > _TIME_SPREAD
    if lost.any():
        text = f"{path}: {lost.sum()} of {frames} steps of time differ from the median by more than half: frames lost?"
        warnings.warn(text, stacklevel=2)
    return (time - time[0]) * TIME_UNITS[unit], f"the file, in {unit}"
