# SPDX-License-Identifier: Apache-2.0
"""`dermis read`: a recording through the chip, and back into forces."""

import dataclasses
import io
import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.chip.spi_protocol import RowsOfInterest
from dermis.converter.vfc import code_type
from dermis.decode import calibration, recording, recording_bag
from dermis.decode.decoder import SATURATED, UNSOLVED, ZERO, Forces
from dermis.decode.recording import Recording
from dermis.errors import InputError, counted, one_line, optional
from dermis.files import write_atomic
from dermis.ndarrays import Bools, Floats, place_of
from dermis.places import BUILD
from dermis.records import Plan
from dermis.report import output, verdict
from dermis.scene import scene as scenes
from dermis.scene.schema import read_toml
from dermis.skin import Skin

Codes = NDArray[np.unsignedinteger]
Results = tuple[Codes, Forces, list[verdict.Row]]
"""Codes, decoded forces and verdicts."""

CHIP = {"row_driver": True, "column_input": True, "lateral": True}
"""Effects of the chip without --scene: row drivers, column inputs and a coupled sheet."""
SATURATED_MAX = 0.01
"""Share of the pressed readings that may be at full scale; more is a wrong unit, scale or k."""
LEAST_CODE = 8
"""A recording whose largest code is below uses less than 5 of 8 bits: a wrong unit, scale or k."""
COVERAGE_MIN = 0.99
"""Least share of forces in their 99.9 % interval; less is another chip or sheet."""
WRONG_UNIT = "a wrong --unit, --scale or [front_end]? k of the scene sets the range"
_BAGGED = "force_n", "low_n", "high_n"
SHADES = ".:-=+*#%@"
THRESHOLD = 0.1
"""Onset: the total force passes this part of its largest value."""


def chip_of(rows: int, cols: int, scene: str | None) -> Plan:
    """Return the plan of a chip and a sheet of this size: the design's, or those of a scene."""
    path, data = Path("default chip"), {"effects": dict(CHIP)}
    if scene is not None:
        data = read_toml(path := scenes.find(scene))
    array = data.get("array", {})
    for name, size in (("rows", rows), ("cols", cols)):
        if isinstance(array, dict) and array.get(name, size) != size:
            raise InputError(path, f"array.{name}", array[name], f"{size}, as the recording has")
    data = data | {"array": {"rows": rows, "cols": cols}, "stimulus": {"kind": "uniform", "force_n": [0.0]}}
    return planning.make(scenes.from_data(data, path), "closed")


def forces_of(values: Floats, unit: str, plan: Plan, area_mm2: float | None, scale: float) -> Floats:
    """Return the forces in newtons of a recording's values, [frames, rows, cols]; NaN where a value is missing.

    InputError for values that the unit does not have, or no area for kPa.
    """
    spread, missing = f"{np.nanmin(values):g} .. {np.nanmax(values):g}", np.isnan(values)
    if unit == "codes":
        if not (missing | (values >= 0) & (values <= plan.timing.code_max)).all():
            raise InputError("recording", "values", spread, f"codes 0..{plan.timing.code_max}")
        force = plan.force_of_duty(values / plan.timing.gate_clocks)
    elif unit == "ohm":
        if (values <= 0).any():
            raise InputError("recording", "values", f"{spread} ohm", "resistances above 0")
        force = plan.sensor.force_n(values)
    elif unit == "kpa":
        if area_mm2 is None:
            raise InputError("command line", "--area", None, "the area of a taxel in mm2, for --unit kpa")
        force = values * (area_mm2 * 1e-3)
    else:
        force = values
    with np.errstate(over="ignore"):  # refused below
        force = force * scale
    if not (missing | ((force >= 0) & np.isfinite(force))).all():
        allowed = "finite forces from 0; --missing N for a value that is none, --clip-negative for 0"
        raise InputError("recording", "values", f"{spread} {unit}", allowed)
    return force + 0.0


