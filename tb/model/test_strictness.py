# SPDX-License-Identifier: Apache-2.0
"""Every key of a scene against every kind of wrong value: what its documentation forbids is refused, by its name."""

import datetime
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dermis import plan as planning
from dermis.errors import InputError
from dermis.scene import scene

BODY = {"shape": "flat", "force_n": 1.0}
BASES: dict[str, dict[str, Any]] = {
    "indenter": {"kind": "indenter", **BODY},
    "slip": {"kind": "slip", **BODY, "speed_pitch_per_s": 10.0, "frames": 2},
    "tapping": {"kind": "tapping", **BODY, "frequency_hz": 10.0, "frames": 2},
    "ramp": {"kind": "ramp", "force_n": [0.0, 1.0]},
    "several": {"kind": "several", "parts": [{"kind": "indenter", **BODY}]},
    "uniform": {"kind": "uniform", "code": 3},
    "frames": {"kind": "frames", "file": "frames.csv", "unit": "codes"},
    "resistance": {"kind": "resistance", "file": "frames.csv"},
}

VALUES: list[Any] = [
    "text", "", "inf", True, False, math.nan, math.inf, -math.inf, 0, 1, 2, -1, 3, 255, 256, 10**30, -(10**30),
    10**31, 10**400, 1e30, 1.1e30, 1e-30, 1e-31,
    0.0, -0.0, 0.5, 2.5, -2.5, 5e-324, 1e-12, 1e308, -1e308, [], [1.0], [1.0, 2.0], [2.0, 1.0], [math.nan],
    [1.0, math.nan], [-1.0, 1.0], [1.0, "x"], [1, True], [[1.0, 2.0]], [{}], {}, {"no_such_key": 1},
    datetime.date(2024, 2, 29), datetime.datetime(2024, 2, 29, 1, 2)
]  # fmt: skip

_NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"


def _power(text: str) -> float:
    """255, 1e9, 2^25 or 2^32 - 1."""
    text = text.replace(" - 1", "")
    base, _, exponent = text.partition("^")
    return float(base) ** float(exponent) if exponent else float(text)


def _number(text: str, value: Any) -> bool | None:
    """Whether the text allows this value as a number; None where a limit in it is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    if "whole" in text and not isinstance(value, int):
        return False
    if isinstance(value, int) and abs(value) > 10**30:
        return False
    if math.isnan(value) or (math.isinf(value) and "inf is legal" not in text):
        return False
    # every number of a scene: 0 or of a size from 1e-30 to 1e30
    if value and math.isfinite(value) and not 1e-30 <= abs(value) <= 1e30:
        return False
    for pattern, holds in (
        (rf">= ({_NUMBER})", lambda a: value >= a),
        (rf"> ({_NUMBER})", lambda a: value > a),
        (rf"< ({_NUMBER})", lambda a: value < a),
        (rf"at most ({_NUMBER})", lambda a: value <= a),
        (rf"above ({_NUMBER})", lambda a: value > a),
        (rf"below ({_NUMBER})", lambda a: value < a),
        (rf"from ({_NUMBER}) to", lambda a: value >= a),
        (rf"from {_NUMBER} to ({_NUMBER})", lambda a: value <= a),
        (rf"({_NUMBER})\.\.", lambda a: value >= a),
        (r"\.\.(\d+(?:\.\d+)?(?:\^\d+)?)", lambda a: value <= a),
    ):
        found = re.search(pattern, text)
        if found and not holds(_power(found[1])):
            return False
    return None if re.search(r"below one|above the", text) else True


def legal(allowed: str, value: Any) -> bool | None:
    """Whether the documentation of a key allows a value; None where it speaks of more than one number or word."""
    said, _, listed = allowed.split(";")[0].partition(", or a list of ")
    if listed and isinstance(value, list):
        return None
    if said.startswith("one of ") and '"' in said:
        return isinstance(value, str) and value in re.findall(r'"([^"]*)"', said)
    if re.match(r"an? (finite |whole )?number", said):
        return _number(said, value)
    return None


def documented() -> Iterator[tuple[str, str, list[str], str]]:
    """Every key: as written in the table, the kind of stimulus it stands in, its path in a scene, what is allowed."""
    for key, _, allowed, _ in scene.schema_rows():
        found = re.fullmatch(r"stimulus kind = (\w+)\.(\w+)", key)
        if found:
            yield key, found[1], ["stimulus", found[2]], allowed
        else:
            yield key, "uniform", key.split("."), allowed


KEYS = list(documented())


def with_value(kind: str, path: list[str], value: Any) -> dict[str, Any]:
    """A scene that is right but for this key."""
    data: dict[str, Any] = {"array": {"rows": 3, "cols": 2}, "stimulus": dict(BASES[kind])}
    if path[0] == "sensor" and path[-1] not in ("law", "k_force_n_ohm"):
        data["sensor"] = {"law": "power"}
    here = data
    for part in path[:-1]:
        here = here.setdefault(part, {})
    here[path[-1]] = value
    return data


def error_of(data: dict[str, Any], directory: Path) -> InputError | None:
    """What a scene says; anything but a plan or an InputError of one line is a failure."""
    found = None
    try:
        planning.make(scene.from_data(data, directory / "made.toml"))
    except InputError as error:
        found = error
    assert str(found).isprintable()
    return found


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    (tmp_path / "frames.csv").write_text("1,2\n3,4\n5,6\n")
    return tmp_path


@pytest.mark.parametrize(("key", "kind", "path", "allowed"), KEYS, ids=[key for key, *_ in KEYS])
def test_a_key_refuses_what_its_documentation_forbids_and_takes_what_it_allows(
    key: str, kind: str, path: list[str], allowed: str, directory: Path
) -> None:
    refused, wrong, name = 0, [], ".".join(path)
    for value in VALUES:
        error = error_of(with_value(kind, path, value), directory)
        verdict, mine = legal(allowed, value), error is not None and f"{error.key}.".startswith(f"{name}.")
        refused += mine
        if verdict is False and not mine:
            wrong.append(f"takes {value!r}, or says {error}")
        elif verdict is True and mine and error.key == name and error.allowed == allowed:
            wrong.append(f"{value!r} is allowed and refused: {error}")
    assert wrong == []
    assert refused >= 10


TABLES = sorted({(kind, tuple(path[:-1])) for _, kind, path, _ in KEYS})


@pytest.mark.parametrize(("kind", "table"), TABLES, ids=[f"{k}-{'.'.join(t)}" for k, t in TABLES])
def test_an_unknown_key_is_named_with_known_ones(kind: str, table: tuple[str, ...], directory: Path) -> None:
    error = error_of(with_value(kind, [*table, "no_such_key"], 1), directory)
    assert error is not None
    assert error.key == ".".join([*table, "no_such_key"])
    assert error.allowed.startswith("unknown key; known here: ")
    siblings = {path[-1] for _, k, path, _ in KEYS if k == kind and tuple(path[:-1]) == table}
    assert siblings <= set(error.allowed.partition("here: ")[2].split(", "))


def test_every_key_that_must_be_given_is_asked_for(directory: Path) -> None:
    rows = zip(KEYS, scene.schema_rows(), strict=True)
    needed = [(kind, path) for (_, kind, path, _), (_, default, _, _) in rows if default == "must be given"]
    for kind, path in needed:
        if path[0] == "stimulus" and path[-1] != "kind":
            data = with_value(kind, path, None)
            del data["stimulus"][path[-1]]
            error = error_of(data, directory)
            assert error is not None
            assert error.key == ".".join(path)
    assert len(needed) > 8
