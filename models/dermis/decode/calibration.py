# SPDX-License-Identifier: Apache-2.0
"""The calibration of a sheet and its read-out: one TOML file with uncertainties."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from tomli_w import dumps

from dermis import effects
from dermis.array.array import Network
from dermis.converter.vfc import W_PRESET, code, code_type
from dermis.decode.crosstalk import CARRIED, CORRECTED
from dermis.decode.force import start_of
from dermis.decode.law import PARAMETERS, Curve, of_sensor
from dermis.decode.memory import MemoryLaw
from dermis.errors import InputError, counted
from dermis.files import text_of, write_atomic
from dermis.machine_code import argument
from dermis.ndarrays import Floats
from dermis.records import Plan, setting_of
from dermis.scene.front_end import FrontEnd
from dermis.scene.sensor import Random, SensorState, spread_factor

FORMAT = 1
COVERAGE_SIGMA = 3.5
"""Standard uncertainties that an interval covers: 0.05 % of a normal error lie beyond."""
MISSED = 5e-4
"""Share of readings that quantisation and noise may put beyond an interval."""
OVERLOAD = 4.0
"""Default of g_max_s: a saturated taxel conducts at most this many times full scale."""

UNKNOWN_PART = 1e6
"""Relative uncertainty of a taxel that does not read a force: its interval has no upper end."""
UNSEEN_DECADES = 0.05
"""Creep in decades that a load below half a code causes unseen before it is in sight: 1.2 ms of it at the default start
of creep. One that stays out of sight between two loads is followed (`memory.GAP_S`)."""

_PER_COLUMN = "step_a start_code inv_i_range_a step_part start_sigma_code zero_code full_code".split()
_NOT_NEGATIVE = "inv_i_range_a step_part start_sigma_code zero_code full_code factor factor_part".split()
_PIECES, _CREEP = "knots coefficients", "creep_per_decade creep_start_s"
_NETWORK = CARRIED | CORRECTED
_TABLES = frozenset("format notes array chip network sheet own_law memory uncertainty mode reference".split())


@dataclass(frozen=True, eq=False)
class Mode:
    """A joint error of one standard uncertainty: resistances, and the factors that fit the loads with them.

    `network` has the fields of array.Network that differ; `factor_part` [rows, cols] is the relative change of factors.
    """

    network: dict[str, Any]
    factor_part: Floats


@dataclass(frozen=True, eq=False)
class Calibration:
    """Everything that a decoder knows of one sheet and its chip.

    A code c is the column current step_a (c - start_code), before compression by inv_i_range_a. A conductance over
    `factor` is that of `curve`; `memory` lies between the two.

    v_bias_v : in volt.
    step_a, start_code, inv_i_range_a : [cols] ampere a code, the code of no current, 1/A.
    network : fields of array.Network other than taxels and bias.
    curve : law of all taxels.
    own : laws of taxels that have their own, by (row, column); of the same kind.
    factor : [rows, cols] relative conductance of each taxel, temperature included.
    reference : (row, column, conductance in siemens) of taxels of constant force; what they read tells the temperature.
    g_max_s : largest conductance of a taxel in siemens, as a bound for saturated ones.
    noise_code : standard deviation of a reading in codes.
    zero_code : [cols] code of a column without current: a start above the level counts at once. A negative current may
        read this or less.
    full_code : [cols] code of a column at full scale, where every second clock takes a packet: a late start makes it
        less than code_max, the default. A larger current may read no more than that.
    step_part, start_sigma_code : [cols] standard uncertainty of step_a, relative, and of start_code.
    factor_part : [rows, cols] standard uncertainty of factor, relative.
    law_part : standard uncertainty of the force by the curve, relative.
    uncorrected_part : bound of a relative error of conductance that is not corrected.
    modes : uncertainty of the network: independent errors.
    offset_v2 : [3, cols] covariance of the columns' offset voltages in V^2, given the resistances: of each with itself,
        with the next column and with the one after.
    falling : the codes that come from the board fall with current: `rising` turns them round.
    divider : r_column_ohm is a divider's resistor, which sets step_a as well.
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
    falling: bool = False
    divider: bool = False
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.full_code is None:
            object.__setattr__(self, "full_code", float(self.code_max))
        shapes = dict.fromkeys(_PER_COLUMN, (self.cols,)) | {"offset_v2": (3, self.cols)}
        shapes |= dict.fromkeys(("factor", "factor_part"), (self.rows, self.cols))
        # What compiled loops take as it is: an index outside, or a shape of another sheet, would read foreign memory.
        for name, shape in shapes.items():
            array = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), shape).copy()
            least = 0.0 if name in _NOT_NEGATIVE else None
            object.__setattr__(self, name, argument(array, name, shape, least))
        for name in ("v_bias_v", "g_max_s", "noise_code", "law_part", "uncorrected_part"):
            argument(getattr(self, name), name, (), 0.0)
        for mode in self.modes:
            argument(mode.factor_part, "factor_part of a mode", (self.rows, self.cols))
        for r, c, *_ in (*self.reference, *self.own):
            if not (0 <= r < self.rows and 0 <= c < self.cols):
                raise ValueError(f"taxel {r}, {c} is not one of {self.rows} x {self.cols}")
        if not (self.step_a > 0).all() or not self.v_bias_v > 0:
            raise ValueError("step_a and v_bias_v must be above 0")

    @classmethod
    def of_plan(cls, plan: Plan) -> Calibration:
        """Return the calibration that knows a plan's every parameter exactly; noise is 0."""
        setting = setting_of(plan.scene)
        state = SensorState(**effects.gather(plan.scene.effects, setting).sensor)
        factor = sheet_factor(state, (plan.rows, plan.cols), setting.rng)
        start_s = plan.scene.design.sensor.creep_start_s
        memory = MemoryLaw.of_effects(state.hysteresis, state.creep_per_decade, start_s)
        sheet = {"curve": of_sensor(plan.sensor), "factor": factor, "memory": memory}
        sheet |= {"network": dict(plan.surrounding)}
        sheet |= {"uncorrected_part": UNSEEN_DECADES * state.creep_per_decade}
        read_out = _of_chip(plan) if plan.front_end is None else _of_board(plan.front_end)
        return cls(rows=plan.rows, cols=plan.cols, v_bias_v=plan.v_bias_v, **read_out, **sheet)

    def rising(self, codes: NDArray) -> NDArray:
        """Return codes that rise with current, for those of the board, or the reverse."""
        return self.code_max - codes.astype(np.int64) if self.falling else codes

    def least_code(self) -> Floats:
        """Return the least rising code [cols] that a column without current may read by noise and drift."""
        return self.start_code - max(4.0, 0.002 * self.code_max) - 4.0 * self.noise_code

    def codes_of(self, current_a: Floats) -> NDArray[np.unsignedinteger]:
        """Return the codes [..., cols] that a board reads of column currents in ampere, without compression."""
        codes = np.floor(current_a / self.step_a + self.start_code + 0.5).clip(0, self.code_max)
        return self.rising(codes).astype(code_type(self.code_max))

    def array(self, mode: Mode | None = None) -> Network:
        """Return the network around the taxels, or the one that is off by a mode."""
        values = self.network if mode is None else self.network | mode.network
        return Network(np.zeros((self.rows, self.cols)), self.v_bias_v, **values)

    def current_part(self, network: Network) -> Floats:
        """Return the currents [cols] of readings in a network over those by step_a: a divider's resistor sets both."""
        return self.array().r_column_ohm / network.r_column_ohm if self.divider else np.ones(self.cols)

    def law_of(self, row: int, col: int) -> Curve:
        """Return the law of a taxel."""
        return self.own.get((row, col), self.curve)

    def uncorrected_n(self, codes: NDArray) -> Floats:
        """Return the forces in newtons of codes [..., cols], each as if its taxel were alone and by the law."""
        current_a = np.maximum(self.step_a * (self.rising(codes) - self.start_code), 0.0)
        return self.curve.force_n(self._alone_s(current_a))

    def g_full_s(self) -> float:
        """Return the largest conductance in siemens of a taxel that alone reads full scale."""
        return float(np.minimum(self._alone_s(self.full_code * self.step_a), self.g_max_s).max())

    def _alone_s(self, current_a: Floats) -> Floats:
        """Return the conductances of taxels that alone draw currents [..., cols]; a divider takes voltage from them."""
        left_v = self.v_bias_v - self.divider * current_a * self.array().r_column_ohm
        return current_a / np.maximum(left_v, 1e-9)

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

    def doubts(self) -> Iterator[str]:
        """Yield what the intervals of readings with this calibration do not know."""
        unread = np.argwhere(self.factor_part >= UNKNOWN_PART)
        if len(unread):
            first = "; ".join(f"{r} {c}" for r, c in unread[:4]) + (" ..." if len(unread) > 4 else "")
            said = f"{counted(len(unread), 'taxel')} without a response to force (row, column {first})"
            yield f"{said}: totals lack them, and what they carry moves their neighbours"
        if not self.noise_code:
            yield "no reading was repeated, or none differed: intervals are those of readings without noise"
        if not self.memory.active and not self.uncorrected_part:
            yield "no [[cycle]] was measured: intervals are those of a sheet without hysteresis and creep"

    def to_toml(self) -> str:
        """Return the calibration as text; `load` reads the same one."""
        sheet = _values(self.curve, "kind logarithmic g_open_s force_on_n")
        sheet |= _values(self, "law_part uncorrected_part") | _values(self.curve, _PIECES)
        data = {
            "format": FORMAT,
            "notes": list(self.notes),
            "array": _values(self, "rows cols g_max_s"),
            "chip": _values(self, "code_max v_bias_v noise_code falling divider", *_PER_COLUMN),
            "network": _plain(self.network),
            "sheet": sheet | _values(self, "factor factor_part"),
            "own_law": [{"row": r, "col": c, **_values(law, _PIECES)} for (r, c), law in self.own.items()],
            "memory": _values(self.memory, "radius weight", _CREEP),
            "uncertainty": _values(self, "offset_v2"),
            "mode": [{"network": _plain(m.network), **_values(m, "factor_part")} for m in self.modes],
            "reference": [{"row": r, "col": c, "conductance_s": g} for r, c, g in self.reference],
        }
        return dumps(data)

    def save(self, path: Path) -> None:
        """Write the calibration whole or not at all."""
        write_atomic(path, self.to_toml())


