# SPDX-License-Identifier: Apache-2.0
"""Liberty as text: write a library from tables, and read one as nested groups."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dermis.errors import InputError
from scripts.liberty.cells import Cell, Sequential

Table = list[list[float]]

MAX_TRANSITION_NS = 1.5


def _number(value: float) -> str:
    return f"{value:.6g}"


@dataclass
class Group:
    """One group of a Liberty file: `kind (name) { attributes, groups }`."""

    kind: str
    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    groups: list[Group] = field(default_factory=list)

    def of(self, kind: str, name: str | None = None) -> list[Group]:
        """Return the groups inside of a kind and, if given, of a name."""
        return [g for g in self.groups if g.kind == kind and (name is None or g.name == name)]

    def one(self, kind: str, name: str | None = None) -> Group:
        """Return the only group of a kind and name."""
        found = self.of(kind, name)
        if len(found) != 1:
            raise KeyError(f"{len(found)} groups {kind} ({name}) in {self.kind} ({self.name})")
        return found[0]

    def numbers(self, attribute: str) -> list[float]:
        """Return the numbers of an attribute such as index_1 or values, in order."""
        return [float(word) for word in re.findall(r"[-+.\deE]+", self.attributes[attribute])]

    def table(self) -> Table:
        """Return the values of a table group, a row for each entry of index_1."""
        values = self.numbers("values")
        rows = len(self.numbers("index_1"))
        width = len(values) // rows
        return [values[i * width : (i + 1) * width] for i in range(rows)]


def _lines(group: Group, indent: int) -> Iterator[str]:
    pad = "  " * indent
    yield f"{pad}{group.kind} ({group.name}) {{"
    for key, value in group.attributes.items():
        if value.startswith("("):
            yield f"{pad}  {key} {value};"
        else:
            yield f"{pad}  {key} : {value};"
    for inner in group.groups:
        yield from _lines(inner, indent + 1)
    yield f"{pad}}}"


def render(library: Group, comment: Sequence[str]) -> str:
    """Return the text of a library with a comment above it."""
    head = ["/*", *[f" * {line}".rstrip() for line in comment], " */"]
    return "\n".join([*head, *_lines(library, 0)]) + "\n"


_TOKEN = re.compile(r'/\*.*?\*/|//[^\n]*|\\\n|\s+|"[^"]*"|[(){};:,]|[^\s(){};:,"]+', re.DOTALL)


def parse(text: str, where: str = "Liberty") -> Group:
    """Read a library.

    Raises
    ------
    InputError
        It is not Liberty, or it ends before its last bracket.
    """
    tokens = [t for t in _TOKEN.findall(text) if not (t.isspace() or t.startswith(("/*", "//", "\\")))]
    position = 0

    def take(expected: str | None = None) -> str:
        nonlocal position
        if position >= len(tokens) or (expected is not None and tokens[position] != expected):
            found = tokens[position] if position < len(tokens) else "the end"
            raise InputError(where, f"token {position}", found, f"{expected or 'more text'}")
        position += 1
        return tokens[position - 1]

    def brackets() -> list[str]:
        take("(")
        inside: list[str] = []
        while (token := take()) != ")":
            inside.append(token)
        return inside

    def group() -> Group:
        kind = take()
        made = Group(kind, "".join(brackets()).strip('"'))
        take("{")
        while tokens[position : position + 1] != ["}"]:
            follows = tokens[position + 1 : position + 2]
            if follows == [":"]:
                key, _ = take(), take()
                words = []
                while (token := take()) != ";":
                    words.append(token)
                made.attributes[key] = " ".join(words)
                continue
            start = position
            key = take()
            inside = brackets()
            if tokens[position : position + 1] == ["{"]:
                position_back(start)
                made.groups.append(group())
            else:
                made.attributes[key] = f"({''.join(inside)})"
                if tokens[position : position + 1] == [";"]:
                    take()
        take("}")
        return made

    def position_back(to: int) -> None:
        nonlocal position
        position = to

    return group()


def _table(kind: str, template: str, rows: Sequence[float], columns: Sequence[float], table: Table) -> Group:
    text = ", ".join(f'"{", ".join(_number(v) for v in row)}"' for row in table)
    index = {"index_1": rows, "index_2": columns}
    attributes = {key: f'("{", ".join(_number(v) for v in axis)}")' for key, axis in index.items() if axis}
    return Group(kind, template, {**attributes, "values": f"({text})"})


def max_capacitance(arcs: Sequence[Mapping[str, Any]]) -> float:
    """Return the load, in pF, at which the slowest edge from the fastest input reaches the longest
    allowed transition.
    """
    best = float("inf")
    for arc in arcs:
        for kind in ("rise_transition", "fall_transition"):
            if kind not in arc["tables"]:
                continue
            loads, row = arc["loads"], arc["tables"][kind][0]
            limit = loads[-1]
            for (c0, t0), (c1, t1) in itertools.pairwise(zip(loads, row, strict=True)):
                if t0 <= MAX_TRANSITION_NS < t1:
                    limit = c0 + (c1 - c0) * (MAX_TRANSITION_NS - t0) / (t1 - t0)
                    break
            best = min(best, limit)
    return best


def _timing(arc: Mapping[str, Any]) -> Group:
    attributes = {"related_pin": f'"{arc["related"]}"'}
    if arc.get("sense"):
        attributes["timing_sense"] = arc["sense"]
    attributes["timing_type"] = arc["type"]
    constraint = "slews_related" in arc
    template = "constraint" if constraint else "delay"
    columns = arc["slews_related"] if constraint else arc["loads"]
    tables = [_table(k, template, arc["slews"], columns, t) for k, t in arc["tables"].items()]
    return Group("timing", "", attributes, tables)


def _storage(how: Sequential) -> Group:
    name = "latch" if how.latch else "ff"
    edge = how.control if how.rising != how.latch else f"(!{how.control})"
    attributes = {"enable" if how.latch else "clocked_on": f'"{edge}"'}
    attributes["data_in" if how.latch else "next_state"] = '"D"'
    if how.clear:
        attributes["clear"] = f'"(!{how.clear})"'
    if how.preset:
        attributes["preset"] = f'"(!{how.preset})"'
    return Group(name, "IQ, IQ_N", attributes)


def cell_group(cell: Cell, area: float, data: Mapping[str, Any]) -> Group:
    """Return the group of a cell.

    Parameters
    ----------
    cell : Cell
    area : in um2
    data : {"capacitance": {pin: pF}, "arcs": [...], "constraints": [...]}
    """
    made = Group("cell", f'"{cell.full_name}"', {"area": _number(area)})
    made.attributes["cell_footprint"] = f'"{cell.full_name.rsplit("_", 1)[0]}"'
    if cell.sequential is not None:
        made.groups.append(_storage(cell.sequential))
    for pin in cell.inputs:
        rise, fall = data["capacitance"][pin]
        attributes = {"direction": "input", "capacitance": _number((rise + fall) / 2)}
        attributes |= {"rise_capacitance": _number(rise), "fall_capacitance": _number(fall)}
        attributes["max_transition"] = _number(MAX_TRANSITION_NS)
        if cell.sequential is not None and pin == cell.sequential.control:
            attributes["clock"] = "true"
        timings = [_timing(arc) for arc in data["constraints"] if arc["pin"] == pin]
        made.groups.append(Group("pin", pin, attributes, timings))
    for pin, function in cell.functions.items():
        arcs = [arc for arc in data["arcs"] if arc["pin"] == pin]
        attributes = {"direction": "output", "function": f'"{function}"'}
        if arcs:
            attributes["max_capacitance"] = _number(max_capacitance(arcs))
            attributes["max_transition"] = _number(MAX_TRANSITION_NS)
        made.groups.append(Group("pin", pin, attributes, [_timing(arc) for arc in arcs]))
    return made


def library_group(
    name: str, process: str, temperature: float, voltage: float, sizes: tuple[int, int, int]
) -> Group:
    """Return a library without cells; sizes: slews, loads, slews of constraint tables."""
    library = Group("library", f'"{name}"')
    library.attributes |= {
        "technology": "(cmos)",
        "delay_model": "table_lookup",
        "time_unit": '"1ns"',
        "voltage_unit": '"1V"',
        "current_unit": '"1mA"',
        "pulling_resistance_unit": '"1kohm"',
        "leakage_power_unit": '"1nW"',
        "capacitive_load_unit": "(1, pf)",
        "nom_process": "1",
        "nom_temperature": _number(temperature),
        "nom_voltage": _number(voltage),
        "in_place_swap_mode": "match_footprint",
    }
    for edge in ("rise", "fall"):
        library.attributes[f"input_threshold_pct_{edge}"] = "50"
        library.attributes[f"output_threshold_pct_{edge}"] = "50"
        library.attributes[f"slew_lower_threshold_pct_{edge}"] = "20"
        library.attributes[f"slew_upper_threshold_pct_{edge}"] = "80"
    library.attributes |= {
        "slew_derate_from_library": "1",
        "default_max_transition": _number(MAX_TRANSITION_NS),
        "default_input_pin_cap": "0",
        "default_output_pin_cap": "0",
        "default_inout_pin_cap": "0",
        "default_fanout_load": "1",
        "default_cell_leakage_power": "0",
        "default_leakage_power_density": "0",
    }
    conditions = {"process": "1", "temperature": _number(temperature), "voltage": _number(voltage)}
    library.groups.append(
        Group("operating_conditions", f'"{process}"', conditions | {"tree_type": '"balanced_tree"'})
    )

    def axis(count: int) -> str:
        return f'("{", ".join(str(i + 1) for i in range(count))}")'

    slews, loads, edges = sizes
    delay = {"variable_1": "input_net_transition", "variable_2": "total_output_net_capacitance"}
    library.groups.append(
        Group("lu_table_template", "delay", delay | {"index_1": axis(slews), "index_2": axis(loads)})
    )
    limit = {"variable_1": "constrained_pin_transition", "variable_2": "related_pin_transition"}
    library.groups.append(
        Group("lu_table_template", "constraint", limit | {"index_1": axis(edges), "index_2": axis(edges)})
    )
    return library
