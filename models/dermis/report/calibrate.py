# SPDX-License-Identifier: Apache-2.0
"""`dermis calibrate`: measurements of a session into one calibration file."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import click
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dermis.decode import calibration, identify, recording
from dermis.decode.calibration import Calibration
from dermis.errors import InputError
from dermis.report import output, verdict
from dermis.report.read import chip_of
from dermis.scene import scene as scenes
from dermis.scene.schema import Strict, entry, read_toml, validate

DRIFT_SIGMA = 4.0
"""Standard uncertainties by which a column's gain may differ from the older calibration ..."""
DRIFT_MIN = 0.005
"""... and the relative difference that is a drift in any case: 1.3 codes at full scale."""
DRIFT_MAX = 0.05
"""Relative drift from the first to the last load: creep is some per cent."""
STEP = 2.0
"""Ratio of the current of a code to that of the design from which on the test currents have another unit."""
STEADY = 1.25
"""Ratio of the sums of two frames up to which a load is steady: it creeps by some per cent."""
SENSITIVITY = {True: (0.2, 5.0), False: (0.02, 50.0)}
"""Conductance at a force over that by the sensor of the scene, or by the default one: beyond lie kg (9.8), g, kPa, or a
weight on each taxel."""
DOUBTFUL = 2.0
"""That ratio from which there is a warning where the scene has the sensor: a pound for a newton makes 4.4."""
MISPLACED_MAX = 0.05
"""Share of pressed readings that may be pressed without a force, or the reverse: the edge of a load is not sharp."""


class _Array(Strict):
    rows: int = entry(..., "Rows", ge=1, le=256)
    cols: int = entry(..., "Columns", ge=1, le=256)


class _Start(Strict):
    scene: str | None = entry(None, "Scene that the fit starts from", "a name or path of a scene")
    law: Literal["linear", "power", "cubic", "table"] = entry("linear", "Law to fit")


class _Current(Strict):
    file: str = entry(..., "Codes of the readings", "a file of codes")
    current_a: float = entry(..., "Current into every column in A; 0 is a dark frame", "a number >= 0", ge=0)


class _Load(Strict):
    file: str = entry(..., "Codes under the load", "a file of codes")
    name: str | None = entry(None, "Name of the load in messages")
    force_n: float | str = entry(
        ..., "Force on every taxel in N: a number, or a file [rows, cols]", "a number >= 0, or a file"
    )


class _Cycle(Strict):
    file: str = entry(..., "Codes from rest over at least one rise and fall", "a file of codes")
    force_n: str = entry(..., "Force on every taxel in N, frame by frame", "a file [frames, rows, cols]")
    t_frame_s: float = entry(..., "Time from frame to frame in s", "a number > 0", gt=0)


class _Reference(Strict):
    row: int = entry(..., "Row of a taxel of constant force", ge=0)
    col: int = entry(..., "Its column", ge=0)
    force_n: float = entry(..., "Its force in N", "a number > 0", gt=0)


class SessionTable(Strict):
    """A calibration session: measurements, and their files relative to the session."""

    array: _Array = entry(..., "Size of the array")
    start: _Start = entry(_Start(), "What is known before")
    current: list[_Current] = entry([], "Test currents and dark frames", "tables")
    load: list[_Load] = entry([], "Known loads", "tables")
    cycle: Annotated[list[_Cycle], Field(max_length=1)] = entry([], "A load cycle", "at most one table")
    reference: list[_Reference] = entry([], "Taxels of constant force, for the temperature", "tables")


