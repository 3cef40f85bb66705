# SPDX-License-Identifier: Apache-2.0
"""Read a recording of any tactile array, from a text to a ROS 2 bag, with time, units and missing taxels."""

import contextlib
import gzip
import io
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dermis.decode import recording_bag, recording_maker, recording_parquet
from dermis.decode import recording_text as text
from dermis.decode.recording_text import TIME_UNITS, Found, Layout, warn
from dermis.errors import InputError, counted, one_line, optional
from dermis.ndarrays import Bools, Floats, place_of
from dermis.scene.schema import read_bytes
from dermis.scene.stimulus import FILE_BYTES_MAX, VALUES_MAX, npy_array, npz_member

UNITS = ("codes", "newtons", "kpa", "ohm")
GAPS = ("keep", "refuse", "hold")
"""Values that are missing in some frames: kept as NaN, refused, or that of the frame before."""
AXES = ("frames", "rows", "cols", "taxels")
BINARY = (".npy", ".npz", ".h5", ".hdf5", ".mat")
# Half a frame: beyond it the nearest whole number of frames is another.
_TIME_SPREAD = 0.5
"""Part of the median by which a step of time may differ before frames count as lost."""
_WRAP = 2.0**32
_FILLS, _ENDS = ("_FillValue", "missing_value"), ("valid_range", "valid_min", "valid_max")
_PACKED = *_FILLS, *_ENDS, "scale_factor", "add_offset"
"""Attributes of a packed data set: values that stand for none, what values may be, and the way to physical ones."""
_MEMBERS = 64
"""Arrays of an npz file that are looked through; of more the name must be given."""
_UNITS = "unit", "units"
"""Names of a set, and attributes of one, with a unit."""
# Between 0.1 and 1 a step without a unit may be seconds of a slow logger, or milliseconds of a fast one; below 1e-3
# days or hours.
_SECONDS_SURE = 1e-3, 0.1
_DAYS = (3.6e4, 6e4), (7e5, 8e5)
"""Times that may be days since 1900, as in Excel, or since year 0, as in MATLAB."""
_STAMPS = (("ns", 1e18, 1e9), ("us", 1e15, 1e6), ("ms", 1e12, 1e3), ("s", 1e9, 1e2))
"""Units of stamps since 1970, from 2001 to 2033, and the largest step: a clock since power-on has such numbers too."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a recording.

    values : [frames, rows, cols] in the unit of the file; 0 where there is no taxel, NaN where a value is missing.
    time_s : [frames] from the first frame.
    start_ns : time of the first frame by the clock of the file; 0 with a rate in place of times.
    present : [rows, cols].
    time_from : where the times come from.
    unit : one of UNITS, if the file says it.
    area_mm2 : area of a taxel, if the file says it.
    order : order of the taxels in the file.
    ignored : columns and sensors that are left out.
    """

    values: Floats
    time_s: Floats
    present: Bools
    time_from: str
    unit: str | None = None
    area_mm2: float | None = None
    order: str = ""
    ignored: tuple[str, ...] = field(default=())
    start_ns: int = 0

    @property
    def t_frame_s(self) -> float:
        """Median time from frame to frame in seconds."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0


def load(path: str | Path, layout: Layout, option: str = "FILE") -> Recording:
    """Read a recording; `option` names it in a message if there is no such file.

    Values or times that are missing, lost frames, and a size that is only likely are warned of. InputError if the file
    cannot be read, contradicts the layout, or leaves a question open: the line names the option that answers it.
    """
    path = Path(path)
    if layout.rate_hz is not None and (layout.time_key or layout.time_unit):
        allowed = "one of --rate and --time-key or --time-unit"
        raise InputError("command line", "--rate", layout.rate_hz, allowed)
    bag = (path if path.suffix in recording_bag.SUFFIXES else path / "metadata.yaml").is_file()
    data = b"" if bag else read_bytes(path, FILE_BYTES_MAX, ("command line", option, str(path)))
    name = path
    if data.startswith(b"\x1f\x8b"):
        data, name = _unpacked(path, data), path.with_suffix("") if path.suffix.lower() == ".gz" else path
    suffix = name.suffix.lower()
    columns = not bag and (data.startswith(b"PAR1") or suffix not in BINARY)
    foreign = ("key",) if columns else ("skip", "taxels", "header") + (() if bag else ("part",))
    for key in foreign:
        if (given := getattr(layout, key)) not in (None, False):
            raise InputError(path, f"--{key}", given, "no such option: it is not for this kind of file")
    if bag:
        found = _parsed(path, lambda: recording_bag.read(path, layout))
    elif data.startswith(b"PAR1"):
        found = _parsed(path, lambda: recording_parquet.Columns(path, data, layout).found())
    elif suffix in BINARY:
        found = _parsed(path, lambda: _binary(path, data, suffix, layout))
    else:
        found = recording_maker.read(path, data, layout)
    frames = _shaped(path, found, layout)
    absent = np.isnan(frames).all(axis=0)
    if absent.any() and found.unit is None and found.shape is None:
        # Files of makers mark places without a sensel.
        said = f"{counted(int(absent.sum()), 'place')} without a value in any frame"
        warn(path, f"{said}, first {place_of(absent[None])[9:]}: taken for no taxel, of force 0")
    if layout.missing is not None:
        missing = layout.missing * found.factor
        absent |= (frames == missing).all(axis=0)
        if missing < 0:  # no force: a value that is missing in some frames only
            frames = np.where(frames == missing, np.nan, frames)
    if absent.all():
        raise InputError(path, "--missing", layout.missing, "a value that some taxel does not always have")
    frames = np.where(absent, 0.0, frames)
    if (infinite := np.isinf(frames)).any():
        allowed = "a finite number; 1e15 for an open taxel in ohm"
        raise InputError(path, place_of(infinite), float(frames[infinite][0]), allowed)
    frames = _gaps(path, frames, layout.gaps)
    time_s, source, start_ns = _times(path, found, len(frames), layout)
    told = found.unit, found.area_mm2, found.order, tuple(found.ignored)
    return Recording(frames, time_s, ~absent, source, *told, start_ns)


@contextlib.contextmanager
def warned() -> Iterator[list[str]]:
    """Collect the warnings of `load` in the block; the list has a line for each at its end."""
    lines: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield lines
    lines += [one_line(str(said.message), 400) for said in caught]


def _unpacked(path: Path, data: bytes) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            unpacked = stream.read(FILE_BYTES_MAX + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(path, "file", str(error), "a readable gzip file") from None
    if len(unpacked) > (most := FILE_BYTES_MAX):
        raise InputError(path, "file", f"more than {most} bytes", f"at most {most} bytes unpacked")
    return unpacked


def held(frames: Floats) -> Floats:
    """Return frames [frames, rows, cols] with the value before, if there is one, in place of a missing one."""
    last = np.where(np.isnan(frames), 0, np.arange(len(frames))[:, None, None])
    return np.take_along_axis(frames, np.maximum.accumulate(last, axis=0), axis=0)


def _gaps(path: Path, frames: Floats, gaps: str) -> Floats:
    """Return frames with the values that are missing in some of them, as `gaps` says."""
    missing = np.isnan(frames)
    if not missing.any():
        return frames
    where = place_of(missing)
    if gaps == "refuse":
        raise InputError(path, where, "missing", "a number in every frame, or --missing hold, or neither")
    said = "forces there are NaN with an open interval"
    if gaps == "hold":
        frames = held(frames)
        said = f"held from the frame before; {np.isnan(frames).sum()} have none"
    count = counted(int(missing.sum()), "missing value")
    warn(path, f"{count} in {counted(int(missing.any(axis=(1, 2)).sum()), 'frame')}, first {where}: {said}")
    return frames


def _binary(path: Path, data: bytes, suffix: str, layout: Layout) -> Found:
    time, name, reversed_axes, time_unit, unit, left, file = None, None, False, "", "", [], None
    if suffix == ".npy":
        values = npy_array(data, path.name, "biuf")
    else:
        if suffix == ".npz":
            sets = _members(data, path, layout)
        elif suffix == ".mat" and not data.startswith(b"MATLAB 7.3"):
            from scipy.io import loadmat  # 0.1 s

            sets = {n: array for n, array in loadmat(io.BytesIO(data)).items() if not n.startswith("__")}
        else:
            sets, reversed_axes = {}, suffix == ".mat"
            file = optional("h5py", "recordings").File(io.BytesIO(data), "r")
            file.visititems(lambda n, item: sets.update({n: item}) if hasattr(item, "dtype") else None)
        values, time, name = _chosen(path, sets, layout)
        as_many = [n for n, i in sets.items() if name and n != name and i.size == time.size]
        part = next((n for n in as_many if text.is_part_of(n, name)), None)
        if part is not None and layout.time_key is None:
            allowed = f"--time-key {name}, without parts of a second, or --rate"
            raise InputError(path, "time", f"{name} and {part}", allowed)
        time_unit, unit = _unit_of(time), _unit_of(values) or _unit_set(sets) or _unit_of(file)
        left = [n for n, item in sets.items() if item is not values and n != name]
        values, time = _physical(values), None if time is None else _physical(time)
        if time is not None and time.dtype.kind in "mM":
            time, time_unit = time.astype(f"{time.dtype.kind}8[ns]").astype(np.int64), "ns"
    values = values.T if reversed_axes else values
    if values.dtype.kind not in "biuf":
        raise InputError(path, "--key", str(values.dtype), "an array of real numbers")
    if time is not None and time.dtype == np.float32 and time.size > 2:
        step = np.median(np.abs(np.diff(time.ravel().astype(float))))
        if np.spacing(np.nanmax(time)) > 0.1 * step:
            allowed = "times of more digits than float32 has, or --rate"
            raise InputError(path, str(name), f"steps of {step:g}", allowed)
    found = Found(np.asarray(values, dtype=float), binary=True, ignored=left)
    if name is not None:
        if (
            time.size and time.dtype.kind in "iu" and abs(int(time.flat[0])) > 2**52
        ):  # a double would lose digits
            found.start = int(time.flat[0])
            time = time.astype(object) - found.start
        found.time = np.asarray(time, dtype=float).ravel()
        named, stated = text.time_unit_of(name), text.time_unit_of(time_unit)
        if named and stated and named != stated and layout.time_unit is None and layout.rate_hz is None:
            allowed = f"--time-unit {named} or {stated}: its name says {named}"
            raise InputError(path, name, f"in {stated}", allowed)
        found.time_unit, found.time_from = named or stated, name
    if unit and not found.scale(unit):
        warn(path, f"{unit} is no unit that is known: values are taken as they are")
    return found


def _unit_of(item: Any) -> str:
    """Return the unit that a data set or a file of HDF5 states, or nothing."""
    told = {name.lower(): value for name, value in getattr(item, "attrs", {}).items()}
    return _words(told.get("units", told.get("unit", "")))


def _words(attribute: Any) -> str:
    return attribute.decode(errors="replace") if isinstance(attribute, bytes) else str(attribute)


def _physical(item: Any) -> Any:
    """Return the numbers of a data set; of HDF5 by the attributes that netCDF has for packed numbers."""
    values, attributes = np.asarray(item), getattr(item, "attrs", {})
    told = {n: np.ravel(v) for n, v in attributes.items() if n in _PACKED}
    told = {n: v if v.dtype.kind in "iuf" else v.astype(float) for n, v in told.items()}
    # netCDF 3 had no other bytes.
    if values.dtype.kind == "i" and _words(attributes.get("_Unsigned", "")) == "true":
        values = values.view(values.dtype.str.replace("i", "u"))
        told = {n: v.astype(values.dtype) if v.dtype.kind == "i" else v for n, v in told.items()}
    if not told or values.dtype.kind not in "biuf":
        return values
    ends = told.get("valid_range", [*told.get("valid_min", [-np.inf]), *told.get("valid_max", [np.inf])])
    none = np.isin(values, [v for n in _FILLS for v in told.get(n, ())])
    none |= (values < ends[0]) | (values > ends[-1])
    # Numbers of 16 bits with factors of float32 stay in that precision, in which the writer's zero is 0.
    scale, offset = (
        1.0 * told.get(n, [default])[0] for n, default in (("scale_factor", 1), ("add_offset", 0))
    )
    return np.where(none, np.nan, values * scale + offset)


def _unit_set(sets: dict[str, Any]) -> str:
    """Return the text of a set that is called unit, or nothing."""
    told = (np.ravel(item) for n, item in sets.items() if n.lower() in _UNITS and item.dtype.kind in "US")
    return next((str(said.astype(str)[0]) for said in told if said.size == 1), "")


def _members(data: bytes, path: Path, layout: Layout) -> dict[str, Any]:
    """Return the arrays of an npz file; those that are named, if it has many."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
    if layout.key is not None or len(names) > _MEMBERS:
        more = [name for name in names[:_MEMBERS] if name.lower() in _UNITS]
        more += [name for name in names[:_MEMBERS] if text.is_time(name)] if layout.time_key is None else []
        names = [name for name in (layout.key, layout.time_key, *more) if name is not None]
    found = {}
    for name in names or [None]:
        found[name] = np.empty(0, object)  # of an array that cannot be read
        with contextlib.suppress(InputError if layout.key is None else ()):
            found[name] = npz_member(data, path.name, name, "iufmMU")
    return found


