# SPDX-License-Identifier: Apache-2.0
"""Design values of models/design.toml and limits of models/spec.toml, loaded strictly.

Stored values are pydantic fields. Derived values have a formula in `_DERIVED`, and a property where code reads them
(``timing.slot_clocks``); the file cannot hold them, so it cannot contradict them.
"""

from __future__ import annotations

import functools
import math
import operator
import re
import typing
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, PrivateAttr, model_validator

from dermis.errors import InputError
from dermis.places import ROOT
from dermis.scene import schema
from dermis.scene.schema import Strict, refuse, validate

DESIGN_FILE = ROOT / "models" / "design.toml"
SPEC_FILE = ROOT / "models" / "spec.toml"

Topology = Literal["direct", "conveyor_mirror", "conveyor_mirror_inverted", "multi_output_conveyor"]
TOPOLOGIES = typing.get_args(Topology)
K_BOLTZMANN_J_PER_K = 1.380649e-23
ELECTRON_C = 1.602176634e-19
ABSOLUTE_ZERO_C = -273.15
# Relative tolerance of cross-checks: rounding of a value that was computed elsewhere in doubles.
ROUNDING = 1e-12

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
RelativeError = Annotated[float, Field(gt=-1, lt=1)]


def exact(value: float | int | str | Fraction) -> Fraction:
    """Return the decimal a person wrote as a fraction, so that 2e-3 / 16 * 5e6 is exactly 625."""
    return Fraction(value if isinstance(value, (Fraction, int, str)) else repr(float(value)))


class Array(Strict):
    """The taxel array and the parameters of its deck."""

    rows: int = Field(ge=1, le=1024)
    cols: int = Field(ge=1, le=1024)
    r_lateral_ohm: Positive
    r_trace_row_ohm: NonNegative
    r_trace_column_ohm: NonNegative
    c_row_f: NonNegative
    c_column_f: NonNegative
    c_taxel_f: NonNegative
    r_floor_ohm: Positive


class Sensor(Strict):
    """Force = k_force_n_ohm / R, the measured curve of an FSR, and the errors of a sheet."""

    force_max_n: Positive
    r_min_ohm: Positive
    r_max_ohm: Positive
    hysteresis: Annotated[float, Field(ge=0, lt=1)]
    creep_per_decade: NonNegative
    spread: Annotated[float, Field(ge=0, lt=1)]
    tc_per_k: float
    force_points_n: list[Positive] = Field(min_length=2)
    r_points_ohm: list[Positive] = Field(min_length=2)
    force_on_n: NonNegative
    r_open_ohm: Positive
    creep_start_s: Positive

    @property
    def k_force_n_ohm(self) -> float:
        """K_f in N.ohm: full force at the lowest resistance."""
        return float(exact(self.force_max_n) * exact(self.r_min_ohm))


class Interface(Strict):
    """The interface between a column and its converter."""

    topology: Topology
    v_bias_v: Positive
    k: int = Field(ge=1, le=100_000)
    k_options: list[Annotated[int, Field(ge=1, le=100_000)]] = Field(min_length=4, max_length=4)


class Converter(Strict):
    """The synchronized voltage-to-frequency converter."""

    i0_a: Positive
    c_int_f: Positive
    f_clk_hz: Positive
    t_edge_s: Positive
    t_jitter_s: NonNegative

    @property
    def packet_v(self) -> float:
        """One packet as a voltage on c_int_f."""
        return float(exact(self.i0_a) / exact(self.f_clk_hz) / exact(self.c_int_f))


class Timing(Strict):
    """One frame, row slot and gate; the slot follows from frame, rows and clock."""

    frame_s: Positive
    gate_clocks: int = Field(ge=1, le=2**24)
    code_bits: int = Field(ge=1, le=16)
    break_clocks: int = Field(ge=1, le=2**16 - 3)
    _slot: Fraction = PrivateAttr(default=Fraction(0))  # in clocks, exactly

    @property
    def slot_clocks(self) -> int:
        """Clocks of one row slot, frame_s / rows * f_clk_hz."""
        return round(self._slot)

    @property
    def settle_clocks(self) -> int:
        """Clocks of a slot before the gate opens."""
        return self.slot_clocks - self.gate_clocks

    @property
    def code_max(self) -> int:
        """Full-scale code."""
        return 2**self.code_bits - 1


