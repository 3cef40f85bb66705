# SPDX-License-Identifier: Apache-2.0
"""The stimulus of a scene: its [stimulus] tables, and the frames that they describe."""

import array as arrays
import codecs
import io
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from dermis.errors import InputError, one_line, quoted
from dermis.ndarrays import Floats, place_of
from dermis.scene.schema import Strict, entry, filled, read_bytes
from dermis.scene.sensor import Sensor

# 131 072 frames of 16x16; a process holds them twice in 1 GB. Longer recordings come in pieces.
VALUES_MAX = 1 << 25
FILE_BYTES_MAX = 1 << 28

# A recording saved by numpy.savez has tens of arrays.
NPZ_MEMBERS_MAX = 4096


@dataclass(frozen=True)
class Frames:
    """Frames of a stimulus [frames, rows, cols], one for each reading of the array."""

    resistance_ohm: Floats  # by the sensor's law
    force_n: Floats
    t_frame_s: float  # from start to start of two readings, the chip's frame time or longer


@dataclass(frozen=True)
class Surroundings:
    """Parts of a scene that its stimulus needs."""

    scene: Path
    rows: int
    cols: int
    sensor: Sensor
    ohm_of_code: Callable[[Floats], Floats]
    t_frame_s: float
    code_max: int
    where: str = "stimulus"

    def wrong(self, key: str, value: Any, allowed: str) -> InputError:
        """The error of one key of the stimulus, or of the whole table where the key is empty."""
        return InputError(self.scene, f"{self.where}.{key}" if key else self.where, value, allowed)


Force = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Forces = Force | Annotated[list[Force], Field(min_length=1)]
Points = Annotated[list[Force], Field(min_length=2)]
Ohm = Annotated[float, Field(ge=0, allow_inf_nan=True)]
Code = Annotated[int, Field(ge=0, le=65535)]
Select = Literal["all", "first", "last"] | Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]
Shape = Literal["flat", "triangular", "cylindrical", "spherical", "round"]
Seconds = Annotated[float, Field(ge=1e-9, le=1e9)]
_SECONDS = "a finite number from 1e-9 to 1e9; or frames instead"
_FORCE = "a finite number >= 0, or a list of them, one a frame"
_POINTS = "a list of at least 2 finite numbers >= 0"
_PROFILES = (
    "flat 1; triangular 1 - |t|; cylindrical sqrt(1 - t^2); these three on the rectangle width x length; "
    "spherical sqrt(1 - t^2 - s^2) and round 1 on the ellipse in it; t and s run from -1 to 1 across width and length"
)


class _Timed(Strict):
    """Timing of a stimulus that consists of frames."""

    t_frame_s: Seconds | None = entry(
        None,
        "Time from one of its frames to the next, in s",
        "a finite number from 1e-9 to 1e9",
        default_from="the frame time of the chip, rows * timing.slot_s",
    )
    resample: Literal["none", "hold", "linear"] = entry(
        "none",
        "Stimulus between its frames, which the chip reads at its own frame time; none: one reading for each frame; "
        "hold: the newest frame; linear: conductance on a straight line from frame to frame",
    )


class _Body(Strict):
    """A stiff body: its place, shape and force."""

    shape: Shape = entry(..., "Pressure under the body: " + _PROFILES)
    force_n: Forces | None = entry(
        None,
        "Force in N on a taxel where the profile is 1; a list gives one frame, or tap, for each force",
        _FORCE + " or tap; or total_force_n instead",
    )
    total_force_n: Forces | None = entry(
        None,
        "Force in N of the whole body, shared by the taxels it touches; a list as for force_n",
        _FORCE + " or tap; or force_n instead",
    )
    width: float = entry(8.0, "Extent across the profile, in taxel pitches", gt=0)
    length: float = entry(8.0, "Extent along the ridge or axis, in taxel pitches", gt=0)
    center_row: float | None = entry(
        None,
        "Row of the centre; 0 is the centre of the first row, fractions lie between rows",
        default_from="(rows - 1) / 2",
    )
    center_col: float | None = entry(
        None, "Column of the centre, as center_row", default_from="(cols - 1) / 2"
    )
    angle_deg: float = entry(
        0.0,
        "Rotation of the width from the direction of rising columns towards rising rows, in degrees",
        ge=-360,
        le=360,
    )
    samples: int = entry(
        1,
        "1: a taxel feels the pressure at its centre; n: the mean over n x n points spread evenly over its pitch",
        ge=1,
        le=16,
    )