def session(path: Path) -> tuple[Calibration, list[verdict.Row]]:
    """Fit the calibration of a session file; rows have each value with its standard uncertainty.

    Raises InputError for anything wrong with the file or with the files that it names, or measurements that
    contradict each other.
    """
    table = validate(SessionTable, read_toml(path), path)
    rows, cols = table.array.rows, table.array.cols
    for n, ref in enumerate(table.reference):
        if ref.row >= rows or ref.col >= cols:
            raise InputError(path, f"reference.{n}", f"{ref.row}, {ref.col}", f"a taxel of {rows} x {cols}")
    for key, measured in (("current", table.current), ("load", table.load), ("cycle", table.cycle)):
        files = [one.file for one in measured]
        if again := next((n for n, file in enumerate(files) if file in files[:n]), None):
            allowed = "another file: a measurement counts once"
            raise InputError(path, f"{key}.{again}.file", files[again], allowed)
    scene = table.start.scene
    if scene is not None and (path.parent / scene).is_file():
        scene = str(path.parent / scene)
    plan = chip_of(rows, cols, scene)
    made = Calibration.of_plan(plan)
    start, stated = made.curve, scene is not None and "sensor" in read_toml(scenes.find(scene))
    said: list[verdict.Row] = []
    if not table.current and (table.load or table.cycle) and plan.front_end is None:
        allowed = "at least two test currents, or the scene of a board with [front_end] in [start]"
        raise InputError(path, "current", "none", allowed)

    def frames(name: str, key: str, unit: str = "codes") -> NDArray[Any]:
        layout = recording.Layout(rows, cols, rate_hz=np.inf, gaps="refuse", frames_first=True)
        try:
            read = recording.load(path.parent / name, layout)
            found = read.values
        except InputError as error:
            allowed = f"a file to read ({error.key} = {error.value}: {error.allowed})"
            if error.key == "shape":
                allowed = f"frames of {rows} x {cols}, as [array] says; its shape is {error.value}"
            raise InputError(path, key, name, allowed) from None
        if read.unit not in (None, unit):
            raise InputError(path, key, f"{name} in {read.unit}", unit)
        if unit == "newtons":
            if not (found >= 0).all():
                raise InputError(path, key, name, f"forces from 0; the least is {found.min():g}")
            return found
        if not ((found >= 0) & (found <= made.code_max) & (found == np.floor(found))).all():
            raise InputError(path, key, name, f"codes, whole numbers 0..{made.code_max}")
        return made.rising(found.astype(np.int64))

    def note(name: str, value: float, unit: str, remark: str) -> None:
        said.append(verdict.report(f"calibrate.{name}", value, unit, remark))

    def value(name: str, pair: tuple[float, float], unit: str, remark: str = "") -> None:
        note(name, pair[0], unit, f"standard uncertainty {pair[1]:.3g}" + (f"; {remark}" if remark else ""))

    try:
        if table.current:
            # The same current in every row slot: rows are readings.
            measured = [frames(c.file, f"current.{n}.file") for n, c in enumerate(table.current)]
            readings = [read.reshape(-1, cols) for read in measured]
            least = min(len(r) for r in readings)
            currents = np.array([r[:least] for r in readings])
            nominal_a = float(made.step_a.mean())
            made = identify.fit_chip(made, currents, [c.current_a for c in table.current])
            step_a = float(made.step_a.mean())
            if not 1.0 / STEP < step_a / nominal_a < STEP:
                allowed = f"amperes into every column: a code of this chip is about {nominal_a:.3g} A"
                raise InputError(path, "current", f"{step_a:.3g} A a code", allowed)
            noise = identify.fit_noise(currents.swapaxes(0, 1)) if least > 1 else 0.0
            made = dataclasses.replace(made, noise_code=noise)
            value("step_a", (float(made.step_a.mean()), float((made.step_part * made.step_a).mean())), "A")
            value("start_code", (float(made.start_code.mean()), float(made.start_sigma_code.mean())), "codes")
        if table.load:
            loads: list[identify.Load] = []
            for n, load in enumerate(table.load):
                known, key = load.force_n, f"load.{n}.force_n"
                if isinstance(known, str):
                    given = frames(known, key, "newtons")
                    force = given[0]
                    if (given != force).any():
                        said_frames = f"{known}: {len(given)} frames that differ"
                        raise InputError(path, key, said_frames, "one map of forces")
                elif 0 <= known < np.inf:
                    force = np.full((rows, cols), known)
                else:
                    raise InputError(path, key, known, "a number >= 0, or a file")
                codes = frames(load.file, f"load.{n}.file")
                total = codes.sum(axis=(1, 2))
                if total.max() > STEADY * total.min() + codes[0].size:
                    allowed = f"frames under a steady load; sums of codes are {total.min()} to {total.max()}"
                    raise InputError(path, f"load.{n}.file", load.file, allowed)
                loads.append(identify.Load(load.name or load.file, codes, force))
            pairs = [
                (a, b) for n, b in enumerate(loads) for a in loads[:n] if np.array_equal(a.codes, b.codes)
            ]
            if same := "; ".join(f"{b.name} reads as {a.name}" for a, b in pairs[:4]):
                note("same_readings", len(pairs), "pairs", f"{same}: each counts as a measurement of its own")
            if not table.current and (spread := [noise for load in loads for noise in _noise(made, load)]):
                made = dataclasses.replace(made, noise_code=float(np.sqrt(np.mean(np.square(spread)))))
                note("noise", made.noise_code, "codes", "of the frames of a load")
            fit = identify.fit_sheet(made, loads, table.start.law)
            made = fit.calibration
            for name, pair in fit.values.items():
                value(name, pair, name.rsplit("_", 1)[1], fit.remarks.get(name, ""))
            note("law_part", made.law_part, "1", "relative error of the law")
            forces = np.concatenate([one.force_n[one.force_n > 0] for one in loads])
            force = float(np.median(forces[forces >= min(made.curve.force_on_n, forces.max())]))
            ratio = float(made.curve.conductance_s(force) / start.conductance_s(force))
            remark = f"conductance at {force:.3g} N over that of the scene: "
            remark += "units (kg for N makes 9.8), a weight for each taxel, or another [sensor] than "
            remark += "its own?" if stated else "the default? [start] scene has that of the sheet"
            if not stated:
                recording.warn(path, "its scene has no [sensor]: forces in pounds or kg would pass")
            elif not 1 / DOUBTFUL < ratio < DOUBTFUL:
                recording.warn(path, f"the sheet conducts {ratio:.3g} times what its [sensor] does: units?")
            low, high = SENSITIVITY[stated]
            said.append(verdict.within("calibrate.sensitivity_ratio", ratio, "1", low, high, remark))
            own = [f"{r} {c}" for r, c in made.own]
            note("own_laws", len(own), "taxels", ", ".join(own[:8]) + (" ..." if len(own) > 8 else ""))
            odd = "; ".join(f"{r} {c} {reason}" for (r, c), reason in list(fit.bad_taxels.items())[:8])
            said.append(verdict.within("calibrate.bad_taxels", len(fit.bad_taxels), "taxels", None, 0, odd))
            pressed = sum(int((load.force_n > 0).sum()) for load in loads)
            odd = "; ".join(fit.elsewhere[:4])
            share = len(fit.elsewhere) / max(pressed, 1)
            said.append(verdict.within("calibrate.misplaced_share", share, "1", None, MISPLACED_MAX, odd))
            remark = "what forces read under the last load over the first: gain, supply, temperature; or, with loads "
            remark += "in the order of their forces, another law"
            said.append(verdict.within("calibrate.drift", fit.drift, "1", -DRIFT_MAX, DRIFT_MAX, remark))
            named = ", ".join(fit.bad)
            said.append(verdict.within("calibrate.bad_loads", len(fit.bad), "loads", None, 0, named))
        for cycle in table.cycle:
            force = frames(cycle.force_n, "cycle.force_n", "newtons")
            seen = frames(cycle.file, "cycle.file")
            if force.shape != seen.shape:
                allowed = f"{len(seen)}, as many as of codes"
                raise InputError(path, "cycle.force_n", f"{len(force)} frames", allowed)
            made, values = identify.fit_memory(made, seen, force, cycle.t_frame_s)
            for name, pair in values.items():
                value(name, pair, "1")
    except identify.ContradictionError as error:
        raise InputError(path, "measurements", "do not fit", str(error)) from None
    if not said:
        raise InputError(path, "measurements", "none", "[[current]], [[load]] or [[cycle]] tables")
    places = []
    for ref in table.reference:
        conductance_s = made.law_of(ref.row, ref.col).conductance_s(ref.force_n)
        places.append((ref.row, ref.col, float(conductance_s * made.factor[ref.row, ref.col])))
    return dataclasses.replace(made, reference=tuple(places)), said


