# SPDX-License-Identifier: Apache-2.0
"""Files of every kind that `dermis read` knows, written from one known recording, and those that it must ask about."""

from __future__ import annotations

import gzip
import math
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dermis.errors import InputError
from dermis.ndarrays import Floats
from dermis.report import output
from tb.programs.decode import files

ROWS, COLS, COUNT = 4, 6, 20
FRAMES: Floats = np.round(np.random.default_rng(20_261_126).uniform(0, 99, (COUNT, ROWS, COLS)), 2)
TIME: Floats = 0.02 * np.arange(COUNT)
SIZE = {"rows": ROWS, "cols": COLS}
RATE = {"rate_hz": 50.0}
EPOCH_NS = 1_760_000_000_900_000_000
STAMPS = [EPOCH_NS + 20_000_000 * n for n in range(COUNT)]


@dataclass(frozen=True, eq=False)
class Case:
    """A file and the truth about it; None: that of the known recording.

    `content` may be a program that writes `file`, `options` are those of `recording.Layout`. `values` [frames, rows,
    cols] are NaN where a value is missing or, in every frame, where there is no taxel; `time_s` counts from the first
    frame. `asks` is the option that the question must name, for a file that does not tell the answer; `says` are words
    of a warning.
    """

    content: str | bytes | Callable[[Path], None]
    options: dict[str, Any] = field(default_factory=dict)
    values: Floats | None = None
    time_s: Floats | None = None
    unit: str | None = None
    area_mm2: float | None = None
    asks: str = ""
    says: str = ""
    file: str = "a.csv"


def fault(case: Case, directory: Path) -> str | None:
    """Write and read a file; return what is wrong with the reading, or None."""
    path = directory / case.file
    if callable(case.content):
        case.content(path)
    else:
        path.write_bytes(case.content.encode() if isinstance(case.content, str) else case.content)
    found, said = files.read(path, case.options)
    if isinstance(found, InputError):
        return None if case.asks and case.asks in said and "\n" not in said else f"refused: {said}"
    if case.asks:
        return f"read as {found.values.shape}, {found.order}; {case.asks} is not asked for"
    if case.says not in said:
        return f"no warning: {case.says}"
    values = FRAMES if case.values is None else case.values
    time_s = TIME if case.time_s is None else case.time_s
    if found.values.shape != values.shape:
        return f"shape {found.values.shape}"
    absent = np.isnan(values).all(axis=0)
    wanted = np.where(absent, 0.0, values)
    # Factors of units have seven digits.
    same = np.allclose(found.values, wanted, rtol=2e-7, atol=0, equal_nan=True)
    if not same or not (found.present == ~absent).all():
        return "values"
    # A double holds the seconds since 1970 to 2.4e-7.
    if not np.allclose(found.time_s, time_s, rtol=0, atol=2.4e-7):
        return f"times {found.time_s[:4]}"
    if found.unit != case.unit or (found.area_mm2 is None) != (case.area_mm2 is None):
        return f"unit {found.unit}, area {found.area_mm2}"
    # Inches of the header have eight digits.
    if case.area_mm2 is not None and not np.isclose(found.area_mm2, case.area_mm2, rtol=1e-6):
        return f"area {found.area_mm2}"
    return None


Name = Callable[[int, int], str]
"""Name of a taxel by row and column."""
Lead = dict[str, Sequence[str]]
"""Columns of cells by name."""


def cells(values: Iterable[float], point: str = ".") -> list[str]:
    """Return numbers as text, with their decimal point."""
    return [f"{v:g}".replace(".", point) for v in values]


def table(
    name: Name | None,
    lead: Lead | None = None,
    order: str = "rows",
    mark: str = ",",
    point: str = ".",
    middle: Lead | None = None,
    frames: Floats = FRAMES,
) -> str:
    """Return a text with a frame a line: columns `lead`, the taxels by `order`, and columns amid the taxels."""
    places = files.ordered(list(np.ndindex(ROWS, COLS)), order, name)
    columns = [(name(*at) if name else "", cells(frames[:, *at], point)) for at in places]
    columns[9:9] = list((middle or {}).items())
    columns[:0] = list((lead or {}).items())
    return "\n".join(files.lines_of(columns, mark, name is not None)) + "\n"


def flat(r: int, c: int, start: str = "p") -> str:
    return f"{start}{r * COLS + c}"


def seconds(factor: float = 1.0, start: float = 0.0) -> list[str]:
    return [f"{start + t * factor:.12g}" for t in TIME]


def blocks(part: str, lost: Sequence[tuple[int, int]] = (), start: str = "") -> str:
    """Return a text with a row a line, and `part` before every frame; a line begins with `start`."""
    lines = []
    for n, frame in enumerate(FRAMES):
        lines.append(part.format(n=n, t=0.02 * n))
        of_rows = [start.format(n=n, r=r, t=0.02 * n) + ",".join(cells(row)) for r, row in enumerate(frame)]
        lines += [line for r, line in enumerate(of_rows) if (n, r) not in lost]
    return "\n".join(lines) + "\n"


def without(at: Any) -> Floats:
    """Return the known recording with missing values at an index."""
    values = FRAMES.copy()
    values[at] = np.nan
    return values


def gap(cell: str) -> str:
    """Return a table whose frame 3 has no number in row 0, column 5."""
    lines = table(flat, {"time": seconds()}).splitlines()
    lines[4] = lines[4].replace(f",{FRAMES[3, 0, 5]:g},", f",{cell},", 1)
    return "\n".join(lines)


def tekscan(
    unit: str, space: str, label: str, factor: float = 1.0, lost: int = COUNT, point: str = ".", **more: str
) -> Case:
    """Return the case of an export of Tekscan of 25 mm2 a taxel; row 0, column 5 has no sensel, frame `lost` is absent.

    `factor` is the unit, if it is a pressure, in kPa; more are `step` in seconds and `end` of the lines of the head.
    """
    head = ["DATA_TYPE MOVIE", f"ROWS {ROWS}", f"COLS {COLS}", f"ROW_SPACING {space}", f"COL_SPACING {space}"]
    head += [f"SECONDS_PER_FRAME {more.get('step', 0.02)}", f"UNITS {unit}", "ASCII_DATA @@"]
    lines, mark = [line + more.get("end", "") for line in head], ";" if point == "," else ","
    there = np.arange(COUNT) != lost
    for n in np.flatnonzero(there):
        rows = [cells(row, point) for row in FRAMES[n]]
        rows[0][5] = "B"
        lines += ["", label.format(n=n + 1, t=0.02 * n), *map(mark.join, rows)]
    text, name = "\n".join([*lines, "@@"]) + "\n", {"N": "newtons", "Raw": None}.get(unit, "kpa")
    says = "" if there.all() else "1 frame lost"
    return Case(text, {}, NO_SENSEL[there] * factor, TIME[there], name, 25.0, says=says, file="a.asf")


