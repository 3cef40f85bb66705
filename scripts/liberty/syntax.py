# SPDX-License-Identifier: Apache-2.0
"""Liberty as nested groups: read a library, and write one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from dermis.errors import InputError
from dermis.files import text_of

_TOKEN = re.compile(r'/\*.*?\*/|//[^\n]*|\\\n|\s+|("[^"]*"|[(){};:,]|[^\s(){};:,"]+)', re.DOTALL)


@dataclass
class Group:
    """One group of a Liberty file: `kind (name) { attributes, groups }`."""

    kind: str
    name: str
    where: str = "Liberty"
    attributes: dict[str, str] = field(default_factory=dict)
    groups: list[Group] = field(default_factory=list)

    def of(self, kind: str, name: str | None = None) -> list[Group]:
        """Return the groups inside of a kind and, if given, of a name."""
        return [g for g in self.groups if g.kind == kind and (name is None or g.name == name)]

    def one(self, kind: str, name: str | None = None) -> Group:
        """Return the only group of a kind and name.

        Raises
        ------
        InputError
            There is none, or more than one.
        """
        found = self.of(kind, name)
        if len(found) != 1:
            raise InputError(
                self.where, f"{kind} ({name or ''})", len(found), f"one in {self.kind} ({self.name})"
            )
        return found[0]

    def numbers(self, attribute: str) -> list[float]:
        """Return the numbers of an attribute such as index_1 or values, in order."""
        return [float(word) for word in re.findall(r"[-+.\deE]+", self.attributes[attribute])]

    def table(self) -> list[list[float]]:
        """Return the values of a table group, a row for each entry of index_1."""
        values = self.numbers("values")
        width = len(values) // len(self.numbers("index_1"))
        return [values[i : i + width] for i in range(0, len(values), width)]


def _lines(group: Group, indent: str = "") -> Iterator[str]:
    yield f"{indent}{group.kind} ({group.name}) {{"
    for key, value in group.attributes.items():
        yield f"{indent}  {key} {value};" if value.startswith("(") else f"{indent}  {key} : {value};"
    for inner in group.groups:
        yield from _lines(inner, f"{indent}  ")
    yield f"{indent}}}"


def render(library: Group) -> str:
    """Return the text of a library."""
    return "\n".join(_lines(library)) + "\n"


def read(path: Path) -> Group:
    """Read a Liberty file.

    Raises
    ------
    InputError
        It is not there, it is not Liberty, or it ends before its last bracket.
    """
    return parse(text_of(path, "a Liberty file"), str(path))


def parse(text: str, where: str = "Liberty") -> Group:
    """Read a library; errors as `read`."""
    tokens = [token for token in _TOKEN.findall(text) if token]
    tokens.reverse()

    def take(*expected: str) -> str:
        found = tokens.pop() if tokens else "the end"
        if (expected and found not in expected) or found == "the end":
            raise InputError(
                where, f"{len(tokens)} tokens before its end", found, " or ".join(expected) or "more text"
            )
        return found

    def until(end: str) -> list[str]:
        words = []
        while (word := take()) != end:
            words.append(word)
        return words

    def inside(group: Group) -> Group:
        while (key := take()) != "}":
            if take(":", "(") == ":":
                group.attributes[key] = " ".join(until(";"))
                continue
            words = "".join(until(")"))
            if tokens[-1:] == ["{"]:
                take()
                group.groups.append(inside(Group(key, words.strip('"'), where)))
            else:
                group.attributes[key] = f"({words})"
                if tokens[-1:] == [";"]:
                    take()
        return group

    kind, _ = take(), take("(")
    library = Group(kind, "".join(until(")")).strip('"'), where)
    take("{")
    return inside(library)