def error_figures(
    force: Floats, found: Floats, time_s: Floats, pressed: Bools
) -> dict[str, tuple[float, str]]:
    """Compare decoded forces with the true ones, [frames, rows, cols] each; {name: (value, unit)}.

    Errors by taxel count the readings in `pressed`, the centre of pressure where the total force is above `THRESHOLD`
    of its largest value; the onset delay is how much later the decoded total passes that value.
    """
    error = (found - force)[pressed]
    total, total_found = force.sum(axis=(1, 2)), found.sum(axis=(1, 2))
    level = THRESHOLD * total.max(initial=0.0)
    axes = np.indices(force.shape[1:])
    loaded = (total > level) & (total_found > 0)
    both = force[loaded], found[loaded]
    centres = [np.stack([(f * axis).sum(axis=(1, 2)) for axis in axes]) / f.sum(axis=(1, 2)) for f in both]
    apart = np.hypot(*(centres[0] - centres[1]))
    passed = [t > level for t in (total, total_found)]
    onset = [float(time_s[np.argmax(above)]) if above.any() else np.nan for above in passed]
    return {
        "rms_error_n": (float(np.sqrt(np.mean(error**2))) if error.size else 0.0, "N"),
        "largest_error_n": (float(np.abs(error).max(initial=0.0)), "N"),
        "total_force_error_n": (float(np.abs(total_found - total).max(initial=0.0)), "N"),
        "centre_error_pitch": (float(apart.max(initial=0.0)), "pitches"),
        "onset_delay_s": (onset[1] - onset[0], "s"),
    }


def read_frames(skin: Skin, rec: Recording, force: Floats) -> Results:
    """Send forces through the chip and back; return codes, decoded forces and verdicts.

    A force that is missing (NaN) is sent as the one before it in time.
    """
    dt = np.diff(rec.time_s, prepend=rec.time_s[0])
    missing = np.isnan(force)
    codes = skin.read(_filled(force), dt)
    found = _decoded(skin, rec, codes, missing, dt)
    force, present = np.where(missing, 0.0, force), rec.present & ~missing
    if skin.plan.front_end is None:
        plain = skin.plan.force_of_duty(codes / skin.plan.timing.gate_clocks)
    else:
        plain = skin.decoder.calibration.uncorrected_n(codes)
    full = (found.flags & SATURATED) > 0
    used = present & (force > 0) & ~full
    rows = []
    for name, forces in (("uncorrected", plain), ("corrected", found.force_n)):
        kept = np.where(present & np.isfinite(forces), forces, 0.0)
        for key, (value, unit) in error_figures(force, kept, rec.time_s, used).items():
            rows.append(verdict.report(f"read.{name}.{key}", value, unit, "pressed taxels below full scale"))
    inside = found.holds(force)
    rows.append(_saturated(full, present, int((present & (force > 0)).sum())))
    covered = float(inside[present].mean())
    # The bound of a saturated taxel, g_max_s, need not hold for forces of a wrong unit.
    least, why = COVERAGE_MIN if rows[-1]["value"] <= SATURATED_MAX else None, ""
    if least is not None and covered < least:
        taxels = np.where(rec.present, (inside | missing).mean(axis=0), np.inf)
        r, c = np.unravel_index(np.argmin(taxels), taxels.shape)
        why = f"the calibration does not fit; most errors at row {r}, column {c}"
    rows.append(verdict.within("read.interval_coverage", covered, "1", least, None, why))
    rows.append(_largest(skin.decoder.calibration.rising(codes)))
    return codes, found, rows