def _chosen(path: Path, sets: dict[str, Any], layout: Layout) -> tuple[Any, Any, str | None]:
    """Return the array of the taxels, that of the times or None, and its name."""
    moments = {n: i for n, i in sets.items() if i.dtype.kind in "mM"}
    numeric = {n: i for n, i in sets.items() if i.dtype.kind in "iuf"} | moments
    large = [n for n, i in numeric.items() if i.ndim >= 2 and min(i.shape) > 0 and i.size > max(i.shape)]
    timed = {n for n in numeric if n == layout.time_key or text.is_time(n.split("/")[-1])} | {*moments}
    # A single taxel, unless an array that cannot be read may be the frames.
    others = [n for n, i in sets.items() if n not in timed and i.size != 1]
    sure = len(large or others) == 1
    large = large or [n for n in others if n in numeric and sets[n].ndim >= 2]
    key = large[0] if layout.key is None and large and sure else layout.key
    if key not in numeric:
        listed = ", ".join(large[:10]) or "none of numbers in two dimensions"
        raise InputError(path, "--key", key, f"a data set of the file: {listed}")
    if numeric[key].size > VALUES_MAX:
        raise InputError(path, key, list(numeric[key].shape), f"at most {VALUES_MAX} values")
    name = layout.time_key
    if name is not None and name not in numeric:
        raise InputError(path, "--time-key", name, "a data set: " + ", ".join(list(numeric)[:10]))
    if name is None and layout.rate_hz is None:
        lengths = {n: i.size for n, i in numeric.items() if i.size == max(i.shape, default=0)}
        fitting = [n for n, size in lengths.items() if size in numeric[key].shape and n in timed - {key}]
        name = fitting[0] if len(fitting) == 1 else None
    return numeric[key], None if name is None else numeric[name], name


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


