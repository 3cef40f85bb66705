# SPDX-License-Identifier: Apache-2.0
"""Every key of a scene against every kind of wrong value: what its documentation forbids is refused, by its name."""

from __future__ import annotations

import datetime
import math
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import engines
from dermis import plan as planning
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES

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
    """Whether the documentation of a key allows a value; None where the text alone cannot tell."""
    said = allowed.split(";")[0]
    if said.startswith("a list of at least 2"):
        if not isinstance(value, list) or len(value) < 2:
            return False
        items = [_number(said.removeprefix("a list of at least 2"), v) for v in value]
        return False if False in items else None
    if said.startswith("a list of different"):
        if not isinstance(value, list) or not value:
            return False
        return False if False in [_number("a whole number >= 0", v) for v in value] else None
    if said.startswith("a list of interface.k_options"):
        whole = isinstance(value, list) and all(type(v) is int for v in value)
        return None if whole else False
    said, _, listed = said.partition(", or a list of ")
    if isinstance(value, list) and listed:
        wanted = said if "them" in listed else "a whole number >= 0"
        items = [_number(wanted, v) for v in value]
        return False if not value or False in items else None
    if said.startswith("one of "):
        if '"' in said:
            return value in re.findall(r'"([^"]*)"', said) if isinstance(value, str) else False
        return None if isinstance(value, int) and not isinstance(value, bool) else False
    if re.match(r"an? (finite |whole )?number", said):
        return _number(said, value)
    if said.startswith('"'):
        return value == said.strip('"')
    if said.startswith(("text", "the name", "a name")):
        return None if isinstance(value, str) else False
    if said.startswith("a table"):
        return None if isinstance(value, bool | dict) else False
    if "tables" in said:
        return (
            None if isinstance(value, list) and value and all(isinstance(v, dict) for v in value) else False
        )
    return False if isinstance(value, float) and math.isnan(value) else None


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


def test_the_bases_are_right(directory: Path) -> None:
    assert {kind for _, kind, _, _ in KEYS} == set(BASES)
    for base in BASES.values():
        assert error_of({"array": {"rows": 3, "cols": 2}, "stimulus": base}, directory) is None


def findings(kind: str, path: list[str], allowed: str, directory: Path) -> tuple[int, list[str]]:
    """How many values a key refuses, and where it departs from its documentation."""
    refused, wrong, name = 0, [], ".".join(path)
    for value in VALUES:
        error = error_of(with_value(kind, path, value), directory)
        verdict = legal(allowed, value)
        if verdict is False:
            refused += 1
            if error is None:
                wrong.append(f"takes {value!r}")
            elif error.key != name and not error.key.startswith(name + "."):
                wrong.append(f"{value!r} is told as {error}")
        elif verdict is True and error is not None and error.key == name and error.allowed == allowed:
            wrong.append(f"{value!r} is allowed and refused: {error}")
    return refused, wrong


@pytest.mark.parametrize(("key", "kind", "path", "allowed"), KEYS, ids=[key for key, *_ in KEYS])
def test_a_key_refuses_what_its_documentation_forbids_and_takes_what_it_allows(
    key: str, kind: str, path: list[str], allowed: str, directory: Path
) -> None:
    refused, wrong = findings(kind, path, allowed, directory)
    assert wrong == []
    assert refused >= 10


@pytest.mark.parametrize(
    ("kind", "key", "said"),
    [
        ("tapping", "duty", "a finite number > 0, at most 0.25"),
        ("tapping", "duty", "a finite number > 0, at most 0.25, or a list of them, one a tap"),
        ("indenter", "width", "a finite number > 1"),
        ("indenter", "samples", "a whole number 2..16"),
        ("uniform", "r_ohm", "a finite number >= 0"),
    ],
)
def test_documentation_that_is_too_strict_is_found(kind: str, key: str, said: str, directory: Path) -> None:
    assert findings(kind, ["stimulus", key], said, directory)[1]


