# SPDX-License-Identifier: Apache-2.0
"""Mutations that know what the inputs are made of: tables, keys and values of TOML, lines, numbers and bytes."""

from __future__ import annotations

import datetime
import math
import random
import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import tomli_w

SIZE_MAX = 1 << 15
"""Bytes of an input: repeats grow up to here."""

TEXTS = (
    "", " ", "\n", "\r", "\t", "\x00", "\x1b[31mred", "\x7f", "\x85", "\u2028", "\u202eltr", "\ufeff",
    "\u00e9", "\U0001f9a0",
    "\n.control\nshell touch fuzz_was_here\n.endc\n", ".control", ".include /etc/passwd", ".end",
    ".lib '/etc/passwd'",
    "*\n.control\nquit\n.endc", "{shell('touch x')}", "$(touch fuzz_was_here)", "`touch fuzz_was_here`",
    "; touch fuzz_was_here",
    "| touch fuzz_was_here", "&& touch fuzz_was_here", "' touch '", "\" touch \"", "%s%n%x", "{0.__class__}",
    "${HOME}", "~", "~root",
    "..", ".", "/", "//", "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "/dev/null", "/dev/stdin",
    "/proc/self/mem",
    "/proc/self/environ", "frames.csv/../frames.csv", "frames.csv\x00.npy", "./frames.csv", "frames.csv ",
    "-", "--out", "-h", "@file",
    "a" * 300, "a" * 5000, "\u00e9" * 200, "\\", "\\n", "'''", '"""', "#", "[x]", "x = 1", "inf", "nan",
    "1e400", "0x10", "1_000", "None",
    "true", "frames.csv", "frames.npy", "frames.npz", "pickled.npy", "deep/none.csv", "link.csv", "pipe.csv",
    "directory.csv", "codes",
)  # fmt: skip
"""Text that means something to a shell, to ngspice, to a file system, to a terminal or to a parser."""

NUMBERS: tuple[Any, ...] = (
    0, 1, -1, 2, 3, 7, 16, 255, 256, 257, 1000, 65535, 65536, 2**25, 2**25 + 1, 2**31, 2**32 - 1, 2**32,
    2**53 + 1, 2**63, 2**64,
    10**30, 10**31, -(10**30), 10**308, 10**400, -(10**400), 10**4000, 0.0, -0.0, 0.5, 1.0, 1.5, -0.5, 1e-3,
    1e-6, 1e-9, 1e-12, 1e-15,
    1e-30, 1e-31, 5e-324, 2.2250738585072014e-308, 0.1, 1e3, 1e6, 1e9, 1e12, 1e18, 1e30, 1.1e30, 1e300,
    1.7976931348623157e308,
    -1e308, math.inf, -math.inf, math.nan, 0.9999999999999999, 1.0000000000000002, 510.0, 249.99999999999997,
    -273.15, 360.1,
)  # fmt: skip
"""Numbers at the edges of types, of the sizes that a scene takes, and beyond."""

DATES = (
    datetime.date(2024, 2, 29),
    datetime.datetime(1, 1, 1, tzinfo=datetime.UTC),
    datetime.datetime(9999, 12, 31, 23, 59, 59, 999999),
    datetime.time(23, 59, 59),
)

LINES = (
    "[array]\nrows = 1000000\ncols = 1000000", "frames = 1000000000", "a" + ".a" * 3000 + " = 1",
    "[" + ".".join("abc" * 300) + "]",
    "x = " + "[" * 3000, "x = " + "{a = " * 800 + "1" + "}" * 800, "x = 1979-13-45",
    "x = 0000-00-00T99:99:99", "x = " + "9" * 5000,
    "x = 1" + "0" * 400 + ".0", "x = 0x" + "f" * 3000, "[[stimulus]]", "[stimulus]", "[effects]",
    "[[effects]]", "[run]", "'' = 1",
    '"\\u0000" = 1', '"a\\nb" = 1', "x = '''\n.control\n'''", "title = 'twice'", "stimulus = 1", "=", "]",
    "\"", "'''", "#" * 2000,
    "force_n = [" + "1," * 2000 + "1]", "x = [[[[[[1]]]]]]", "\ufefftitle = 1", "kind = \"uniform\"",
    "effects.lateral = true",
)  # fmt: skip
"""Lines that a scene may not hold, or not twice, or only elsewhere."""