def _shaped(path: Path, found: Found, layout: Layout) -> Floats:
    """Return values as [frames, rows, cols]."""
    values = found.values
    if not values.size:
        raise InputError(path, "shape", list(values.shape), "at least one frame")
    if layout.axes is not None:
        values, by_line = _by_axes(path, values, layout.axes, layout), True
    else:
        by_line = found.by_line or found.time is not None
        if found.shape is None:
            values = _frames_first(path, values, found, layout)
    shape = values.shape[1:] if values.ndim == 3 else found.shape
    if shape is not None:
        if (layout.rows or shape[0], layout.cols or shape[1]) != tuple(shape):
            allowed = f"[frames, {layout.rows}, {layout.cols}], or other --rows, --cols or --axes"
            raise InputError(path, "shape", list(values.shape), allowed)
        return values.reshape(-1, *shape)
    made = _split(path, values, layout, by_line, list(found.values.shape))
    flat = layout.axes is None and len(made) == len(values) and min(made.shape[1:]) > 1
    if path.suffix.lower() == ".mat" and flat:
        allowed = "--axes frames,cols,rows if (:) made the frames, column after column; frames,taxels if row after row"
        raise InputError(path, "shape", list(found.values.shape), allowed)
    return made


def _by_axes(path: Path, values: Floats, axes: tuple[str | int, ...], layout: Layout) -> Floats:
    """Return [frames, rows, cols] or [frames, taxels] of an array whose axes are named.

    Taxels [frames, taxels] may be frames,cols,rows: column after column.
    """
    if values.ndim == 2 and axes[0] == "frames" and len(axes) == 3 and values.shape[1] == layout.size:
        values = values.reshape(-1, *(layout.cols if axis == "cols" else layout.rows for axis in axes[1:]))
    shape = list(values.shape)
    if values.ndim != len(axes):
        raise InputError(path, "--axes", shape, f"{values.ndim} names or numbers, not {len(axes)}")
    if wrong := [a for a, n in zip(axes, shape, strict=True) if isinstance(a, int) and a >= n]:
        raise InputError(path, "--axes", shape, f"a number of a part that there is, not {wrong[0]}")
    values = values[tuple(a if isinstance(a, int) else slice(None) for a in axes)]
    names = [a for a in axes if isinstance(a, str)]
    if "frames" not in names:
        names, values = ["frames", *names], values[np.newaxis]
    return values.transpose([names.index(a) for a in AXES if a in names])