def _of_board(board: FrontEnd) -> dict[str, Any]:
    """Return the fields of a calibration that say how a board turns currents into counts."""
    codes = {"code_max": board.full_scale, "zero_code": board.zero_count, "full_code": board.full_count}
    codes |= {"step_a": board.step_a, "start_code": board.start_count, "inv_i_range_a": 0.0}
    return codes | {"g_max_s": OVERLOAD * board.g_max_s, "falling": board.falling, "divider": board.divider}


def _of_chip(plan: Plan) -> dict[str, Any]:
    """Return the fields of a calibration that say how the chip of a plan turns currents into codes."""
    c, gate, code_max = plan.converter, plan.timing.gate_clocks, plan.timing.code_max
    (packet, start), packet_v = start_of(c), c.packet_v()
    step_a = c.k * c.i0_a * packet / (gate * c.gain)
    level = {"w0": W_PRESET + c.preset_error_v / packet_v, "packet": packet}
    level["threshold"] = c.v_comp_offset_v / packet_v
    none, full = (code(part * packet, gate, code_max, **level).astype(float) for part in (0.0, 0.5))
    return {
        "code_max": code_max,
        "zero_code": none,
        "full_code": full,
        "step_a": step_a,
        "start_code": 0.5 - start / packet + gate * c.i_offset_a / (c.i0_a * packet),
        "inv_i_range_a": c.inv_i_range_a,
        "g_max_s": OVERLOAD * code_max * float(step_a.max()) / plan.v_bias_v,
    }