def xsensor() -> str:
    """Return an export of XSENSOR with two sensors; the right one has the known recording, the left one half of it."""
    lines = ["\ufeffFile:,x", "Units:,mmHg"]
    for n, frame in enumerate(FRAMES):
        clock = f"23:59:{59.9 + 0.02 * n:06.3f}" if n < 5 else f"00:00:{0.02 * n - 0.1:06.3f}"
        lines += [f"FRAME,{n}", f"Time, {clock}"]
        for part in ("left", "right"):
            lines += [f"SENSOR,{part}", f"Rows,{ROWS}", f"Columns,{COLS}", "Sensel Width (cm),0.5"]
            lines += ["Sensel Height (cm),0.4", "SENSELS"]
            lines += [",".join(cells(row * (0.5 if part == "left" else 1))) + ",,," for row in frame]
        lines += ["GROUP,1", "Cells,2", "SENSELS", "1,2,,,,"]
    return "\n\n".join(lines)


def emed() -> str:
    """Return a list of novel emed: rows 21 to 24, columns 11 to 16, two pages a picture, sums at the margins."""
    head = "File: x\tMatrix: 64x95\n\tSensor area: 0.25 cm²\tTime/picture:20.0 ms"
    head += "\nSensor size: 0.500x0.500 cm\n"
    lines = [head]
    for n, frame in enumerate(FRAMES):
        for half in (range(3), range(3, 6)):
            lines += [f"Page {n}", f"Pict-No.: {n + 1}  {20 * n} ms", ""]
            lines.append("  ".join(str(c + 11) for c in half) + "  Force")
            for r in range(ROWS):
                row = frame[r, list(half)]
                lines.append(f"{r + 21} " + " ".join(f"{v:.2f}" for v in (*row, row.sum() * 0.025)))
            lines += ["Force " + "999 " * 4, "\x0c"]
    return "\n".join([*lines, "Page 9", "MVP", "", "11 12", "21 999 999"])


PLIANCE = [n for n in range(1, ROWS * COLS + 1) if n % COLS not in (1, 2)]
NOVEL = "file name: x date/time 17.06.23\nscanning rate [Hz]: 50\npressure values in kPa\n\n"


def pliance() -> str:
    """Return an export of novel pliance whose sensors are numbered, without those of two columns."""
    lines = [NOVEL + "electrical:", "time[secs]  " + "  ".join(map(str, PLIANCE))]
    for t, frame in zip(TIME, FRAMES, strict=True):
        lines.append(f"{t:.5f}  " + "  ".join(f"{frame.ravel()[k - 1]:.3f}" for k in PLIANCE))
    return "\n".join([*lines, "MVP  " + "9  " * len(PLIANCE), "", "time[secs] force[N]", "0 9"])


def pedar() -> str:
    """Return an export of novel pedar: two soles with the same numbers; the right one has the known recording."""
    lines = ["time[secs]\t" + "\t".join(str(k) for _ in range(2) for k in range(1, ROWS * COLS + 1))]
    for t, frame in zip(TIME, FRAMES, strict=True):
        lines.append("\t".join([f"{t:.2f}", *cells((*(0 * frame).ravel(), *frame.ravel()))]))
    return NOVEL + "\n".join(lines)


NO_COLUMNS, NO_SENSEL = without(np.s_[:, :, :2]), without(np.s_[:, 0, 5])


def mat(path: Path) -> None:
    scipy.io.savemat(path, {"P": np.moveaxis(FRAMES, 0, 2), "t": TIME, "fs": 50.0}, do_compression=True)


def flat_mat(path: Path) -> None:
    scipy.io.savemat(path, {"P": FRAMES.transpose(0, 2, 1).reshape(COUNT, -1), "t": TIME})


def cells_mat(path: Path) -> None:
    frames = np.empty((COUNT, 1), object)
    frames[:, 0] = [*FRAMES]
    scipy.io.savemat(path, {"force": frames, "time": TIME[:, None]})


def mat73(path: Path) -> None:
    # MATLAB 7.3 is HDF5 behind 512 bytes of its own; arrays have their axes reversed.
    with h5py.File(path, "w", userblock_size=512) as file:
        file["P"], file["t"] = np.moveaxis(FRAMES, 0, 2).T, TIME[:, np.newaxis]
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])


def packed(path: Path, stated: str = "ms") -> None:
    """Write values in hundredths, the first one missing, and times of two names for their unit."""
    with h5py.File(path, "w") as file:
        file.attrs["Units"] = "N"
        file["p"], file["time_ms"] = np.round(100 * FRAMES), 1e3 * TIME
        file["p"][0, 0, 0] = -1.0
        file["p"].attrs.update(scale_factor=0.01, _FillValue=-1.0)
        file["time_ms"].attrs["units"] = stated


def netcdf(path: Path) -> None:
    """Write whole numbers with factors of float32, by which 100 is exactly 0, one beyond what is valid, and stamps."""
    with h5py.File(path, "w") as file:
        file["p"], file["stamp_ns"] = (np.round(FRAMES) * 100 + 100).astype(np.int16), np.array(STAMPS)
        file["stamp_ns"].attrs["_FillValue"] = np.int64(-1)
        file["p"][3, 0, 5] = 20_000
        file["p"][4, 0, 5] = 100
        file["p"].attrs.update(
            scale_factor=np.float32(0.01), add_offset=np.float32(-1.0), valid_max=np.int16(19_999)
        )


def unsigned(path: Path) -> None:
    """Write bytes with the attribute by which netCDF says that they have no sign, the first one missing."""
    with h5py.File(path, "w") as file:
        file["p"], file["time_ms"] = np.round(FRAMES * 2.5).astype(np.uint8).view(np.int8), 1e3 * TIME
        file["p"][0, 0, 0] = -1
        file["p"].attrs.update({"_Unsigned": "true", "_FillValue": np.int8(-1), "scale_factor": 0.4})


def parquet(made: dict[str, Any], options: dict[str, Any] | None = None, **told: Any) -> Case:
    told = {"file": "a.parquet"} | told
    return Case(lambda path: pq.write_table(pa.table(made), path), options or {}, **told)


def npy(array: NDArray[Any], options: dict[str, Any], **told: Any) -> Case:
    """Return the case of an array without times."""
    return Case(output.npy_bytes(array), RATE | options, file="a.npy", **told)