def _frames_first(path: Path, values: Floats, found: Found, layout: Layout) -> Floats:
    """Return an array with its frames on the first axis, where it is known which axis that is."""
    shape, size, taxels = values.shape, (layout.rows, layout.cols), layout.size
    if layout.frames_first and shape[1:] == size:
        return values
    allowed = "--axes as in frames,rows,cols or taxels,frames or frames,0,rows,cols"
    ask = InputError(path, "shape", list(shape), allowed)
    # The times of a file tell the axis of the frames, if only one has so many.
    timed = found.time is not None and shape.count(found.time.size) == 1
    last = timed and shape[-1] == found.time.size
    if values.ndim == 3:
        first_fits, last_fits = (
            all(s in (None, n) for s, n in zip(size, places, strict=True))
            for places in (shape[1:], shape[:2])
        )
        if timed:
            first_fits, last_fits = first_fits and shape[0] == found.time.size, last_fits and last
        elif None in size:
            # Squares tell the frames; else the frames are by far the most.
            first_fits = first_fits and (shape[1] == shape[2] or shape[0] > max(shape[1:]))
            last_fits = last_fits and shape[0] == shape[1]
        if first_fits == last_fits:
            raise ask
        frames = values if first_fits else np.moveaxis(values, 2, 0)
        # Of rows and columns that are given, the axes of the frames that leave both.
        others = {n for n in range(3) if None not in size and sorted(np.delete(shape, n)) == sorted(size)}
        unsure = len(others) > 1 and not timed
        strip = None in size and min(frames.shape[1:]) <= 2 and max(frames.shape[1:]) > 32
        if strip or (unsure and not first_fits):
            raise ask
        if None in size or unsure:
            said = "frames, rows, cols" if first_fits else "rows, cols, frames"
            warn(path, f"taken as [{said}] from its shape {list(shape)}; --axes otherwise")
        elif not first_fits:
            found.order = "axes rows, cols, frames"
        return frames
    if values.ndim != 2:
        raise ask
    if found.by_line or not found.binary:
        return values
    if timed:
        return values.T if last else values
    if taxels is not None:
        lines = shape[1] == layout.cols != taxels and shape[0] % layout.rows == 0
        if (shape[0] == taxels) + (shape[1] == taxels) + lines > 1:
            raise ask
        if shape[0] == taxels:
            found.order = "axes taxels, frames"
            return values.T
        return values
    if layout.rows or layout.cols:
        return values
    if text.square(shape[0]) and shape[0] > 1 and not text.square(shape[1]):
        warn(path, f"taken as [taxels, frames] from its shape {list(shape)}; --axes otherwise")
        return values.T
    if text.square(shape[0]) and text.square(shape[1]) and min(shape) > 1:
        raise ask
    return values


