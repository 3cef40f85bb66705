# SPDX-License-Identifier: Apache-2.0
"""The calibration of a sheet and its read-out: one TOML file with uncertainties."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from tomli_w import dumps

from dermis.array.array import Network
from dermis.converter.vfc import W_PRESET, code
from dermis.decode.law import KINDS, Curve, of_sensor
from dermis.decode.memory import MemoryLaw
from dermis.errors import InputError
from dermis.files import text_of, write_atomic
from dermis.records import Plan, setting_of
from dermis.scene.sensor import SensorState, spread_factor

Floats = NDArray[np.float64]

FORMAT = 1
COVERAGE_SIGMA = 3.5
"""Standard uncertainties that an interval covers: 0.05 % of a normal error lie beyond."""
MISSED = 5e-4
"""Share of readings that quantisation and noise may put beyond an interval."""
OVERLOAD = 4.0
"""Default of g_max_s: a saturated taxel conducts at most this many times full scale."""

UNSEEN_DECADES = 0.05
"""Creep in decades that loads below half a code cause unseen, as they come and go in some tens of milliseconds."""

_PER_COLUMN = (
    "step_a",
    "start_code",
    "inv_i_range_a",
    "step_part",
    "start_sigma_code",
    "zero_code",
    "full_code",
)
_NETWORK = (
    "r_row_driven_ohm",
    "r_row_grounded_ohm",
    "r_column_ohm",
    "v_column_offset_v",
    "i_leak_a",
    "g_lateral_row_s",
    "g_lateral_column_s",
    "r_trace_row_ohm",
    "r_trace_column_ohm",
    "r_return_ohm",
    "r_pad_row_ohm",
    "r_pad_column_ohm",
)


@dataclass(frozen=True, eq=False)
class Mode:
    """A joint error of one standard uncertainty: resistances, and the factors that fit the loads with them.

    Attributes
    ----------
    network : dict
        Fields of array.Network that differ, with their values.
    factor_part : ndarray
        [rows, cols] relative change of the factors.
    """

    network: dict[str, Any]
    factor_part: Floats


@dataclass(frozen=True, eq=False)
class Calibration:
    """Everything that a decoder knows of one sheet and its chip.

    A code c is the column current step_a (c - start_code), before compression by inv_i_range_a. A conductance over
    `factor` is that of `curve`; `memory` lies between the two.

    Attributes
    ----------
    rows, cols, code_max : int
    v_bias_v : float
        In volt.
    step_a, start_code, inv_i_range_a : ndarray
        [cols] ampere a code, the code of no current, 1/A.
    network : dict
        Fields of array.Network other than taxels and bias.
    curve : Curve
        Law of all taxels.
    own : dict
        Laws of taxels that have their own, by (row, column); of the same kind.
    factor : ndarray
        [rows, cols] relative conductance of each taxel, temperature included.
    memory : MemoryLaw
    reference : tuple
        (row, column, conductance in siemens) of taxels of constant force; what they read tells the temperature.
    g_max_s : float
        Largest conductance of a taxel in siemens, as a bound for saturated ones.
    noise_code : float
        Standard deviation of a reading in codes.
    zero_code : ndarray
        [cols] code of a column without current: a start above the level counts at once. A negative current may read
        this or less.
    full_code : ndarray
        [cols] code of a column at full scale, where every second clock takes a packet: a late start makes it less
        than code_max, the default. A larger current may read no more than that.
    step_part, start_sigma_code : ndarray
        [cols] standard uncertainty of step_a, relative, and of start_code.
    factor_part : ndarray
        [rows, cols] standard uncertainty of factor, relative.
    law_part : float
        Standard uncertainty of the force by the curve, relative.
    uncorrected_part : float
        Bound of a relative error of conductance that is not corrected.
    modes : tuple of Mode
        Uncertainty of the network: independent errors.
    offset_v2 : ndarray
        [3, cols] covariance of the columns' offset voltages in V^2, given the resistances: of each with itself, with
        the next column and with the one after.
    """

    rows: int
    cols: int
    code_max: int
    v_bias_v: float
    step_a: Floats
    start_code: Floats
    inv_i_range_a: Floats
    network: dict[str, Any]
    curve: Curve
    factor: Floats
    memory: MemoryLaw
    g_max_s: float
    own: dict[tuple[int, int], Curve] = field(default_factory=dict)
    reference: tuple[tuple[int, int, float], ...] = ()
    noise_code: float = 0.0
    zero_code: Floats = 0.0  # type: ignore[assignment]
    full_code: Floats = None  # type: ignore[assignment]
    step_part: Floats = 0.0  # type: ignore[assignment]
    start_sigma_code: Floats = 0.0  # type: ignore[assignment]
    factor_part: Floats = 0.0  # type: ignore[assignment]
    law_part: float = 0.0
    uncorrected_part: float = 0.0
    modes: tuple[Mode, ...] = ()
    offset_v2: Floats = 0.0  # type: ignore[assignment]
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.full_code is None:
            object.__setattr__(self, "full_code", float(self.code_max))
        for name in (*_PER_COLUMN, "factor", "factor_part"):
            shape = (self.cols,) if name in _PER_COLUMN else (self.rows, self.cols)
            array = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), shape).copy()
            object.__setattr__(self, name, array)
        object.__setattr__(self, "offset_v2", np.broadcast_to(self.offset_v2, (3, self.cols)).astype(float))

    @classmethod
    def of_plan(cls, plan: Plan) -> Calibration:
        """Return the calibration that knows a plan's every parameter exactly; noise is 0."""
        c, gate, table = plan.converter, plan.timing.gate_clocks, plan.scene.table
        packet = 1.0 + c.packet_error
        start = -W_PRESET + (c.v_comp_offset_v - c.preset_error_v) / c.packet_v()
        step_a = c.k * c.i0_a * packet / (gate * c.gain)
        packet_v = c.packet_v()
        level = {
            "w0": W_PRESET + c.preset_error_v / packet_v,
            "packet": packet,
            "threshold": c.v_comp_offset_v / packet_v,
        }
        state = SensorState(**_sensor_fields(plan))
        factor = np.full((plan.rows, plan.cols), 1.0 + state.temperature_error)
        if state.spread:
            draw = setting_of(plan.scene).rng("sensor_spread").standard_normal(factor.shape)
            factor = factor * spread_factor(draw, state.spread)
        creep_start_s = plan.scene.design.sensor.creep_start_s
        return cls(
            rows=plan.rows,
            cols=plan.cols,
            code_max=plan.timing.code_max,
            zero_code=code(0.0 * packet, gate, plan.timing.code_max, **level).astype(float),
            full_code=code(packet / 2, gate, plan.timing.code_max, **level).astype(float),
            v_bias_v=table.interface.v_bias_v,
            step_a=step_a,
            start_code=0.5 - start / packet + gate * c.i_offset_a / (c.i0_a * packet),
            inv_i_range_a=c.inv_i_range_a,
            network=dict(plan.surrounding),
            curve=of_sensor(plan.sensor),
            factor=factor,
            memory=MemoryLaw.of_effects(state.hysteresis, state.creep_per_decade, creep_start_s),
            uncorrected_part=UNSEEN_DECADES * state.creep_per_decade,
            g_max_s=OVERLOAD * plan.timing.code_max * float(step_a.max()) / plan.v_bias_v,
        )

    def array(self, mode: Mode | None = None) -> Network:
        """Return the network around the taxels, or the one that is off by a mode."""
        values = self.network if mode is None else self.network | mode.network
        return Network(np.zeros((self.rows, self.cols)), self.v_bias_v, **values)

    def law_of(self, row: int, col: int) -> Curve:
        """Return the law of a taxel."""
        return self.own.get((row, col), self.curve)

    def half_width_code(self) -> float:
        """Half the width in codes that quantisation and noise leave: beyond it lie `MISSED` of all readings.

        The error is a uniform one of +-1/2 plus a normal one. Its tail beyond w is s (f((w - 1/2)/s) - f((w + 1/2)/s))
        with f(z) = phi(z) - z Q(z).
        """
        s = self.noise_code
        if s <= 0:
            return 0.5

        def excess(w: float) -> float:
            ends = (np.array([w - 0.5, w + 0.5])) / s
            f = np.exp(-(ends**2) / 2) / np.sqrt(2 * np.pi) - ends * ndtr(-ends)
            return 2.0 * s * (f[0] - f[1]) - MISSED

        return float(brentq(excess, 0.0, 0.5 + 10.0 * s))

    def check(self, rows: int, cols: int, file: Path | str) -> None:
        """Refuse frames of another size than the calibration's."""
        if (rows, cols) != (self.rows, self.cols):
            allowed = f"frames of {self.rows} x {self.cols}, or the calibration of this array"
            raise InputError(file, "array", f"{rows} x {cols}", allowed)

    def to_toml(self) -> str:
        """Return the calibration as text; `load` reads the same one."""
        data: dict[str, Any] = {"format": FORMAT, "notes": list(self.notes)}
        data["array"] = {"rows": self.rows, "cols": self.cols, "g_max_s": float(self.g_max_s)}
        chip = {"code_max": self.code_max, "v_bias_v": float(self.v_bias_v), "noise_code": self.noise_code}
        data["chip"] = chip | {name: getattr(self, name).tolist() for name in _PER_COLUMN}
        data["network"] = _plain(self.network)
        sheet = {"kind": self.curve.kind, "logarithmic": bool(self.curve.logarithmic)}
        sheet |= {"g_open_s": float(self.curve.g_open_s), "force_on_n": float(self.curve.force_on_n)}
        sheet |= {"law_part": float(self.law_part), "uncorrected_part": float(self.uncorrected_part)}
        arrays = {"knots": self.curve.knots, "coefficients": self.curve.coefficients}
        arrays |= {"factor": self.factor, "factor_part": self.factor_part}
        data["sheet"] = sheet | {name: array.tolist() for name, array in arrays.items()}
        data["own_law"] = [
            {"row": r, "col": c, "knots": law.knots.tolist(), "coefficients": law.coefficients.tolist()}
            for (r, c), law in self.own.items()
        ]
        data["memory"] = {
            f.name: np.asarray(getattr(self.memory, f.name), dtype=float).tolist() for f in fields(MemoryLaw)
        }
        data["uncertainty"] = {"offset_v2": self.offset_v2.tolist()}
        data["mode"] = [
            {"network": _plain(mode.network), "factor_part": mode.factor_part.tolist()} for mode in self.modes
        ]
        data["reference"] = [{"row": r, "col": c, "conductance_s": g} for r, c, g in self.reference]
        return dumps(data)

    def save(self, path: Path) -> None:
        """Write the calibration whole or not at all."""
        write_atomic(path, self.to_toml())


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value, dtype=float).tolist() for name, value in values.items()}


