# SPDX-License-Identifier: Apache-2.0
"""Every non-ideality that a scene may switch on: its meaning, its parameters and the record fields
that it sets.

To add one: a table of parameters, a function from them to record fields, one entry in EFFECTS.
Engines and decks read the record fields and need nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, create_model

from dermis import bounds
from dermis.errors import InputError
from dermis.scene.design import ABSOLUTE_ZERO_C, ELECTRON_C, K_BOLTZMANN_J_PER_K, TOPOLOGIES, Design
from dermis.scene.schema import Strict, entry

_Number = Annotated[float, Field(allow_inf_nan=False)]
PerColumn = _Number | Annotated[list[_Number], Field(min_length=1)]
_PER_COLUMN = "a finite number, or a list of them, one a column"
_OHM = _FARAD = _RMS = "a finite number >= 0"
_FINITE = "a finite number"
_POSITIVE = "a finite number > 0"
_CELSIUS = "a finite number above -273.15"
# Of a factor 1 + sigma n: six sigma below one must leave something.
_SMALL = "a finite number 0..0.1"


@dataclass(frozen=True)
class Setting:
    """The part of a scene that an effect may read besides its own parameters."""

    cols: int
    topology: str
    k: float
    c_int_f: float  # of the integrator, k times larger where nothing divides the current
    design: Design
    rng: Callable[
        [str], np.random.Generator
    ]  # by effect name: adding an effect moves no other effect's numbers

    @classmethod
    def of(cls, table: Any, design: Design, rng: Callable[[str], np.random.Generator]) -> Setting:
        """The setting of a scene's resolved tables."""
        interface = table.interface
        c_int_f = interface.c_int_f * (interface.k if interface.topology == "direct" else 1)
        return cls(table.array.cols, interface.topology, interface.k, c_int_f, design, rng)


class Contribution(NamedTuple):
    """Record fields an effect sets."""

    network: Mapping[str, Any] = MappingProxyType({})
    converter: Mapping[str, Any] = MappingProxyType({})
    drive: Mapping[str, Any] = MappingProxyType({})
    sensor: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Effect:
    """One non-ideality.

    Attributes
    ----------
    name, meaning : str
        The word used in TOML, Python, Verilog and SPICE, and its meaning in one line.
    table : type
        Its parameters, pydantic; None marks a default that comes from `defaults`.
    defaults : callable
        (design, topology) -> physical defaults, used when the effect is named without a value. A missing one
        must be given.
    contribute : callable
        (parameters, setting) -> Contribution.
    topologies : tuple of str
        Where it exists.
    random : bool
        True if it draws random numbers during conversion; its bound then has a stated confidence.
    bound : bounds.Bounding
        How far it moves decisions that engine closed made without it.
    considered : bool
        True if auto considers it without its being named; False for effects that change the scene itself.
    needs : mapping
        Effects and parameters that must be on as well, or this one moves no code.
    examples : mapping
        By topology: parameters that take the place of those of `example`.

    The parameters of the table carry the rest: meaning, allowed values, example and range
    (schema.entry).
    """

    name: str
    meaning: str
    table: type[Strict]
    defaults: Callable[[Design, str], dict[str, Any]]
    contribute: Callable[[Any, Setting], Contribution]
    topologies: tuple[str, ...] = TOPOLOGIES
    random: bool = False
    bound: bounds.Bounding = bounds.unknown
    considered: bool = True
    needs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    examples: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def example(self, topology: str = "conveyor_mirror") -> dict[str, Any]:
        """Return parameters that move codes, alone (with `needs`) and among the examples of all
        effects.
        """
        fields = self.table.model_fields
        return {name: fields[name].json_schema_extra["example"] for name in fields} | dict(  # type: ignore[index]
            self.examples.get(topology, {})
        )

    def range(self) -> dict[str, tuple[float, float]]:
        """Return the smallest and the largest magnitude of each parameter in random scenes."""
        fields = self.table.model_fields
        return {name: fields[name].json_schema_extra["range"] for name in fields}  # type: ignore[index]

    def signs(self, parameter: str) -> tuple[int, ...]:
        """Return the signs that a parameter may have."""
        limits = {"low": _LOWEST.get((self.name, parameter), (-math.inf, True))[0], "high": math.inf}
        for limit in self.table.model_fields[parameter].metadata:
            for name, end in (("ge", "low"), ("gt", "low"), ("le", "high"), ("lt", "high")):
                limits[end] = getattr(limit, name, limits[end])
        return (-1,) * (limits["low"] < 0) + (1,) * (limits["high"] > 0)

    def draw(self, rng: np.random.Generator, decades: float = 0.0) -> dict[str, float]:
        """Draw parameters evenly in powers of ten within `range`, or up to `decades` beyond both
        ends.
        """
        found = {}
        for name, (low, high) in self.range().items():
            ratio = high / low * 100.0**decades
            found[name] = float(rng.choice(self.signs(name)) * low * 10.0**-decades * ratio ** rng.random())
        return found