def _split(path: Path, values: Floats, layout: Layout, by_line: bool, shape: list[int]) -> Floats:
    """Return [frames, taxels] or [lines, cols] as [frames, rows, cols]; `by_line`: a line is known to be a frame.

    `shape` is that of the file.
    """
    rows, cols, allowed = layout.rows, layout.cols, "--rows and --cols of the array"
    count = values.shape[1]
    if rows is None and cols is None and text.square(count):
        rows = cols = round(count**0.5)
        # 32 values or fewer are as likely a row.
        if not by_line and (len(values) % count == 0 or (len(values) > 1 and 1 < count <= 32)):
            a_row = f"--cols {count} and --rows if it is a row"
            if values.shape[0] != shape[0]:
                a_row = "--axes rows,cols if it is one frame"
            question = f"--rows {rows} --cols {cols} if a line is a frame, {a_row}"
            raise InputError(path, "shape", shape, question)
        if count > 1:
            warn(path, f"{count} taxels taken as {rows} x {cols}; --rows and --cols otherwise")
    elif rows is None and cols is not None and count % cols == 0 and count != cols:
        rows = count // cols
    elif cols is None and rows is not None and count % rows == 0:
        cols = count // rows
    if rows is None or cols is None:
        raise InputError(path, "columns", f"{count} taxels", allowed)
    if count == rows * cols or (count == cols and len(values) % rows == 0):
        return values.reshape(-1, rows, cols)
    raise InputError(path, "columns", f"{count} taxels", f"{rows * cols}, as --rows {rows} --cols {cols} say")


