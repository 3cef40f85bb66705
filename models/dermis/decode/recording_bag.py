# SPDX-License-Identifier: Apache-2.0
"""ROS 2 bags, MCAP and sqlite3, through rosbags: arrays of numbers and images as frames."""

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.decode.recording_text import COL, ROW, Found, Layout, warn
from dermis.errors import InputError, optional
from dermis.scene.stimulus import VALUES_MAX

SUFFIXES = (".mcap", ".db3")  # or a directory
_ENCODING = re.compile(r"(?:mono|(?=\d+[USF]C))(8|16|32|64)(?:([USF])C(\d*))?")
_TYPES = {"U": "u", "S": "i", "F": "f", None: "u"}
_LISTED = 64  # elements of a list of messages that are looked through


def read(path: Path, layout: Layout) -> Found:
    """Read the frames of one topic; times are the stamps of the headers, or of reception, whole nanoseconds.

    InputError if the topic or the field is not the only one with numbers, a message has another size than the first, or
    an encoding is not known; any other exception that the library raises on a damaged bag.
    """
    reader = optional("rosbags.highlevel", "recordings").AnyReader
    types = optional("rosbags.typesys", "recordings")
    # A bag of sqlite3 need not say its types: those of a release with long support.
    with reader([path], default_typestore=types.get_typestore(types.Stores.ROS2_HUMBLE)) as bag:
        topic, name = _chosen(path, bag, layout)
        frames, received, stamps, senders, total = [], [], [], {}, 0
        for kind, moment, message in _messages(bag, topic):
            header = getattr(message, "header", message)
            sender = senders.setdefault((kind, getattr(header, "frame_id", "")), len(senders) + 1)
            if layout.part not in (None, sender):
                continue
            frame = _arrays(path, message, layout).get(name)
            shape = None if frame is None else frame.shape
            if frame is None or (frames and shape != frames[0].shape):
                allowed = f"{name or 'data'} of the shape {frames[0].shape if frames else 'of an array'}, as the first"
                raise InputError(path, f"message {len(frames)} of {topic}", shape, allowed)
            if (total := total + frame.size) > VALUES_MAX:
                raise InputError(path, topic, "more values", f"at most {VALUES_MAX} values in all")
            stamp = getattr(header, "stamp", None)
            frames.append(frame)
            received.append(moment)
            stamps.append(stamp.sec * 10**9 + stamp.nanosec if hasattr(stamp, "nanosec") else 0)
    if not frames or (layout.part is None and len(senders) > 1):
        listed = ", ".join(
            f"{n} {frame or 'without a name'} ({kind})" for (kind, frame), n in senders.items()
        )
        raise InputError(path, "--part", layout.part, f"one of the sensors of {topic}: {listed}")
    if layout.time_key not in (None, "reception"):
        raise InputError(path, "--time-key", layout.time_key, "reception, for a bag; else the stamps")
    values = np.stack(frames).astype(float)
    told = layout.time_key is None and all(stamps) and len({*stamps}) > 1
    time, source = (stamps, "stamps of the headers") if told else (received, "times of reception")
    order = sorted(range(len(time)), key=time.__getitem__)
    if order != list(range(len(time))):
        late = int((np.diff(time) < 0).sum())
        warn(path, f"{late} messages have an earlier stamp than the one before: sorted by their stamps")
    # Differences of whole nanoseconds are exact; a double holds those since 1970 to 256 ns.
    start = time[order[0]]
    since_s = np.array([time[k] - start for k in order]) * 1e-9
    found = Found(values[order], since_s, "s", source, Fraction(start, 10**9))
    found.shape, found.by_line = values.shape[1:] if values.ndim == 3 else None, values.ndim == 2
    found.order = f"row by row, {name or 'data'} of {topic}"
    return found


def _messages(bag: Any, topic: str) -> Iterator[tuple[str, int, Any]]:
    """Yield type, time of reception in nanoseconds and content of the messages of a topic."""
    for connection, moment, raw in bag.messages([c for c in bag.connections if c.topic == topic]):
        yield connection.msgtype, moment, bag.deserialize(raw, connection.msgtype)


def _chosen(path: Path, bag: Any, layout: Layout) -> tuple[str, str]:
    """Return topic and field of the frames; `layout.key` is a topic, or topic.field."""
    found, unread, key = [], [], layout.key
    damaged = optional("rosbags.highlevel", "recordings").AnyReaderError
    wanted, _, field = (key or "").partition(".")
    for topic in sorted({c.topic for c in bag.connections if key is None or c.topic == wanted}):
        try:
            first = next(_messages(bag, topic), None)
            arrays = {} if first is None else _arrays(path, first[2], layout)
        except (KeyError, damaged) as error:  # a type that the bag does not define
            unread.append(f"not {topic} ({type(error).__name__} {error})")
        except InputError as error:
            if key is not None:
                raise
            unread.append(f"not {topic} ({error.key} {error.value})")
        else:
            found += [(topic, name) for name, a in arrays.items() if a.size > 1 and field in ("", name)]
    if len(found) != 1:
        names = [f"{topic}.{name}" if name else topic for topic, name in found] or ["no array of numbers"]
        listed = ", ".join((names + unread)[:20])
        raise InputError(path, "--key", key, f"the topic, or topic.field, of the frames: {listed}")
    return found[0]