def _noise(made: Calibration, load: identify.Load) -> list[float]:
    """Return the noise in codes of a load with several frames; none of one, or of one that reads nothing."""
    pressed = load.codes.mean(axis=0) >= identify.LEAST_CODE
    return [identify.fit_noise(load.codes[:, pressed])] if len(load.codes) > 1 and pressed.any() else []


def drift_rows(new: Calibration, old: Calibration) -> list[verdict.Row]:
    """Return a verdict on each column whose gain has drifted, or one row if none has."""
    apart = np.abs(new.step_a / old.step_a - 1)
    allowed = np.maximum(DRIFT_SIGMA * np.hypot(new.step_part, old.step_part), DRIFT_MIN)
    name, why = "calibrate.gain_drift", "drifted: calibrate anew"
    if not (moved := np.nonzero(apart > allowed)[0]).size:
        return [verdict.within(name, float(apart.max()), "1", None, float(allowed.max()))]
    ends = [(c, float(apart[c]), float(allowed[c])) for c in moved]
    return [verdict.within(f"{name}.column_{c}", off, "1", None, most, why) for c, off, most in ends]


@click.command("calibrate")
@click.argument("recordings", type=click.Path())
@click.option(
    "--out", type=click.Path(), help="File of the calibration; default calibration.toml next to RECORDINGS."
)
@click.option("--check", type=click.Path(), help="Earlier calibration: report columns whose gain drifted.")
def calibrate_command(recordings: str, out: str | None, check: str | None) -> int:
    """Fit a calibration to a session file that names test currents, loads and cycles."""
    path = Path(recordings)
    target = path.with_name("calibration.toml") if out is None else Path(out)
    if target.is_dir():
        raise InputError("command line", "--out", str(target), "a file to write")
    if target.is_file() and not target.read_bytes().startswith(b"format = "):
        allowed = "a new file, or an earlier calibration to replace"
        raise InputError("command line", "--out", str(target), allowed)
    old = None if check is None else calibration.load(check)
    with recording.warned() as notes:
        made, rows = session(path)
    for said in (*notes, *made.doubts()):
        click.echo(f"warning: {said}", err=True)
    if old is not None:
        old.check(made.rows, made.cols, check)
        rows += drift_rows(made, old)
    output.prepare(target.parent)
    made.save(target)
    verdict.write_rows("calibrate", rows)
    verdict.print_rows(rows, f"calibration of {made.rows} x {made.cols} taxels")
    click.echo(f"the calibration is {target}")
    return verdict.exit_code(rows)