def _times(path: Path, found: Found, frames: int, layout: Layout) -> tuple[Floats, str, int]:
    """Return the times of frames in seconds from the first, where they are from, and the first one in nanoseconds."""
    time, number = found.time, found.number
    if number is not None and frames > 1:
        steps = np.diff(number)
        if (steps <= 0).any():
            raise InputError(path, "frame", float(number[int(np.argmin(steps)) + 1]), "numbers that rise")
        if (lost := int((steps - 1).sum())) and (steps == 1).any():
            first = number[int(np.argmax(steps > 1))]
            warn(path, f"{counted(lost, 'frame')} lost, the first after frame {first:g}")
    if layout.rate_hz is not None:
        _warn_of_other_times(path, found, frames, layout.rate_hz)
        number = np.arange(frames) if number is None else number - number[0]
        return number / layout.rate_hz, "option --rate", 0
    if frames == 1:
        return np.zeros(1), "a single frame", 0
    if time is None:
        raise InputError(path, "time", "not in the file", "--rate in frames a second, or --time-key")
    if found.values.ndim == 2 and time.size == len(found.values) and time.size % frames == 0:
        time = time[:: time.size // frames]  # a time a line
    if time.size != frames:
        raise InputError(path, "time", f"{time.size} times", f"{frames}, one a frame; or --rate")
    time = time.ravel().copy()
    if np.isnan(time).any():
        known = np.isfinite(time)
        lost = f"{(~known).sum()} of {frames}"
        if known.sum() < 2 or not (known[0] and known[-1]):
            raise InputError(path, "time", f"{lost} missing", "a first and a last time; or --rate")
        warn(path, f"{lost} times are missing, the first of frame {np.argmin(known)}: interpolated")
        time = np.interp(np.arange(frames), np.flatnonzero(known), time[known])
    step = np.diff(time)
    wrapped = (step < -_WRAP / 2) & (step > -_WRAP) & (time[1:] >= 0)
    if wrapped.any():
        warn(path, f"the counter of the time starts again at frame {int(np.argmax(wrapped)) + 1}: 2^32 added")
        time[1:] += _WRAP * np.cumsum(wrapped)
        step = np.diff(time)
    if not (np.isfinite(step).all() and (step >= 0).all() and time[-1] > time[0]):
        at = int(np.argmin(np.where(np.isfinite(step), step, -np.inf)))
        allowed = f"later than the frame before, at {time[at]:.9g}; "
        allowed += "or --time-key of another column, or --rate"
        raise InputError(path, f"time of frame {at + 1}", float(time[at + 1]), allowed)
    if (same := int((step == 0).sum())) and same < frames - 1:
        first = int(np.argmax(step == 0)) + 1
        warn(path, f"{same} times are those of the frame before, the first of frame {first}")
    unit, median = layout.time_unit or found.time_unit, float(np.median(step[step > 0]))
    if found.time_unit not in (None, unit):
        warn(path, f"{found.time_from} is in {found.time_unit} by its name, which --time-unit overrules")
    if unit is None:
        first = time[0] + found.start
        unit = next((u for u, least, most in _STAMPS if least < first < 2 * least and median < most), None)
        days = any(least < first < most for least, most in _DAYS)
        if unit is None and not days and _SECONDS_SURE[0] <= median < _SECONDS_SURE[1]:
            unit = None if text.asks_unit(found.time_from) else "s"
    if unit is None:
        raise InputError(path, "time", f"steps of {median:g}", "--time-unit " + ", ".join(TIME_UNITS))
    lost = (np.abs(step / median - 1) > _TIME_SPREAD) & (step > 0)
    if lost.any():
        said = f"{lost.sum()} of {frames - 1} steps of time differ from the median by more than half"
        warn(path, f"{said}, the first after frame {int(np.argmax(lost))}: frames lost?")
    start_ns = (found.start + Fraction(time[0])) * Fraction(str(TIME_UNITS[unit])) * 10**9
    return (time - time[0]) * TIME_UNITS[unit], f"{found.time_from}, in {unit}", round(start_ns)


def _warn_of_other_times(path: Path, found: Found, frames: int, rate_hz: float) -> None:
    """Warn of times in the file that `--rate` overrules, if they are of another rate or of several recordings."""
    if found.time is None or frames < 2 or found.time.size % frames or np.isinf(rate_hz):
        return
    found.ignored.append(found.time_from)
    step = np.diff(np.ravel(found.time)[:: found.time.size // frames])
    step = step[np.isfinite(step)]
    if step.size and (step < 0).any():
        warn(path, f"{found.time_from} falls after frame {int(np.argmax(step < 0))}: recordings joined?")
    elif step.size and found.time_unit and np.median(step) > 0:
        own_hz = 1.0 / (float(np.median(step)) * TIME_UNITS[found.time_unit])
        if abs(own_hz / rate_hz - 1) > 0.01:
            warn(path, f"{found.time_from} says {own_hz:.6g} frames/s, which --rate overrules")