def decode_frames(skin: Skin, rec: Recording, path: str) -> Results:
    """Decode the codes of a chip; return them, forces and verdicts. InputError for values that are no codes."""
    known, missing = skin.decoder.calibration, np.isnan(rec.values)
    most = known.code_max
    values = np.where(rec.present, rec.values, np.round(known.zero_code))
    good = missing | ((values >= 0) & (values <= most) & (values == np.floor(values)))
    if not good.all():
        allowed = f"a code, a whole number 0..{most}; --through-chip sends scaled values through a chip"
        raise InputError(path, place_of(~good), float(values[~good][0]), allowed)
    codes = _filled(values).astype(code_type(most))
    found = _decoded(skin, rec, codes, missing, np.diff(rec.time_s, prepend=rec.time_s[0]))
    present = rec.present & ~missing
    pressed = present & ((found.flags & ZERO) == 0)
    width = (found.high_n - found.low_n)[pressed]
    open_ = int(np.isinf(width).sum())
    total = np.where(present, found.force_n, 0.0).sum(axis=(1, 2))
    unsolved = int((found.flags & UNSOLVED).any(axis=(1, 2)).sum())
    why = "the network does not fit, or a reference lost its force" if unsolved else ""
    wrong_side = "a wrong counts, side or zero_count of [front_end]"
    below = float((known.rising(codes) < known.least_code())[present].mean())
    rows = [
        verdict.report("read.decoded.largest_force_n", float(np.nanmax(found.force_n)), "N", ""),
        verdict.report("read.decoded.largest_total_force_n", float(total.max()), "N", ""),
        verdict.within("read.decoded.unsolved_frames", unsolved, "frames", None, 0, why),
        verdict.within("read.below_zero_share", below, "1", None, SATURATED_MAX, wrong_side if below else ""),
        _saturated((found.flags & SATURATED) > 0, present, int(pressed.sum())),
        _largest(known.rising(codes)),
    ]
    if open_ < width.size:
        median, note = float(np.median(width[np.isfinite(width)])), "median of pressed taxels"
        note += f"; {counted(open_, 'reading')} without an upper end" if open_ else ""
        rows.insert(0, verdict.report("read.decoded.interval_width_n", median, "N", note))
    return codes, found, rows


def _filled(values: Floats) -> Floats:
    """Return values [frames, rows, cols] in which a missing one is that before it in time, or after it, or 0."""
    if not np.isnan(values).any():
        return values
    return np.nan_to_num(recording.held(recording.held(values)[::-1])[::-1])


def _decoded(skin: Skin, rec: Recording, codes: Codes, missing: Bools, dt: Floats) -> Forces:
    """Decode codes; a missing one gives NaN in 0..inf, and may be any code for the intervals of the others."""
    found = skin.decoder.decode(codes, dt, missing=missing)
    for array in (found.force_n, found.low_n, found.high_n):
        array[:, ~rec.present] = 0.0
    return found


def _saturated(full: Bools, present: Bools, pressed: int) -> verdict.Row:
    saturated = full & present
    share = float(saturated.sum() / max(pressed, 1))
    why = f"{int(saturated.any(axis=0).sum())} taxels; {WRONG_UNIT}" if share else ""
    return verdict.within("read.saturated_share", share, "1", None, SATURATED_MAX, why)


def _largest(codes: NDArray) -> verdict.Row:
    most = int(codes.max(initial=0))
    why = f"the recording uses little of the range: {WRONG_UNIT}" if most < LEAST_CODE else ""
    return verdict.within("read.largest_code", most, "codes", LEAST_CODE, None, why)


def understood(rec: Recording, unit: str, area_mm2: float | None) -> dict[str, str]:
    """Return what was understood of a recording, by name."""
    frames, rows, cols = rec.values.shape
    missing, absent = int(np.isnan(rec.values).sum()), int((~rec.present).sum())
    rate = f"{1 / rec.t_frame_s:.6g} frames/s" if frames > 1 and rec.t_frame_s > 0 else "none"
    return {
        "frames": f"{frames}",
        "size": f"{rows} rows x {cols} columns" + (f", {absent} places without a taxel" if absent else ""),
        "rate": f"{rate}, time from {rec.time_from}",
        "unit": unit + (f" on {area_mm2:g} mm2 a taxel" if unit == "kpa" and area_mm2 else ""),
        "order": rec.order,
        "ignored": one_line(", ".join(rec.ignored), 200) or "nothing",
        "missing": f"{missing} values",
    }