class _Lateral(Strict):
    r_ohm: float | None = entry(
        None,
        "One resistor between the inner electrodes of every two neighbouring taxels, in ohm",
        "a finite number > 0",
        default_from="array.r_lateral_ohm",
        gt=0,
        example=2e3,
        range=(100.0, 1e4),
    )


class _RowDriver(Strict):
    r_ohm: float | None = entry(
        None,
        "In series with the driven row, in ohm",
        _OHM,
        default_from="row_driver.r_on_ohm",
        ge=0,
        example=3.0,
        range=(0.1, 30.0),
    )
    grounded_r_ohm: Annotated[float, Field(ge=0, allow_inf_nan=True)] | None = entry(
        None,
        "In series with every grounded row, in ohm; inf leaves them floating",
        "a number >= 0 (inf is legal)",
        default_from="r_ohm, or row_driver.r_ground_ohm when r_ohm is left out too",
        ge=0,
        example=5.0,
        range=(0.1, 30.0),
    )


class _Pad(Strict):
    r_row_ohm: float | None = entry(
        None,
        "From the driver of a row to the sheet, in ohm",
        _OHM,
        default_from="wires.r_pad_row_ohm",
        ge=0,
        example=3.0,
        range=(0.01, 150.0),
    )
    r_column_ohm: float | None = entry(
        None,
        "From the sheet to the input of a column, in ohm",
        _OHM,
        default_from="wires.r_pad_column_ohm",
        ge=0,
        example=1.0,
        range=(0.01, 150.0),
    )


class _Return(Strict):
    r_ohm: float | None = entry(
        None,
        "From the ground of the row drivers to ground, in ohm",
        _OHM,
        default_from="wires.r_return_ohm",
        ge=0,
        example=30.0,
        range=(0.01, 30.0),
    )


class _ColumnInput(Strict):
    r_ohm: PerColumn | None = entry(
        None,
        "Between every column and its virtual ground, in ohm",
        "a finite number >= 0, or a list of them, one a column",
        default_from="conveyor.r_x_ohm (topology direct: must be given)",
        example=20.0,
        range=(0.1, 30.0),
    )


class _ColumnOffset(Strict):
    v_v: PerColumn | None = entry(
        None,
        "Voltage of the virtual ground, in V",
        _PER_COLUMN,
        default_from="conveyor.v_offset_v (topology direct: integrator.v_offset_v)",
        example=2e-4,
        range=(1e-5, 5e-3),
    )


class _MirrorRatio(Strict):
    ratio_error: PerColumn | None = entry(
        None,
        "Relative error of the current delivered",
        _PER_COLUMN,
        default_from="mirror.ratio_error",
        example=0.02,
        range=(1e-3, 0.05),
    )
    spread: float = entry(
        0.0,
        "Standard deviation of a further relative error, drawn for each column",
        _SMALL,
        ge=0,
        le=0.1,
        example=0.01,
        range=(1e-4, 0.05),
    )


class _OffsetCurrent(Strict):
    i_a: PerColumn = entry(
        1e-9,
        "Adds to the current into the converter, after the mirror, in A",
        _PER_COLUMN,
        example=3e-7,
        range=(1e-10, 3e-7),
    )


class _IntegratorGain(Strict):
    gain_dc: float | None = entry(
        None,
        "Open-loop gain of the integrator",
        "a finite number >= 1",
        default_from="integrator.gain_dc",
        ge=1,
        example=100.0,
        range=(100.0, 1e5),
    )
    r_in_ohm: float | None = entry(
        None,
        "Across the integrator's input, in ohm",
        "a finite number > 0",
        default_from="integrator.r_in_ohm",
        gt=0,
        example=1e4,
        range=(1e5, 1e9),
    )


class _IntegratorRange(Strict):
    v_max_v: float | None = entry(
        None,
        "Highest output of the integrator, in V",
        "a finite number > 0",
        default_from="integrator.v_out_max_v",
        gt=0,
        example=0.7,
        range=(0.55, 1.6),
    )
    v_min_v: float | None = entry(
        None,
        "Lowest output of the integrator, in V",
        "a finite number < 0",
        default_from="integrator.v_out_min_v",
        lt=0,
        example=-0.6,
        range=(0.55, 1.6),
    )


class _ComparatorOffset(Strict):
    v_v: PerColumn | None = entry(
        None,
        "Decision level, in V of the integrator; plus needs more charge",
        _PER_COLUMN,
        default_from="comparator.v_offset_v",
        example=0.3,
        range=(1e-3, 0.3),
    )


class _ComparatorHysteresis(Strict):
    v_v: float | None = entry(
        None,
        "Full width of the window around the decision level, in V",
        "a finite number >= 0, below one packet",
        default_from="comparator.v_hysteresis_v",
        ge=0,
        example=0.3,
        range=(1e-4, 0.3),
    )


