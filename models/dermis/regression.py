# SPDX-License-Identifier: Apache-2.0
"""`dermis sim`: whole frames through Verilog and ngspice, every code judged against the exact charge-balance count."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import tomli_w
from numpy.typing import NDArray

from dermis import engines, output, plan, progress, report, verdict, waves
from dermis.design import ROOT
from dermis.engines import Result, cosim
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.plan import Plan
from dermis.scene import SCENES
from dermis.sensor import InverseSensor
from dermis.verdict import Row
from dermis.views import BEHAVIOURAL

OUT = ROOT / "build" / "sim"

# 510 x of a force that was computed from a code is that code to a few ulp; no other force comes this close by accident.
_EXACT = 1e-9


@dataclass(frozen=True)
class Case:
    """One scene of the regression, and through which chip it is read."""

    name: str
    scene: Path
    simulator: str = "icarus"
    sync_latch: bool = False
    record: bool = False
    readback: bool = False


CASES = (
    Case("flat_indenter", SCENES / "flat_indenter.toml"),
    # recorded: several taxels under a ridge are the paper's Fig. 11
    Case("triangular_indenter", SCENES / "triangular_indenter.toml", sync_latch=True, record=True),
    Case("cylindrical_indenter", SCENES / "cylindrical_indenter.toml", simulator="verilator"),
    Case("uniform_staircase", SCENES / "uniform_staircase.toml"),
)

FIGURES = {
    "cylindrical_frame.png": "cylindrical_indenter/frame.png",
    "triangular_transient.png": "triangular_indenter/transient.png",
}
"""Figures of the README, and the results they are copies of."""


def on_code(made: Plan) -> NDArray[np.bool_]:
    """Where the code leaves nothing to rounding: x = c / gate_clocks, or full scale and above; [frames, rows, cols]."""
    steps = made.timing.gate_clocks * made.duty_ideal()
    with np.errstate(invalid="ignore"):
        whole = np.abs(steps - np.round(steps)) <= _EXACT * np.maximum(steps, 1.0)
    return whole | (steps >= made.timing.code_max)


def fit_residual(made: Plan, codes: NDArray[Any]) -> tuple[float, float, NDArray[np.float64]] | None:
    """Straight line through code against force below saturation: slope a newton, offset, residuals; or None.

    None as well where codes do not follow force in a line: another law than Force = K/R, or a sheet that has aged.
    """
    if made.force_n is None or not isinstance(made.sensor, InverseSensor):
        return None
    if not np.allclose(made.sensor.force_n(made.resistance_ohm), made.force_n, rtol=_EXACT, atol=0):
        return None
    steps = made.timing.gate_clocks * made.duty_ideal()
    below = np.isfinite(made.force_n) & (steps <= made.timing.code_max)
    force, code = made.force_n[below], codes[below].astype(float)
    if np.unique(force).size < 3:
        return None
    slope, offset = np.polyfit(force, code, 1)
    return float(slope), float(offset), code - (slope * force + offset)


def _reference(made: Plan) -> str | None:
    """The engine to compare with: the closed formula, or the event engine where it has none; None for itself."""
    # What such an engine refuses by value is told as a row that was skipped: not engines.cheapest.
    return next((e for e in ("closed", "event") if e != made.engine and not engines.refused(made, e)), None)


def _compare_transistors(made: Plan, codes: NDArray[Any], name: str) -> list[Row]:
    """Verdict rows of codes read in transistors: against ideal blocks, as read, and with each column calibrated."""
    ideal = replace(made, views=BEHAVIOURAL)
    reference = _reference(ideal)
    if reference is None:
        return [verdict.skip(f"frame.transistor_error_lsb.{name}", "no other engine takes its effects")]
    exact = engines.run(replace(ideal, engine=reference)).codes.astype(float)
    inside = (exact > 0) & (exact < made.timing.code_max) & (codes < made.timing.code_max)
    error = np.abs(codes - exact)
    note = f"{codes.size} codes against engine {reference}, as read: gain and offset of the channels"
    rows = [verdict.report(f"frame.transistor_error_lsb.{name}", float(error.max()), "lsb", note)]
    rest = []
    for column in range(made.cols):
        x, y = (some[:, :, column][inside[:, :, column]] for some in (exact, codes))
        if np.unique(x).size >= 3:
            gain, offset = np.polyfit(x, y, 1)
            rest.append(np.abs(y - gain * x - offset).max())
    key = f"frame.transistor_residual_lsb.{name}"
    if rest:
        note = f"{len(rest)} columns, gain and offset of each taken away; both codes are whole numbers"
        rows.append(verdict.judge(key, float(max(rest)), note))
    else:
        rows.append(verdict.skip(key, "no column has three codes to fit a line to", "lsb"))
    return rows


def compare(made: Plan, result: Result, name: str, expected: NDArray[Any] | None = None) -> list[Row]:
    """Judge the codes of a run against a neighbouring engine, and a straight line.

    Parameters
    ----------
    made, result : the plan and what an engine made of it
    name : last part of the rows' names
    expected : codes that a frame file holds, to be read back
    """
    codes = result.codes.astype(int)
    if made.views.in_transistors(made.topology):
        return _compare_transistors(made, codes, name)
    rows = []
    reference = _reference(made)
    if reference is not None:
        try:
            error = np.abs(codes - engines.run(replace(made, engine=reference)).codes)
        except InputError as refusal:  # fields that it honours, with values that it does not take
            rows.append(verdict.skip(f"frame.code_error_lsb.{name}", str(refusal)))
            kinds = {}
        else:
            kinds = {"frame.code_error_exact_lsb": on_code(made), "frame.code_error_lsb": ~on_code(made)}
            if made.active_fields():
                kinds = {"frame.code_error_lsb": np.ones(codes.shape, bool)}
        for row, where in kinds.items():
            if where.any():
                note = f"{int(where.sum())} codes against engine {reference}"
                rows.append(verdict.judge(f"{row}.{name}", int(error[where].max()), note))
    if not made.active_fields() and (fit := fit_residual(made, codes)) is not None:
        note = f"code = {fit[0]:.4f} / N x force {fit[1]:+.3f}"
        rows.append(verdict.judge(f"frame.fit_residual_lsb.{name}", float(np.abs(fit[2]).max()), note))
    if expected is not None:
        worst = int(np.abs(codes - expected).max())
        rows.append(
            verdict.judge(f"frame.readback_error_lsb.{name}", worst, f"{made.frames} frames of the file")
        )
    return rows


def frame_file_case(
    path: Path, select: str, unit: str, key: str | None = None, rows: int = 16, cols: int = 16
) -> Case:
    """Write the scene that reads a user's frame file, and return its case.

    Parameters
    ----------
    path : csv, npy or npz file, see docs/scenes.md
    select : "spread" (four frames over the file), "all", "first", "last" or numbers "0,10,20"
    unit : "codes" or "newtons"
    key : which array of an npz file
    rows, cols : taxels of a frame

    Raises
    ------
    InputError
        The file, its values or an option is wrong.
    """
    if not path.is_file() or path.suffix.lower() not in (".csv", ".npy", ".npz"):
        raise InputError("command line", "--frames", str(path), "a .csv, .npy or .npz file that can be read")
    # A name for every file and way of reading it, so that two runs at once do not share a scene.
    asked = hashlib.sha256(repr((path.resolve(), select, unit, key, rows, cols)).encode()).hexdigest()[:12]
    scene = ROOT / "build" / "frame_files" / f"{path.stem}_{asked}.toml"

    def write(chosen: Any) -> None:
        stimulus = {"kind": "frames", "file": str(path.resolve()), "unit": unit, "select": chosen}
        if key is not None:
            stimulus["key"] = key
        array = {"rows": rows, "cols": cols}
        title = "".join(c for c in f"Frames of {path.name}" if c.isprintable())
        write_atomic(scene, tomli_w.dumps({"title": title, "array": array, "stimulus": stimulus}))

    if select == "spread":
        write("all")
        frames = plan.load(scene).frames
        write(sorted({round(i * (frames - 1) / 3) for i in range(4)}))
    elif select in ("all", "first", "last"):
        write(select)
    else:
        try:
            numbers = [int(word) for word in select.split(",")]
        except ValueError:
            raise InputError(
                "command line",
                "--select",
                select,
                "spread, all, first, last, or frame numbers such as 0,10,20",
            ) from None
        if min(numbers) < 0:
            raise InputError("command line", "--select", select, "frame numbers >= 0")
        write(numbers)
    return Case("frame_file", scene, readback=unit == "codes")


def run_case(case: Case, made: Plan, on_slots: Callable[[int], None]) -> list[Row]:
    """Read one scene through the chip, write its files and figures, and judge it."""
    out = OUT / case.name
    result = cosim.run(
        made,
        on_slots,
        simulator=case.simulator,
        sync_latch=case.sync_latch,
        record=case.record,
    )
    expected = None
    if case.readback:
        expected = np.round(made.timing.gate_clocks * made.duty_ideal()).astype(int)
    rows = compare(made, result, case.name, expected)
    chip = f"{case.simulator}, {'flip-flop + latch' if case.sync_latch else 'flip-flop + flip-flop'}"
    rows = [
        {**row, "note": f"{row['note']}; {chip}" if row["status"] != "SKIP" else row["note"]} for row in rows
    ]

    def draw(directory: Path) -> None:
        if case.record:
            waves.write(directory, made, result)
            report.transient_figure(made, result, directory / "transient.png")
        report.frame_figure(made, result.codes, fit_residual(made, result.codes), directory / "frame.png")

    output.write(out, made, result, rows, draw)
    return rows


def run(cases: list[Case]) -> tuple[list[Row], bool]:
    """Run cases side by side; return the rows in their order and whether a simulator failed."""
    plans = [plan.load(case.scene, "cosim") for case in cases]
    for made in plans:
        engines.check(made)
    with contextlib.ExitStack() as places:
        for case in cases:
            places.enter_context(output.place(OUT / case.name))
        return _run(cases, plans)


def _run(cases: list[Case], plans: list[Plan]) -> tuple[list[Row], bool]:
    done = [0] * len(cases)
    failed = False
    rows: list[Row] = []
    total = sum(made.frames * made.rows for made in plans)
    with progress.slots("reading the array", total) as show, ThreadPoolExecutor(len(cases)) as pool:

        def one(index: int) -> list[Row]:
            def on_slots(slots: int) -> None:
                done[index] = slots
                show(sum(done))

            return run_case(cases[index], plans[index], on_slots)

        futures = [pool.submit(one, i) for i in range(len(cases))]
        try:
            for case, future in zip(cases, futures, strict=True):
                try:
                    rows += future.result()
                except SimulatorError as error:
                    failed = True
                    rows.append(verdict.error(f"frame.code_error_lsb.{case.name}", str(error)))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            cosim.end_all()
            raise
    return rows, failed


@click.command("sim")
@click.option(
    "--frames", type=click.Path(path_type=Path), help="Also read this frame file (csv, npy or npz)."
)
@click.option(
    "--select", default="spread", help="Frames of the file: spread (4), all, first, last, or 0,10,20."
)
@click.option("--unit", type=click.Choice(["codes", "newtons"]), default="codes", help="What the file holds.")
@click.option("--key", help="Which array of an npz file.")
@click.option("--rows", type=click.IntRange(1, 256), default=16, help="Rows of a frame of the file.")
@click.option("--cols", type=click.IntRange(1, 256), default=16, help="Columns of a frame of the file.")
@click.option("--only", multiple=True, help="Only this case (may be repeated).")
@click.option("--docs", is_flag=True, help="Also redraw the figures in docs/figures.")
def sim_command(
    frames: Path | None,
    select: str,
    unit: str,
    key: str | None,
    rows: int,
    cols: int,
    only: tuple[str, ...],
    docs: bool,
) -> int:
    """Run the full-array regression: real Verilog, ngspice, every code judged.

    Results, figures and waves are in build/sim/CASE, the table in build/sim.json.
    """
    cases = list(CASES)
    if frames is not None:
        cases.append(frame_file_case(frames, select, unit, key, rows, cols))
    if only:
        known = [case.name for case in cases]
        for name in only:
            if name not in known:
                raise InputError("command line", "--only", name, f"one of {', '.join(known)}")
        cases = [case for case in cases if case.name in only]
    verdicts, failed = run(cases)
    verdict.write_rows("sim", verdicts)
    verdict.print_rows(
        verdicts, "Full-array regression: Verilog and ngspice in lock-step against the exact count"
    )
    if docs and not failed:
        for name, source in FIGURES.items():
            write_atomic(ROOT / "docs" / "figures" / name, (OUT / source).read_bytes())
    click.echo(f"codes, figures and waves are in {os.path.relpath(OUT)}")
    return SimulatorError.exit_code if failed else verdict.exit_code(verdicts)