def test_a_negative_zero_is_a_zero(directory: Path) -> None:
    data = {
        "array": {"rows": 3, "cols": 2},
        "stimulus": {"kind": "uniform", "r_ohm": [-0.0, 500.0]},
        "effects": {"row_driver": {"r_ohm": -0.0}, "column_input": {"r_ohm": [-0.0, 1.0]}},
    }
    table = scene.from_data(data, directory / "made.toml").table
    zeros = [table.stimulus.r_ohm[0], table.effects.row_driver.r_ohm, table.effects.column_input.r_ohm[0]]
    assert [math.copysign(1.0, zero) for zero in zeros] == [1.0, 1.0, 1.0]


TABLES = sorted({(kind, tuple(path[:-1])) for _, kind, path, _ in KEYS})


@pytest.mark.parametrize(("kind", "table"), TABLES, ids=[f"{k}-{'.'.join(t)}" for k, t in TABLES])
def test_a_key_that_is_not_known_is_named_with_those_that_are(
    kind: str, table: tuple[str, ...], directory: Path
) -> None:
    error = error_of(with_value(kind, [*table, "no_such_key"], 1), directory)
    assert error is not None
    assert error.key == ".".join([*table, "no_such_key"])
    assert error.allowed.startswith("unknown key; known here: ")
    siblings = {path[-1] for _, k, path, _ in KEYS if k == kind and tuple(path[:-1]) == table}
    assert siblings <= set(error.allowed.partition("here: ")[2].split(", "))


def random_scene(rng: random.Random) -> dict[str, Any]:
    """Some stimulus, some topology, up to eight effect keys and two others, with what their documentation allows."""
    kind = rng.choice([k for k in BASES if k not in ("frames", "resistance")])
    data: dict[str, Any] = {
        "array": {"rows": rng.randint(1, 4), "cols": 2},
        "stimulus": dict(BASES[kind]),
        "interface": {"topology": rng.choice(TOPOLOGIES)},
        "sensor": {"law": rng.choice(["inverse", "inverse", "power"])},
    }
    on, other = ([k for k in KEYS if (k[2][0] == "effects") is which] for which in (True, False))
    other = [k for k in other if k[2][-1] not in ("engine", "views", "title")]
    for _, stands_in, path, allowed in rng.sample(on, rng.randint(0, 8)) + rng.sample(
        other, rng.randint(0, 2)
    ):
        here = data
        for part in path[:-1]:
            inner = here.setdefault(part, {})
            here = inner if isinstance(inner, dict) else {}
        if path[0] != "stimulus" or stands_in == kind:
            here[path[-1]] = rng.choice(
                [v for v in VALUES + SIZES if legal(allowed, v) is not False] or [True]
            )
    return data


SIZES = [s * v for v in (1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.9, 10.0, 100.0, 1e6) for s in (1, 1, 1, -1)]


@pytest.mark.parametrize(
    "seed", [*range(10), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(10, 60))]
)
def test_scenes_of_legal_keys_run_or_are_refused(seed: int, directory: Path) -> None:
    """However absurd together: a code for every taxel, or one line; never a traceback, a NaN or an overflow."""
    data = random_scene(random.Random(seed))
    try:
        plan = planning.make(scene.from_data(data, directory / "made.toml"))
        for name in ("closed", "event"):
            if plan.frames <= 5 and not engines.refused(plan, name):
                codes = engines.run(planning.make(plan.scene, name)).codes
                assert codes.shape == plan.resistance_ohm.shape
    except InputError as error:
        refused = str(error)
    except SimulatorError as error:
        refused = str(error)
        assert refused.startswith("array solve: "), "the one limit that only a solve can find"
    else:
        refused = ""
    assert "\n" not in refused