def sheet_factor(state: SensorState, shape: tuple[int, int], rng: Random) -> Floats:
    """Return the relative conductance of the taxels of a sheet, [rows, cols], by temperature and spread."""
    factor = np.full(shape, 1.0 + state.temperature_error)
    if state.spread:
        factor = factor * spread_factor(rng("sensor_spread").standard_normal(shape), state.spread)
    return factor


def _values(of: Any, *names: str) -> dict[str, Any]:
    """Return attributes by name, arrays as lists."""
    return _plain({name: getattr(of, name) for name in " ".join(names).split()})


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in values.items()}


def load(path: Path | str) -> Calibration:
    """Read a calibration; InputError for no such file, no TOML, a missing key or a value of a wrong kind or size."""
    path = Path(path)
    try:
        data = tomllib.loads(text_of(path, "a calibration that `dermis calibrate` wrote"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(path, "file", str(error), "a calibration that `dermis calibrate` wrote") from None
    if data.get("format") != FORMAT:
        raise InputError(path, "format", data.get("format"), f"{FORMAT}, a calibration of this version")

    def each(name: str) -> list[_Table]:
        return [_Table(path, f"{name}.{n}", one) for n, one in enumerate(data.get(name, []))]

    if unknown_key := data.keys() - _TABLES:
        raise InputError(path, min(unknown_key), "a table", "one of " + ", ".join(sorted(_TABLES)))
    array, chip, sheet, memory = (_Table(path, n, data.get(n)) for n in ("array", "chip", "sheet", "memory"))
    rows, cols, code_max = array.whole("rows"), array.whole("cols"), chip.whole("code_max")
    taxels, radius = (rows, cols), memory.numbers("radius", None)
    # The first versions had no codes of none and of full scale, and no uncertainty of offsets.
    first = {"zero_code": [0.0] * cols, "full_code": [code_max] * cols, "falling": False, "divider": False}
    chip.data = first | chip.data
    known = data.get("uncertainty", {"offset_v2": np.zeros((3, cols)).tolist()})
    kind, logarithmic = sheet.value("kind", str), sheet.value("logarithmic", bool)
    curve = Curve(kind, logarithmic, **sheet.floats("g_open_s force_on_n"), **sheet.pieces())
    if curve.kind not in PARAMETERS:
        raise InputError(path, "sheet.kind", curve.kind, "one of " + ", ".join(PARAMETERS))
    try:
        made = Calibration(
            rows=rows,
            cols=cols,
            code_max=code_max,
            **chip.floats("v_bias_v noise_code"),
            network=_Table(path, "network", data.get("network", {})).network(cols),
            curve=curve,
            factor=sheet.numbers("factor", taxels, positive=True),
            memory=MemoryLaw(radius, memory.numbers("weight", radius.shape), **memory.floats(_CREEP)),
            **array.floats("g_max_s"),
            own={one.place(rows, cols): replace(curve, **one.pieces()) for one in each("own_law")},
            reference=tuple(
                (*t.place(rows, cols), *t.floats("conductance_s").values()) for t in each("reference")
            ),
            factor_part=sheet.numbers("factor_part", taxels),
            **sheet.floats("law_part uncorrected_part"),
            modes=tuple(
                Mode(t.inner("network").network(cols), t.numbers("factor_part", taxels)) for t in each("mode")
            ),
            offset_v2=_Table(path, "uncertainty", known).numbers("offset_v2", (3, cols)),
            notes=tuple(data.get("notes", ())),
            **{name: chip.value(name, bool) for name in ("falling", "divider")},
            **{name: chip.numbers(name, (cols,), positive=name == "step_a") for name in _PER_COLUMN},
        )
    except ValueError as error:
        raise InputError(path, "values", "out of range", str(error)) from None
    try:
        for mode in (None, *made.modes):
            made.array(mode)
    except ValueError as error:
        raise InputError(path, "network", "its values", str(error)) from None
    taxel_s = np.linspace(0.0, made.g_full_s(), 100)
    if not all(law.force_n(taxel_s).max() > 0.0 for law in (curve, *made.own.values())):
        allowed = "the law that `dermis calibrate` wrote"
        raise InputError(path, "sheet", "no force at any conductance", allowed)
    return made


class _Table:
    """A table of the file; an error names its key."""

    def __init__(self, path: Path, name: str, data: Any) -> None:
        self.path, self.name = path, name
        self.data: dict[str, Any] = data if isinstance(data, dict) else {}

    def _wrong(self, key: str, value: Any, allowed: str) -> InputError:
        return InputError(self.path, f"{self.name}.{key}", value, allowed)

    def value(self, key: str, kind: type | tuple[type, ...]) -> Any:
        found = self.data.get(key)
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise self._wrong(key, found, "the value that `dermis calibrate` wrote")
        return found

    def whole(self, key: str) -> int:
        found = self.value(key, int)
        if not 1 <= found <= 1 << 16:
            raise self._wrong(key, found, "a whole number 1..65536")
        return found

    def place(self, rows: int, cols: int) -> tuple[int, int]:
        found = self.value("row", int), self.value("col", int)
        if not (0 <= found[0] < rows and 0 <= found[1] < cols):
            raise InputError(self.path, self.name, f"taxel {found}", f"a taxel of {rows} x {cols}")
        return found

    def inner(self, key: str) -> _Table:
        return _Table(self.path, f"{self.name}.{key}", self.data.get(key))

    def network(self, cols: int) -> dict[str, Any]:
        if unknown := self.data.keys() - _NETWORK:
            raise self._wrong(min(unknown), "a key", "one of " + ", ".join(sorted(_NETWORK)))
        free = "r_row_grounded_ohm"  # inf: rows that are not driven are open
        return {name: self.numbers(name, (), (cols,), finite=name != free)[()] for name in self.data}

    def pieces(self) -> dict[str, Floats]:
        knots = self.numbers("knots", None)
        return {"knots": knots, "coefficients": self.numbers("coefficients", (knots.size, 4))}

    def floats(self, names: str) -> dict[str, float]:
        return {name: float(self.numbers(name, ())) for name in names.split()}

    def numbers(self, key: str, *shapes: Any, finite: bool = True, positive: bool = False) -> Floats:
        """Return an array of one of some shapes; None is any length."""
        found = self.value(key, (int, float, list))
        try:
            # As objects, or true beside numbers would be 1.
            cells = np.asarray(found, dtype=object)
            if any(isinstance(cell, bool | str) for cell in cells.flat):
                raise TypeError
            array = cells.astype(float)
        except (ValueError, TypeError, OverflowError):
            raise self._wrong(key, found, "numbers in equal rows") from None
        if array.shape not in shapes and not (shapes == (None,) and array.ndim == 1):
            raise self._wrong(key, f"shape {list(array.shape)}", f"shape {list(shapes)}")
        if np.isnan(array).any() or (finite and not np.isfinite(array).all()):
            raise self._wrong(key, "not a number", "finite numbers")
        if positive and not (array > 0).all():
            raise self._wrong(key, array.min(), "numbers > 0")
        return array