class _ComparatorDelay(Strict):
    t_s: float | None = entry(
        None,
        "From crossing to output, in s",
        "a finite number >= 0, below one clock",
        default_from="comparator.t_delay_s",
        ge=0,
        example=1.3e-7,
        range=(1e-10, 2e-8),
    )


class _ChargePacket(Strict):
    packet_error: PerColumn | None = entry(
        None,
        "Relative error of every packet",
        _PER_COLUMN,
        default_from="charge.packet_error",
        example=0.03,
        range=(1e-4, 0.05),
    )


class _PresetError(Strict):
    v_v: PerColumn = entry(
        1e-3,
        "Error of the preset, in V of the integrator; plus is more charge",
        _PER_COLUMN,
        example=0.2,
        range=(1e-4, 0.3),
    )


class _Trace(Strict):
    r_row_ohm: float | None = entry(
        None,
        "Of a row line, a pitch, in ohm",
        _OHM,
        default_from="array.r_trace_row_ohm",
        ge=0,
        example=1.0,
        range=(0.01, 5.0),
    )
    r_column_ohm: float | None = entry(
        None,
        "Of a column line, a pitch, in ohm",
        _OHM,
        default_from="array.r_trace_column_ohm",
        ge=0,
        example=1.0,
        range=(0.01, 5.0),
    )


class _LineCapacitance(Strict):
    c_row_f: float | None = entry(
        None,
        "Of every row line to ground, in F",
        _FARAD,
        default_from="array.c_row_f",
        ge=0,
        example=1e-8,
        range=(1e-11, 1e-8),
    )
    c_column_f: float | None = entry(
        None,
        "Of every column line to ground, in F",
        _FARAD,
        default_from="array.c_column_f",
        ge=0,
        example=1e-8,
        range=(1e-11, 1e-8),
    )
    c_taxel_f: float | None = entry(
        None,
        "Across every taxel, in F",
        _FARAD,
        default_from="array.c_taxel_f",
        ge=0,
        example=1e-10,
        range=(1e-13, 1e-10),
    )


class _MuxLeakage(Strict):
    i_a: PerColumn | None = entry(
        None,
        "Into every column, in A",
        _PER_COLUMN,
        default_from="row_driver.i_leak_a",
        example=2e-5,
        range=(1e-10, 1e-5),
    )


class _MirrorOutput(Strict):
    r_out_ohm: float | None = entry(
        None,
        "Across the mirror's output, in ohm",
        _POSITIVE,
        default_from="mirror.r_out_ohm",
        gt=0,
        example=1e4,
        range=(1e5, 1e8),
    )


class _MirrorLag(Strict):
    q_c: float | None = entry(
        None,
        "Time constant times output current, in C",
        _POSITIVE,
        default_from="mirror.q_lag_c",
        gt=0,
        example=4e-11,
        range=(1e-15, 1e-11),
    )


class _RangeSwitch(Strict):
    r_ohm: float | None = entry(
        None,
        "In series with the mirror's input devices, in ohm",
        _OHM,
        default_from="mirror.r_switch_ohm",
        ge=0,
        example=100.0,
        range=(0.01, 10.0),
    )
    v_overdrive_v: float | None = entry(
        None,
        "Overdrive of those devices, in V",
        _POSITIVE,
        default_from="mirror.v_overdrive_v",
        gt=0,
        example=0.3,
        range=(0.1, 0.4),
    )


class _IntegratorBandwidth(Strict):
    gbw_hz: float | None = entry(
        None,
        "Gain-bandwidth product, in Hz",
        _POSITIVE,
        default_from="integrator.gbw_hz",
        gt=0,
        example=3e5,
        range=(1e6, 1e8),
    )


class _ComparatorNoise(Strict):
    v_v: float | None = entry(
        None,
        "Of every decision, rms in V",
        _RMS,
        default_from="comparator.v_noise_v",
        ge=0,
        example=0.05,
        range=(2e-6, 6e-3),
    )


class _Metastability(Strict):
    t_aperture_s: float | None = entry(
        None,
        "Crossings within half of it either side of a clock edge are decided by a coin, in s",
        "a finite number >= 0, below one clock",
        default_from="comparator.t_aperture_s",
        ge=0,
        example=1e-7,
        range=(1e-14, 1e-7),
    )


class _ReferenceDrift(Strict):
    tc_per_k: float | None = entry(
        None,
        "Relative change of i0 a kelvin",
        _FINITE,
        default_from="charge.tc_per_k",
        example=1e-3,
        range=(1e-5, 1e-3),
    )
    delta_k: float | None = entry(
        None,
        "How far the chip is from where i0 was set, in K",
        _FINITE,
        default_from="ambient.delta_k",
        example=40.0,
        range=(1.0, 60.0),
    )