def _sensor_fields(plan: Plan) -> dict[str, float]:
    from dermis import effects

    return dict(effects.gather(plan.scene.effects, setting_of(plan.scene)).sensor)


def load(path: Path | str) -> Calibration:
    """Read a calibration.

    Raises
    ------
    InputError
        No such file, no TOML, a missing key or a value of the wrong kind or size.
    """
    path = Path(path)
    try:
        data = tomllib.loads(text_of(path, "a calibration that `dermis calibrate` wrote"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(path, "file", str(error), "a calibration that `dermis calibrate` wrote") from None
    if data.get("format") != FORMAT:
        raise InputError(path, "format", data.get("format"), f"{FORMAT}, a calibration of this version")
    table = _Reader(path, data)
    rows, cols = table.whole("array", "rows"), table.whole("array", "cols")
    if isinstance(chip := data.get("chip"), dict):
        # Of a calibration of an earlier version.
        chip.setdefault("zero_code", [0.0] * cols)
        chip.setdefault("full_code", [float(table.whole("chip", "code_max"))] * cols)
    numbers = {name: table.numbers("chip", name, (cols,)) for name in _PER_COLUMN}
    if not (numbers["step_a"] > 0).all():
        raise InputError(path, "chip.step_a", numbers["step_a"].min(), "numbers > 0")
    network = table.network("network", cols)
    modes = []
    for n, entry in enumerate(data.get("mode", [])):
        one = _Reader(path, {f"mode.{n}": entry, f"mode.{n}.network": entry.get("network", {})})
        part = one.numbers(f"mode.{n}", "factor_part", (rows, cols))
        modes.append(Mode(one.network(f"mode.{n}.network", cols), part))
    knots = table.numbers("sheet", "knots", None)
    curve = Curve(
        table.value("sheet", "kind", str),
        table.value("sheet", "logarithmic", bool),
        knots,
        table.numbers("sheet", "coefficients", (knots.size, 4)),
        table.number("sheet", "g_open_s"),
        table.number("sheet", "force_on_n"),
    )
    if curve.kind not in KINDS:
        raise InputError(path, "sheet.kind", curve.kind, "one of " + ", ".join(KINDS))
    factor = table.numbers("sheet", "factor", (rows, cols))
    if not (factor > 0).all():
        raise InputError(path, "sheet.factor", factor.min(), "numbers > 0")
    radius = table.numbers("memory", "radius", None)
    memory = MemoryLaw(
        radius,
        table.numbers("memory", "weight", (radius.size,)),
        table.number("memory", "creep_per_decade"),
        table.number("memory", "creep_start_s"),
    )
    own = {}
    for n, entry in enumerate(data.get("own_law", [])):
        one = _Reader(path, {f"own_law.{n}": entry})
        own_knots = one.numbers(f"own_law.{n}", "knots", None)
        pieces = one.numbers(f"own_law.{n}", "coefficients", (own_knots.size, 4))
        own[one.place(f"own_law.{n}", rows, cols)] = replace(curve, knots=own_knots, coefficients=pieces)
    reference = []
    for n, entry in enumerate(data.get("reference", [])):
        one = _Reader(path, {f"reference.{n}": entry})
        reference.append(
            (*one.place(f"reference.{n}", rows, cols), one.number(f"reference.{n}", "conductance_s"))
        )
    made = Calibration(
        rows=rows,
        cols=cols,
        code_max=table.whole("chip", "code_max"),
        v_bias_v=table.number("chip", "v_bias_v"),
        network=network,
        curve=curve,
        factor=factor,
        memory=memory,
        g_max_s=table.number("array", "g_max_s"),
        own=own,
        reference=tuple(reference),
        noise_code=table.number("chip", "noise_code"),
        factor_part=table.numbers("sheet", "factor_part", (rows, cols)),
        law_part=table.number("sheet", "law_part"),
        uncorrected_part=table.number("sheet", "uncorrected_part"),
        modes=tuple(modes),
        offset_v2=table.numbers("uncertainty", "offset_v2", (3, cols)) if "uncertainty" in data else 0.0,
        notes=tuple(data.get("notes", ())),
        **numbers,
    )
    try:
        for mode in (None, *modes):
            made.array(mode)
    except ValueError as error:
        raise InputError(path, "network", "its values", str(error)) from None
    return made


@dataclass(frozen=True)
class _Reader:
    path: Path
    data: dict[str, Any]

    def value(self, section: str, key: str, kind: type | tuple[type, ...]) -> Any:
        found = self.data.get(section, {}).get(key) if isinstance(self.data.get(section, {}), dict) else None
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise InputError(self.path, f"{section}.{key}", found, "the value that `dermis calibrate` wrote")
        return found

    def whole(self, section: str, key: str) -> int:
        found = self.value(section, key, int)
        if not 1 <= found <= 1 << 16:
            raise InputError(self.path, f"{section}.{key}", found, "a whole number 1..65536")
        return found

    def place(self, section: str, rows: int, cols: int) -> tuple[int, int]:
        found = self.value(section, "row", int), self.value(section, "col", int)
        if not (0 <= found[0] < rows and 0 <= found[1] < cols):
            raise InputError(self.path, section, f"taxel {found}", f"a taxel of {rows} x {cols}")
        return found

    def network(self, section: str, cols: int) -> dict[str, Any]:
        given = self.data.get(section, {})
        for name in given:
            if name not in _NETWORK:
                raise InputError(self.path, f"{section}.{name}", "a key", "one of " + ", ".join(_NETWORK))
        return {
            name: self.numbers(section, name, ((), (cols,)), finite=name != "r_row_grounded_ohm")[()]
            for name in given
        }

    def number(self, section: str, key: str) -> float:
        return float(self.numbers(section, key, ()))

    def numbers(self, section: str, key: str, shape: Any, finite: bool = True) -> Floats:
        found = self.value(section, key, (int, float, list))
        try:
            array = np.asarray(found, dtype=float)
        except (ValueError, TypeError):
            raise InputError(self.path, f"{section}.{key}", found, "numbers in equal rows") from None
        shapes = [shape] if not shape or not isinstance(shape[0], tuple) else list(shape)
        if shape is None:
            shapes = [array.shape] if array.ndim == 1 else []
        if array.shape not in shapes:
            raise InputError(self.path, f"{section}.{key}", f"shape {list(array.shape)}", f"shape {shapes}")
        if np.isnan(array).any() or (finite and not np.isfinite(array).all()):
            raise InputError(self.path, f"{section}.{key}", "not a number", "finite numbers")
        return array
