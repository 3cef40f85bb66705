# SPDX-License-Identifier: Apache-2.0
"""Every non-ideality a scene may switch on: its meaning, its parameters and the record fields it sets.

To add one: a table of parameters, a function from them to record fields, one entry in EFFECTS. Engines and
decks read the record fields and need nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field, create_model

from dermis.design import TOPOLOGIES, Design
from dermis.design import load as load_design
from dermis.errors import InputError
from dermis.schema import Strict, entry

_Number = Annotated[float, Field(allow_inf_nan=False)]
PerColumn = _Number | Annotated[list[_Number], Field(min_length=1)]
_PER_COLUMN = "a finite number, or a list of them, one a column"
_OHM = "a finite number >= 0"


@dataclass(frozen=True)
class Setting:
    """What an effect may look at besides its own parameters."""

    cols: int
    topology: str
    k: float
    design: Design
    rng: Callable[
        [str], np.random.Generator
    ]  # by effect name: adding an effect moves no other effect's numbers


@dataclass(frozen=True)
class Contribution:
    """Record fields an effect sets."""

    network: Mapping[str, Any] = field(default_factory=dict)
    converter: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """One non-ideality.

    Attributes
    ----------
    name, meaning : str
        The word used in TOML, Python, Verilog and SPICE, and one line on what it is.
    table : type
        Its parameters, pydantic; None marks a default that comes from `defaults`.
    defaults : callable
        (design, topology) -> physical defaults, used when the effect is named without a value. A missing one
        must be given.
    contribute : callable
        (parameters, setting) -> Contribution.
    topologies : tuple of str
        Where it exists.
    """

    name: str
    meaning: str
    table: type[Strict]
    defaults: Callable[[Design, str], dict[str, Any]]
    contribute: Callable[[Any, Setting], Contribution]
    topologies: tuple[str, ...] = TOPOLOGIES


class _Lateral(Strict):
    r_ohm: float | None = entry(
        None,
        "One resistor between the inner electrodes of every two neighbouring taxels, in ohm",
        "a finite number > 0",
        default_from="array.r_lateral_ohm",
        gt=0,
    )


class _RowDriver(Strict):
    r_ohm: float | None = entry(
        None, "In series with the driven row, in ohm", _OHM, default_from="row_driver.r_on_ohm", ge=0
    )
    grounded_r_ohm: Annotated[float, Field(ge=0, allow_inf_nan=True)] | None = entry(
        None,
        "In series with every grounded row, in ohm; inf leaves them floating",
        "a number >= 0 (inf is legal)",
        default_from="r_ohm, or row_driver.r_ground_ohm when r_ohm is left out too",
    )


class _ColumnInput(Strict):
    r_ohm: PerColumn | None = entry(
        None,
        "Between every column and its virtual ground, in ohm",
        "a finite number >= 0, or a list of them, one a column",
        default_from="conveyor.r_x_ohm (topology direct: must be given)",
    )


class _ColumnOffset(Strict):
    v_v: PerColumn | None = entry(
        None,
        "Voltage of the virtual ground, in V",
        _PER_COLUMN,
        default_from="conveyor.v_offset_v (topology direct: integrator.v_offset_v)",
    )


class _MirrorRatio(Strict):
    ratio_error: PerColumn | None = entry(
        None, "Relative error of the current delivered", _PER_COLUMN, default_from="mirror.ratio_error"
    )
    spread: float = entry(
        0.0,
        "Standard deviation of a further relative error, drawn for each column",
        "a finite number 0..1",
        ge=0,
        le=1,
    )


class _OffsetCurrent(Strict):
    i_a: PerColumn = entry(
        1e-9, "Adds to the current into the converter, after the mirror, in A", _PER_COLUMN
    )


class _IntegratorGain(Strict):
    gain_dc: float | None = entry(
        None,
        "Open-loop gain of the integrator",
        "a finite number >= 1",
        default_from="integrator.gain_dc",
        ge=1,
    )
    r_in_ohm: float | None = entry(
        None,
        "Across the integrator's input, in ohm",
        "a finite number > 0",
        default_from="integrator.r_in_ohm",
        gt=0,
    )


class _IntegratorRange(Strict):
    v_max_v: float | None = entry(
        None,
        "Highest output of the integrator, in V",
        "a finite number > 0",
        default_from="integrator.v_out_max_v",
        gt=0,
    )
    v_min_v: float | None = entry(
        None,
        "Lowest output of the integrator, in V",
        "a finite number < 0",
        default_from="integrator.v_out_min_v",
        lt=0,
    )


class _ComparatorOffset(Strict):
    v_v: PerColumn | None = entry(
        None,
        "Decision level, in V of the integrator; plus needs more charge",
        _PER_COLUMN,
        default_from="comparator.v_offset_v",
    )


class _ComparatorHysteresis(Strict):
    v_v: float | None = entry(
        None,
        "Full width of the window around the decision level, in V",
        "a finite number >= 0, below one packet",
        default_from="comparator.v_hysteresis_v",
        ge=0,
    )


class _ComparatorDelay(Strict):
    t_s: float | None = entry(
        None,
        "From crossing to output, in s",
        "a finite number >= 0, below one clock",
        default_from="comparator.t_delay_s",
        ge=0,
    )


class _ChargePacket(Strict):
    packet_error: PerColumn | None = entry(
        None, "Relative error of every packet", _PER_COLUMN, default_from="charge.packet_error"
    )


class _PresetError(Strict):
    v_v: PerColumn = entry(
        1e-3, "Error of the preset, in V of the integrator; plus is more charge", _PER_COLUMN
    )


def _lateral(p: _Lateral, _: Setting) -> Contribution:
    return Contribution({"g_lateral_row_s": 1.0 / p.r_ohm, "g_lateral_column_s": 1.0 / p.r_ohm})


def _row_driver(p: _RowDriver, _: Setting) -> Contribution:
    return Contribution({"r_row_driven_ohm": p.r_ohm, "r_row_grounded_ohm": p.grounded_r_ohm})


def _row_driver_defaults(design: Design, _: str) -> dict[str, Any]:
    return {"r_ohm": design.row_driver.r_on_ohm, "grounded_r_ohm": design.row_driver.r_ground_ohm}


def _mirror_ratio(p: _MirrorRatio, setting: Setting) -> Contribution:
    gain = 1.0 + np.asarray(p.ratio_error, dtype=float)
    if p.spread:
        gain = gain * (1.0 + p.spread * setting.rng("mirror_ratio").standard_normal(setting.cols))
    return Contribution(converter={"gain": gain})


_MIRRORED = tuple(t for t in TOPOLOGIES if t != "direct")

EFFECTS: dict[str, Effect] = {
    e.name: e
    for e in (
        Effect(
            "lateral",
            "the sheet conducts sideways: resistors between neighbouring taxels, both ways",
            _Lateral,
            lambda d, t: {"r_ohm": d.array.r_lateral_ohm},
            _lateral,
        ),
        Effect(
            "row_driver",
            "on-resistance of the row drivers: the driven row droops, the grounded rows lift",
            _RowDriver,
            _row_driver_defaults,
            _row_driver,
        ),
        Effect(
            "column_input",
            "input resistance of the columns: the virtual ground gives way",
            _ColumnInput,
            lambda d, t: {} if t == "direct" else {"r_ohm": d.conveyor.r_x_ohm},
            lambda p, s: Contribution({"r_column_ohm": p.r_ohm}),
        ),
        Effect(
            "column_offset",
            "offset of the virtual ground: every taxel of the column adds its share",
            _ColumnOffset,
            lambda d, t: {"v_v": d.integrator.v_offset_v if t == "direct" else d.conveyor.v_offset_v},
            lambda p, s: Contribution({"v_column_offset_v": p.v_v}),
        ),
        Effect(
            "mirror_ratio",
            "ratio error of the k:1 mirror, systematic and from column to column",
            _MirrorRatio,
            lambda d, t: {"ratio_error": d.mirror.ratio_error},
            _mirror_ratio,
            _MIRRORED,
        ),
        Effect(
            "offset_current",
            "a constant current into every converter",
            _OffsetCurrent,
            lambda d, t: {},
            lambda p, s: Contribution(converter={"i_offset_a": p.i_a}),
        ),
        Effect(
            "integrator_gain",
            "finite gain: the input gives way and leaks through what hangs on it (direct: the whole column)",
            _IntegratorGain,
            lambda d, t: {"gain_dc": d.integrator.gain_dc, "r_in_ohm": d.integrator.r_in_ohm},
            lambda p, s: Contribution(converter={"inv_gain_dc": 1.0 / p.gain_dc, "g_in_s": 1.0 / p.r_in_ohm}),
        ),
        Effect(
            "integrator_range",
            "the output of the integrator stops at its limits, and charge beyond them is lost",
            _IntegratorRange,
            lambda d, t: {"v_max_v": d.integrator.v_out_max_v, "v_min_v": d.integrator.v_out_min_v},
            lambda p, s: Contribution(converter={"v_int_max_v": p.v_max_v, "v_int_min_v": p.v_min_v}),
        ),
        Effect(
            "comparator_offset",
            "offset of the decision level",
            _ComparatorOffset,
            lambda d, t: {"v_v": d.comparator.v_offset_v},
            lambda p, s: Contribution(converter={"v_comp_offset_v": p.v_v}),
        ),
        Effect(
            "comparator_hysteresis",
            "the comparator answers only half a window past its level",
            _ComparatorHysteresis,
            lambda d, t: {"v_v": d.comparator.v_hysteresis_v},
            lambda p, s: Contribution(converter={"v_hysteresis_v": p.v_v}),
        ),
        Effect(
            "comparator_delay",
            "the synchronizer samples what the comparator saw a while ago",
            _ComparatorDelay,
            lambda d, t: {"t_s": d.comparator.t_delay_s},
            lambda p, s: Contribution(converter={"t_comp_delay_s": p.t_s}),
        ),
        Effect(
            "charge_packet",
            "every packet is too large or too small",
            _ChargePacket,
            lambda d, t: {"packet_error": d.charge.packet_error},
            lambda p, s: Contribution(converter={"packet_error": p.packet_error}),
        ),
        Effect(
            "preset_error",
            "the preset misses half a packet",
            _PresetError,
            lambda d, t: {},
            lambda p, s: Contribution(converter={"preset_error_v": p.v_v}),
        ),
    )
}

# [effects]: one optional table an effect. true is the effect with its defaults, false is off, as is leaving
# it out.
EffectsTable: type[Strict] = create_model(
    "EffectsTable",
    __base__=Strict,
    __doc__="What departs from the ideal; what is not named is off.",
    **{
        e.name: (
            e.table | bool | None,
            entry(None, e.meaning, "a table of its parameters, true (its defaults) or false (off)"),
        )
        for e in EFFECTS.values()
    },
)


def resolve_effects(table: Any, setting: Setting, file: Any) -> dict[str, Strict]:
    """Return the parameters of every effect that is on, with every default filled in.

    Raises InputError for an effect the topology does not have, a value without default, lists of a wrong
    length and values outside what the physics allows.
    """
    on: dict[str, Strict] = {}
    for effect in EFFECTS.values():
        given = getattr(table, effect.name)
        if given is None or given is False:
            continue
        key = f"effects.{effect.name}"
        if setting.topology not in effect.topologies:
            raise InputError(
                file,
                key,
                f"on with topology {setting.topology}",
                "off, or topology " + ", ".join(effect.topologies),
            )
        parameters = effect.table() if given is True else given
        defaults = effect.defaults(setting.design, setting.topology)
        if effect.name == "row_driver" and parameters.r_ohm is not None:
            defaults["grounded_r_ohm"] = parameters.r_ohm
        missing = {k: v for k, v in defaults.items() if getattr(parameters, k) is None}
        parameters = parameters.model_copy(update=missing)
        for name in type(parameters).model_fields:
            value = getattr(parameters, name)
            if value is None:
                raise InputError(
                    file, f"{key}.{name}", "nothing", "a value; this topology has no default for it"
                )
            _check(effect, name, value, setting, file)
        on[effect.name] = parameters
    return on


# What is impossible rather than bad: a negative resistance, a packet or a mirror that turns its sign.
_LOWEST = {("column_input", "r_ohm"): (0.0, True), ("mirror_ratio", "ratio_error"): (-1.0, False),
           ("charge_packet", "packet_error"): (-1.0, False)}  # fmt: skip


def _check(effect: Effect, name: str, value: Any, setting: Setting, file: Any) -> None:
    key = f"effects.{effect.name}.{name}"
    if isinstance(value, list) and len(value) != setting.cols:
        raise InputError(
            file, key, f"a list of {len(value)}", f"a number or a list of {setting.cols}, one a column"
        )
    low = _LOWEST.get((effect.name, name))
    if low is not None:
        bound, closed = low
        for v in value if isinstance(value, list) else [value]:
            if v < bound or (v == bound and not closed):
                raise InputError(file, key, v, f"a number {'>=' if closed else '>'} {bound:g}")
    if effect.name == "comparator_delay" and value >= 1.0 / setting.design.converter.f_clk_hz:
        raise InputError(file, key, value, f"below one clock ({1.0 / setting.design.converter.f_clk_hz:g} s)")


def gather(on: Mapping[str, Strict], setting: Setting) -> Contribution:
    """Collect what the effects that are on write; no two may write the same field."""
    network: dict[str, Any] = {}
    converter: dict[str, Any] = {}
    for name, parameters in on.items():
        part = EFFECTS[name].contribute(parameters, setting)
        for into, fields in ((network, part.network), (converter, part.converter)):
            for key, value in fields.items():
                if key in into:
                    raise ValueError(f"{name} and another effect both set {key}")
                into[key] = value
    return Contribution(network, converter)


def effects_table() -> str:
    """Every effect as a Markdown table: name, meaning, what it writes; docs/scenes.md holds it."""
    design = load_design()
    lines = ["| effect | what it is | record fields it writes |", "|---|---|---|"]
    for effect in EFFECTS.values():
        topology = effect.topologies[0] if "direct" not in effect.topologies else "conveyor_mirror"
        setting = Setting(design.array.cols, topology, design.interface.k, design, _no_rng)
        on = resolve_effects(EffectsTable(**{effect.name: True}), setting, "defaults")
        part = effect.contribute(on[effect.name], setting)
        fields = [f"Network.{f}" for f in part.network] + [f"Converter.{f}" for f in part.converter]
        only = "" if effect.topologies == TOPOLOGIES else f" (not for {', '.join(_missing(effect))})"
        lines.append(f"| `{effect.name}` | {effect.meaning}{only} | {', '.join(f'`{f}`' for f in fields)} |")
    return "\n".join(lines) + "\n"


def _missing(effect: Effect) -> list[str]:
    return [t for t in TOPOLOGIES if t not in effect.topologies]


def _no_rng(name: str) -> np.random.Generator:
    raise AssertionError(f"{name}: the defaults draw no random number")