def npz(made: dict[str, Any], options: dict[str, Any], **told: Any) -> Case:
    return Case(lambda path: np.savez(path, **made), options, file="a.npz", **told)


def columns(name: Name, order: str = "rows") -> dict[str, Floats]:
    """Return the columns of the taxels by name in an order of `files.ordered`."""
    return {name(*at): FRAMES[:, *at] for at in files.ordered(list(np.ndindex(ROWS, COLS)), order, name)}


def levels(path: Path) -> None:
    """Write a table of pandas with rows and columns as two levels of names, and times as its index."""
    names = pd.MultiIndex.from_product([[f"r{r}" for r in range(ROWS)], [f"c{c}" for c in range(COLS)]])
    index = pd.to_datetime(STAMPS, unit="ns")
    pd.DataFrame(FRAMES.reshape(COUNT, -1), columns=names, index=index).to_parquet(path)


LISTS = {"stamp": pa.array(STAMPS, pa.timestamp("ns")), "data": [frame.ravel().tolist() for frame in FRAMES]}

STORE = get_typestore(Stores.ROS2_HUMBLE)
TOUCH = "std_msgs/Header header\nuint16 rows\nuint16 cols\nfloat32[] force\nfloat32[] low"
STORE.register(get_types_from_msg(TOUCH, "skin/msg/Touch"))
STORE.register(get_types_from_msg("builtin_interfaces/Time stamp\nfloat32[24] force", "skin/msg/Stamped"))
LISTED_FIELDS = "std_msgs/Header header\nsensor_msgs/ChannelFloat32[] sensors"
STORE.register(get_types_from_msg(LISTED_FIELDS, "skin/msg/Listed"))
T = STORE.types
WHOLE = np.floor(FRAMES * 100)


def header(ns: int, name: str = "palm") -> Any:
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), name)


def bag(
    topics: Topic | dict[str, Topic],
    options: dict[str, Any] | None = None,
    values: Floats | None = None,
    *,
    storage: str = "mcap",
    file: str = "a",
    received: Sequence[int] = STAMPS,
    **told: Any,
) -> Case:
    """Return the case of a bag, or of its one file, of messages by topic, each with its type, or of those of /skin."""

    by_topic = topics if isinstance(topics, dict) else {"/skin": topics}

    def write(path: Path) -> None:
        place = path.with_suffix(".bag") if path.suffix else path
        with Writer(place, version=9, storage_plugin=StoragePlugin[storage.upper()]) as made:
            for topic, (kind, messages) in by_topic.items():
                connection = made.add_connection(topic, kind, typestore=STORE)
                for ns, message in zip(received, messages, strict=True):
                    made.write(connection, ns, STORE.serialize_cdr(message, kind))
        if path.suffix:
            shutil.move(next(p for p in place.iterdir() if p.name != "metadata.yaml"), path)

    return Case(write, options or {}, values, file=file, **told)


SINGLE = FRAMES.astype(np.float32).astype(float)


def single(frame: Floats) -> NDArray[np.float32]:
    return frame.astype("f4").ravel()


Made = Callable[[Floats], NDArray[Any]]
Topic = tuple[str, Sequence[Any]]
"""Type of the messages of a topic, and the messages."""


def messages(kind: str, made: Callable[[int, Any], Any], frames: Floats = FRAMES) -> Topic:
    return kind, [made(ns, f) for ns, f in zip(STAMPS, frames, strict=True)]


def arrays(kind: str, made: Made, dims: Sequence[tuple[str, int, int]] = (), offset: int = 0) -> Topic:
    """Return multi-arrays of the known recording, in hundredths for whole numbers."""
    told = [T["std_msgs/msg/MultiArrayDimension"](*d) for d in dims]
    layout, name = T["std_msgs/msg/MultiArrayLayout"](told, offset), f"std_msgs/msg/{kind}MultiArray"
    frames = FRAMES if kind.startswith("Float") else WHOLE
    return messages(name, lambda _, f: T[name](layout, made(f)), frames)


def images(made: Made, encoding: str, pad: int = 0) -> Topic:
    """Return images [rows, cols] or [rows, cols, channels], in hundredths for whole numbers, rows padded by bytes."""
    name = "sensor_msgs/msg/Image"

    def image(ns: int, values: Floats) -> Any:
        frame = made(values)
        data = np.pad(frame.reshape(ROWS, -1).view(np.uint8), ((0, 0), (0, pad)), constant_values=77)
        said = *frame.shape[:2], encoding, int(frame.dtype.byteorder == ">"), data.shape[1]
        return T[name](header(ns), *said, data.ravel())

    return messages(name, image, FRAMES if "F" in encoding else WHOLE)


def own(kind: str, made: Callable[[int, Any], Sequence[Any]]) -> Topic:
    """Return messages of a type of this program with the fields that `made` returns."""
    return messages(f"skin/msg/{kind}", lambda ns, f: T[f"skin/msg/{kind}"](*made(ns, f)))


def padded(frame: Floats) -> NDArray[np.int16]:
    return np.r_[-7, -7, np.pad(frame, ((0, 0), (0, 2)), constant_values=-9).ravel()].astype(np.int16)


FLOATS = arrays("Float32", single)
DIMS = [("rows", 4, 24), ("cols", 6, 6)]
DOUBLES = arrays("Float64", np.ravel, DIMS)
TURNED = arrays("Int32", lambda f: f.T.astype("i4").ravel(), [("cols", 6, 24), ("rows", 4, 4)])
SHEAR = images(lambda f: np.stack([0 * f, f, f + 1], 2).astype("<f4"), "32FC3")
BIG = images(lambda f: f.astype(">u2"), "16UC1", 4)
LATER = BIG[0], [*BIG[1][:4], BIG[1][5], BIG[1][4], *BIG[1][6:]]
OWN = own("Touch", lambda ns, f: (header(ns), ROWS, COLS, single(f), 0 * single(f)))
HALF_NS = 10_000_000
THUMB = own("Touch", lambda ns, f: (header(ns + HALF_NS, "thumb"), ROWS, COLS, single(1 + 0 * f), single(f)))
BOTH = OWN[0], [message for pair in zip(OWN[1], THUMB[1], strict=True) for message in pair]
BOTH_NS = [ns for stamp in STAMPS for ns in (stamp, stamp + HALF_NS)]
STAMPED = own("Stamped", lambda ns, f: (header(ns).stamp, single(f)))
LISTED = own("Listed", lambda ns, f: (header(ns), [T["sensor_msgs/msg/ChannelFloat32"]("palm", single(f))]))
LATE = [ns + 3_000_000 * (n % 3) for n, ns in enumerate(STAMPS)]
"""Times of reception that jitter by up to 6 ms."""