class _Lasting(Strict):
    """Duration of a moving stimulus; frames follow each other at the chip's frame time."""

    frames: int | None = entry(
        None, "Frames to read", "a whole number 1..2^25; or duration_s instead", ge=1, le=1 << 25
    )
    duration_s: Seconds | None = entry(
        None,
        "Or time to read for, in s, rounded up to whole frames",
        _SECONDS,
    )


class IndenterTable(_Body, _Timed):
    """A stiff body pressed into the sheet; one frame for each force."""

    kind: Literal["indenter"] = entry(..., "A body pressed into the sheet")


class SlipTable(_Body, _Lasting):
    """A stiff body that slides over the sheet."""

    kind: Literal["slip"] = entry(..., "A body that slides over the sheet, read at the chip's frame time")
    speed_pitch_per_s: float = entry(
        ..., "Speed in taxel pitches a second (100 mm/s on a pitch of 5 mm is 20)", ge=0
    )
    direction_deg: float = entry(
        0.0,
        "Direction of the motion in degrees: 0 towards rising columns, 90 towards rising rows",
        ge=-360,
        le=360,
    )
    start_s: float = entry(0.0, "Start of the motion in s; until then the body rests at its centre", ge=0)


class TappingTable(_Body, _Lasting):
    """A stiff body that taps on the sheet; a list of forces is repeated."""

    kind: Literal["tapping"] = entry(
        ...,
        "A body that taps on the sheet with these highest forces, repeated, read at the chip's frame time",
    )
    frequency_hz: float = entry(
        ..., "Taps a second; the first begins at time 0", "a finite number > 0, at most 1e6", gt=0, le=1e6
    )
    duty: float = entry(0.5, "Share of the period in contact", gt=0, le=1)
    profile: Literal["half_sine", "square"] = entry("half_sine", "Force over the time of contact")


class RampTable(_Body, _Lasting):
    """A body, or even pressure, whose force changes along straight lines."""

    kind: Literal["ramp"] = entry(
        ...,
        "A force that runs along straight lines in time, read at the chip's frame time; with the effect motion it "
        "runs inside every gate as well",
    )
    shape: Shape | None = entry(
        None, "Without it, the same force on every taxel; else pressure under a body, as for an indenter"
    )
    force_n: Points | None = entry(
        None,
        "Forces in N on a taxel where the profile is 1, at equal steps of time from the first frame to the last, "
        "joined by straight lines",
        _POINTS + "; or total_force_n instead",
    )
    total_force_n: Points | None = entry(
        None,
        "As force_n, of the whole body and shared by the taxels it touches",
        _POINTS + "; or force_n instead",
    )
    frames: int | None = entry(
        None,
        "Frames to read, the first and the last force included; left out with duration_s: one a force",
        "a whole number 2..2^25; or duration_s instead",
        ge=2,
        le=1 << 25,
    )
    duration_s: Seconds | None = entry(
        None,
        "Or time from the first force to the last, in s",
        _SECONDS,
    )


