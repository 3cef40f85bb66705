# SPDX-License-Identifier: Apache-2.0
"""Target `frames`: the file of a scene's frames as csv, npy, npz, or as a link, a pipe, a device.

An input has HEAD bytes before the content: places in THINGS, NAMES, TABLES and KEYS, the number of
bytes at the end that repeat, and the power of two of the size up to which they repeat (0: not).
"""

import io
import os
import socket
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from dermis import plan as planning
from dermis.report.output import npy_bytes
from dermis.scene import scene as scenes
from tb.programs.fuzz import inputs, oracle, target_scene

HEAD = 6
POWER_MAX = 22  # 4 MB: enough for memory that grows faster than the file


def _link(to: str) -> Callable[[Path, bytes], None]:
    return lambda path, data: path.symlink_to(to)


def _linked_file(path: Path, data: bytes) -> None:
    (path.parent / "target.bin").write_bytes(data)
    path.symlink_to("target.bin")


def _sparse(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    os.truncate(path, 1 << 40)


def _socket(path: Path, data: bytes) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))  # the name of a socket has 107 characters at most


_DEVICES = ("/dev/zero", "/dev/stdin", "/proc/kmsg", "/proc/self/mem", "/etc/shadow", "/")
THINGS: tuple[Callable[[Path, bytes], Any], ...] = (
    Path.write_bytes, _linked_file, _sparse, _socket, lambda path, data: path.mkdir(),
    lambda path, data: os.mkfifo(path), lambda path, data: None, _link("loop.csv"), *map(_link, _DEVICES),
)  # fmt: skip
"""Makers of the object at the path of a frame file."""

NAMES = (
    "loop.csv", "loop.npy", "loop.npz", "loop.CSV", "loop", "", ".", "..", "loop.csv/", "loop.csv\x00", "a\nb.csv",
    "\x1b[2J.npy", "n" * 400 + ".csv", "d/" * 3000 + "x.csv", "~/x.csv", "$(touch x).csv", "-.csv",
)  # fmt: skip
TABLES: tuple[dict[str, Any], ...] = (
    {"kind": "frames", "unit": "codes"},
    {"kind": "frames", "unit": "newtons"},
    {"kind": "resistance"},
    {"kind": "frames", "unit": "newtons", "scale": 1e30},
    {"kind": "frames", "unit": "codes", "select": [2, 0, 10**9]},
    {"kind": "resistance", "select": [0] * 300, "t_frame_s": 1.0, "resample": "linear"},
    {"kind": "frames", "unit": "codes", "t_frame_s": 1e9, "resample": "hold"},
)
KEYS = (None, "codes", "other", "", "codes.npy", "../codes", "a\nb", "x" * 500)

_TEXTS = (
    b"1,2\n3,4\n5,6\n", b"1,2,3,4,5,6\n" * 3, b"0.5,inf\n0,1e3\n1,nan\n", b" 1 , 2 \r\n\r\n3,4\r\n5,6", b"1,,\n",
    b"-1,2\n" * 3, b"1_0,2\n" * 3, b"1e400,1\n" * 3, b"\xef\xbb\xbf1,2\n" * 3, b"row,col\n1,2\n", b"", b"\x00", b",",
)  # fmt: skip
_SHAPES = (
    "(3, 2)", "(1, 3, 2)", "(6,)", "()", "(-3, -2)", "(0, 3, 2)", "(3.0, 2)", "(99999999999, 3, 2)", "[3, 2]",
    "(3, 2)*9", "(None, 2)", "(33554432, 3, 2)", "(" + "9" * 4000 + ",)",
)  # fmt: skip
_DTYPES = (
    "'<f8'", "'<i8'", "'|u1'", "'<f2'", "'<f16'", "'|b1'", "'<c16'", "'|S9'", "'<U999999999'", "'<M8[ns]'", "'|O'",
    "('<f8', (1000,))", "[('a', '<f8'), ('b', '|O')]", "lambda",
)  # fmt: skip
_ORDERS = ("False", "False", "True", "None", "__import__('os').mkdir('x')")
_MEMBERS = ("codes.npy", "codes", "../x.npy", "a\nb.npy", "other.npy")
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
_PHRASES = ("1,2\n", ",", "inf", "nan", "1e999", "-0", "\r", "PK\x03\x04", "1_0", "+5", "256", "PK\x01\x02")


def _header(dtype: str, order: str, shape: str, length: int) -> bytes:
    text = f"{{'descr': {dtype}, 'fortran_order': {order}, 'shape': {shape}}}".encode().ljust(108) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(range(48))[:length]


def _npz(members: dict[str, bytes], method: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


@st.composite
def strategy(draw: st.DrawFn) -> bytes:
    """Draw what is at the place of a file, how a scene names it, and its content."""
    codes = np.array([[1, 2], [3, 4], [5, 6]])
    arrays = [codes.astype(t) for t in ("u1", "i8", "f8", "f2", "g", "?", "c16", "S3", "M8[s]")]
    arrays += [codes[None].repeat(2, 0), np.asfortranarray(codes), 3, np.zeros(0), np.full((3, 2), np.nan)]
    headers = st.builds(_header, *map(st.sampled_from, (_DTYPES, _ORDERS, _SHAPES)), st.integers(0, 48))
    npy = st.sampled_from([*map(npy_bytes, arrays), target_scene.pickled()]) | headers
    members = st.dictionaries(st.sampled_from(_MEMBERS), npy, max_size=2)
    bomb = st.just({"codes.npy": bytes(1 << 22)})
    contents = st.sampled_from(_TEXTS), npy, st.builds(_npz, members | bomb, st.sampled_from(_METHODS))
    kind = draw(st.integers(0, 2))
    data = draw(contents[kind])
    head = [draw(st.integers(0, len(of) - 1)) for of in (THINGS, NAMES, TABLES, KEYS)]
    if draw(st.integers(0, 3)):  # mostly a file of a name that fits
        head[0] = 0
    if draw(st.integers(0, 3)):
        head[1], head[3] = kind, 0
    # A large file takes most of the time.
    head += [draw(st.integers(0, 16)), draw(st.sampled_from((0,) * 40 + (12, 16, 18, 20, POWER_MAX)))]
    return bytes(head) + (draw(inputs.edited(data, _PHRASES)) if draw(st.booleans()) else data)


prepare = target_scene.prepare


def run(data: bytes, place: Path) -> str:
    """Put the thing in its place and plan a scene that names it."""
    thing, name, table, key, tail, power = data[:HEAD].ljust(HEAD, b"\0")
    body, block = data[HEAD:], data[HEAD:][-max(1, tail) :]
    if block and power:
        size = 1 << min(power, POWER_MAX)
        body = (body + block * ((size - len(body)) // len(block) + 1))[: 1 << POWER_MAX]
    file = NAMES[name % len(NAMES)]
    for ending in (".csv", ".npy", ".npz"):
        path = place / f"loop{ending}"
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        path.unlink(missing_ok=True)
    ending = Path(file).suffix if Path(file).suffix in (".csv", ".npy", ".npz") else ".csv"
    THINGS[thing % len(THINGS)](place / f"loop{ending}", body)
    stimulus = {"file": file, **TABLES[table % len(TABLES)]}
    if (word := KEYS[key % len(KEYS)]) is not None:
        stimulus["key"] = word
    tree = {"array": {"rows": 3, "cols": 2}, "stimulus": stimulus}

    def one() -> None:
        target_scene.look(planning.make(scenes.from_data(tree, place / "scene.toml")), place, again=False)

    return oracle.judge(one)
