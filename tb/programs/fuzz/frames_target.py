# SPDX-License-Identifier: Apache-2.0
"""Target `frames`: what stands behind the file name of a scene: csv, npy, npz, and everything that is no such file."""

from __future__ import annotations

import io
import os
import random
import socket
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dermis import plan as planning
from dermis.scene import scene as scenes
from tb.programs.fuzz import grammar, oracle, scene_target
from tb.programs.fuzz.target import Target

HEAD = 6
"""Bytes in front of a file's content: what is there, its ending, the table, the key, how often its end repeats, and to
what size."""

GROWN_MAX = 1 << 22
"""Bytes of a file whose end repeats: enough for what grows faster than the file to show."""


def _regular(path: Path, data: bytes) -> None:
    path.write_bytes(data)


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
        # A socket's name may have 107 characters; the directory's own name is longer on some machines.
        made.bind(f"/proc/self/fd/{_open_directory(path.parent)}/{path.name}")


def _open_directory(path: Path) -> int:
    global _directory
    if _directory is None:
        _directory = os.open(path, os.O_RDONLY)
    return _directory


_directory: int | None = None

_DEVICES = (
    "/dev/zero",
    "/dev/null",
    "/dev/urandom",
    "/dev/full",
    "/dev/tty",
    "/dev/stdin",
    "/dev/fd/0",
    "/proc/self/mem",
)
_DEVICES += ("/proc/self/environ", "/proc/self/maps", "/proc/kmsg", "/", "/etc/shadow", "/nonexistent/x")

THINGS: tuple[Callable[[Path, bytes], None], ...] = (
    *[_regular] * 40, _linked_file, _sparse, _socket, lambda path, data: path.mkdir(), lambda path,
    data: os.mkfifo(path),
    lambda path, data: None, _link("loop.csv"), *(_link(device) for device in _DEVICES),
)  # fmt: skip
"""What may be where a frame file is looked for, by the first byte of the input."""

NAMES = (
    *["loop.csv", "loop.npy", "loop.npz"] * 12, "loop.CSV", "loop.txt", "loop", "", ".", "..", "loop.csv/",
    "loop.csv\x00", "a\nb.csv",
    "\x1b[2J.npy", "\u202evsc.csv", "n" * 400 + ".csv", "d/" * 3000 + "x.csv", "~/x.csv", "$(touch x).csv",
    "-.csv", " .csv",
    "\U0001f9a0.npy",
)  # fmt: skip

TABLES: tuple[dict[str, Any], ...] = (
    {"kind": "frames", "unit": "codes"},
    {"kind": "frames", "unit": "newtons"},
    {"kind": "resistance"},
    {"kind": "frames", "unit": "newtons", "scale": 1e30},
    {"kind": "frames", "unit": "codes", "select": "last"},
    {"kind": "frames", "unit": "codes", "select": [2, 0, 10**9]},
    {"kind": "resistance", "select": [0] * 300, "t_frame_s": 1.0, "resample": "linear"},
    {"kind": "frames", "unit": "codes", "t_frame_s": 1e9, "resample": "hold"},
)

KEYS: tuple[str | None, ...] = (
    None,
    None,
    None,
    "codes",
    "other",
    "",
    "codes.npy",
    "../codes",
    "a\nb",
    "x" * 500,
)

GROWTHS = (0,) * 27 + (12, 16, 18, 20, 22)
"""Powers of two of the size to which the end of a file repeats; few, for they take most of the time."""


def _npy(array: Any, version: tuple[int, int] | None = None) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), version=version)
    return stream.getvalue()