def strongest(force: Floats, rows: int, cols: int) -> tuple[str, Floats]:
    """Return words for the frame with the most force, and the frame [at most rows, at most cols].

    A place of a larger frame has the largest of its forces; NaN if all of them are missing.
    """
    total = np.nansum(force, axis=(1, 2))
    frame = force[int(np.argmax(total))]
    words = f"frame {int(np.argmax(total))}, {total.max():.4g} N in all, {np.nanmax(frame):.4g} N at most"
    for axis, most in enumerate((rows, cols)):
        starts = np.arange(0, frame.shape[axis], -(-frame.shape[axis] // most))
        frame = np.fmax.reduceat(frame, starts, axis=axis)
    return words, frame


def touch_map(force: Floats) -> list[str]:
    """Return the frame with the most force as lines of characters, at most 32 x 64."""
    words, frame = strongest(force, 32, 64)
    frame = np.nan_to_num(frame)
    level = np.ceil(frame / max(frame.max(), 1e-300) * (len(SHADES) - 1)).astype(int)
    return [f"{words}:", *("".join(SHADES[k] for k in row) for row in level)]


def interest_rows(codes: NDArray[Any], time_s: Floats, t_frame_s: float, late: int = 1) -> list[verdict.Row]:
    """Follow `RowsOfInterest` over codes [frames, rows, cols], at the frame rate of the chip.

    A mask acts `late` frames after the next: 1 in continuous scanning, 0 with single shots.
    """
    # 20 000 frames are 40 s of a touch, and half a second of work.
    time = t_frame_s * np.arange(min(20_000, int(np.ptp(time_s) / t_frame_s + 1.5))) + time_s[0]
    peaks = np.stack([np.interp(time, time_s, peak) for peak in codes.max(axis=2).T], axis=1)
    policy = RowsOfInterest(codes.shape[1])
    masks = [policy.mask] * (1 + late)
    for mask, peak in zip(masks, peaks, strict=False):  # grows while it is followed
        masks.append(policy.next(np.flatnonzero(mask), peak[mask, None]))
    read, touched, at = np.array(masks[: len(time)]), peaks >= policy.threshold, np.arange(len(time))[:, None]
    wait = np.minimum.accumulate(np.where(read, at, len(time))[::-1])[::-1] - at
    waits = wait[touched & np.diff(touched, axis=0, prepend=False)]
    note = f"{(waits > 0).sum()} of {waits.size} late; {(touched & ~read).sum()} of {touched.sum()} readings missed"
    followed = f"{counted(len(time), 'frame')} of {t_frame_s:g} s"
    saved = verdict.report("read.rows_saved", 1 - read.mean(), "1", followed)
    return [saved, verdict.report("read.touch_delay_frames", int(waits.max(initial=0)), "frames", note)]


def _range_of(_: click.Context, __: click.Parameter, said: str | None) -> tuple[int, int] | None:
    match = re.fullmatch(r"(\d{1,6})(?:\.\.|-)(\d{1,6})", said or "")
    if said is not None and (match is None or int(match[1]) > int(match[2])):
        raise InputError("command line", "--taxels", said, "FIRST..LAST, columns from 0")
    return None if match is None else (int(match[1]), int(match[2]))


def _axes_of(_: click.Context, __: click.Parameter, said: str | None) -> tuple[str | int, ...] | None:
    if said is None:
        return None
    axes = tuple(int(a) if a.isdecimal() else a for a in re.split(r"[,\s]+", said.strip()))
    names = sorted(a for a in axes if isinstance(a, str))
    if names not in (["cols", "rows"], ["cols", "frames", "rows"], ["frames", "taxels"]):
        allowed = "frames,rows,cols in any order, or frames,taxels, "
        allowed += "with numbers for axes of which a part is taken"
        raise InputError("command line", "--axes", said, allowed)
    return axes


def _missing_of(_: click.Context, __: click.Parameter, said: tuple[str, ...]) -> dict[str, Any]:
    """Return what --missing says of places without a taxel, and of gaps."""
    found: dict[str, Any] = {}
    for one in said:
        try:
            found |= {"gaps": one} if one in recording.GAPS else {"missing": float(one)}
        except ValueError:
            raise InputError("command line", "--missing", one, "a number, refuse or hold") from None
    return found


_FILE, _POSITIVE = click.Path(), click.FloatRange(0, 1e9, min_open=True)
_RATE, _SKIPPED, _PART = click.FloatRange(1e-6, 1e9), click.IntRange(0, 10_000), click.IntRange(1)


@click.command("read")
@click.argument("file", type=click.Path())
@click.option("--unit", type=click.Choice(recording.UNITS), help="Unit of the values.")
@click.option("--rate", "rate_hz", type=_RATE, help="Frames per second, if the file has no times.")
@click.option("--rows", type=click.IntRange(1, 256), help="Rows of the array.")
@click.option("--cols", type=click.IntRange(1, 256), help="Columns of the array.")
@click.option("--skip", type=_SKIPPED, help="Leading columns to skip, such as a time or a counter.")
@click.option("--taxels", callback=_range_of, metavar="FIRST..LAST", help="Columns of the taxels, from 0.")
@click.option("--part", type=_PART, help="Sensor, or group of names, from 1, of a file with several.")
@click.option("--header", type=click.Choice(["yes", "no"]), help="Whether a line of numbers is a header.")
@click.option(
    "--axes",
    callback=_axes_of,
    help="Axes of an array, as rows,cols,frames or taxels,frames; a number takes a part.",
)
@click.option("--key", help="Name of the array in an npz, mat or HDF5 file; topic, or topic.field, of a bag.")
@click.option("--time-key", help="Name of the array, or name or number of the column, with the times.")
@click.option("--time-unit", type=click.Choice(list(recording.TIME_UNITS)), help="Unit of the times.")
@click.option(
    "--missing",
    callback=_missing_of,
    multiple=True,
    help="Value that a place without a taxel has in every frame; or refuse or hold, for values missing in some.",
)
@click.option("--mask", type=click.Path(), help="csv or npy file [rows, cols], 0 at a place without a taxel.")
@click.option("--clip-negative", is_flag=True, help="Replace negative values with 0.")
@click.option("--area", "area_mm2", type=click.FloatRange(1e-9, 1e9), help="Area of a taxel in mm2, for kPa.")
@click.option("--scale", type=_POSITIVE, default=1.0, show_default=True, help="Factor on every force.")
@click.option(
    "--through-chip",
    is_flag=True,
    help="Send codes as forces through the simulated chip, as all other units.",
)
@click.option("--scene", help="Scene of chip and sheet; its stimulus is ignored.")
@click.option("--calibration", "known", type=_FILE, help="Calibration of `dermis calibrate` for decoding.")
@click.option("--out", type=click.Path(), help="Directory of the results; default build/read/FILE.")
@click.option("--hdf5", is_flag=True, help="Also write forces.h5.")
@click.option("--bag", type=click.Choice(["mcap", "sqlite3"]), help="Also write forces_bag, a ROS 2 bag.")
def read_command(
    file: str,
    unit: str | None,
    mask: str | None,
    clip_negative: bool,
    area_mm2: float | None,
    scale: float,
    scene: str | None,
    known: str | None,
    out: str | None,
    hdf5: bool,
    bag: str | None,
    through_chip: bool,
    **layout: Any,
) -> int:
    """Read a recording: forces with time and intervals.

    Codes are decoded with the chip of --scene or --calibration. Other units, and codes with --through-chip, are forces
    that the simulated chip reads and decodes.
    """
    with output.place(BUILD / "read" / Path(file).stem if out is None else out) as target:
        with recording.warned() as given:
            layout["header"] = {"yes": True, "no": False}.get(layout["header"])
            layout |= layout.pop("missing")
            rec = recording.load(file, recording.Layout(**layout))
        notes: list[str] = []

        def note(said: str) -> None:
            notes.append(said)
            click.echo(f"warning: {said}", err=True)

        for said in given:
            note(said)
        said_area, area_mm2 = area_mm2 is not None, area_mm2 or rec.area_mm2
        if unit is None and rec.unit is None:
            said = f"unknown for values {np.nanmin(rec.values):g} .. {np.nanmax(rec.values):g}"
            raise InputError(file, "unit", said, "--unit " + ", ".join(recording.UNITS))
        if unit is not None and rec.unit not in (None, unit):
            raise InputError(file, "--unit", unit, f"{rec.unit}, as the file says")
        unit = unit or rec.unit
        if said_area and unit != "kpa":
            allowed = f"no such option: it is for --unit kpa, not {unit}"
            raise InputError("command line", "--area", area_mm2, allowed)
        if mask is not None:
            rec = _masked(rec, mask)
        if clip_negative:
            rec = dataclasses.replace(rec, values=np.maximum(rec.values, 0.0))
        frames, rows, cols = rec.values.shape
        decodes = unit == "codes" and not through_chip
        if decodes and scale != 1:
            allowed = "left out for codes that are decoded; or --through-chip"
            raise InputError("command line", "--scale", scale, allowed)
        if decodes and scene is None and known is None:
            said = "codes of the default chip; --scene or --calibration of the chip otherwise"
            note(f"{one_line(file)}: {said}")
        chip = chip_of(rows, cols, scene)
        own_chip, frame_s = chip.front_end is None, chip.timing.frame_s
        if not own_chip and unit == "codes" and through_chip:
            allowed = "a scene of a chip, not of a [front_end]"
            raise InputError("command line", "--through-chip", scene, allowed)
        # Times of a file have six digits; a frame that is shorter by less is the same.
        if own_chip and not decodes and frames > 1 and rec.t_frame_s < frame_s * (1 - 1e-6):
            allowed = (
                f"at most {1 / frame_s:.4g} frames a second: the chip reads {rows} rows in {frame_s:g} s"
            )
            allowed += "; a scene with [front_end] has no such limit"
            speed = f"{1 / rec.t_frame_s:.6g}" if rec.t_frame_s else "no time between frames"
            raise InputError(file, "rate", speed, allowed)
        own = None if known is None else calibration.load(known)
        if own is not None:
            own.check(rows, cols, known)
            for said in own.doubts():
                note(f"{known}: {said}")
        skin = Skin(chip, calibration=own)
        if decodes:
            codes, found, judged = decode_frames(skin, rec, file)
            if skin.decoder.calibration.memory.active and (held := int((found.low_n[0] > 0).sum())):
                said = "their creep and hysteresis are taken to begin there"
                note(f"{counted(held, 'taxel')} loaded in the first frame: {said}")
        else:
            values = np.where(rec.present, rec.values, np.inf if unit == "ohm" else 0)
            force = np.where(rec.present, forces_of(values, unit, chip, area_mm2, scale), 0.0)
            codes, found, judged = read_frames(skin, rec, force)
            if above := int(((found.flags & SATURATED) > 0).sum()):
                most = f"{np.nanmax(force):.4g} N at most"
                note(f"{counted(above, 'force')} beyond the range of the read-out, {most}")
        if own_chip and (own is None or not (own.divider or own.falling)):
            judged += interest_rows(codes, rec.time_s, frame_s)
        told = understood(rec, unit, area_mm2)
        summary = {"file": str(file), "unit": unit, "scene": scene or "default chip", "calibration": known}
        summary |= {"decoded": decodes, "understood": told, "warnings": notes}
        if out is None and (before := _file_of(target)) not in (None, summary["file"]):
            note(f"{one_line(str(target), 200)}: replaces the results of {one_line(before, 200)}")
        write(target, rec, (codes, found, judged), summary, hdf5, bag)
        for name, value in told.items():
            click.echo(f"{name:8} {value}")
        click.echo("\n".join(touch_map(found.force_n)))
        output.MAPS.append((*strongest(np.where(rec.present, found.force_n, np.nan), 64, 64), "N"))
        verdict.write_rows("read", judged)
        size = f"{counted(frames, 'frame')} of {rows} x {cols}, {rec.present.sum()} taxels"
        verdict.print_rows(judged, f"{one_line(file)}: {size}, time from {rec.time_from}")
        click.echo(f"codes, forces and summary are in {one_line(str(target), 400)}")
        return verdict.exit_code(judged)


def _file_of(target: Path) -> str | None:
    """Return the file of an earlier result, None if there is none."""
    try:
        return str(json.loads((target / "summary.json").read_text(encoding="utf-8"))["file"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _masked(rec: Recording, mask: str) -> Recording:
    """Return a recording without the taxels for which the file `mask` has 0."""
    rows, cols = rec.present.shape
    allowed = f"{rows} x {cols} values, 0 where there is no taxel"
    layout = recording.Layout(rows, cols, rate_hz=np.inf, gaps="refuse", header=False)
    try:
        found = recording.load(mask, layout, "--mask").values
    except InputError as error:
        raise InputError(mask, error.key, error.value, f"{error.allowed}; {allowed}") from None
    present = rec.present & (found[0] != 0)
    if len(found) > 1 or not present.any():
        raise InputError(mask, "--mask", f"{len(found)} frames" if len(found) > 1 else "no taxel", allowed)
    return dataclasses.replace(rec, present=present)


def write(
    target: Path, rec: Recording, results: Results, said: dict[str, Any], hdf5: bool, bag: str | None
) -> None:
    """Write codes and forces with time (csv, npy, HDF5 and a ROS 2 bag if asked for) and, last, summary.json."""
    codes, found, rows = results
    summary = said | dict(zip(("frames", "rows", "cols"), codes.shape, strict=True))
    summary |= {"taxels": int(rec.present.sum()), "t_frame_s": rec.t_frame_s if len(codes) > 1 else None}
    summary |= {"time_from": rec.time_from, "start_ns": rec.start_ns, "verdicts": rows}
    missing = np.isnan(rec.values)
    # A code that is missing in the file is missing in the results.
    shown = np.where(missing, np.nan, codes) if missing.any() else codes
    forces = {"forces_n": found.force_n, "forces_low_n": found.low_n, "forces_high_n": found.high_n}
    arrays = {"codes": shown} | forces
    files: dict[str, bytes | str] = {"forces.h5": _hdf5(arrays, rec)} if hdf5 else {}
    files |= {f"{name}.npy": output.npy_bytes(array) for name, array in arrays.items()}
    files |= {
        "time_s.npy": output.npy_bytes(rec.time_s),
        "codes.csv": output.csv_of(shown, "g" if missing.any() else "d", rec.time_s),
        "forces_n.csv": output.csv_of(found.force_n, ".6g", rec.time_s),
        "summary.json": json.dumps(summary, indent=1, allow_nan=False) + "\n",
    }
    inputs = [Path(said[key]).resolve() for key in ("file", "scene", "calibration") if said[key]]
    for name in files:
        if (target / name).resolve() in inputs:
            allowed = f"another directory: it would replace {name}, which was read"
            raise InputError("command line", "--out", str(target), allowed)
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target, prefix=".bag_") as held:
        if bag is not None:
            topics = {f"/dermis/{n}": np.where(rec.present, getattr(found, n), np.nan) for n in _BAGGED}
            recording_bag.write(Path(held) / "bag", topics, rec.time_s, bag, max(rec.start_ns, 0))
        # A summary is there only with the files that it describes.
        for name in ("summary.json", "forces.h5"):
            (target / name).unlink(missing_ok=True)
        shutil.rmtree(target / "forces_bag", ignore_errors=True)
        if bag is not None:
            (Path(held) / "bag").rename(target / "forces_bag")
    for name, content in files.items():
        write_atomic(target / name, content)


def _hdf5(arrays: dict[str, NDArray], rec: Recording) -> bytes:
    held = io.BytesIO()
    with optional("h5py", "recordings").File(held, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, compression="gzip")
        file["time_s"], file["present"] = rec.time_s, rec.present
    return held.getvalue()