class Supply(Strict):
    """Supplies; ground is mid rail, the virtual ground of the columns."""

    vdd_v: Positive
    vss_v: float = Field(lt=0)
    v_logic_v: Positive


class Ripple(Strict):
    """Ripple of the supply on the bias of the driven row."""

    relative: Annotated[float, Field(ge=0, lt=1)]
    frequency_hz: Positive


class Integrator(Strict):
    """Amplifier, capacitor switch and clamp of the integrator."""

    gain_dc: Positive
    gbw_hz: Positive
    v_offset_v: float
    v_out_max_v: Positive
    v_out_min_v: float = Field(lt=0)
    r_in_ohm: Positive
    r_preset_ohm: Positive


class Comparator(Strict):
    """The comparator, decision level 0 V."""

    gain_dc: Positive
    v_offset_v: float
    v_hysteresis_v: NonNegative
    t_delay_s: NonNegative
    v_noise_v: NonNegative
    t_aperture_s: NonNegative


class Conveyor(Strict):
    """Second-generation current conveyor."""

    r_x_ohm: NonNegative
    v_offset_v: float
    f_pole_hz: Positive
    r_z_ohm: Positive
    i_out_max_a: Positive
    gain_error: RelativeError


class Mirror(Strict):
    """The asymmetrical k:1 current mirror."""

    ratio_error: RelativeError
    r_out_ohm: Positive
    f_pole_hz: Positive
    q_lag_c: Positive
    r_switch_ohm: NonNegative
    v_overdrive_v: Positive


class RowDriver(Strict):
    """Switch resistance of a driven and of a grounded row."""

    r_on_ohm: NonNegative
    r_ground_ohm: NonNegative
    i_leak_a: float


class Wires(Strict):
    """Metal and bond wires between blocks and the sheet."""

    r_pad_row_ohm: NonNegative
    r_pad_column_ohm: NonNegative
    r_return_ohm: NonNegative


class Charge(Strict):
    """The charge source."""

    packet_error: RelativeError
    tc_per_k: float
    flicker: NonNegative


class Calibration(Strict):
    """Currents that a chip calibrates itself with."""

    i_pedestal_a: Positive
    i_test_a: Positive


class Ambient(Strict):
    """Surroundings."""

    temperature_c: float = Field(gt=-273.15)
    delta_k: float
    noise_factor: NonNegative