def _npz(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _claims(header: str) -> bytes:
    text = header.encode("latin-1", "replace") + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(range(64))


def seeds() -> list[bytes]:
    """Good files of each kind, and of each thing that is none; the first `HEAD` bytes say which."""
    codes = np.array([[1, 2], [3, 4], [5, 6]])
    texts = [
        b"1,2\n3,4\n5,6\n", b"1,2,3,4,5,6\n" * 3, b"0.5,inf\n0,1e3\n1,nan\n", b" 1 , 2 \r\n\r\n3,4\r\n5,6",
        b"1,,\n", b"-1,2\n" * 3,
        b"1_0,2\n" * 3, b"1e400,1\n" * 3, b"\xef\xbb\xbf1,2\n" * 3, b"1;2\n", b"row,col\n1,2\n", b"", b"\n\n",
        b"0x1,2\n", b"\x00", b",",
        b"1" * 3000 + b",2\n",
    ]  # fmt: skip
    arrays = [
        _npy(codes.astype(t))
        for t in ("u1", "i8", "f8", ">f4", "f2", "u2", "g", "?", "c16", "S3", "U2", "M8[s]")
    ]
    arrays += [
        _npy(codes[None].repeat(2, 0)),
        _npy(np.asfortranarray(codes)),
        _npy(codes.astype(float), (2, 0)),
        _npy(codes, (3, 0)),
    ]
    arrays += [
        _npy(np.zeros(0)),
        _npy(3),
        _npy(np.zeros((2, 3, 2, 1))),
        _npy(np.full((3, 2), np.nan)),
        scene_target.pickled(),
    ]
    for header in (
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3, 2)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 3, 2)}",
        "{'descr': '|u1', 'fortran_order': False, 'shape': (33554432, 3, 2)}",
        "{'descr': ('<f8', (1000,)), 'fortran_order': False, 'shape': (3, 2)}",
        "{'descr': [('a', '<f8'), ('b', '|O')], 'fortran_order': False, 'shape': (3, 2)}",
        "{'descr': '|O', 'fortran_order': False, 'shape': ()}",
        "{'descr': '<f8', 'fortran_order': __import__('os').mkdir('x'), 'shape': (3, 2)}",
        "{'descr': '|V99999999', 'fortran_order': False, 'shape': (3, 2)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (" + "9" * 4000 + ",)}",
        "(" * 90 + ")" * 90,
        "{'descr': '<f8', 'shape': (3, 2)}",
    ):
        arrays.append(_claims(header))
    good = _npy(codes)
    zips = [
        _npz({"codes.npy": good}, method)
        for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    ]
    zips += [
        _npz({"codes.npy": good, "other.npy": arrays[2]}),
        _npz({}),
        _npz({"../../codes.npy": good}),
        _npz({"a\nb.npy": good}),
    ]
    zips += [
        _npz({"codes.npy": scene_target.pickled()}),
        _npz({"codes": good}),
        _npz({"codes.npy": bytes(1 << 22)}, zipfile.ZIP_DEFLATED),
    ]
    lzma_bomb = bytearray(zips[3])
    at = lzma_bomb.find(b"\x5d\x00")
    if at > 0:  # the size of the dictionary that an LZMA stream asks for: 4 GB
        lzma_bomb[at + 1 : at + 5] = b"\xff\xff\xff\xff"
    zips.append(bytes(lzma_bomb))
    found = []
    for kind, contents in enumerate((texts, arrays, zips)):
        for n, content in enumerate(contents):
            found.append(bytes((0, kind, n % 3, 0, 0, 0)) + content)
    for thing in range(40, len(THINGS)):
        found.append(bytes((thing, thing % 3, 0, 0, 0, 0)) + b"1,2\n3,4\n5,6\n")
    for name in range(len(NAMES)):
        found.append(bytes((0, name, 0, 0, 0, 0)) + b"1,2\n3,4\n5,6\n")
    # What grows: lines, one line, an empty archive's directory, zeros behind an npy.
    for content in (b"1,2\n", b"1,", b",", b"1", b"\n", b" ", b"1,2,3,4,5,6\n"):
        found.append(bytes((0, 0, 0, 0, len(content), 31)) + content)
    found.append(bytes((0, 1, 0, 0, 8, 30)) + good + bytes(8))
    found.append(bytes((0, 2, 0, 0, 8, 30)) + zips[0])
    return found