class _ClockJitter(Strict):
    t_s: float | None = entry(
        None,
        "Of every edge, rms in s",
        "a finite number >= 0, at most a tenth of a clock",
        default_from="converter.t_jitter_s",
        ge=0,
        example=5e-9,
        range=(1e-13, 1.5e-8),
    )


class _ThermalNoise(Strict):
    temperature_c: float | None = entry(
        None,
        "Of sheet and chip, in degrees Celsius",
        _CELSIUS,
        default_from="ambient.temperature_c",
        gt=-273.15,
        example=27.0,
        range=(1.0, 125.0),
    )
    factor: float | None = entry(
        None,
        "Noise power over that of the taxels alone",
        "a finite number >= 0",
        default_from="ambient.noise_factor",
        ge=0,
        example=2e5,
        range=(0.02, 60.0),
    )


class _ShotNoise(Strict):
    factor: float = entry(
        1.0,
        "Noise power over that of single electrons",
        "a finite number >= 0",
        ge=0,
        example=3e3,
        range=(0.01, 30.0),
    )


class _KtcNoise(Strict):
    temperature_c: float | None = entry(
        None,
        "Of the preset switch, in degrees Celsius",
        _CELSIUS,
        default_from="ambient.temperature_c",
        gt=-273.15,
        example=27.0,
        range=(1.0, 125.0),
    )


class _FlickerNoise(Strict):
    relative: float | None = entry(
        None,
        "Of the packets from slot to slot, rms relative",
        _SMALL,
        default_from="charge.flicker",
        ge=0,
        le=0.1,
        example=5e-3,
        range=(5e-7, 2e-3),
    )


class _SupplyRipple(Strict):
    relative: float | None = entry(
        None,
        "Amplitude on the bias, relative",
        "a finite number 0..1",
        default_from="ripple.relative",
        ge=0,
        le=1,
        example=0.05,
        range=(1e-4, 0.05),
    )
    frequency_hz: float | None = entry(
        None,
        "Of the ripple, in Hz",
        _POSITIVE,
        default_from="ripple.frequency_hz",
        gt=0,
        example=3e3,
        range=(1e3, 1e6),
    )
    phase_deg: float = entry(
        0.0, "At the first clock of the first frame, in degrees", _FINITE, example=30.0, range=(1.0, 360.0)
    )


class _Motion(Strict):
    pass


class _SensorHysteresis(Strict):
    relative: float | None = entry(
        None,
        "How far the resistance on the way back lies below that on the way up, relative",
        "a finite number from 0 to below 1",
        default_from="sensor.hysteresis",
        ge=0,
        lt=1,
        example=0.2,
        range=(1e-3, 0.9),
    )


class _SensorCreep(Strict):
    per_decade: float | None = entry(
        None,
        "Relative growth of conductance a decade of time",
        _RMS,
        default_from="sensor.creep_per_decade",
        ge=0,
        example=0.1,
        range=(5e-4, 0.5),
    )


class _SensorTemperature(Strict):
    tc_per_k: float | None = entry(
        None,
        "Relative change of conductance a kelvin",
        _FINITE,
        default_from="sensor.tc_per_k",
        example=3e-3,
        range=(3e-5, 5e-3),
    )
    delta_k: float | None = entry(
        None,
        "How far the sheet is from where it was measured, in K",
        _FINITE,
        default_from="ambient.delta_k",
        example=30.0,
        range=(1.0, 60.0),
    )


class _SensorSpread(Strict):
    relative: float | None = entry(
        None,
        "Standard deviation of conductance from taxel to taxel, relative",
        "a finite number from 0 to below 1",
        default_from="sensor.spread",
        ge=0,
        lt=1,
        example=0.1,
        range=(1e-3, 0.5),
    )


def _lateral(p: _Lateral, _: Setting) -> Contribution:
    return Contribution({"g_lateral_row_s": 1.0 / p.r_ohm, "g_lateral_column_s": 1.0 / p.r_ohm})


def _row_driver(p: _RowDriver, _: Setting) -> Contribution:
    return Contribution({"r_row_driven_ohm": p.r_ohm, "r_row_grounded_ohm": p.grounded_r_ohm})


def _pad(p: _Pad, _: Setting) -> Contribution:
    rows, columns = (
        ("r_row_driven_ohm", "r_row_grounded_ohm", "r_pad_row_ohm"),
        ("r_column_ohm", "r_pad_column_ohm"),
    )
    return Contribution(dict.fromkeys(rows, p.r_row_ohm) | dict.fromkeys(columns, p.r_column_ohm))


def _row_driver_defaults(design: Design, _: str) -> dict[str, Any]:
    return {"r_ohm": design.row_driver.r_on_ohm, "grounded_r_ohm": design.row_driver.r_ground_ohm}


