# SPDX-License-Identifier: Apache-2.0
"""Every non-ideality that a scene may switch on, and the record fields of those that are on.

One file a family holds its effects: parameters, fields, bounds and words. To add an effect is one
entry there; engines and decks read the record fields and need nothing else.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, create_model

from dermis import bounds as bounds
from dermis.effects import array, comparator, integrator, lines, mirror, motion, noise, packet, sheet
from dermis.effects.effect import Contribution, Effect, Setting
from dermis.errors import InputError
from dermis.scene.schema import Strict, entry, filled, refuse

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for family in (array, lines, mirror, integrator, comparator, packet, noise, motion, sheet)
    for effect in family.EFFECTS
}


class AutoTable(Strict):
    """[effects] auto: every effect is on, and only cells that stay open are walked."""

    budget_lsb: float = entry(
        0.0,
        "Error of a level that decides a cell without a walk, in LSB; 0 gives the codes of everything on",
        ge=0,
    )


class ExtractedTable(Strict):
    """[effects] extracted: what was measured of the chip in transistors, as the effects it amounts to."""

    corner: Literal["tt", "ff", "ss", "sf", "fs"] = entry("tt", "Corner of the process")
    temperature_c: Annotated[float, Field(allow_inf_nan=False)] = entry(
        27.0,
        "Temperature of the chip, in degrees Celsius",
        "a finite number; models/extracted has a file for it",
    )


# [effects]: one optional table an effect. true is the effect with its defaults, false is off, as is
# leaving it out; auto switches on what is left out too.
EffectsTable: type[Strict] = create_model(
    "EffectsTable",
    __base__=Strict,
    __doc__="What departs from the ideal; what is not named is off.",
    auto=(
        AutoTable | None,
        entry(
            None,
            "Every effect with defaults is on, named or not; cells whose code no effect can change are not "
            "walked (docs/auto.md)",
            "a table",
        ),
    ),
    extracted=(
        ExtractedTable | None,
        entry(
            None,
            "The effects that the chip in transistors has, with the values measured of it (docs/equivalence.md); none "
            "of them may be named beside it, but false leaves one out",
            "a table",
        ),
    ),
    **{
        e.name: (
            e.table | bool | None,
            entry(None, e.meaning, "a table of its parameters, true (its defaults) or false (off)"),
        )
        for e in EFFECTS.values()
    },
)


def considered(effect: Effect, setting: Setting) -> bool:
    """Return True if auto considers the effect unnamed: the topology has it, and its parameters have defaults."""
    if not effect.considered or setting.topology not in effect.topologies:
        return False
    filled = effect.table().model_dump() | effect.defaults(setting.design, setting.topology)
    return None not in filled.values()


def resolve_effects(table: Any, setting: Setting, file: Any) -> dict[str, Strict]:
    """Return the parameters of every effect that is on, with every default filled in.

    With `auto` that is every effect that it switches on; cells are left out later (docs/auto.md).
    Raises InputError for an effect the topology does not have, a value without default, lists of a
    wrong length and values outside what the physics allows.
    """
    on: dict[str, Strict] = {}
    for effect in EFFECTS.values():
        given = getattr(table, effect.name)
        if given is None and table.auto is not None and considered(effect, setting):
            given = True
        if given is None or given is False:
            continue
        key = f"effects.{effect.name}"
        if setting.topology not in effect.topologies:
            allowed = "off, or topology " + ", ".join(effect.topologies)
            raise InputError(file, key, f"on with topology {setting.topology}", allowed)
        parameters = effect.table() if given is True else given
        defaults = effect.defaults(setting.design, setting.topology)
        for follower, other in effect.follows.items():
            if (value := getattr(parameters, other)) is not None:
                defaults[follower] = value
        parameters = filled(parameters, defaults)
        refuse(_wrong(effect, parameters, setting), parameters, file, f"{key}.")
        on[effect.name] = parameters
    return on


def _wrong(effect: Effect, parameters: Strict, setting: Setting) -> Iterator[tuple[str, str]]:
    """Yield parameters with impossible values, and what is allowed."""
    for name in effect.parameters:
        value = getattr(parameters, name)
        if value is None:
            yield name, "a value; this topology has no default for it"
        if isinstance(value, list) and len(value) != setting.cols:
            yield name, f"a number or a list of {setting.cols}, one a column"
    yield from effect.wrong(parameters, setting)


def check_together(on: Mapping[str, Strict], topology: str, packet_v: float, file: Any) -> None:
    """Refuse effects that contradict each other, naming both.

    Raises InputError where the levels of the comparator or the preset lie outside the range of the
    integrator (it would never answer, or answer for ever), where hysteresis reaches the preset, and
    where errors of the packet leave none together.
    """

    def values(name: str, key: str) -> list[float]:
        value = getattr(on[name], key) if name in on else 0.0
        return value if isinstance(value, list) else [value]

    def contradict(names: list[str], value: Any, allowed: str) -> None:
        raise InputError(file, " and ".join(f"effects.{n}" for n in names), value, allowed)

    (window,) = values("comparator_hysteresis", "v_v")
    if window >= packet_v * (1 - 1e-9):
        # A window that reaches the preset would carry the state of the row before over to the next.
        contradict(["comparator_hysteresis.v_v"], window, f"below one packet ({packet_v:g} V)")
    drift = on.get("reference_drift")
    if drift is not None and "charge_packet" in on:
        packet = 1.0 + min(values("charge_packet", "packet_error")) + drift.tc_per_k * drift.delta_k
        if packet <= 0:
            both = ["charge_packet", "reference_drift"]
            contradict(both, f"a packet of {packet:g}", "a packet above 0 together")
    if "integrator_range" not in on:
        return
    low, high = on["integrator_range"].v_min_v, on["integrator_range"].v_max_v
    if topology != "conveyor_mirror_inverted":  # stored charge drives the output down
        low, high = -high, -low
    offsets, presets = values("comparator_offset", "v_v"), values("preset_error", "v_v")
    levels = [("comparator_offset", v, window / 2) for v in offsets]
    levels += [("preset_error", v - packet_v / 2, 0.0) for v in presets]
    for name, v, room in levels:
        if not low < v - room <= v + room < high:
            names = ["integrator_range", *[name] * (name in on), *["comparator_hysteresis"] * (room > 0)]
            where = f"a level of {v:g} V of stored charge, outside {low:g} .. {high:g} V"
            contradict(names, where, "levels inside the range of the integrator")


def gather(on: Mapping[str, Strict], setting: Setting) -> Contribution:
    """Collect the record fields of all effects that are on; values of several effects add up."""
    total = Contribution({}, {}, {}, {})
    for name, parameters in on.items():
        for into, added in zip(total, EFFECTS[name].contribute(parameters, setting), strict=True):
            for key, value in added.items():
                into[key] = np.add(into[key], value) if key in into else value
    return total