def _arrays(path: Path, message: Any, layout: Layout, name: str = "") -> dict[str, NDArray]:
    """Return the arrays of numbers of a message by the name of their field; "": the message is one."""
    fields = {field.name: getattr(message, field.name) for field in dataclasses.fields(message)}
    if {"encoding", "step", "height", "data"} <= fields.keys():
        return {name: _image(path, fields)}
    if {"layout", "data"} <= fields.keys() and hasattr(fields["layout"], "dim"):
        return {name: _multi_array(path, fields["layout"], fields["data"], layout.size)}
    if "data" in fields and fields.keys() & {"format", "point_step"}:
        return {}  # a compressed image, a cloud of points: bytes
    found: dict[str, NDArray] = {}
    for key, value in fields.items():
        inner = f"{name}.{key}".lstrip(".")
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and "covariance" not in key:
            found[inner] = value
            rows, cols = fields.get("rows"), fields.get("cols")
            if isinstance(rows, int) and isinstance(cols, int) and rows * cols == value.size:
                found[inner] = value.reshape(rows, cols)
        for part, one in enumerate(value[:_LISTED] if isinstance(value, list) else [value]):
            if dataclasses.is_dataclass(one):
                found |= _arrays(path, one, layout, f"{inner}[{part}]" if isinstance(value, list) else inner)
    return found


def _image(path: Path, said: Mapping[str, Any]) -> NDArray:
    """Return an image as [rows, cols], or [rows, cols, channels] if it has several; rows may end in padding."""
    match = _ENCODING.fullmatch(said["encoding"])
    if match is None:
        raise InputError(path, "encoding", said["encoding"], "mono8, mono16, or 8UC1 to 64FC1")
    bits, kind, channels = int(match[1]), _TYPES[match[2]], int(match[3] or 1)
    order, width = ">" if said["is_bigendian"] else "<", said["width"] * channels
    rows, step, data = said["height"], said["step"], np.asarray(said["data"], np.uint8)
    if step < width * bits // 8 or data.size != rows * step:
        allowed = f"{rows} rows of {step} bytes, each at least {width * bits // 8}"
        raise InputError(path, "image", f"{data.size} bytes", allowed)
    lines = np.ascontiguousarray(data.reshape(rows, step)[:, : width * bits // 8])
    pixels = lines.view(f"{order}{kind}{bits // 8}")
    return pixels if channels == 1 else pixels.reshape(rows, -1, channels)


def _multi_array(path: Path, layout: Any, data: NDArray, size: int | None) -> NDArray:
    """Return a multi-array in the shape of its dimensions; flat if it names none, or wrong ones for `size` values.

    Element [i, j, ...] is at data_offset + stride_1 i + stride_2 j + ..., with the strides of the dimensions after the
    first, as the definition of the message says; 0 is a stride that nobody filled in. Strides that are each
    dimension's own are accepted where they say the same as none.
    """
    data = np.asarray(data)[layout.data_offset :]
    dims = [d for d in layout.dim if d.size > 1 or len(layout.dim) <= 2]
    sizes, told = [d.size for d in dims], [d.stride for d in dims]
    if not any(sizes):
        return data
    plain = [math.prod(sizes[k + 1 :]) for k in range(len(sizes))]
    steps = plain if told == plain else [t or p for t, p in zip([*told[1:], 1], plain, strict=True)]
    overlap = any(a < b * n for a, b, n in zip(steps, steps[1:], sizes[1:], strict=False))
    last = sum(step * (n - 1) for step, n in zip(steps, sizes, strict=True))
    if overlap or min(sizes) < 1 or not last < data.size <= steps[0] * sizes[0]:
        said = ", ".join(f"{d.label or '?'} {d.size} by {d.stride}" for d in layout.dim)
        if data.size == size:
            warn(path, f"dimensions of the array are wrong and are ignored: {said}")
            return data
        allowed = f"sizes and strides of {data.size} values; or --rows and --cols"
        raise InputError(path, "layout.dim", said, allowed)
    array = np.lib.stride_tricks.as_strided(data, sizes, [step * data.itemsize for step in steps]).copy()
    turned = len(dims) == 2 and dims[0].label.lower() in COL and dims[1].label.lower() in ROW
    return array.T if turned else array


def write(
    directory: Path, topics: Mapping[str, NDArray], time_s: NDArray, storage: str, start_ns: int = 0
) -> None:
    """Write a bag, a directory that must not be there, in "mcap" or "sqlite3": a Float64MultiArray a frame.

    `topics` has [frames, rows, cols] by topic, and `time_s` [frames] from `start_ns` is written to 1 ns.
    """
    rosbag2 = optional("rosbags.rosbag2", "recordings")
    types = optional("rosbags.typesys", "recordings")
    store = types.get_typestore(types.Stores.ROS2_HUMBLE)
    kinds, kind = store.types, "std_msgs/msg/Float64MultiArray"
    dimension = kinds["std_msgs/msg/MultiArrayDimension"]
    with rosbag2.Writer(directory, version=9, storage_plugin=rosbag2.StoragePlugin[storage.upper()]) as bag:
        connections = {topic: bag.add_connection(topic, kind, typestore=store) for topic in topics}
        moments = start_ns + np.round(np.asarray(time_s) * 1e9).astype(np.int64)
        for n, moment in enumerate(moments.tolist()):
            for topic, frames in topics.items():
                rows, cols = frames.shape[1:]
                dims = [dimension("rows", rows, rows * cols), dimension("cols", cols, cols)]
                layout = kinds["std_msgs/msg/MultiArrayLayout"](dims, 0)
                message = kinds[kind](layout, np.ascontiguousarray(frames[n], np.float64).ravel())
                bag.write(connections[topic], moment, store.serialize_cdr(message, kind))