OWN_OUTPUT = output.csv_of(FRAMES, "g", TIME)


def every(form: str, step: int = 20) -> list[str]:
    """Return a cell for every frame, with milliseconds that rise by a step."""
    return [form.format(step * n) for n in range(COUNT)]


def csv(name: Name | None, lead: Lead | None = None, **told: Any) -> Case:
    """Return the case of a csv: of a known size, and of a known rate if no column is a time, if not told otherwise."""
    options = SIZE if "time" in " ".join(lead or {}).lower() else SIZE | RATE
    made = {key: told.pop(key) for key in ("order", "mark", "point", "middle", "frames") if key in told}
    return Case(table(name, lead, **made), **({"options": options} | told))


def by_time(name: Name, order: str = "rows", **told: Any) -> Case:
    """Return the case of a csv with a column of time, and no option unless given."""
    return csv(name, {"time": seconds()}, order=order, **({"options": {}} | told))


# From the definitions: a standard atmosphere is 101.325 kPa, 760 mmHg and 14.69595 psi.
PSI = 101.325 / 14.69595
MMHG = 101.325 / 760
WIDE, WIDE_SIZE = np.arange(5.0 * 256).reshape(5, 8, 32), {"rows": 8, "cols": 32}
HANDS = np.stack([0 * FRAMES, FRAMES], 1)
LINES = [f"Frame {n}\n" + ",".join(cells(f.ravel())) for n, f in enumerate(FRAMES)]
LINES_LOST = "\n".join(LINES[:4] + LINES[5:])
UNITS = ",".join(["ms"] + ["psi"] * ROWS * COLS)
WITH_UNITS = table(flat, {"time": seconds(1e3)}).replace("\n", f"\n{UNITS}\n", 1)
INDEX = {"": every("{}", 1)}
IMU = {"imu_0": ["5"] * COUNT, "imu_1": ["6"] * COUNT}
ROS = {"%time": list(map(str, STAMPS)), "field.header.seq": INDEX[""]}
ROS["field.header.frame_id"] = ["palm"] * COUNT
WORDS = {"hand": ["left"] * COUNT, "place": ["palm"] * COUNT}
PAIR = {"stamp.sec": [str(s // 10**9) for s in STAMPS], "stamp.nanosec": [str(s % 10**9) for s in STAMPS]}
LATE_MS = [900 + 20 * n for n in range(COUNT)]
AT_NIGHT = [("25/03/24", "23:59:59") if ms < 1000 else ("26/03/24", "00:00:00") for ms in LATE_MS]
DATE_CLOCK_MS = dict(zip(("Date", "Time"), zip(*AT_NIGHT, strict=True), strict=True))
DATE_CLOCK_MS["ms"] = [str(ms % 1000) for ms in LATE_MS]
CLOCK_MS = {"timestamp": [f"2024-03-04 10:00:{ms // 1000:02d}" for ms in LATE_MS]}
CLOCK_MS["ms"] = DATE_CLOCK_MS["ms"]
WRAPPED = {"time_us": [str((2**32 - 50_000 + 20_000 * n) % 2**32) for n in range(COUNT)]}
LIST = "".join(f'{t:.2f},"[{", ".join(cells(f.ravel()))}]"\n' for t, f in zip(TIME, FRAMES, strict=True))
QUOTED = table(flat, {"time": seconds()}, mark='","').strip().replace("\n", '"\n"')
LOST_LINE = np.delete(FRAMES, 4, 0), np.delete(TIME, 4)
LOST_ROWS = [(7, 3), (8, 0)]
OVERLAP = arrays("Float64", np.ravel, [("rows", 4, 3), ("cols", 6, 3)])
TWICE = arrays("Float64", lambda f: np.r_[f, f].ravel(), DIMS)
SOME_NAMES = {"t": TIME, **columns(lambda r, c: flat(r, c) if r < 3 else f"p{r * COLS + c + 5}")}
HEARD_S = (np.array(LATE) - LATE[0]) * 1e-9

DAYS = {"date": [f"2024-03-{4 + 25 * n // 24:02d}" for n in range(COUNT)]}
DAYS["time"] = [f"{25 * n % 24:02d}:00:00" for n in range(COUNT)]
HOURS_25 = 90_000.0 * np.arange(COUNT)
SLASHES = {"date": [day.replace("-", "/") for day in DAYS["date"]], "time": DAYS["time"]}
DAYS_FIRST = {"date": [f"{n + 1}/03/2024" for n in range(COUNT)], "time": ["10:00:00"] * COUNT}
SLOW = [1_020_000 * n for n in range(COUNT)]
PARTS = {"sec": [str(us // 10**6) for us in SLOW], "usec": [str(us % 10**6) for us in SLOW]}
EXCEL = {"time": [f"{45352 + n / 1440:.8f}" for n in range(COUNT)]}
AGAIN = {"time": seconds(), "seq": [str(n % 12) for n in range(COUNT)]}
TWICE_SEQ = {"seq": [str(n // 2 if n < 4 else n - 2) for n in range(COUNT)]}
TAGGED = "".join("D:" + ",".join(cells(f.ravel())) + ",77\n" for f in FRAMES)
ARROWS = "".join(f"12:00:00.{20 * n:03d} -> {','.join(cells(f.ravel()))}\n" for n, f in enumerate(FRAMES))
OWN_TIMES = "time_s,row," + ",".join(f"c{c}" for c in range(COLS)) + "\n"
OWN_TIMES += "".join(
    f"{0.02 * n + 0.001 * r:.3f},{r},{','.join(cells(row))}\n"
    for n, f in enumerate(FRAMES)
    for r, row in enumerate(f)
)
THOUSANDS = table(flat).splitlines()[0] + ('\n"1,234"' + ",985" * (ROWS * COLS - 1)) * COUNT + "\n"
PACKED, NO_SIGN = np.round(FRAMES), np.round(FRAMES * 2.5) * 0.4
NO_SIGN[0, 0, 0] = np.nan
PACKED[3, 0, 5], PACKED[4, 0, 5] = np.nan, 0.0
CUT = FRAMES.copy()
CUT[-1, -1, -1] //= 1
CUT_TEXT = "\n".join(",".join(f"{v:.2f}" for v in frame.ravel()) for frame in FRAMES)[:-3]
NEWTONS, THOUSAND_OHM = {"values": FRAMES / 1e3, "unit": "newtons"}, {"values": FRAMES * 1e3, "unit": "ohm"}
DOUBLED = np.repeat(FRAMES, 2, 0)[:COUNT]
BY_NUMBER = SIZE | {"time_key": "0"}
STAMP_GONE, STAMP_TWICE, TWICE_S = seconds(), seconds(), TIME.copy()
STAMP_GONE[5], STAMP_TWICE[8], TWICE_S[8] = "", STAMP_TWICE[7], TIME[7]
GAP_S = TIME + 0.1 * (TIME > 0.05)
LATER_S = [f"{100 + t:.3f}" for t in GAP_S]
SIDES = "left", "right"
NUMBERED = np.concatenate([np.arange(24.0).reshape(1, ROWS, COLS), FRAMES])
RAMP = "\n".join(",".join(map(str, row)) for row in 5 * np.arange(4)[:, None] + np.arange(24))
ROW_LOST = "".join(line for n, line in enumerate(OWN_OUTPUT.splitlines(keepends=True)) if n != 10)
SOME_255, HELD = NO_SENSEL.copy(), FRAMES.copy()
SOME_255[2, 2, 2] = 255
HELD[3, 0, 5] = FRAMES[2, 0, 5]
NAMED = {"force": FRAMES, "time_ms": 20 * np.arange(COUNT)}
SECONDS = dict(zip(("sec", "nanosec"), np.divmod(STAMPS, 10**9), strict=True))
FEW_DIGITS = np.float32(1.7e9 + 200 * np.arange(COUNT))

CASES: dict[str, Case] = {
    # What readers from outside found: read wrongly without a word, or refused without saying why.
    "a column before its row": by_time(lambda r, c: f"col{c}_{r}", "text"),
    "x and y": by_time(lambda r, c: f"x{c}y{r}", "text"),
    "c and two numbers": by_time(lambda r, c: f"c{c}_{r}", asks="--taxels"),
    "a number before row and column": by_time(lambda r, c: f"left2_r{r}c{c}", "columns"),
    "a text and a number in a cell": Case(TAGGED, SIZE | RATE, asks="--taxels"),
    "a clock and an arrow": Case(ARROWS, SIZE),
    "a date with slashes beside a clock": csv(flat, SLASHES, time_s=HOURS_25),
    "a date that is not known beside a clock": csv(
        flat, DAYS | {"date": every("03/04/2024")}, asks="--time-key"
    ),
    "AM and PM": csv(flat, {"time": every("12:00:00.{:03d} AM")}),
    "a name of a month": csv(flat, {"time": every("04-Mar-2024 10:00:00.{:03d}")}),
    "a date and time in digits": csv(flat, {"timestamp": every("20240304100000.{:03d}")}),
    "an index of dates": csv(flat, {"": every("2024-03-04 10:00:00.{:03d}")}, options=SIZE),
    "a unit in a comment": Case("# time unit: s\n# unit: mN\n" + table(None), SIZE | RATE, **NEWTONS),
    "a unit in a sentence": Case("# forces in mN\n" + table(None), SIZE | RATE, **NEWTONS),
    "two units in comments": Case("# unit: N\n# unit: mN\n" + table(None), SIZE | RATE, says="several units"),
    "names with a comma": csv(lambda r, c: f'"p[{r},{c}]"', {"t": seconds()}, options={}),
    "pairs as names": csv(lambda r, c: f'"{r},{c}"', options=RATE),
    "pairs in brackets": csv(lambda r, c: f'"({r},{c})"', {"t": seconds()}, options={}, order="columns"),
    "a pair in a cell": Case(
        't,a,b\n0.0,"[1,2]",3\n0.1,"[2,3]",4\n', {"rows": 1, "cols": 2, "taxels": (1, 2)}, asks="--taxels"
    ),
    "rows with a time of their own": Case(OWN_TIMES, {"cols": COLS}),
    "doubled frames": csv(flat, TWICE_SEQ, frames=DOUBLED, values=DOUBLED, says="twice"),
    "day and month that tell each other": csv(flat, DAYS_FIRST, time_s=86400.0 * np.arange(COUNT)),
    "a comment about another unit": Case("# load cell unit: kg\n" + table(None), SIZE | RATE),
    "words in brackets": csv(lambda r, c: f"r{r}c{c} (left)", {"time (host)": seconds()}, options={}),
    "decimal marks of two kinds": csv(
        flat, {"Zeit (s)": every("0,{:02d}", 2)}, options=SIZE, mark=";", asks="one of them"
    ),
    "numbers as names, and a column of words": csv(lambda r, c: flat(r, c, ""), {"sum": ["palm"] * COUNT}),
    "two sensors that look like rows": by_time(lambda r, c: f"p{r // 2}_{r % 2 * COLS + c}", asks="--rows"),
    "mN": csv(lambda r, c: f"r{r}c{c} [mN]", {"t": seconds()}, options={}, **NEWTONS),
    "kohm": csv(lambda r, c: f"r{r}c{c}_kohm", {"t": seconds()}, options={}, **THOUSAND_OHM),
    "a unit that nobody knows": csv(lambda r, c: f"r{r}c{c} (pt)", {"t": seconds()}, options={}, says='"pt"'),
    "a date and a clock": csv(flat, DAYS, time_s=HOURS_25),
    "seconds and microseconds": csv(flat, PARTS, options=SIZE, time_s=1.02 * np.arange(COUNT)),
    "a clock and ms": csv(flat, {"time": every("23:59:59"), "ms": every("{}")}),
    "days since 1900": csv(flat, EXCEL, asks="--time-unit"),
    "a date that is read in two ways": csv(flat, {"time": every("03/04/2024 10:00:00")}, asks="--rate"),
    "a counter that falls": csv(flat, {"": [str(20 - n) for n in range(COUNT)]}, says="in another order"),
    **{
        f"a first line {line}": Case(
            f"{line}\n" + table(lambda r, c: f"r{r}c{c}", {"time": seconds()}),
            {},
            FRAMES * 4.4482216,
            unit="newtons",
        )
        for line in ("Units,lbf", "Force unit;lbf;;", "# force [pounds]")
    },
    "a counter that begins again": csv(flat, AGAIN, says="recordings joined"),
    "another rate than the times": csv(
        flat, {"time_s": seconds()}, options=SIZE | {"rate_hz": 100.0}, time_s=TIME / 2, says="overrules"
    ),
    "a mark of thousands": Case(THOUSANDS, SIZE | RATE, asks="thousands"),
    "a point that marks thousands": Case(
        THOUSANDS.replace('"1,234"', "1.234"), SIZE | RATE, asks="thousands"
    ),
    "cut in its last number": Case(CUT_TEXT, SIZE | RATE, CUT, says="cut off"),
    "words at the end": Case(table(flat) + "Stopped by user\n", SIZE | RATE, asks="line 22"),
    "-1 for a missing value": Case(gap("-1"), SIZE | {"missing": -1.0}, without((3, 0, 5))),
    "packed numbers of HDF5": Case(packed, values=without((0, 0, 0)), unit="newtons", file="a.h5"),
    "whole numbers of netCDF": Case(netcdf, values=PACKED, file="a.h5"),
    "bytes of netCDF without a sign": Case(unsigned, values=NO_SIGN, file="a.h5"),
    "HDF5, a time in two units": Case(
        lambda path: packed(path, "s"), asks="--time-unit ms or s", file="a.h5"
    ),
    "npz, stamps with too few digits": npz({"p": FRAMES, "t": FEW_DIGITS}, {}, asks="--rate"),
    "JSON": Case('{"t": 0, "p": [1, 2]}\n' * COUNT, SIZE | RATE, asks="JSON", file="a.json"),
    "an option of another kind of file": csv(flat, options=SIZE | RATE | {"key": "p"}, asks="--key"),
    "npy, column after column": npy(
        FRAMES.transpose(0, 2, 1).reshape(COUNT, -1), SIZE | {"axes": ("frames", "cols", "rows")}
    ),
    "npy, frames on either axis": npy(np.zeros((ROWS, COLS, ROWS)), SIZE, asks="--axes"),
    "a stamp that is missing": csv(
        flat, {"time": STAMP_GONE}, says="1 of 20 times are missing, the first of frame 5"
    ),
    "two equal stamps": csv(flat, {"time": STAMP_TWICE}, time_s=TWICE_S, says="the first of frame 8"),
    "lost frames": csv(None, {"": LATER_S}, options=BY_NUMBER, time_s=GAP_S, says="frames lost"),
    "a place without a taxel": npy(np.nan_to_num(SOME_255, nan=255.0), {"missing": 255.0}, values=SOME_255),
    "a place without a taxel, in a unit that is scaled": Case(
        table(lambda r, c: f"r{r}c{c} [mN]", {"time": seconds()}, frames=np.nan_to_num(SOME_255, nan=255.0)),
        {"missing": 255.0},
        SOME_255 * 1e-3,
        unit="newtons",
    ),
    "two times that differ": csv(
        flat, {"time_s": seconds(), "time_ms": seconds(3000.0)}, says="time_s and time_ms differ"
    ),
    "two times that differ, one without a unit": csv(
        flat, {"time": seconds(), "time_ms": seconds(2000.0)}, says="time and time_ms differ"
    ),
    "row and column in one number": csv(
        lambda r, c: f"S{r + 1}{c + 1}",
        {"time_s": seconds()},
        options=SIZE | {"taxels": (1, ROWS * COLS)},
        says="taken row by row",
    ),
    "a unit of time that is not that of the name": csv(
        flat,
        {"time_ms": seconds(1e3)},
        options=SIZE | {"time_unit": "s"},
        time_s=TIME * 1e3,
        says="--time-unit overrules",
    ),
    "a name too high": csv(lambda r, c: flat(r, c).replace("23", "29"), options=RATE, asks="p0, not 23"),
    "a name twice": csv(lambda r, c: flat(r, c).replace("23", "3"), options=RATE, asks="p3 twice"),
    "left and right": csv(lambda r, c: f"{SIDES[r // 2]}_{r % 2 * COLS + c}", options=RATE, asks="--part"),
    "columns in one number": csv(lambda r, c: flat(r, c, "c"), options=RATE, asks="--rows and --cols"),
    "two numbers with words": csv(
        lambda r, c: f"h{r // 2}_t{r % 2 * COLS + c}", options=RATE, asks="row and column"
    ),
    "one row in brackets": csv(lambda r, c: f"s[0][{r * COLS + c}]"),
    "numbers of columns": csv(lambda r, c: flat(r, c, ""), says="--header"),
    "numbers of columns, and a time": csv(lambda r, c: flat(r, c, ""), {"time": seconds()}),
    "numbers that are data": Case(
        table(lambda r, c: flat(r, c, "")), SIZE | RATE | {"header": False}, NUMBERED, 0.02 * np.arange(21)
    ),
    "numbers that go on": Case(RAMP, SIZE | RATE, asks="--header"),
    "a row lost from its own output": Case(ROW_LOST, values=without((2, 1)), says="frame 2 has no row 1"),
    "a missing cell, held": Case(gap("N/A"), SIZE | {"gaps": "hold"}, HELD, says="held"),
    "a place without a value": npy(NO_SENSEL, SIZE, values=NO_SENSEL, says="taken for no taxel"),
    "a missing cell, refused": Case(gap("N/A"), SIZE | {"gaps": "refuse"}, asks="frame 3, row 0, column 5"),
    "no time": Case(table(None), SIZE, asks="--rate"),
    "no size": Case(table(None), RATE, asks="--rows and --cols"),
    "another size": Case(table(None), RATE | {"rows": 5, "cols": 6}, asks="--rows and --cols"),
    "a word to skip": csv(None, WORDS, options=RATE | {"skip": 1, "rows": 5, "cols": 5}, asks="--skip"),
    "a time without a unit": csv(flat, {"t": every("{}")}, options=SIZE, asks="--time-unit"),
    "a time that falls": csv(
        None, {"": every("{}", -1)}, options=BY_NUMBER, asks="later than the frame before"
    ),
    "halves before the taxels": csv(None, {"": seconds(25)}, options=SIZE, asks="--skip N, --taxels"),
    "a value too many": Case(table(None).replace("\n", ",1\n", 1), SIZE | RATE, asks="line 2"),
    "an empty file": Case("", SIZE, asks="at least one line"),
    "a header only": Case("a,b\n", SIZE, asks="header only"),
    "a letter in a number": Case(table(None).replace("0", "x", 1), SIZE | RATE, asks="a number"),
    "a line or a frame": Case("1 2 3 4\n" * 8, RATE, asks="--rows 2 --cols 2 if a line is a frame"),
    "three names of two columns": Case("a,b,c\n1,2\n", RATE, asks="header = 3 names"),
    "Parquet, a duration by its name": parquet(
        {"lasted": pd.to_timedelta(TIME, unit="s"), **columns(flat)}, SIZE | {"time_key": "lasted"}
    ),
    "Parquet, stamps of 1970": parquet({"t": pd.to_datetime(TIME, unit="s"), **columns(flat)}, SIZE),
    # Damaged files.
    "no mcap": Case(b"no bag", asks="a readable", file="a.mcap"),
    "no db3": Case(b"SQLite format 3\0", asks="a readable", file="a.db3"),
    "no Parquet": Case(b"PAR1 no", asks="a readable", file="a.parquet"),
    "no gzip": Case(b"\x1f\x8b\x08", asks="a readable", file="a.csv.gz"),
    # Names and orders.
    "names by columns": by_time(lambda r, c: f"r{r}c{c}", "columns"),
    "names descending": by_time(flat, "descending", options=SIZE),
    "names sorted as text": by_time(lambda r, c: flat(r, c, "taxel_"), "text", options=SIZE),
    "names from one": by_time(lambda r, c: f"row{r + 1}_col{c + 1}", "descending"),
    **{
        f"a name in {unit}": by_time(lambda r, c, u=unit: f"r{r}c{c} [{u}]", says="no unit")
        for unit in ("0.01 N", "ozf", "%", "MN", "mPa", "ounces")
    },
    "names with brackets": by_time(lambda r, c: f"s[{r}][{c}]", "columns"),
    "numbers as names": csv(lambda r, c: flat(r, c, "")),
    "numbers and an index": csv(lambda r, c: flat(r, c, ""), INDEX),
    "names of some": by_time(lambda r, c: flat(r, c) if (r, c) != (2, 2) else "q", asks="--taxels"),
    "two arrays in names": by_time(lambda r, c: f"{'lr'[r % 2]}_{r // 2 * COLS + c}", asks="--part"),
    "columns amid taxels": csv(flat, {"sum": ["7"] * COUNT, "time": seconds()}, middle=IMU),
    "names of a ROS export": csv(lambda r, c: flat(r, c, "field.data"), ROS),
    "spaces": csv(None, mark="  "),
    "semicolons, decimal commas": csv(None, mark=";", point=","),
    "words to skip": csv(None, WORDS, options=SIZE | RATE | {"skip": 2}),
    "marks at the ends": Case("# by hand\n" + table(None).replace("\n", ",\n"), SIZE | RATE),
    # Times.
    "time_ms": csv(flat, {"time_ms": seconds(1e3)}),
    "Time [ms]": csv(flat, {"time [ms]": seconds(1e3)}),
    "time in us": csv(flat, {"time_us": seconds(1e6)}),
    "stamps in ns": csv(flat, {"timestamp": list(map(str, STAMPS))}),
    "sec and nanosec": csv(flat, PAIR, options=SIZE),
    "date, clock and ms": csv(flat, DATE_CLOCK_MS, options=SIZE),
    "date with clock, and ms": csv(flat, CLOCK_MS, options=SIZE),
    "sec and nanosec without names": csv(None, PAIR, options=SIZE),
    "a column of time by number": csv(None, {"": seconds()}, options=SIZE | {"time_key": "0"}),
    "a counter that wraps": csv(flat, WRAPPED, says="2^32"),
    "a clock since power-on": csv(flat, {"timestamp": seconds(1e6, 1.5e9)}, asks="--time-unit"),
    "time in minutes": csv(flat, {"Time [min]": seconds(1 / 60)}),
    "time in hours": csv(flat, {"time_h": seconds(1 / 3600)}),
    "time in an unknown unit": csv(flat, {"time [ks]": seconds(1e-3)}, asks="--time-unit"),
    "time in days": csv(flat, {"time": seconds(1 / 86400)}, asks="--time-unit"),
    "a line of units": Case(WITH_UNITS, SIZE, FRAMES * PSI, unit="kpa"),
    "a comment at the end": Case(table(flat, {"time": seconds()}) + "# end of file\n", SIZE),
    "a first column that rises": csv(None, {"": seconds(0.5)}, options=SIZE, asks="--time-key"),
    "decimal commas and dotted dates": csv(
        flat, {"time": every("25.04.2023 10:49:00,{:03d}")}, mark=";", point=","
    ),
    # Frames of several lines, missing cells.
    "blank lines, lost rows": Case(blocks("", LOST_ROWS), RATE, without([7, 8]), says="8 has 3 of"),
    **{
        f"blocks, {start} before a row": Case(blocks("", start=start), RATE, asks="--skip 1")
        for start in ("{r},", "{n},", "{t},")
    },
    "comments, lost rows": Case(blocks("# frame {n}", LOST_ROWS), SIZE | RATE, without([7, 8])),
    "labels with times": Case(blocks("Frame {n} ({t:.2f} s)"), SIZE),
    "labels of lines, one lost": Case(LINES_LOST, SIZE | RATE, *LOST_LINE, says="1 frame lost"),
    "its own output": Case(OWN_OUTPUT),
    **{
        f"missing cell {cell}": Case(gap(cell), SIZE, without((3, 0, 5)))
        for cell in ("nan", "", "-", "null", "N/A")
    },
    # Codings and quotes.
    "UTF-16": Case(table(flat, {"time [µs]": seconds(1e6)}, mark="\t").encode("utf-16"), SIZE, file="a.txt"),
    **{
        coding: Case(table(flat, {"time [µs]": seconds(1e6)}).encode(coding), SIZE)
        for coding in ("utf-16-le", "utf-16-be", "utf-32", "utf-8-sig")
    },
    "Latin-1": Case(table(flat, {"°": ["1"] * COUNT, "t": seconds()}).encode("latin-1"), SIZE),
    "a byte order mark, blank lines": Case("\ufeff" + table(None).replace("\n", "\r\n\r\n"), SIZE | RATE),
    "quoted cells": Case(f'"{QUOTED}"', SIZE),
    "a list in one column": Case("time,data\n" + LIST, SIZE),
    "csv.gz": Case(gzip.compress(table(flat, {"t": seconds()}).encode()), SIZE, file="a.csv.gz"),
    # Makers.
    "Tekscan, kPa": tekscan("KPa", "5 mm", "Frame {n}"),
    "Tekscan, psi": tekscan("PSI", "0.5 cm", "Frame {n}", PSI, end=",,,"),
    "Tekscan, mmHg": tekscan("mmHg", "0.19685039 inches", "Frame {n}", MMHG),
    "Tekscan, N/cm2": tekscan("N/cm2", "5 mm", "Frame {n}", 10),
    "Tekscan, N, stamps, commas": tekscan("N", "5 mm", "Frame {n} ({t:.3f} s)", end=";;", point=","),
    "Tekscan, raw, a lost frame": tekscan("Raw", "5 mm", "Frame {n}", lost=9),
    "Tekscan, exponents": tekscan("KPa", "5.0e-1 cm", "Frame {n}", step="2.0E-02"),
    "XSENSOR, two sensors": Case(xsensor(), asks="--part"),
    "XSENSOR, one of two": Case(xsensor(), {"part": 2}, FRAMES * MMHG, None, "kpa", 20.0),
    "novel emed": Case(emed().encode("latin-1"), unit="kpa", area_mm2=25.0, file="a.lst"),
    "novel pliance": Case(pliance(), SIZE, NO_COLUMNS, unit="kpa", says="another table", file="a.asc"),
    "novel pliance, size unknown": Case(pliance(), asks="--rows and --cols", file="a.asc"),
    "novel pedar": Case(pedar(), SIZE | {"part": 2}, unit="kpa", file="a.asc"),
    "novel pedar, two soles": Case(pedar(), SIZE, asks="--part", file="a.asc"),
    # Arrays.
    "npy": npy(FRAMES, SIZE),
    "npy, taxels first": npy(FRAMES.reshape(COUNT, -1).T, SIZE),
    "npy, two hands": npy(HANDS, SIZE, asks="--axes"),
    "npy, one of two hands": npy(HANDS, {"axes": ("frames", 1, "rows", "cols")}),
    "npy, frames last": npy(np.moveaxis(FRAMES, 0, 2), SIZE),
    "npy, taxels row by row": npy(FRAMES.reshape(COUNT, -1), SIZE),
    "npy, frames last by name": npy(np.moveaxis(FRAMES, 0, 2), {"axes": ("rows", "cols", "frames")}),
    "npy, columns first by name": npy(FRAMES.transpose(0, 2, 1), {"axes": ("frames", "cols", "rows")}),
    "npy, taxels of one of two hands": npy(
        np.moveaxis(HANDS, 1, 0).reshape(2, COUNT, -1), SIZE | {"axes": (1, "frames", "taxels")}
    ),
    **{
        f"npy, axes of {shape}": npy(np.arange(math.prod(shape)).reshape(shape), {}, asks="--axes")
        for shape in ((4, 4, 4), (4, 8, 32), (20, 2, 256), (3, 2, 4, 4), (16, 4))
    },
    "npz": npz(NAMED | {"note": np.array("left")}, SIZE),
    "npz, datetime64": npz({"force": FRAMES, "time": np.array(STAMPS, "datetime64[ns]")}, SIZE),
    "npz, timedelta64": npz({"force": FRAMES, "time": 20 * np.arange(COUNT, dtype="m8[ms]")}, SIZE),
    "npz, no array but the times": npz(
        {"force": FRAMES.astype(str), "time": TIME[:, None]}, {}, asks="--key"
    ),
    "mat, cells beside times": Case(cells_mat, asks="--key", file="a.mat"),
    "npz, parts of a second": npz({"force": FRAMES} | SECONDS, SIZE, asks="--time-key"),
    "npz, by name": npz(NAMED | {"note": np.array("left")}, SIZE | {"key": "force"}),
    "npz, with its unit": npz(NAMED | {"unit": "mN"}, SIZE, **NEWTONS),
    "npy, 256 columns": npy(WIDE.reshape(5, -1), WIDE_SIZE, values=WIDE, time_s=TIME[:5]),
    "MATLAB 5": Case(mat, file="a.mat"),
    "MATLAB, frames in one row": Case(flat_mat, SIZE, asks="--axes frames,cols,rows", file="a.mat"),
    "MATLAB, frames by (:)": Case(flat_mat, SIZE | {"axes": ("frames", "cols", "rows")}, file="a.mat"),
    "MATLAB 7.3": Case(mat73, file="a.mat"),
    # Parquet.
    "Parquet": parquet({"time_ms": TIME * 1e3, **columns(lambda r, c: f"r{r}c{c}", "columns")}),
    "Parquet, a list and stamps": parquet(LISTS, SIZE),
    "Parquet, rows of lists": parquet({"t": TIME, "force": FRAMES.tolist()}, file="a.pq"),
    "Parquet, names of some": parquet(SOME_NAMES, asks="--taxels"),
    "Parquet of pandas, two levels of names": Case(levels, file="a.parquet"),
    # ROS 2 bags.
    "mcap, Float32MultiArray": bag(FLOATS, SIZE, SINGLE),
    "sqlite3, Float64MultiArray": bag(DOUBLES, storage="sqlite3"),
    "one mcap file": bag(DOUBLES, file="a.mcap"),
    "one db3 file": bag(DOUBLES, storage="sqlite3", file="a.db3"),
    "strides of each dimension": bag(arrays("Float64", np.ravel, [("rows", 4, 6), ("cols", 6, 1)])),
    "strides that overlap": bag(OVERLAP, {"key": "/skin"}, asks="--rows"),
    "Int16MultiArray, padding": bag(arrays("Int16", padded, [("y", 4, 32), ("x", 6, 8)], 2), values=WHOLE),
    "Int32MultiArray, columns first": bag(TURNED, values=WHOLE),
    "16UC1, big-endian, padding": bag(BIG, values=WHOLE, received=LATE),
    "32SC1": bag(images(lambda f: f.astype("<i4"), "32SC1"), values=WHOLE),
    "32FC1": bag(images(lambda f: f.astype("<f4"), "32FC1"), values=SINGLE, storage="sqlite3", received=LATE),
    "32FC3": bag(SHEAR, asks="--axes"),
    "a channel of 32FC3": bag(SHEAR, {"axes": ("frames", "rows", "cols", 1)}, SINGLE),
    "rgb8": bag(images(lambda f: np.zeros((4, 6, 3), "u1"), "rgb8"), {"key": "/skin"}, asks="mono16"),
    "two sensors on a topic": bag(BOTH, {"key": "/skin.force"}, received=BOTH_NS, asks="--part"),
    "one of two sensors on a topic": bag(BOTH, {"key": "/skin.force", "part": 1}, SINGLE, received=BOTH_NS),
    "two topics": bag({"/skin": DOUBLES, "/other": DOUBLES}, asks="--key"),
    "one of two topics": bag({"/skin": DOUBLES, "/other": FLOATS}, {"key": "/skin"}),
    "a field of an own message": bag({"/a": OWN}, {"key": "/a.force"}, SINGLE, received=LATE),
    "times of reception": bag(BIG, {"time_key": "reception"}, WHOLE, received=LATE, time_s=HEARD_S),
    "a stamp without a header": bag(STAMPED, SIZE, SINGLE, received=LATE),
    "a list of messages": bag(LISTED, SIZE, SINGLE),
    "two frames in a message": bag(TWICE, {"key": "/skin"}, asks="--rows"),
    "sorted by stamps": bag(LATER, values=WHOLE, says="sorted by their stamps"),
}
"""Every kind of file of which the reader is judged."""