class UniformTable(_Timed):
    """The same on every taxel: force_n, code or r_ohm; a list gives one frame each."""

    kind: Literal["uniform"] = entry(..., "The same on every taxel; give exactly one of force_n, code, r_ohm")
    force_n: Forces | None = entry(None, "Force in N", _FORCE)
    code: Code | Annotated[list[Code], Field(min_length=1)] | None = entry(
        None,
        "Resistance with this ideal code: x = code / timing.gate_clocks, 510 in the stored design",
        "a whole number 0..255 (of another design 0..timing.code_max), or a list of them, one a frame",
    )
    r_ohm: Ohm | Annotated[list[Ohm], Field(min_length=1)] | None = entry(
        None,
        "Resistance in ohm; 0 is a short, inf is open",
        "a number >= 0 (inf is legal), or a list of them, one a frame",
    )


class _Stored(_Timed):
    """Frames that are ready: in a file, or in memory."""

    file: str = entry(
        ...,
        "csv (one frame a line of rows x cols values, or one row a line, rows lines a frame), npy or npz "
        "([rows, cols] or [frames, rows, cols]); relative to the scene",
        "the name of a csv, npy or npz file",
        min_length=1,
    )
    key: str | None = entry(
        None, "Name of the array in an npz file; optional if there is only one", "a name in the npz"
    )
    select: Select = entry(
        "all",
        "Numbers of the frames to use, from 0, in this order",
        'one of "all", "first", "last", or a list of frame numbers >= 0',
    )
    _given: Callable[[], NDArray[Any]] | None = PrivateAttr(None)  # arrays could not be compared

    def given(self, values: NDArray[Any]) -> Self:
        """Return this table with values in memory; `file` is then only their name in errors."""
        made = self.model_copy()
        made._given = lambda: values
        return made

    def __getstate__(self) -> dict[Any, Any]:
        """Leave the values in the process that plans: workers get the frames of their plan."""
        return super().__getstate__() | {"__pydantic_private__": {"_given": None}}


class FramesTable(_Stored):
    """Frames from a file."""

    kind: Literal["frames"] = entry(..., "Frames from a file")
    unit: Literal["codes", "newtons"] = entry(
        ...,
        "codes: 0..timing.code_max, each for the resistance with this ideal code (x = code / timing.gate_clocks); "
        "newtons: force on the taxel",
    )
    scale: float = entry(1.0, "Factor on every force, after the unit", ge=0)


class ResistanceTable(_Stored):
    """Resistances from a file."""

    kind: Literal["resistance"] = entry(..., "Resistances in ohm from a file; 0 is a short, inf is open")


_Bodies = IndenterTable | SlipTable | TappingTable | RampTable
Part = Annotated[_Bodies, Field(discriminator="kind")]


class SeveralTable(Strict):
    """Several bodies at once; their forces add."""

    kind: Literal["several"] = entry(..., "Several bodies at once; their forces add")
    parts: Annotated[list[Part], Field(min_length=1, max_length=64)] = entry(
        ...,
        "The bodies; one that ends before the others holds its last frame",
        "1 to 64 tables of kind indenter, slip, tapping or ramp, each a [[stimulus.parts]] of its own",
    )


StimulusTable = Annotated[
    _Bodies | SeveralTable | UniformTable | FramesTable | ResistanceTable, Field(discriminator="kind")
]


def resolve(table: Any, rows: int, cols: int, t_frame_s: float) -> Any:
    """Fill in what a [stimulus] table takes from the rest of the scene: its place and its time."""
    if isinstance(table, SeveralTable):
        return table.model_copy(update={"parts": [resolve(p, rows, cols, t_frame_s) for p in table.parts]})
    defaults = {"center_row": (rows - 1) / 2, "center_col": (cols - 1) / 2, "t_frame_s": t_frame_s}
    return filled(table, {key: defaults[key] for key in defaults.keys() & type(table).model_fields})


