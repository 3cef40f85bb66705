# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies of hostile input: TOML tables, text, bytes, values at the edges of types."""

import contextlib
import datetime
import math
import re
import tomllib
from collections.abc import Sequence
from typing import Any

import tomli_w
from hypothesis import strategies as st

SIZE_MAX = 1 << 15  # bytes of an input
TEXTS = (
    "", " ", "\n", "\r", "\x00", "\x1b[31mred", "\x7f", "\x85", "\u2028", "\u202eltr", "\ufeff", "\u00e9", "\U0001f9a0",
    "\n.control\nshell touch fuzz_was_here\n.endc\n", ".include /etc/passwd", "*\n.control\nquit\n.endc",
    "$(touch fuzz_was_here)", "`touch fuzz_was_here`", "' touch '", "%s%n%x", "{0.__class__}", "~", "..", ".", "/",
    "../../../../etc/passwd", "/dev/zero", "/dev/stdin", "/proc/self/mem", "frames.csv\x00.npy", "-", "--out", "-h",
    "a" * 300, "a" * 5000, "\\", "'''", '"""', "#", "[x]", "x = 1", "inf", "nan", "1e400", "0x10", "None", "true",
    "frames.csv", "frames.npy", "frames.npz", "pickled.npy", "link.csv", "pipe.csv", "directory.csv", "codes",
)  # fmt: skip
"""Text with a meaning to a shell, to ngspice, to a file system, to a terminal or to a parser."""

NUMBERS: tuple[Any, ...] = (
    0, 1, -1, 2, 3, 16, 255, 256, 65535, 65536, 2**25, 2**25 + 1, 2**31, 2**32, 2**53 + 1, 2**63, 2**64, 10**30,
    10**31, 10**308, 10**400, 10**4000, 0.0, -0.0, 0.5, 1e-3, 1e-30, 1e-31, 5e-324, 1e30, 1.1e30,
    1.7976931348623157e308, -1e308, math.inf, -math.inf, math.nan, 1.0000000000000002, 510.0, -273.15, 360.1,
)  # fmt: skip
"""Numbers at the edges of types, of the sizes that a scene accepts, and beyond."""

LINES = (
    "[array]\nrows = 1000000\ncols = 1000000", "frames = 1000000000", "a" + ".a" * 3000 + " = 1",
    "[" + ".".join("abc" * 300) + "]", "x = " + "[" * 3000, "x = " + "{a = " * 800 + "1" + "}" * 800,
    "x = 1979-13-45", "x = " + "9" * 5000, "x = 1" + "0" * 400 + ".0", "x = 0x" + "f" * 3000, "[[stimulus]]",
    "[effects]", "'' = 1", '"\\u0000" = 1', '"a\\nb" = 1', "x = '''\n.control\n'''", "stimulus = 1", "=", "]", "'''",
    "force_n = [" + "1," * 2000 + "1]", "effects.lateral = true",
)  # fmt: skip
"""Lines that a scene may not hold, or not twice."""

_PLAUSIBLE = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.01, 0.1, 0.5, 1.0, 2.0, 3, 10.0, 250.0, 1e3, 1e6)
_REMOVED = object()

texts = st.sampled_from(TEXTS) | st.text(max_size=8)
values = st.recursive(
    st.sampled_from(NUMBERS) | st.floats() | st.integers(-(2**64), 2**64) | texts | st.booleans()
    | st.sampled_from((datetime.date(2024, 2, 29), datetime.time(23, 59, 59))),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=2),
    max_leaves=5,
)  # fmt: skip
Words = Sequence[tuple[Sequence[str], str]]
"""Keys of a TOML file as paths, each with the values that its documentation allows."""


def _plausible(allowed: str) -> st.SearchStrategy[Any]:
    """Return values that the documentation of a key may allow."""
    if named := re.findall(r'"([^"]*)"', allowed):
        return st.sampled_from(named)
    if allowed.startswith("a table"):
        return st.sampled_from(({}, True, False))
    if "whole" in allowed:
        return st.sampled_from((1, 2, 3, 4, 5, 16, 80, 255))
    number = st.sampled_from(_PLAUSIBLE)
    return number | st.lists(number, min_size=1, max_size=3) if "list" in allowed else number


def _put(tree: dict[str, Any], path: Sequence[str], value: Any) -> None:
    """Set a key, or remove it; what stands in the way of its table goes."""
    for part in path[:-1]:
        if not isinstance(tree.get(part), dict):
            tree[part] = {}
        tree = tree[part]
    tree[path[-1]] = value
    if value is _REMOVED:
        del tree[path[-1]]


def encoded(text: str) -> bytes:
    """Return the bytes of a text that may hold lone surrogates."""
    return text.encode("utf-8", "surrogatepass")


@st.composite
def edited(draw: st.DrawFn, data: bytes, phrases: Sequence[str]) -> bytes:
    """Draw a text with some pieces replaced, repeated or cut, rarely in another encoding."""
    pieces = st.sampled_from(phrases).map(encoded) | texts.map(encoded) | st.binary(max_size=2)
    for _ in range(draw(st.sampled_from((0, 1, 1, 2, 4)))):
        at = draw(st.integers(0, len(data)))
        end = at + draw(st.sampled_from((0, 0, 0, 1, 2, 16, SIZE_MAX)))
        times = draw(st.sampled_from((1,) * 9 + (8, 100, 3000)))
        data = (data[:at] + draw(pieces) * times + data[end:])[:SIZE_MAX]
    whole = draw(st.sampled_from(("",) * 20 + ("utf-16", "utf-8-sig", "latin-1")))
    return data.decode("utf-8", "replace").encode(whole, "replace") if whole else data


@st.composite
def toml(draw: st.DrawFn, bases: Sequence[bytes], known: Words) -> bytes:
    """Draw a TOML file: a known one with entries set or removed, or with its text edited."""
    data = draw(st.sampled_from(bases))
    # An edit that the TOML library refuses leaves the text as it was.
    with contextlib.suppress(ValueError, TypeError, AttributeError, RecursionError):
        # The parser takes seconds for a key of thousands of parts; a value may be none of TOML.
        tree = {} if b".a.a.a" in data else tomllib.loads(data.decode())
        for _ in range(draw(st.sampled_from((0, 1, 1, 2, 4))) if tree else 0):
            path, allowed = draw(st.sampled_from(known))
            if draw(st.integers(0, 9)) == 0:
                path = [*path[:-1], draw(texts)]
            _put(tree, path, draw(st.one_of(_plausible(allowed), values, st.just(_REMOVED))))
        data = encoded(tomli_w.dumps(tree))[:SIZE_MAX] if tree else data
    if draw(st.integers(0, 3)):
        return data
    return draw(edited(data, [*LINES, *(path[-1] for path, _ in known[:60])]))