def _mirror_ratio(p: _MirrorRatio, setting: Setting) -> Contribution:
    gain = 1.0 + np.asarray(p.ratio_error, dtype=float)
    if p.spread:
        gain = gain * (1.0 + p.spread * setting.rng("mirror_ratio").standard_normal(setting.cols))
    return Contribution(converter={"gain": gain})


def _kt_j(temperature_c: float) -> float:
    return K_BOLTZMANN_J_PER_K * (temperature_c - ABSOLUTE_ZERO_C)


_MIRRORED = tuple(t for t in TOPOLOGIES if t != "direct")

EFFECTS: dict[str, Effect] = {
    e.name: e
    for e in (
        Effect(
            "lateral",
            "conductance of the sheet: resistors between neighbouring taxels, along rows and columns",
            _Lateral,
            lambda d, t: {"r_ohm": d.array.r_lateral_ohm},
            _lateral,
            needs={"column_input": {"r_ohm": 5.0}},
            bound=bounds.honoured,
        ),
        Effect(
            "row_driver",
            "on-resistance of the row drivers: the driven row droops, the grounded rows rise",
            _RowDriver,
            _row_driver_defaults,
            _row_driver,
            bound=bounds.honoured,
        ),
        Effect(
            "pad",
            "resistance of pads and wires in series with rows and columns",
            _Pad,
            lambda d, t: {"r_row_ohm": d.wires.r_pad_row_ohm, "r_column_ohm": d.wires.r_pad_column_ohm},
            _pad,
            # Columns of the direct interface that give way would move each other by a count: cosim
            # alone takes that.
            examples={"direct": {"r_row_ohm": 1.0, "r_column_ohm": 0.0}},
            bound=bounds.honoured,
            considered=False,
        ),
        Effect(
            "return",
            "common return of the grounded rows: their current raises all of them",
            _Return,
            lambda d, t: {"r_ohm": d.wires.r_return_ohm},
            lambda p, s: Contribution({"r_return_ohm": p.r_ohm}),
            needs={"column_input": {"r_ohm": 5.0}},
            bound=bounds.honoured,
            considered=False,
        ),
        Effect(
            "column_input",
            "input resistance of the columns, in series with the virtual ground",
            _ColumnInput,
            lambda d, t: {} if t == "direct" else {"r_ohm": d.conveyor.r_x_ohm},
            lambda p, s: Contribution({"r_column_ohm": p.r_ohm}),
            bound=bounds.honoured,
        ),
        Effect(
            "column_offset",
            "offset of the virtual ground: a current through every taxel of the column",
            _ColumnOffset,
            lambda d, t: {"v_v": d.integrator.v_offset_v if t == "direct" else d.conveyor.v_offset_v},
            lambda p, s: Contribution({"v_column_offset_v": p.v_v}),
            bound=bounds.honoured,
        ),
        Effect(
            "mirror_ratio",
            "ratio error of the k:1 mirror, systematic and from column to column",
            _MirrorRatio,
            lambda d, t: {"ratio_error": d.mirror.ratio_error},
            _mirror_ratio,
            _MIRRORED,
            bound=bounds.honoured,
        ),
        Effect(
            "offset_current",
            "constant current into every converter",
            _OffsetCurrent,
            lambda d, t: {},
            lambda p, s: Contribution(converter={"i_offset_a": p.i_a}),
            bound=bounds.honoured,
        ),
        Effect(
            "integrator_gain",
            "finite gain: charge leaks through the conductance at the input (direct: the whole column)",
            _IntegratorGain,
            lambda d, t: {"gain_dc": d.integrator.gain_dc, "r_in_ohm": d.integrator.r_in_ohm},
            lambda p, s: Contribution(converter={"inv_gain_dc": 1.0 / p.gain_dc, "g_in_s": 1.0 / p.r_in_ohm}),
            examples={"direct": {"gain_dc": 6e3}},
            bound=bounds.integrator_gain,
        ),
        Effect(
            "integrator_range",
            "limits of the integrator's output: charge beyond them is lost",
            _IntegratorRange,
            lambda d, t: {"v_max_v": d.integrator.v_out_max_v, "v_min_v": d.integrator.v_out_min_v},
            lambda p, s: Contribution(converter={"v_int_max_v": p.v_max_v, "v_int_min_v": p.v_min_v}),
            examples={"direct": {"v_max_v": 1.6, "v_min_v": -1.6}},
            bound=bounds.integrator_range,
        ),
        Effect(
            "comparator_offset",
            "offset of the decision level",
            _ComparatorOffset,
            lambda d, t: {"v_v": d.comparator.v_offset_v},
            lambda p, s: Contribution(converter={"v_comp_offset_v": p.v_v}),
            bound=bounds.honoured,
        ),
        Effect(
            "comparator_hysteresis",
            "hysteresis of the comparator: it switches half a window past its level",
            _ComparatorHysteresis,
            lambda d, t: {"v_v": d.comparator.v_hysteresis_v},
            lambda p, s: Contribution(converter={"v_hysteresis_v": p.v_v}),
            bound=bounds.comparator_hysteresis,
        ),
        Effect(
            "comparator_delay",
            "delay of the comparator before the synchronizer",
            _ComparatorDelay,
            lambda d, t: {"t_s": d.comparator.t_delay_s},
            lambda p, s: Contribution(converter={"t_comp_delay_s": p.t_s}),
            bound=bounds.comparator_delay,
        ),
        Effect(
            "charge_packet",
            "relative error of every packet",
            _ChargePacket,
            lambda d, t: {"packet_error": d.charge.packet_error},
            lambda p, s: Contribution(converter={"packet_error": p.packet_error}),
            bound=bounds.honoured,
        ),
        Effect(
            "preset_error",
            "error of the preset voltage",
            _PresetError,
            lambda d, t: {},
            lambda p, s: Contribution(converter={"preset_error_v": p.v_v}),
            bound=bounds.honoured,
        ),
        Effect(
            "trace",
            "resistance of the lines, between taxels and to driver and column input",
            _Trace,
            lambda d, t: {"r_row_ohm": d.array.r_trace_row_ohm, "r_column_ohm": d.array.r_trace_column_ohm},
            lambda p, s: Contribution({"r_trace_row_ohm": p.r_row_ohm, "r_trace_column_ohm": p.r_column_ohm}),
            bound=bounds.honoured,
        ),
        Effect(
            "line_capacitance",
            "capacitance of lines and taxels: settling that is not complete when the gate opens",
            _LineCapacitance,
            lambda d, t: {
                "c_row_f": d.array.c_row_f,
                "c_column_f": d.array.c_column_f,
                "c_taxel_f": d.array.c_taxel_f,
            },
            lambda p, s: Contribution(
                {"c_row_f": p.c_row_f, "c_column_f": p.c_column_f, "c_taxel_f": p.c_taxel_f}
            ),
            needs={"row_driver": {"r_ohm": 1e3}, "column_input": {"r_ohm": 1e3}},
            # Columns that saturate would move the others by more than a count: engine cosim alone
            # takes that.
            examples={"direct": {"c_row_f": 2e-9, "c_column_f": 0.0, "c_taxel_f": 0.0}},
            bound=bounds.line_capacitance,
        ),
        Effect(
            "mux_leakage",
            "leakage of open switches into the columns, before the mirror",
            _MuxLeakage,
            lambda d, t: {"i_a": d.row_driver.i_leak_a},
            lambda p, s: Contribution({"i_leak_a": p.i_a}),
            bound=bounds.honoured,
        ),
        Effect(
            "mirror_output",
            "finite output resistance of the mirror, across the integrator's input",
            _MirrorOutput,
            lambda d, t: {"r_out_ohm": d.mirror.r_out_ohm},
            lambda p, s: Contribution(converter={"g_in_s": 1.0 / p.r_out_ohm}),
            _MIRRORED,
            needs={"integrator_gain": {"gain_dc": 100.0}},
            bound=bounds.honoured,
        ),
        Effect(
            "mirror_lag",
            "slow mirror at low current: a rest of the previous row's current when the gate opens",
            _MirrorLag,
            lambda d, t: {"q_c": d.mirror.q_lag_c},
            lambda p, s: Contribution(converter={"q_mirror_c": p.q_c}),
            _MIRRORED,
            bound=bounds.mirror_lag,
        ),
        Effect(
            "range_switch",
            "resistance of the switches that set k: compression at high current",
            _RangeSwitch,
            lambda d, t: {"r_ohm": d.mirror.r_switch_ohm, "v_overdrive_v": d.mirror.v_overdrive_v},
            lambda p, s: Contribution(converter={"inv_i_range_a": p.r_ohm / p.v_overdrive_v}),
            _MIRRORED,
            bound=bounds.honoured,
        ),
        Effect(
            "integrator_bandwidth",
            "finite gain-bandwidth product: the output lags behind the charge",
            _IntegratorBandwidth,
            lambda d, t: {"gbw_hz": d.integrator.gbw_hz},
            lambda p, s: Contribution(converter={"t_gbw_s": 1.0 / (2.0 * math.pi * p.gbw_hz)}),
            examples={"direct": {"gbw_hz": 2e6}},
            bound=bounds.integrator_bandwidth,
        ),
        Effect(
            "comparator_noise",
            "noise of the decision level",
            _ComparatorNoise,
            lambda d, t: {"v_v": d.comparator.v_noise_v},
            lambda p, s: Contribution(converter={"v_comp_noise_v": p.v_v}),
            random=True,
            bound=bounds.comparator_noise,
        ),
        Effect(
            "metastability",
            "metastability: a crossing close to a clock edge may be seen one clock late",
            _Metastability,
            lambda d, t: {"t_aperture_s": d.comparator.t_aperture_s},
            lambda p, s: Contribution(converter={"t_meta_s": p.t_aperture_s}),
            random=True,
            bound=bounds.metastability,
        ),
        Effect(
            "reference_drift",
            "drift of the reference current, and so of every packet, with temperature",
            _ReferenceDrift,
            lambda d, t: {"tc_per_k": d.charge.tc_per_k, "delta_k": d.ambient.delta_k},
            lambda p, s: Contribution(converter={"packet_error": p.tc_per_k * p.delta_k}),
            bound=bounds.honoured,
        ),
        Effect(
            "clock_jitter",
            "jitter of clock edges: it moves samples and changes the width of packets",
            _ClockJitter,
            lambda d, t: {"t_s": d.converter.t_jitter_s},
            lambda p, s: Contribution(converter={"t_jitter_s": p.t_s}),
            random=True,
            bound=bounds.clock_jitter,
        ),
        Effect(
            "thermal_noise",
            "thermal noise current of every conductance on a column",
            _ThermalNoise,
            lambda d, t: {"temperature_c": d.ambient.temperature_c, "factor": d.ambient.noise_factor},
            lambda p, s: Contribution(converter={"kt_noise_j": _kt_j(p.temperature_c) * p.factor}),
            random=True,
            bound=bounds.thermal_noise,
        ),
        Effect(
            "shot_noise",
            "shot noise of input current and packets",
            _ShotNoise,
            lambda d, t: {},
            lambda p, s: Contribution(converter={"q_shot_c": ELECTRON_C * p.factor}),
            random=True,
            bound=bounds.shot_noise,
        ),
        Effect(
            "ktc_noise",
            "sampled noise of the preset switch on the capacitor",
            _KtcNoise,
            lambda d, t: {"temperature_c": d.ambient.temperature_c},
            lambda p, s: Contribution(
                converter={"v_preset_noise_v": math.sqrt(_kt_j(p.temperature_c) / s.c_int_f)}
            ),
            random=True,
            bound=bounds.ktc_noise,
        ),
        Effect(
            "flicker_noise",
            "slow noise of the reference: the packet size differs from slot to slot",
            _FlickerNoise,
            lambda d, t: {"relative": d.charge.flicker},
            lambda p, s: Contribution(converter={"packet_flicker": p.relative}),
            random=True,
            bound=bounds.flicker_noise,
        ),
        Effect(
            "supply_ripple",
            "sine on the bias of the driven row",
            _SupplyRipple,
            lambda d, t: {"relative": d.ripple.relative, "frequency_hz": d.ripple.frequency_hz},
            lambda p, s: Contribution(
                drive={
                    "ripple": p.relative,
                    "f_ripple_hz": p.frequency_hz,
                    "phase_ripple_rad": math.radians(p.phase_deg),
                }
            ),
            bound=bounds.supply_ripple,
        ),
        Effect(
            "motion",
            "forces change within frame and gate: conductances on straight lines from frame to frame",
            _Motion,
            lambda d, t: {},
            lambda p, s: Contribution(drive={"motion": True}),
            bound=bounds.motion,
            considered=False,
        ),
        Effect(
            "sensor_hysteresis",
            "hysteresis of a taxel: higher conductance for falling force",
            _SensorHysteresis,
            lambda d, t: {"relative": d.sensor.hysteresis},
            lambda p, s: Contribution(sensor={"hysteresis": p.relative}),
            bound=bounds.honoured,
            considered=False,
        ),
        Effect(
            "sensor_creep",
            "creep of a taxel: the conductance grows with every decade of time under load",
            _SensorCreep,
            lambda d, t: {"per_decade": d.sensor.creep_per_decade},
            lambda p, s: Contribution(sensor={"creep_per_decade": p.per_decade}),
            bound=bounds.honoured,
            considered=False,
        ),
        Effect(
            "sensor_temperature",
            "temperature coefficient of the sheet's conductance",
            _SensorTemperature,
            lambda d, t: {"tc_per_k": d.sensor.tc_per_k, "delta_k": d.ambient.delta_k},
            lambda p, s: Contribution(sensor={"temperature_error": p.tc_per_k * p.delta_k}),
            bound=bounds.honoured,
            considered=False,
        ),
        Effect(
            "sensor_spread",
            "random factor on the conductance of each taxel",
            _SensorSpread,
            lambda d, t: {"relative": d.sensor.spread},
            lambda p, s: Contribution(sensor={"spread": p.relative}),
            bound=bounds.honoured,
            considered=False,
        ),
    )
}