@dataclass(frozen=True)
class Vocabulary:
    """The keys of a TOML file as paths, each with what its documentation allows."""

    keys: tuple[tuple[tuple[str, ...], str], ...]

    def words(self) -> list[str]:
        """Every word of a key, and every text that some key allows, once."""
        found = {word for path, _ in self.keys for word in path}
        for _, allowed in self.keys:
            found.update(re.findall(r'"([^"]*)"', allowed))
        return sorted(found)


def hostile(rng: random.Random, depth: int = 0) -> Any:
    """A value of any type, most often a strange one."""
    pick = rng.random()
    if pick < 0.35:
        return rng.choice(NUMBERS)
    if pick < 0.6:
        return rng.choice(TEXTS)
    if pick < 0.7:
        return rng.choice((True, False))
    if pick < 0.75:
        return rng.choice(DATES)
    if depth > 3:
        return 1
    if pick < 0.9:
        return [hostile(rng, depth + 1) for _ in range(rng.choice((0, 1, 1, 2, 2, 3, 16, 17)))]
    return {rng.choice(TEXTS) or "x": hostile(rng, depth + 1) for _ in range(rng.randint(0, 2))}


def plausible(rng: random.Random, allowed: str) -> Any:
    """A value that the documentation of a key may well allow."""
    words = re.findall(r'"([^"]*)"', allowed)
    if words and rng.random() < 0.9:
        return rng.choice(words)
    if allowed.startswith("a table"):
        return rng.choice(({}, True, True, False))
    if "whole" in allowed:
        return rng.choice((1, 2, 2, 3, 4, 5, 16, 80, 255))
    number = rng.choice((0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.01, 0.1, 0.5, 1.0, 2.0, 3, 10.0, 250.0, 1e3, 1e6))
    if "list" in allowed and rng.random() < 0.3:
        return [number] * rng.choice((1, 2, 2, 3))
    return number


def _tables(data: Any, depth: int = 0) -> list[dict[str, Any]]:
    found = []
    if isinstance(data, dict):
        found.append(data)
    if depth < 8:
        inner = list(data.values()) if isinstance(data, dict) else data if isinstance(data, list) else []
        for value in inner[:20]:
            found += _tables(value, depth + 1)
    return found


def _set(data: dict[str, Any], path: Sequence[str], value: Any) -> None:
    here: Any = data
    for part in path[:-1]:
        if not isinstance(here.get(part), dict):
            here[part] = {}
        here = here[part]
    here[path[-1]] = value


def mutate_tree(data: dict[str, Any], rng: random.Random, words: Vocabulary) -> None:
    """Change one thing in the tables of a file."""
    tables = _tables(data)
    table = rng.choice(tables)
    keys = list(table)
    pick = rng.random()
    if pick < 0.6 or not keys:
        path, allowed = rng.choice(words.keys)
        _set(data, path, plausible(rng, allowed) if rng.random() < 0.8 else hostile(rng))
        return
    key = rng.choice(keys)
    if pick < 0.7:
        table[key] = hostile(rng)
    elif pick < 0.75:
        del table[key]
    elif pick < 0.78:
        table[rng.choice((*TEXTS[:40], key + "_", key.upper(), *words.words()))] = table.pop(key)
    elif pick < 0.84:
        table[key] = rng.choice(([table[key]], {"x": table[key]}, {key: table[key]}, [table[key]] * 3))
    elif pick < 0.92:
        value = table[key]
        if isinstance(value, int | float) and not isinstance(value, bool):
            factors: tuple[Any, ...] = (-1, 0, 2, 0.5, 1e3, 1e-3, 1e9, 1e-9, 1e30)
            with_factor = value * rng.choice(factors) if abs(value) < 1e300 else value
            table[key] = rng.choice((with_factor, float(value) if abs(value) < 1e300 else value, str(value)))
        else:
            table[key] = rng.choice((str(value)[:100], [value, value], hostile(rng)))
    else:
        rng.choice(tables)[rng.choice(words.words())] = table[key]


