# SPDX-License-Identifier: Apache-2.0
"""What presses on the sheet: the [stimulus] tables of a scene and the frames they stand for."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dermis.errors import InputError, one_line, quoted
from dermis.schema import Strict, entry, read_bytes
from dermis.sensor import InverseSensor

Floats = NDArray[np.float64]

# 131 072 frames of 16x16: what one process holds twice over in 1 GB. Longer recordings come in pieces.
VALUES_MAX = 1 << 25
FILE_BYTES_MAX = 1 << 28

CODE_MAX = 255


@dataclass(frozen=True)
class Frames:
    """What the sheet goes through: resistance_ohm and force_n (newtons, or None), [frames, rows, cols]."""

    resistance_ohm: Floats
    force_n: Floats | None


@dataclass(frozen=True)
class Surroundings:
    """What a stimulus needs to know of the rest of the scene."""

    scene: Path
    rows: int
    cols: int
    sensor: InverseSensor
    force_of_code: Callable[[Floats], Floats]


Finite = Annotated[float, Field(allow_inf_nan=False)]
Force = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Ohm = Annotated[float, Field(ge=0, allow_inf_nan=True)]
Code = Annotated[int, Field(ge=0, le=CODE_MAX)]
_FORCE = "a finite number >= 0, or a list of them, one a frame"


class IndenterTable(Strict):
    """A stiff body pressed into the sheet; one frame for each force."""

    kind: Literal["indenter"] = entry(..., "A body pressed into the sheet", '"indenter"')
    shape: Literal["flat", "triangular", "cylindrical"] = entry(
        ...,
        "Pressure along the width: flat 1, triangular 1 - |t|, cylindrical sqrt(1 - t^2), t = -1..1 from "
        "edge to edge; along the length always constant",
        'one of "flat", "triangular", "cylindrical"',
    )
    force_n: Force | Annotated[list[Force], Field(min_length=1)] = entry(
        ..., "Force in N on a taxel where the profile is 1; a list makes one frame each", _FORCE
    )
    width: float = entry(8.0, "Extent across the profile, in taxel pitches", "a finite number > 0", gt=0)
    length: float = entry(
        8.0, "Extent along the ridge or axis, in taxel pitches", "a finite number > 0", gt=0
    )
    center_row: float | None = entry(
        None,
        "Row of the centre; 0 is the centre of the first row, fractions lie between rows",
        "a finite number",
        default_from="(rows - 1) / 2",
    )
    center_col: float | None = entry(
        None, "Column of the centre, as center_row", "a finite number", default_from="(cols - 1) / 2"
    )
    angle_deg: float = entry(
        0.0,
        "Turn of the width from the direction of rising columns towards rising rows, in degrees",
        "a finite number from -360 to 360",
        ge=-360,
        le=360,
    )


class UniformTable(Strict):
    """The same on every taxel; exactly one of force_n, code, r_ohm; a list makes one frame each."""

    kind: Literal["uniform"] = entry(
        ..., "The same on every taxel; give exactly one of the keys below", '"uniform"'
    )
    force_n: Force | Annotated[list[Force], Field(min_length=1)] | None = entry(None, "Force in N", _FORCE)
    code: Code | Annotated[list[Code], Field(min_length=1)] | None = entry(
        None,
        "The force whose ideal code this is: x = code / 510",
        "a whole number 0..255, or a list of them, one a frame",
    )
    r_ohm: Ohm | Annotated[list[Ohm], Field(min_length=1)] | None = entry(
        None,
        "Resistance in ohm; 0 is a short, inf is open",
        "a number >= 0 (inf is legal), or a list of them, one a frame",
    )


class FramesTable(Strict):
    """Frames from a file."""

    kind: Literal["frames"] = entry(..., "Frames from a file", '"frames"')
    file: str = entry(
        ...,
        "csv (one frame a line of rows x cols values, or one row a line, rows lines a frame), npy or npz "
        "([rows, cols] or [frames, rows, cols]); relative to the scene",
        "the name of a csv, npy or npz file",
        min_length=1,
    )
    key: str | None = entry(
        None, "Which array of an npz file; may be left out where there is one", "a name in the npz"
    )
    unit: Literal["codes", "newtons"] = entry(
        ...,
        "codes: 0..255, each stands for the force whose ideal code it is (x = code / 510), 255 too; "
        "newtons: force on the taxel",
        'one of "codes", "newtons"',
    )
    scale: float = entry(1.0, "Factor on every force, after the unit", "a finite number >= 0", ge=0)
    select: (
        Literal["all", "first", "last"] | Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]
    ) = entry(
        "all",
        "Which frames, counted from 0, in the order given",
        'one of "all", "first", "last", or a list of frame numbers >= 0',
    )


class ResistanceTable(Strict):
    """Resistances from a file."""

    kind: Literal["resistance"] = entry(..., "Resistances from a file", '"resistance"')
    file: str = entry(
        ...,
        "csv, npy or npz laid out as for frames, in ohm; 0 is a short, inf is open; relative to the scene",
        "the name of a csv, npy or npz file",
        min_length=1,
    )
    key: str | None = entry(
        None, "Which array of an npz file; may be left out where there is one", "a name in the npz"
    )
    select: (
        Literal["all", "first", "last"] | Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]
    ) = entry(
        "all",
        "Which frames, counted from 0, in the order given",
        'one of "all", "first", "last", or a list of frame numbers >= 0',
    )


StimulusTable = Annotated[
    IndenterTable | UniformTable | FramesTable | ResistanceTable, Field(discriminator="kind")
]


def indenter_profile(table: IndenterTable, rows: int, cols: int) -> Floats:
    """Pressure relative to its peak at the centre of every taxel, [rows, cols], 0..1.

    With u across and v along the body, counted in pitches from its centre, a taxel is touched where its
    centre has |u| <= width/2 and |v| <= length/2. With t = u / (width/2): flat 1; triangular 1 - |t|, a
    straight ridge; cylindrical sqrt(1 - t^2), the half ellipse of Hertz for a cylinder lying on a plane.
    """
    if table.center_row is None or table.center_col is None:
        raise ValueError("the [stimulus] table is not resolved: the centre has no value")
    angle = math.radians(table.angle_deg)
    down = np.arange(rows, dtype=float)[:, np.newaxis] - table.center_row
    right = np.arange(cols, dtype=float)[np.newaxis, :] - table.center_col
    with np.errstate(over="ignore", invalid="ignore"):
        t = (right * math.cos(angle) + down * math.sin(angle)) / (table.width / 2)
        s = (down * math.cos(angle) - right * math.sin(angle)) / (table.length / 2)
    # A centre on the edge counts as touched whatever way the sine of 90 degrees rounds.
    touched = (np.abs(t) <= 1 + 1e-9) & (np.abs(s) <= 1 + 1e-9)
    t = np.clip(np.where(touched, t, 0.0), -1.0, 1.0)
    profile = {"flat": np.ones_like(t), "triangular": 1 - np.abs(t), "cylindrical": np.sqrt(1 - t * t)}[
        table.shape
    ]
    return np.where(touched, profile, 0.0)


def make_frames(table: Any, about: Surroundings) -> Frames:
    """Turn a resolved [stimulus] table into frames; InputError for what is wrong in file or keys."""
    sensor = about.sensor
    if isinstance(table, IndenterTable):
        profile = indenter_profile(table, about.rows, about.cols)
        force = _frame_steps(table.force_n, "force_n", about)[:, np.newaxis, np.newaxis] * profile
        return Frames(sensor.resistance_ohm(force), force)
    if isinstance(table, UniformTable):
        return _uniform(table, about)
    values = read_frames(table, about)
    if isinstance(table, ResistanceTable):
        return Frames(values, sensor.force_n(values))
    if table.unit == "codes":
        values = about.force_of_code(values)
    with np.errstate(over="ignore"):
        force = values * table.scale
    if not np.isfinite(force).all():
        raise InputError(about.scene, "stimulus.scale", table.scale, "a factor that keeps every force finite")
    return Frames(sensor.resistance_ohm(force), force)


def _uniform(table: UniformTable, about: Surroundings) -> Frames:
    given = [k for k in ("force_n", "code", "r_ohm") if getattr(table, k) is not None]
    if len(given) != 1:
        found = " and ".join(given) or "nothing"
        raise InputError(about.scene, "stimulus", found, "exactly one of force_n, code, r_ohm")
    steps = _frame_steps(getattr(table, given[0]), given[0], about)
    steps = np.tile(steps[:, np.newaxis, np.newaxis], (1, about.rows, about.cols))
    if given[0] == "r_ohm":
        return Frames(steps, about.sensor.force_n(steps))
    force = about.force_of_code(steps) if given[0] == "code" else steps
    return Frames(about.sensor.resistance_ohm(force), force)


def _frame_steps(value: Any, key: str, about: Surroundings) -> Floats:
    steps = np.atleast_1d(np.asarray(value, dtype=float))
    if steps.size * about.rows * about.cols > VALUES_MAX:
        raise InputError(
            about.scene, f"stimulus.{key}", f"{steps.size} frames", f"at most {VALUES_MAX} values in all"
        )
    return steps


def read_frames(table: FramesTable | ResistanceTable, about: Surroundings) -> Floats:
    """Read and check the file of a table: [frames, rows, cols], finite (ohm may be inf) and 0 or above."""
    path = about.scene.parent / table.file
    shown = table.file
    told_by = (about.scene, "stimulus.file", table.file)
    suffix = Path(table.file).suffix.lower()
    if table.key is not None and suffix != ".npz":
        raise InputError(about.scene, "stimulus.key", quoted(table.key), "left out, except for an npz file")
    if suffix == ".csv":
        values = _read_csv(read_bytes(path, FILE_BYTES_MAX, told_by), shown, about)
    elif suffix in (".npy", ".npz"):
        values = _read_numpy(read_bytes(path, FILE_BYTES_MAX, told_by), shown, suffix, table, about)
    else:
        raise InputError(
            about.scene, "stimulus.file", quoted(table.file), "a file that ends in .csv, .npy or .npz"
        )
    _check_values(values, shown, table)
    return values[_selected(table, values.shape[0], about)]


def _selected(table: FramesTable | ResistanceTable, frames: int, about: Surroundings) -> list[int] | slice:
    if isinstance(table.select, str):
        return {"all": slice(None), "first": slice(0, 1), "last": slice(frames - 1, frames)}[table.select]
    for number in table.select:
        if number >= frames:
            raise InputError(about.scene, "stimulus.select", number, f"frame numbers 0..{frames - 1}")
    if len(table.select) * about.rows * about.cols > VALUES_MAX:
        raise InputError(
            about.scene,
            "stimulus.select",
            f"{len(table.select)} frames",
            f"at most {VALUES_MAX} values in all",
        )
    return list(table.select)


def _check_values(values: Floats, shown: str, table: FramesTable | ResistanceTable) -> None:
    codes = isinstance(table, FramesTable) and table.unit == "codes"
    if isinstance(table, ResistanceTable):
        good, allowed = values >= 0, "a resistance >= 0 in ohm (inf is legal)"
    elif codes:
        good = (values >= 0) & (values <= CODE_MAX) & (np.floor(values) == values)
        allowed = f"a whole number 0..{CODE_MAX}"
    else:
        good, allowed = (values >= 0) & np.isfinite(values), "a finite force >= 0 in newtons"
    if not good.all():
        frame, row, col = (int(i) for i in np.argwhere(~good)[0])
        raise InputError(
            shown, f"frame {frame}, row {row}, column {col}", float(values[frame, row, col]), allowed
        )


def _read_csv(data: bytes, shown: str, about: Surroundings) -> Floats:
    rows, cols = about.rows, about.cols
    layout = f"{rows * cols} values (a frame) or {cols} values (a row of it)"
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        raise InputError(
            shown, f"byte {error.start}", data[error.start], "numbers separated by commas"
        ) from None
    lines: list[list[float]] = []
    width = 0
    held = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        cells = line.split(",")
        width = width or len(cells)
        if width not in (rows * cols, cols):
            raise InputError(shown, f"line {number}", f"{len(cells)} values", layout)
        if len(cells) != width:
            raise InputError(
                shown, f"line {number}", f"{len(cells)} values", f"{width} values, as the lines above"
            )
        held += width
        if held > VALUES_MAX:
            raise InputError(shown, f"line {number}", f"{held} values", f"at most {VALUES_MAX} values")
        try:
            if "_" in line:  # float() takes 1_000
                raise ValueError
            lines.append([float(cell) for cell in cells])
        except ValueError:
            place, cell = next((i, c) for i, c in enumerate(cells, start=1) if not _is_number(c))
            raise InputError(
                shown, f"line {number}, value {place}", quoted(cell.strip()), "a number"
            ) from None
    if not lines:
        raise InputError(shown, "lines", 0, f"at least one line of {layout}")
    if width == rows * cols:
        return np.array(lines).reshape(-1, rows, cols)
    if len(lines) % rows:
        raise InputError(shown, "lines", len(lines), f"whole frames of {rows} lines of {cols} values")
    return np.array(lines).reshape(-1, rows, cols)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _read_numpy(
    data: bytes, shown: str, suffix: str, table: FramesTable | ResistanceTable, about: Surroundings
) -> Floats:
    try:
        array = _npz_member(data, shown, table.key) if suffix == ".npz" else _npy(data, shown)
    except InputError:
        raise
    except Exception as error:  # zip, header and dtype parsers raise whatever they like on garbage
        reason = one_line(str(error) or type(error).__name__, 200)
        raise InputError(
            shown, "file", Path(shown).name, f"a readable {suffix[1:]} file ({reason})"
        ) from None
    if array.dtype.kind not in "iuf":
        raise InputError(shown, "dtype", str(array.dtype), "integers or floating point numbers")
    shape = (about.rows, about.cols)
    if array.ndim == 2:
        array = array[np.newaxis]
    if array.ndim != 3 or array.shape[1:] != shape or array.shape[0] < 1:
        found = list(array.shape)
        raise InputError(
            shown, "shape", found, f"[{shape[0]}, {shape[1]}] or [frames, {shape[0]}, {shape[1]}]"
        )
    return array.astype(float)


def _npy(data: bytes, shown: str) -> NDArray[Any]:
    # The header is believed only as far as the bytes behind it reach: a file of 80 bytes can claim a
    # petabyte.
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    reader = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(
        version
    )
    if reader is None:
        raise ValueError(f"npy version {version}")
    shape, fortran, dtype = reader(stream)
    if dtype.hasobject or dtype.kind not in "iuf":
        raise InputError(shown, "dtype", str(dtype), "integers or floating point numbers")
    values = math.prod(int(n) for n in shape)
    if values > VALUES_MAX:
        raise InputError(shown, "shape", list(shape), f"at most {VALUES_MAX} values")
    if values * dtype.itemsize > len(data) - stream.tell():
        raise InputError(shown, "shape", list(shape), "as many values as the file holds")
    flat = np.frombuffer(data, dtype=dtype, count=values, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran else "C")


def _npz_member(data: bytes, shown: str, key: str | None) -> NDArray[Any]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = [n.removesuffix(".npy") for n in archive.namelist()]
        if key is None and len(names) == 1:
            key = names[0]
        if key is None or key not in names:
            listed = ", ".join(one_line(n) for n in names[:10])
            raise InputError(shown, "key", "nothing" if key is None else quoted(key), f"one of {listed}")
        member = archive.getinfo(next(n for n in archive.namelist() if n.removesuffix(".npy") == key))
        limit = VALUES_MAX * 8 + 4096
        if member.file_size > limit:
            raise InputError(shown, key, f"{member.file_size} bytes", f"at most {limit} bytes unpacked")
        with archive.open(member) as stream:
            # What the directory says of the size is a claim; what is read is bounded here.
            unpacked = stream.read(limit + 1)
    if len(unpacked) > limit:
        raise InputError(shown, key, f"over {limit} bytes", f"at most {limit} bytes unpacked")
    return _npy(unpacked, shown)