def test_every_key_that_must_be_given_is_asked_for(directory: Path) -> None:
    needed = [(kind, path) for (key, kind, path, _), (_, default, _, _) in zip(KEYS, scene.schema_rows(), strict=True)
              if default == "must be given" and path[0] == "stimulus" and path[-1] != "kind"]  # fmt: skip
    assert len(needed) > 8
    for kind, path in needed:
        data = with_value(kind, path, None)
        del data["stimulus"][path[-1]]
        error = error_of(data, directory)
        assert error is not None
        assert error.key == ".".join(path)


@pytest.mark.parametrize(
    ("data", "key", "both"),
    [
        ({"stimulus": {"kind": "uniform", "code": 1, "r_ohm": 1.0}}, "stimulus", ["code", "r_ohm"]),
        ({"stimulus": {**BASES["indenter"], "total_force_n": 1.0}}, "stimulus", ["force_n", "total_force_n"]),
        ({"stimulus": {**BASES["slip"], "duration_s": 1.0}}, "stimulus", ["frames", "duration_s"]),
        (
            {"stimulus": BASES["uniform"], "sensor": {"r_open_ohm": 1e9}},
            "sensor.r_open_ohm",
            ["law", "inverse"],
        ),
        (
            {"stimulus": BASES["uniform"], "sensor": {"law": "power", "k_force_n_ohm": 1.0}},
            "sensor.k_force_n_ohm",
            ["law", "power"],
        ),
        ({"stimulus": {**BASES["frames"], "key": "codes"}}, "stimulus.key", ["npz"]),
        (
            {
                "stimulus": BASES["uniform"],
                "effects": {
                    "charge_packet": {"packet_error": [0.0, -0.6]},
                    "reference_drift": {"tc_per_k": 0.01, "delta_k": -50},
                },
            },
            "effects.charge_packet and effects.reference_drift",
            ["a packet of -0.1", "above 0 together"],
        ),
    ],
)
def test_keys_that_contradict_each_other_are_named(
    data: dict[str, Any], key: str, both: list[str], directory: Path
) -> None:
    error = error_of({"array": {"rows": 3, "cols": 2}, **data}, directory)
    assert error is not None
    assert error.key == key
    assert all(word in str(error) for word in both)


@pytest.mark.parametrize("kind", sorted(BASES))
def test_each_stimulus_comes_back_from_its_resolved_scene(kind: str, directory: Path) -> None:
    variants: dict[str, list[dict[str, Any]]] = {
        "indenter": [{"angle_deg": 12.5, "samples": 3}, {"t_frame_s": 0.1, "resample": "hold"}],
        "slip": [{"direction_deg": -33.0, "start_s": 1e-3, "center_row": 0.25}],
        "tapping": [{"profile": "square", "duty": 0.3, "force_n": [1, 2]}],
        "ramp": [{"shape": "spherical", "duration_s": 0.0111, "samples": 2}],
        "several": [{"parts": [BASES["slip"], {**BASES["tapping"], "frames": 5}, BASES["ramp"]]}],
        "uniform": [{"t_frame_s": 0.01, "resample": "linear", "code": [1, 200]}],
        "frames": [{"scale": 2.0, "select": [0, 0]}],
        "resistance": [{"select": "last", "t_frame_s": 1.0}],
    }
    for more in [{}, *variants[kind]]:
        for sensor in ({}, {"law": "power", "force_on_n": 0.3}):
            data = {"array": {"rows": 3, "cols": 2}, "stimulus": {**BASES[kind], **more}, "sensor": sensor}
            plan = planning.make(scene.from_data(data, directory / "made.toml"))
            (directory / "resolved.toml").write_text(plan.resolved_toml(directory), encoding="utf-8")
            again = planning.load(directory / "resolved.toml")
            assert (plan.resistance_ohm == again.resistance_ohm).all()
            assert np.array_equal(plan.force_n, again.force_n)
            assert (plan.drive, plan.sensor) == (again.drive, again.sensor)
            assert again.resolved_toml(directory) == plan.resolved_toml(directory)