class AutoTable(Strict):
    """[effects] auto: every effect is on, and only cells that stay open are walked."""

    budget_lsb: float = entry(
        0.0,
        "Error of a level that decides a cell without a walk, in LSB; 0 gives the codes of everything on",
        "a finite number >= 0",
        ge=0,
    )


class ExtractedTable(Strict):
    """[effects] extracted: what was measured of the chip in transistors, as the effects it amounts
    to.
    """

    corner: Literal["tt", "ff", "ss", "sf", "fs"] = entry(
        "tt", "Corner of the process", 'one of "tt", "ff", "ss", "sf", "fs"'
    )
    temperature_c: _Number = entry(
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
    """Return True if auto considers the effect unnamed: the topology has it and every parameter has
    a default.
    """
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
    for name in ("reference_drift", "sensor_temperature"):
        if name in on and on[name].tc_per_k * on[name].delta_k <= -1:
            p = on[name]
            raise InputError(
                file,
                f"effects.{name}.delta_k",
                p.delta_k,
                f"above {-1 / p.tc_per_k:g} K, where nothing is left"
                if p.tc_per_k > 0
                else f"below {-1 / p.tc_per_k:g} K, where nothing is left",
            )
    return on


# Impossible values: a negative resistance, a packet or a mirror that changes its sign.
_LOWEST = {("column_input", "r_ohm"): (0.0, True), ("mirror_ratio", "ratio_error"): (-1.0, False),
           ("charge_packet", "packet_error"): (-1.0, False)}  # fmt: skip


def check_together(on: Mapping[str, Strict], topology: str, packet_v: float, file: Any) -> None:
    """Refuse effects that contradict each other, naming both.

    Raises InputError where the levels of the comparator or the preset lie outside the range of the
    integrator (it would never answer, or answer for ever), where hysteresis reaches the preset, and
    where errors of the packet leave none together.
    """

    def values(name: str, key: str) -> list[float]:
        value = getattr(on[name], key) if name in on else 0.0
        return value if isinstance(value, list) else [value]

    offsets, window = values("comparator_offset", "v_v"), values("comparator_hysteresis", "v_v")[0]
    presets = values("preset_error", "v_v")
    if window >= packet_v * (1 - 1e-9):
        # A window that reaches the preset would carry the state of the row before over to the next.
        raise InputError(
            file, "effects.comparator_hysteresis.v_v", window, f"below one packet ({packet_v:g} V)"
        )
    drift = on.get("reference_drift")
    if drift is not None and "charge_packet" in on:
        packet = 1.0 + min(values("charge_packet", "packet_error")) + drift.tc_per_k * drift.delta_k
        if packet <= 0:
            raise InputError(
                file,
                "effects.charge_packet and effects.reference_drift",
                f"a packet of {packet:g}",
                "a packet above 0 together",
            )
    if "integrator_range" not in on:
        return
    limits = on["integrator_range"]
    low, high = limits.v_min_v, limits.v_max_v
    if topology != "conveyor_mirror_inverted":  # stored charge drives the output down
        low, high = -high, -low
    for name, stands, room in (
        ("comparator_offset", offsets, window / 2),
        ("preset_error", [v - packet_v / 2 for v in presets], 0.0),
    ):
        for v in stands:
            if not low < v - room <= v + room < high:
                where = f"a level of {v:g} V of stored charge, outside {low:g} .. {high:g} V"
                names = [
                    "integrator_range",
                    *([name] if name in on else []),
                    *(["comparator_hysteresis"] if room else []),
                ]
                raise InputError(
                    file,
                    " and ".join(f"effects.{n}" for n in names),
                    where,
                    "levels inside the range of the integrator",
                )


# Jitter of an edge in clocks. Two edges in a row are 1 apart and move by sqrt(2) of it against each
# other: at a tenth they keep their order to 7 sigma, once in 1e12 edges; from half a clock on every
# third pair would change places, and what is counted is no clock any more.
JITTER_MAX = 0.1

_BELOW_ONE_CLOCK = {("comparator_delay", "t_s"), ("metastability", "t_aperture_s")}


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
    clock_s = 1.0 / setting.design.converter.f_clk_hz
    if (effect.name, name) in _BELOW_ONE_CLOCK and value >= clock_s:
        raise InputError(file, key, value, f"below one clock ({clock_s:g} s)")
    if effect.name == "clock_jitter" and value > JITTER_MAX * clock_s:
        allowed = (
            f"at most a tenth of a clock ({JITTER_MAX * clock_s:g} s), or edges would overtake each other"
        )
        raise InputError(file, key, value, allowed)


# Fields that several effects may write: their values add up. Every other field has one effect.
_SUMS = frozenset({"g_in_s", "packet_error", "r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm"})


def gather(on: Mapping[str, Strict], setting: Setting) -> Contribution:
    """Collect the record fields of all effects that are on."""
    total = Contribution({}, {}, {}, {})
    for name, parameters in on.items():
        for into, added in zip(total, EFFECTS[name].contribute(parameters, setting), strict=True):
            if not added:  # most effects set fields of one record
                continue
            for key, value in added.items():
                if key in into and key not in _SUMS:
                    raise ValueError(f"{name} and another effect both set {key}")
                into[key] = np.add(into[key], value) if key in into else value
    return total