class Design(Strict):
    """All of models/design.toml, plus derived values."""

    array: Array
    sensor: Sensor
    interface: Interface
    converter: Converter
    timing: Timing
    supply: Supply
    ripple: Ripple
    integrator: Integrator
    comparator: Comparator
    conveyor: Conveyor
    mirror: Mirror
    row_driver: RowDriver
    wires: Wires
    charge: Charge
    calibration: Calibration
    ambient: Ambient

    @model_validator(mode="after")
    def _derive(self) -> Design:
        self.timing._slot = exact(self.timing.frame_s) / self.array.rows * exact(self.converter.f_clk_hz)
        return self

    def _contradictions(self) -> Iterator[tuple[str, str]]:
        """Yield keys that contradict others, each with what it may hold."""
        timing, sensor, converter = self.timing, self.sensor, self.converter
        slot, clocks, full = timing._slot, timing.slot_clocks, timing.code_max
        # A clock such as 1/3 MHz has no exact double: whole to 1e-12 is whole.
        if clocks < 1 or abs(clocks - slot) > slot * ROUNDING:
            yield "timing.frame_s", f"a row slot frame_s / rows of whole clocks, not of {float(slot)!r}"
        # The reader needs two clocks with the row on before the gate (docs/rtl.md); it would stretch a shorter slot.
        most = clocks - timing.break_clocks - 2
        if timing.gate_clocks > most:
            yield "timing.gate_clocks", f"at most {most} of the {clocks} clocks of a row slot"
        if timing.gate_clocks < 2 * full:
            yield "timing.gate_clocks", f"at least {2 * full} clocks for {timing.code_bits} bits"
        forces, ohms, options = sensor.force_points_n, sensor.r_points_ohm, self.interface.k_options
        if sorted(set(forces)) != forces:
            yield "sensor.force_points_n", "forces that rise"
        if sorted(set(ohms), reverse=True) != ohms or len(ohms) != len(forces):
            yield "sensor.r_points_ohm", f"{len(forces)} resistances that fall, one a force point"
        if sensor.r_open_ohm <= ohms[0]:
            yield "sensor.r_open_ohm", f"above the first of r_points_ohm = {ohms[0]!r}"
        if sorted(set(options)) != options:
            yield "interface.k_options", "four different ratios, rising"
        if self.interface.k not in options:
            yield "interface.k", f"one of k_options = {options}"
        if self.duty(sensor.r_min_ohm) > 0.5 * (1 + ROUNDING):
            low = self.resistance_full_scale_ohm
            yield "sensor.r_min_ohm", f"at least 2 v_bias_v / (k i0_a) = {low!r} ohm"
        t_clk_s = float(1 / exact(converter.f_clk_hz))
        if 2 * converter.t_edge_s >= t_clk_s:
            yield "converter.t_edge_s", f"below half a clock of {t_clk_s!r} s"
        if converter.packet_v > self.swing_v * (1 + ROUNDING):
            yield "converter.c_int_f", f"a packet of at most {self.swing_v!r} V on it"
        stored = self.stored()
        for key, words, holds, other in _ORDER:
            if not holds(stored[key], stored[other]):
                yield key, f"{words} {other} = {stored[other]!r}"

    @property
    def swing_v(self) -> float:
        """Largest packet in volt: the charge stays within one packet of the threshold."""
        return min(self.integrator.v_out_max_v, -self.integrator.v_out_min_v)

    @property
    def resistance_full_scale_ohm(self) -> float:
        """Resistance in ohm at which x = 1/2."""
        return float(2 * self._r_unit())

    def duty(self, resistance_ohm: float) -> float:
        """Return x = V_b / (k i0 R); R = 0 gives inf, R = inf gives 0."""
        if resistance_ohm == 0:
            return math.inf
        return float(self._r_unit() / exact(resistance_ohm)) if math.isfinite(resistance_ohm) else 0.0

    def _r_unit(self) -> Fraction:
        return exact(self.interface.v_bias_v) / (self.interface.k * exact(self.converter.i0_a))

    def replace(self, /, **sections: Any) -> Design:
        """Return a copy with some values changed, as in ``replace(timing={"frame_s": 4e-3})``, checked like a file.

        ``model_copy(update=...)`` would neither check nor derive anew. Raises InputError.
        """
        return _validated(schema.merged(self.model_dump(), sections), "design")

    def stored(self) -> dict[str, Any]:
        """Return the stored values as ``{"section.key": value}`` in the order of the file."""
        return {f"{s}.{k}": v for s, keys in self.model_dump().items() for k, v in keys.items()}

    def derived(self) -> dict[str, float | int]:
        """Return the derived values as ``{"section.key": value}``."""
        return {name: value(self) for name, value in _DERIVED.items()}


_DERIVED: dict[str, Callable[[Design], float]] = {
    "sensor.k_force_n_ohm": lambda d: d.sensor.k_force_n_ohm,
    "sensor.force_min_n": lambda d: d.sensor.k_force_n_ohm / d.sensor.r_max_ohm,
    "converter.t_clk_s": lambda d: float(1 / exact(d.converter.f_clk_hz)),
    "converter.packet_c": lambda d: float(exact(d.converter.i0_a) / exact(d.converter.f_clk_hz)),
    "converter.packet_v": lambda d: d.converter.packet_v,
    "converter.f_max_hz": lambda d: float(exact(d.converter.f_clk_hz) / 2),  # two ones are never adjacent
    "timing.slot_clocks": lambda d: d.timing.slot_clocks,
    "timing.settle_clocks": lambda d: d.timing.settle_clocks,
    "timing.code_max": lambda d: d.timing.code_max,
    "timing.slot_s": lambda d: float(exact(d.timing.frame_s) / d.array.rows),
    "timing.gate_s": lambda d: float(d.timing.gate_clocks / exact(d.converter.f_clk_hz)),
    "timing.settle_s": lambda d: float(d.timing.settle_clocks / exact(d.converter.f_clk_hz)),
    "integrator.t_gbw_s": lambda d: 1 / (2 * math.pi * d.integrator.gbw_hz),
    "conveyor.t_pole_s": lambda d: 1 / (2 * math.pi * d.conveyor.f_pole_hz),
    "mirror.t_pole_s": lambda d: 1 / (2 * math.pi * d.mirror.f_pole_hz),
    "integrator.v_preset_v": lambda d: float(exact(d.converter.packet_v) / 2),  # negative if inverted
    "converter.i0_direct_a": lambda d: float(d.interface.k * exact(d.converter.i0_a)),  # k times larger
    "converter.c_direct_f": lambda d: float(d.interface.k * exact(d.converter.c_int_f)),
    "converter.swing_v": lambda d: d.swing_v,
}
"""Formulas of the derived values, in the units of their names."""