def body_profile(table: _Body, row: Floats, col: Floats, rows: int, cols: int) -> Floats:
    """Pressure relative to its peak on every taxel, [places, rows, cols], 0..1, with the centre at each place.

    With u across and v along the body, counted in pitches from its centre, t = u / (width/2) and
    s = v / (length/2): flat 1, triangular 1 - |t| (a straight ridge) and cylindrical sqrt(1 - t^2) (the half
    ellipse of Hertz for a cylinder lying on a plane) where |t| <= 1 and |s| <= 1; spherical sqrt(1 - t^2 - s^2)
    (the half ellipsoid of Hertz for a ball) and round 1 where t^2 + s^2 <= 1.
    """
    out = np.zeros((row.size, rows, cols))
    step = max(1, (1 << 20) // (rows * cols * table.samples**2))
    inside = (np.arange(table.samples) + 0.5) / table.samples - 0.5
    # Of every place [places, samples down, samples right, rows, cols].
    down = (np.arange(rows) + inside[:, np.newaxis])[:, np.newaxis, :, np.newaxis]
    right = (np.arange(cols) + inside[:, np.newaxis])[:, np.newaxis, :]
    for n in range(0, row.size, step):
        at = slice(n, n + step), *(np.newaxis,) * 4
        pressure = _pressure(table, down - row[at], right - col[at])
        out[at[0]] = pressure.reshape(-1, table.samples**2, rows, cols).sum(axis=1)
    return out / table.samples**2


def _pressure(table: _Body, down: Floats, right: Floats) -> Floats:
    angle = math.radians(table.angle_deg)
    # Half of the smallest positive width rounds to 0.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        t = (right * math.cos(angle) + down * math.sin(angle)) / (table.width / 2)
        s = (down * math.cos(angle) - right * math.sin(angle)) / (table.length / 2)
        # A centre on the edge counts as touched for any rounding of the sine of 90 degrees.
        edge = 1 + 1e-9
        if table.shape in ("spherical", "round"):
            touched = t * t + s * s <= edge
        else:
            touched = (np.abs(t) <= edge) & (np.abs(s) <= edge)
    t, s = np.where(touched, t, 0.0), np.where(touched, s, 0.0)
    profile = {
        "flat": np.ones_like,
        "round": np.ones_like,
        "triangular": lambda t: np.maximum(1 - np.abs(t), 0.0),
        "cylindrical": lambda t: np.sqrt(np.maximum(1 - t * t, 0.0)),
        "spherical": lambda t: np.sqrt(np.maximum(1 - t * t - s * s, 0.0)),
    }[table.shape](t)
    return np.where(touched, profile, 0.0)


def make_frames(table: Any, about: Surroundings) -> Frames:
    """Turn a resolved [stimulus] table into frames; raise InputError for a wrong file or key."""
    sensor = about.sensor
    if isinstance(table, _Body):
        return _body(table, about)
    if isinstance(table, SeveralTable):
        return _several(table, about)
    if isinstance(table, UniformTable):
        return _uniform(table, about)
    values = read_frames(table, about)
    if isinstance(table, ResistanceTable) or table.unit == "codes":
        ohm = values if isinstance(table, ResistanceTable) else about.ohm_of_code(values)
        values = sensor.force_n(ohm)
        if isinstance(table, ResistanceTable) or table.scale == 1:
            return _in_time(table, about, ohm, values)
    with np.errstate(over="ignore"):
        force = values * table.scale
    if not np.isfinite(force).all():
        raise about.wrong("scale", table.scale, "a factor that keeps every force finite")
    return _in_time(table, about, sensor.resistance_ohm(force), force)


def _one_of(table: Strict, keys: tuple[str, ...], about: Surroundings) -> str:
    given = [k for k in keys if getattr(table, k) is not None]
    if len(given) != 1:
        raise about.wrong("", " and ".join(given) or "nothing", "exactly one of " + ", ".join(keys))
    return given[0]


def _uniform(table: UniformTable, about: Surroundings) -> Frames:
    key = _one_of(table, ("force_n", "code", "r_ohm"), about)
    steps = _frame_steps(getattr(table, key), key, about)
    if key == "code" and steps.max() > about.code_max:
        raise about.wrong(key, f"{steps.max():g}", f"0..{about.code_max}, the codes of this design")
    steps = np.tile(steps[:, np.newaxis, np.newaxis], (1, about.rows, about.cols))
    if key == "force_n":
        return _in_time(table, about, about.sensor.resistance_ohm(steps), steps)
    ohm = about.ohm_of_code(steps) if key == "code" else steps
    return _in_time(table, about, ohm, about.sensor.force_n(ohm))


def _frame_steps(value: Any, key: str, about: Surroundings) -> Floats:
    steps = np.atleast_1d(np.asarray(value, dtype=float))
    if steps.size * about.rows * about.cols > VALUES_MAX:
        raise about.wrong(key, f"{steps.size} frames", f"at most {VALUES_MAX} values in all")
    return steps


def _body(table: _Body, about: Surroundings) -> Frames:
    key = _one_of(table, ("force_n", "total_force_n"), about)
    forces = _frame_steps(getattr(table, key), key, about)
    row, col = np.array([table.center_row]), np.array([table.center_col])
    if isinstance(table, SlipTable):
        count = _count(table, about, forces.size if forces.size > 1 else None)
        if forces.size not in (1, count):
            said = f"one force, or one for each of the {count} frames"
            raise about.wrong(key, f"{forces.size} forces", said)
        time = np.arange(count) * about.t_frame_s
        path = table.speed_pitch_per_s * np.maximum(time - table.start_s, 0.0)
        turn = math.radians(table.direction_deg)
        row, col = row + path * math.sin(turn), col + path * math.cos(turn)
        forces = np.broadcast_to(forces, count)
    elif isinstance(table, TappingTable):
        time = np.arange(_count(table, about, None)) * about.t_frame_s
        # A tap that begins on a frame begins there in spite of rounding.
        tap = np.floor(time * table.frequency_hz + 1e-9)
        with np.errstate(over="ignore"):
            phase = np.maximum(time * table.frequency_hz - tap, 0.0) / table.duty
        # A tap that ends on a frame ends there in spite of rounding.
        wave = np.sin(np.pi * np.minimum(phase, 1.0)) if table.profile == "half_sine" else phase < 1 - 1e-9
        forces = forces[(tap % forces.size).astype(int)] * np.where(phase < 1, wave, 0.0)
    elif isinstance(table, RampTable):
        count = _count(table, about, forces.size)
        last = (count - 1) * about.t_frame_s if table.duration_s is None else table.duration_s
        share = np.minimum(np.arange(count) * about.t_frame_s / last, 1.0)
        forces = np.interp(share * (forces.size - 1), np.arange(forces.size), forces)
    if table.shape is None:
        profile = np.ones((1, about.rows, about.cols))
    else:
        profile = body_profile(table, row, col, about.rows, about.cols)
    if key == "total_force_n":
        whole = profile.sum(axis=(1, 2), keepdims=True)
        if isinstance(table, IndenterTable) and not whole.all() and forces.any():
            raise about.wrong(key, table.total_force_n, "0 for a body that touches no taxel")
        # A moving body that has left the sheet presses on no taxel.
        profile = np.divide(profile, whole, out=np.zeros_like(profile), where=whole > 0)
    force = forces[:, np.newaxis, np.newaxis] * profile
    ohm = about.sensor.resistance_ohm(force)
    if isinstance(table, _Timed):
        return _in_time(table, about, ohm, force)
    return Frames(ohm, force, about.t_frame_s)


def _count(table: _Lasting, about: Surroundings, listed: int | None) -> int:
    """Return the number of frames of a moving stimulus; `listed` is that of its forces."""
    both_ends = isinstance(table, RampTable)
    if listed is None or (table.frames is not None and table.duration_s is not None):
        _one_of(table, ("frames", "duration_s"), about)
    if table.duration_s is not None:
        count = max(1, math.ceil(table.duration_s / about.t_frame_s - 1e-9)) + both_ends
    else:
        count = listed if table.frames is None else table.frames
    if count * about.rows * about.cols > VALUES_MAX:
        key = "frames" if table.duration_s is None else "duration_s"
        said = f"at most {VALUES_MAX} values in all, {VALUES_MAX // (about.rows * about.cols)} frames"
        raise about.wrong(key, getattr(table, key), said)
    return count


def _several(table: SeveralTable, about: Surroundings) -> Frames:
    force, t_frame_s = np.zeros((1, about.rows, about.cols)), None
    for n, part in enumerate(table.parts):
        here = replace(about, where=f"{about.where}.parts.{n}")
        made = make_frames(part, here)
        if made.t_frame_s != (t_frame_s := t_frame_s or made.t_frame_s):
            said = 'the same for all parts, or resample = "hold" or "linear"'
            raise here.wrong("t_frame_s", getattr(part, "t_frame_s", made.t_frame_s), said)
        count = max(len(made.force_n), len(force))
        with np.errstate(over="ignore"):
            force = _held(made.force_n, count) + _held(force, count)
        if not np.isfinite(force).all():
            raise here.wrong("", "its forces", "a sum that stays finite")
    return Frames(about.sensor.resistance_ohm(force), force, t_frame_s)


def _held(values: Floats, count: int) -> Floats:
    return values[np.minimum(np.arange(count), values.shape[0] - 1)]


def _in_time(table: _Timed, about: Surroundings, ohm: Floats, force: Floats) -> Frames:
    """Return the frames that the chip reads of a stimulus; see `_Timed.resample`."""
    steps = about.t_frame_s / table.t_frame_s
    # Frame times are decimals, compared up to rounding; so is a frame on the border of two, below.
    if abs(steps - 1) < 1e-9:
        return Frames(ohm, force, about.t_frame_s)
    frames = ohm.shape[0]
    if table.resample == "none":
        if steps > 1:
            said = f'at least the frame time of the chip, {about.t_frame_s:g} s, or resample = "hold" or "linear"'
            raise about.wrong("t_frame_s", table.t_frame_s, said)
        return Frames(ohm, force, table.t_frame_s)
    hold = table.resample == "hold"
    # hold: the last frame lasts as long as the others; linear: the last one is the end.
    count = math.ceil(frames / steps - 1e-9) if hold else math.floor((frames - 1) / steps + 1e-9) + 1
    if count * about.rows * about.cols > VALUES_MAX:
        said = f"a time that makes at most {VALUES_MAX} values, not {count} frames"
        raise about.wrong("t_frame_s", table.t_frame_s, said)
    place = np.arange(max(count, 1)) * steps
    first = np.minimum(np.floor(place + 1e-9).astype(int), frames - 1)
    if hold:
        return Frames(ohm[first], force[first], about.t_frame_s)
    share = (place - first)[:, np.newaxis, np.newaxis]
    # The rounding of the place, as above.
    share[share < 1e-9] = 0.0
    before, after = ohm[first], ohm[np.minimum(first + 1, frames - 1)]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        between = 1.0 / ((1.0 - share) / before + share / after)
    kept = (share == 0) | (before == after)
    ohm = np.where(kept, before, between)
    return Frames(ohm, np.where(kept, force[first], about.sensor.force_n(ohm)), about.t_frame_s)


def read_frames(table: _Stored, about: Surroundings) -> Floats:
    """Return the frames of a table's file, [frames, rows, cols], checked."""
    if table._given is not None:
        values = _shaped(np.asarray(table._given()), table.file, about)
    else:
        values = _read_file(table, about)
    _check_values(values, table.file, table, about.code_max)
    # -0.0 becomes 0.0: 1 / -0.0 would be -inf.
    return values[_selected(table, values.shape[0], about)] + 0.0


def _read_file(table: _Stored, about: Surroundings) -> Floats:
    shown, suffix = table.file, Path(table.file).suffix.lower()
    if table.key is not None and suffix != ".npz":
        raise about.wrong("key", quoted(table.key), "left out, except for an npz file")
    if suffix not in (".csv", ".npy", ".npz"):
        raise about.wrong("file", quoted(shown), "a file that ends in .csv, .npy or .npz")
    data = read_bytes(about.scene.parent / shown, FILE_BYTES_MAX, (about.scene, f"{about.where}.file", shown))
    if suffix == ".csv":
        return _read_csv(data, shown, about)
    return _read_numpy(data, shown, suffix, table, about)


def _selected(table: _Stored, frames: int, about: Surroundings) -> list[int] | slice:
    if isinstance(table.select, str):
        return {"all": slice(None), "first": slice(0, 1), "last": slice(frames - 1, frames)}[table.select]
    for number in table.select:
        if number >= frames:
            raise about.wrong("select", number, f"frame numbers 0..{frames - 1}")
    if len(table.select) * about.rows * about.cols > VALUES_MAX:
        raise about.wrong("select", f"{len(table.select)} frames", f"at most {VALUES_MAX} values in all")
    return list(table.select)


def _check_values(values: Floats, shown: str, table: _Stored, code_max: int) -> None:
    if isinstance(table, ResistanceTable):
        good, allowed = values >= 0, "a resistance >= 0 in ohm (inf is legal)"
    elif table.unit == "codes":
        good = (values >= 0) & (values <= code_max) & (np.floor(values) == values)
        allowed = f"a whole number 0..{code_max}"
    else:
        good, allowed = (values >= 0) & np.isfinite(values), "a finite force >= 0 in newtons"
    if not good.all():
        raise InputError(shown, place_of(~good), float(values[~good][0]), allowed)


def _read_csv(data: bytes, shown: str, about: Surroundings) -> Floats:
    """Return the values of a csv file [frames, rows, cols]; the first that is wrong is named."""
    rows, cols = about.rows, about.cols
    data = data.removeprefix(codecs.BOM_UTF8)
    if not data.isascii():
        at = next(i for i, byte in enumerate(data) if byte > 127)
        raise InputError(shown, f"byte {at}", data[at], "numbers separated by commas")
    layout = f"{rows * cols} values (a frame) or {cols} values (a row of it)"
    values, width = arrays.array("d"), 0
    # Any of LF, CR LF and CR ends a line.
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), encoding="ascii"), start=1):
        if number > VALUES_MAX:
            raise InputError(shown, f"line {number}", "one line more", f"at most {VALUES_MAX} lines")
        if line.isspace():
            continue
        # Counted before it is split: a line may be the whole file.
        found = line.count(",") + 1
        width = width or found
        if found != width or width not in (rows * cols, cols):
            allowed = f"{width} values, as the lines above" if found != width else layout
            raise InputError(shown, f"line {number}", f"{found} values", allowed)
        if (total := len(values) + found) > VALUES_MAX:
            raise InputError(shown, f"line {number}", f"{total} values", f"at most {VALUES_MAX} values")
        cells = line.split(",")
        try:
            values.extend(map(_number, cells) if "_" in line else map(float, cells))
        except ValueError:
            place = len(values) % width + 1
            said = quoted(cells[place - 1].strip())
            raise InputError(shown, f"line {number}, value {place}", said, "a number") from None
    if not width:
        raise InputError(shown, "lines", 0, f"at least one line of {layout}")
    lines = len(values) // width
    if width == cols != rows * cols and lines % rows:
        raise InputError(shown, "lines", lines, f"whole frames of {rows} lines of {cols} values")
    return np.frombuffer(values).reshape(-1, rows, cols)