def dump(data: dict[str, Any]) -> bytes | None:
    """The file of some tables; None where they have none, as NaN in a date or a cycle."""
    try:
        return tomli_w.dumps(data).encode("utf-8", "surrogatepass")
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None


def mutate_toml(data: bytes, rng: random.Random, words: Vocabulary) -> bytes:
    """Change a TOML file in its tables, in its lines or in its bytes."""
    if rng.random() < 0.7:
        # The parser itself would take its time and memory over a key of thousands of parts.
        parsed = len(data) < 20_000 and b".a.a.a.a.a.a" not in data
        try:
            tree = tomllib.loads(data.decode()) if parsed else None
        except (ValueError, RecursionError):  # a text that is no TOML is changed as a text
            tree = None
        if tree is not None:
            for _ in range(rng.choice((1, 1, 1, 2, 4))):
                mutate_tree(tree, rng, words)
            written = dump(tree)
            if written is not None:
                return written[:SIZE_MAX]
    return mutate_text(data, rng, [*words.words(), *LINES])


def mutate_text(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    """Change a text in its lines, tokens or bytes; `phrases` are put into it whole."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        data = rng.choice(_TEXT_STEPS)(data, rng, phrases)[:SIZE_MAX]
    return data


def _cut(data: bytes, rng: random.Random) -> int:
    return rng.randint(0, len(data))


def _insert(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    at, what = _cut(data, rng), rng.choice((rng.choice(phrases), rng.choice(TEXTS)))
    return data[:at] + what.encode("utf-8", "surrogatepass") + data[at:]


def _line(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    pick = rng.randrange(4)
    if pick == 0:
        del lines[at]
    elif pick == 1:
        lines.insert(rng.randint(0, len(lines)), lines[at])
    elif pick == 2:
        lines.insert(at, rng.choice(phrases).encode())
    else:
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


def _number(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    found = list(re.finditer(rb"[-+]?\d[\d.e+-]*", data[:20_000]))
    if not found:
        return data
    at = rng.choice(found)
    number = rng.choice(NUMBERS)
    # A number of thousands of digits has no text by default.
    text = str(number) if isinstance(number, float) or abs(number) < 10**1000 else "1" + "0" * 4000
    return data[: at.start()] + text.encode() + data[at.end() :]


def _quoted(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    found = list(re.finditer(rb'"[^"\n]*"', data[:20_000]))
    if not found:
        return data
    at = rng.choice(found)
    return data[: at.start() + 1] + rng.choice(TEXTS).encode() + data[at.end() - 1 :]


def _bytes(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    out = bytearray(data or b" ")
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[rng.randrange(len(out))] = rng.choice(
            (0, 9, 10, 13, 27, 34, 39, 46, 0x7F, 0x80, 0xFF, rng.randrange(256))
        )
    return bytes(out)


def _repeat(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    first, last = sorted((_cut(data, rng), _cut(data, rng)))
    block = data[first:last][: rng.choice((1, 8, 64, 4096))]
    times = min(1 << rng.randint(1, 14), SIZE_MAX // max(1, len(block)) + 1)
    return data[:last] + block * times + data[last:]


def _whole(data: bytes, rng: random.Random, phrases: Sequence[str]) -> bytes:
    return rng.choice(
        (
            lambda: b"\xef\xbb\xbf" + data,
            lambda: data.replace(b"\n", b"\r\n"),
            lambda: data.replace(b"\n", b"\r"),
            lambda: data[: _cut(data, rng)],
            lambda: data[_cut(data, rng) :],
            lambda: data + data,
            lambda: data.decode("utf-8", "replace").encode("utf-16"),
            lambda: data.decode("utf-8", "replace").encode("latin-1", "replace"),
            lambda: data + b"\x00",
            lambda: data.replace(b" ", b"\t"),
            lambda: data.upper(),
        )
    )()


_TEXT_STEPS: tuple[Callable[[bytes, random.Random, Sequence[str]], bytes], ...] = (
    _insert, _insert, _line, _line, _number, _number, _quoted, _bytes, _repeat, _whole,
)  # fmt: skip


def vocabulary(rows: Iterable[tuple[str, str]]) -> Vocabulary:
    """The words of keys as dotted paths with what they allow."""
    return Vocabulary(tuple((tuple(key.split(".")), allowed) for key, allowed in rows))
