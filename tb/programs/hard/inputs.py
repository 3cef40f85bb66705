# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the input: values that no scene, file or deck may hold are refused by name."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dermis import plan
from dermis.chip.spice_text import array_subckt
from dermis.engines import closed
from dermis.errors import InputError
from dermis.records import Plan
from dermis.scene import scene
from tb.programs.hard.case import Case, Measured


def refused(run: Callable[[], object], key: str) -> Measured:
    """Return 0 if a run ends with an InputError at a key, else 1."""
    try:
        run()
    except InputError as error:
        return Measured(float(key not in error.key), str(error))
    return Measured(1.0, "accepted")


def planned(data: Mapping[str, Any]) -> Plan:
    """Plan a scene of one row with these tables."""
    tables = {"array": {"rows": 1, "cols": 2}, "stimulus": {"kind": "uniform", "code": [5]}, **data}
    return plan.make(scene.from_data(tables, Path("hard.toml")), "event")


def effect(name: str, key: str, *values: float) -> Measured:
    """Return the number of values of an effect that a scene accepts."""
    asked = [
        refused(partial(planned, {"effects": {name: {key: value}}}), f"effects.{name}.{key}")
        for value in values
    ]
    return Measured(sum(one.error or 0.0 for one in asked), asked[0].note)


def narrow_range() -> Measured:
    """Return 0 if limits of the output between which a preset has no room are refused."""
    limits = {"integrator_range": {"v_max_v": 0.3, "v_min_v": -0.3}}
    return refused(partial(planned, {"effects": limits}), "effects.integrator_range")


def every_number() -> Measured:
    """Count the keys of a scene that accept NaN, or an infinity that their table does not allow."""
    through, asked = [], 0
    for key, _, allowed, _ in scene.schema_rows():
        if not any(word in allowed for word in ("number", "one of interface.k_options")):
            continue
        table, _, name = key.rpartition(".")
        kind = table.partition(" kind = ")[2]
        for value in (math.nan, -math.inf, *(() if "inf is legal" in allowed else (math.inf,))):
            given = [value] * 2 if "a list of" in allowed and "or a list" not in allowed else value
            data: Any = {name: given} | ({"kind": kind} if kind else {})
            for part in reversed(table.partition(" ")[0].split(".")):
                data = {part: data}
            asked += 1
            if found := refused(partial(planned, data), name).error:
                through.append(f"{key} = {value}: {found}")
    return Measured(float(len(through)), "; ".join(through[:3]) or f"{asked} values refused")


def resistances() -> Measured:
    """Count the invalid resistances that a list, a csv and an npy file accept; minus zero is a short."""
    through = []
    with tempfile.TemporaryDirectory() as place:
        for value in (math.nan, -math.inf, -1.0, -1e-300):
            ohm = np.array([[500.0, value]])
            np.savetxt(Path(place) / "taxels.csv", ohm, delimiter=",")
            np.save(Path(place) / "taxels.npy", ohm)
            stimuli = [{"kind": "uniform", "r_ohm": ohm[0].tolist()}]
            stimuli += [
                {"kind": "resistance", "file": f"{place}/taxels.{suffix}"} for suffix in ("csv", "npy")
            ]
            through += [f"{s}" for s in stimuli if refused(partial(planned, {"stimulus": s}), "").error]
    short = closed.run(planned({"stimulus": {"kind": "uniform", "r_ohm": [-0.0]}})).codes
    if (short != 255).any():
        through.append(f"minus zero reads {short.ravel().tolist()}")
    return Measured(float(len(through)), "; ".join(through))


def deck() -> Measured:
    """Return 0 if a NaN is refused before a deck is written."""
    return refused(partial(array_subckt, 1, 2, [[math.nan, 1e3]]), "[0, 0]")


_T_CLK_S = 2e-7
_TABLE: Sequence[tuple[str, str, Callable[[], Measured]]] = (
    (
        "every_number_of_a_scene_as_nan_and_infinity",
        "Comparisons with NaN are false, so an inverted range check accepts it.",
        every_number,
    ),
    (
        "resistances_that_are_none",
        "NaN, minus infinity and negative ohm in a list, a csv and an npy file.",
        resistances,
    ),
    ("not_a_number_in_a_deck", "NaN as a resistance must not reach ngspice.", deck),
    (
        "hysteresis_larger_than_a_packet_in_a_scene",
        "A packet does not cross the window: the comparator latches up.",
        partial(effect, "comparator_hysteresis", "v_v", 1.5),
    ),
    (
        "comparator_delay_of_a_clock_and_more",
        "A decision older than a clock needs more memory: a different machine.",
        partial(effect, "comparator_delay", "t_s", _T_CLK_S, 2 * _T_CLK_S, 1.0),
    ),
    (
        "range_smaller_than_a_packet_in_a_scene",
        "Limits closer than the preset: the integrator cannot start where it must.",
        narrow_range,
    ),
    (
        "jitter_of_a_clock_and_more",
        "Clock edges change their order from a tenth of a clock on (ten sigma): packets of negative width.",
        partial(effect, "clock_jitter", "t_s", 3 * _T_CLK_S, _T_CLK_S, 0.10001 * _T_CLK_S),
    ),
)


def cases() -> list[Case]:
    """Return every case of this module."""
    return [
        Case(
            name,
            "input",
            why,
            "an error that names the place",
            {"scene": run},
            source="docs/scenes.md, the table of keys",
            tolerance="none: a value is refused or not",
            unit="accepted",
            short=True,
        )
        for name, why, run in _TABLE
    ]