def _number(cell: str) -> float:
    """Return the number of a text; float() alone takes 1_000 as well."""
    return float(cell.replace("_", "no number"))


def _read_numpy(data: bytes, shown: str, suffix: str, table: _Stored, about: Surroundings) -> Floats:
    try:
        array = npz_member(data, shown, table.key) if suffix == ".npz" else npy_array(data, shown)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # zip, header and dtype parsers raise whatever they like on garbage
        reason = one_line(str(error) or type(error).__name__, 200)
        allowed = f"a readable {suffix[1:]} file ({reason})"
        raise InputError(shown, "file", Path(shown).name, allowed) from None
    return _shaped(array, shown, about)


def _shaped(array: NDArray[Any], shown: str, about: Surroundings) -> Floats:
    """Return values as doubles [frames, rows, cols]."""
    if array.dtype.kind not in "iuf":
        raise InputError(shown, "dtype", str(array.dtype), "integers or floating point numbers")
    if array.size > VALUES_MAX:
        raise InputError(shown, "shape", list(array.shape), f"at most {VALUES_MAX} values")
    if array.ndim == 2:
        array = array[np.newaxis]
    if array.ndim != 3 or array.shape[1:] != (about.rows, about.cols) or array.shape[0] < 1:
        allowed = f"[{about.rows}, {about.cols}] or [frames, {about.rows}, {about.cols}]"
        raise InputError(shown, "shape", list(array.shape), allowed)
    # Values too large for a double become inf, and signalling NaN quiet ones; both are refused later with their place.
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(float)