def _mutate_npy(data: bytes, rng: random.Random) -> bytes:
    end = data.find(b"\n", 0, 400)
    if rng.random() < 0.2 or end < 10:
        return grammar.mutate_text(
            data, rng, ["'descr'", "'shape'", "(", ")", "|O", "<f8", ">i2", "True", "lambda"]
        )
    pairs = (
        (b"<f8", (b"|O", b"<f2", b">f8", b"|u1", b"<i8", b"<c16", b"|S9", b"<U999999999", b"<f16", b"|b1",
        b"<M8[ns]", b"|V0", b"|S0")),
        (b"<i8", (b"|O", b"<f8", b"|u1", b"<u2", b"|S0")),
        (b"(3, 2)", (b"(2, 3)", b"(1, 3, 2)", b"(6,)", b"()", b"(-3, -2)", b"(3, 2, 1)", b"(0, 3, 2)",
        b"(3.0, 2)", b"(True, 3, 2)",
                     b"(99999999999, 3, 2)", b"(1099511627776, 0, 2)", b"[3, 2]", b"(3, 2)*9", b"(None, 2)",
                     b"'3,2'")),
        (b"False", (b"True", b"0", b"None", b"[]")),
        (b"'shape'", (b"'shap'", b"'shape': 1, 'shape'")),
    )  # fmt: skip
    old, new = rng.choice(pairs)
    changed = data.replace(old, rng.choice(new), 1)
    grown = len(changed) - len(data)
    if data[:6] == b"\x93NUMPY" and rng.random() < 0.9 and data[6] == 1:
        size = struct.unpack("<H", data[8:10])[0] + grown
        changed = changed[:8] + struct.pack("<H", size & 0xFFFF) + changed[10:]
    return changed


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Another file, or another thing in its place, by what it is."""
    head, body = bytearray(data[:HEAD].ljust(HEAD, b"\0")), data[HEAD:]
    if rng.random() < 0.15:
        head[rng.randrange(HEAD)] = rng.choice((0, 0, 1, 2, rng.randrange(256)))
    if rng.random() < 0.01:
        head[5] = 27 + rng.randrange(5)
    if rng.random() < 0.05:
        head[0] = rng.randrange(256)
    if body[:6] == b"\x93NUMPY":
        body = _mutate_npy(body, rng)
    elif body[:2] == b"PK" and rng.random() < 0.5:
        at = body.find(b"\x93NUMPY")
        inner = _mutate_npy(body[at:][:300], rng) if at > 0 else b"1,2\n"
        method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
        name = rng.choice(
            ("codes.npy", "codes", "../x.npy", "a\x00b.npy", "\n.npy", "other.npy", "x" * 70000)
        )[:60000]
        try:
            body = _npz({name: inner}, method)
        except (ValueError, struct.error):
            body = grammar.mutate_text(body, rng, ["PK\x01\x02", "PK\x05\x06"])
    else:
        body = grammar.mutate_text(
            body,
            rng,
            [
                "1,2\n",
                ",",
                "inf",
                "nan",
                "1e999",
                "-0",
                "0x1",
                "\r",
                "PK\x03\x04",
                "1,2,3,4,5,6\n",
                "1_0",
                "+5",
                "255",
                "256",
                "PK\x01\x02",
            ],
        )
    return bytes(head) + body


def grown(body: bytes, tail: int, power: int) -> bytes:
    """A file whose last bytes, `tail` of them, repeat until it has 2**power bytes."""
    if not power or not body:
        return body
    block = body[-max(1, tail) :]
    return (body + block * ((min(1 << power, GROWN_MAX) - len(body)) // len(block) + 1))[:GROWN_MAX]


def clean(path: Path) -> None:
    """Remove what the input before this one left."""
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def prepare(place: Path) -> None:
    """Everything loaded that a plan may load."""
    scene_target.prepare(place)


def run(data: bytes, place: Path) -> str:
    """Make the thing, and plan a scene that names it."""
    thing, name, table, key, tail, power = data[:HEAD].ljust(HEAD, b"\0")
    where, file = place / "loop", NAMES[name % len(NAMES)]
    for ending in (".csv", ".npy", ".npz"):
        clean(where.with_suffix(ending))
    ending = Path(file).suffix if Path(file).suffix in (".csv", ".npy", ".npz") else ".csv"
    body = grown(data[HEAD:], tail, GROWTHS[power % len(GROWTHS)])
    THINGS[thing % len(THINGS)](where.with_suffix(ending), body)
    stimulus = {"file": file, **TABLES[table % len(TABLES)]}
    word = KEYS[key % len(KEYS)]
    if word is not None:
        stimulus["key"] = word
    scene = {"array": {"rows": 3, "cols": 2}, "stimulus": stimulus}

    def one() -> None:
        made = planning.make(scenes.from_data(scene, place / "scene.toml"))
        scene_target.look(made, place, again=False)

    return oracle.judge(one, lambda path: False)


TARGET = Target("frames", "frame files", seeds, mutate, prepare, run)