_ORDER = (
    ("sensor.r_max_ohm", "above", operator.gt, "sensor.r_min_ohm"),
    ("array.r_floor_ohm", "below", operator.lt, "sensor.r_min_ohm"),
    ("integrator.v_out_max_v", "at most", operator.le, "supply.vdd_v"),
    ("integrator.v_out_min_v", "at least", operator.ge, "supply.vss_v"),
)


def _validated(data: dict[str, Any], file: str) -> Design:
    derived = dict.fromkeys(_DERIVED, "derived from other values, not to be written")
    design: Design = validate(Design, data, file, refused=derived)
    refuse(design._contradictions(), design, file)
    return design


def shown(path: Path) -> str:
    """Return a path for messages: relative to the project root if it is inside."""
    try:
        return str(Path(path).resolve().relative_to(ROOT))
    except ValueError:
        return str(path)


def load(path: str | Path | None = None) -> Design:
    """Load and check a design file (models/design.toml when none is named).

    Raises InputError: one line with file, key, value and what is allowed.
    """
    if path is None:
        return _default()
    return _validated(schema.read_toml(Path(path), shown(Path(path))), shown(Path(path)))


@functools.cache
def _default() -> Design:
    return load(DESIGN_FILE)


class Reason(NamedTuple):
    """Reason for a stored value."""

    mark: str
    text: str


def reasons(path: str | Path | None = None) -> dict[str, Reason]:
    """Return the comment above each key of a design file: its mark (P, C or S) and text."""
    found, section = {}, ""
    text = Path(path or DESIGN_FILE).read_text(encoding="utf-8")
    for comment, head, key in re.findall(r"((?:^#.*\n)*)^(?:\[(\w+)\]|(\w+)[ \t]*=)", text, re.MULTILINE):
        section = head or section
        if key:
            said = " ".join(line.lstrip("# ").strip() for line in comment.splitlines())
            mark = re.match(r"\[([PCS])\] (.+)", said)
            found[f"{section}.{key}"] = Reason(*mark.groups()) if mark else Reason("", "")
    return found


class Limit(Strict):
    """One row of models/spec.toml."""

    min: float | None = Field(default=None)
    max: float | None = Field(default=None)
    unit: str = Field(min_length=1)
    gate: bool
    conditions: str = Field(min_length=1)
    command: str = Field(min_length=1)


def load_spec(path: str | Path) -> dict[str, Limit]:
    """Load a file of limits, one table ``["block.quantity_unit"]`` each.

    Raises InputError: one line with file, key, value and what is allowed.
    """
    file = shown(Path(path))
    limits: dict[str, Limit] = {}
    for name, entry in schema.read_toml(Path(path), file).items():
        if not re.fullmatch(r"[a-z0-9_]+(\.[a-z0-9_]+)+", name):
            raise InputError(file, "name", repr(name), 'a quoted table name such as ["frame.code_error_lsb"]')
        limit: Limit = validate(Limit, entry, file, name)
        if limit.min is None and limit.max is None:
            raise InputError(file, f"{name}.min, max", "nothing", "at least one of them")
        if limit.min is not None and limit.max is not None and limit.min > limit.max:
            raise InputError(file, f"{name}.min", limit.min, f"at most max = {limit.max!r}")
        limits[name] = limit
    return limits


@functools.cache
def spec() -> dict[str, Limit]:
    """Return the limits of models/spec.toml by name."""
    return load_spec(SPEC_FILE)