def npy_array(data: bytes, shown: str, kinds: str = "iuf") -> NDArray[Any]:
    # The header is checked against the bytes of the file: 80 bytes can claim a petabyte.
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"npy version {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or dtype.kind not in kinds:
        raise InputError(shown, "dtype", str(dtype), "integers or floating point numbers")
    values = math.prod(int(n) for n in shape)
    if values > VALUES_MAX:
        raise InputError(shown, "shape", list(shape), f"at most {VALUES_MAX} values")
    if values * dtype.itemsize > len(data) - stream.tell():
        raise InputError(shown, "shape", list(shape), "no more values than the file holds")
    flat = np.frombuffer(data, dtype=dtype, count=values, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran else "C")


def npz_member(data: bytes, shown: str, key: str | None, kinds: str = "iuf") -> NDArray[Any]:
    # zipfile takes hundreds of bytes of memory for each entry of 46 bytes before it can be checked.
    if (entries := data.count(b"PK\x01\x02")) > NPZ_MEMBERS_MAX:
        raise InputError(shown, "members", entries, f"at most {NPZ_MEMBERS_MAX} arrays")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = [n.removesuffix(".npy") for n in archive.namelist()]
        if key is None and len(names) == 1:
            key = names[0]
        if key is None or key not in names:
            listed = ", ".join(one_line(n) for n in names[:10])
            raise InputError(shown, "key", "nothing" if key is None else quoted(key), f"one of {listed}")
        member = archive.getinfo(next(n for n in archive.namelist() if n.removesuffix(".npy") == key))
        # The methods of numpy; an LZMA stream may ask for a dictionary of 4 GB before the first byte.
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            method = zipfile.compressor_names.get(member.compress_type, member.compress_type)
            raise InputError(shown, key, f"compressed by {method}", "stored or deflated, as numpy.savez does")
        limit = VALUES_MAX * 8 + 4096
        if member.file_size > limit:
            raise InputError(shown, key, f"{member.file_size} bytes", f"at most {limit} bytes unpacked")
        with archive.open(member) as stream:
            # The size in the directory is a claim; this read is bounded by it.
            unpacked = stream.read(member.file_size + 1)
    if len(unpacked) != member.file_size:
        said = f"the {member.file_size} bytes that its entry says"
        raise InputError(shown, key, f"{len(unpacked)} bytes or more unpacked", said)
    return npy_array(unpacked, shown, kinds)
