# SPDX-License-Identifier: Apache-2.0
"""`dermis sim`: whole frames through Verilog and ngspice, judged against the exact count."""

import contextlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import tomli_w
from matplotlib.figure import Figure

from dermis import engines, plan
from dermis.engines import cosim
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import figures, output, verdict, waves
from dermis.report.comparison import compare, fit_residual
from dermis.scene.design import ROOT
from dermis.scene.scene import SCENES, from_data
from scripts import cosims
from scripts.judged import SHOW, digest, finish

OUT = ROOT / "build" / "sim"


@dataclass(frozen=True)
class Case:
    """One scene of the regression, with the simulator and synchronizer that read it."""

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
    "triangular_transient.png": "triangular_indenter/transient.png",
    "indenters.png": "indenters.png",
}
"""Figures of the documentation, copied from files of a run."""

INDENTERS = ("flat", "triangular", "cylindrical")
"""Shapes of the paper's Fig. 10."""


def frame_file_case(
    path: Path, select: str, unit: str, key: str | None = None, rows: int = 16, cols: int = 16
) -> Case:
    """Write the scene that reads a user's frame file (docs/scenes.md), and return its case; InputError
    if the file, its values or an option is wrong.

    `select` is "spread" (four frames over the file), "all", "first", "last" or numbers "0,10,20";
    `key` the name of the array in an npz file.
    """
    if not path.is_file() or path.suffix.lower() not in (".csv", ".npy", ".npz"):
        raise InputError("command line", "--frames", str(path), "a .csv, .npy or .npz file that can be read")
    # The name depends on the file and the options, so that two parallel runs do not share a scene.
    asked = digest((), path.resolve(), select, unit, key, rows, cols)[:12]
    scene = ROOT / "build" / "frame_files" / f"{path.stem}_{asked}.toml"
    chosen: str | list[int] = "all" if select == "spread" else select
    if select not in ("spread", "all", "first", "last"):
        if not re.fullmatch(r"\s*\d+\s*(,\s*\d+\s*)*", select, re.ASCII):
            allowed = "spread, all, first, last, or frame numbers such as 0,10,20"
            raise InputError("command line", "--select", select, allowed)
        chosen = [int(word) for word in select.split(",")]
    stimulus = {"kind": "frames", "file": str(path.resolve()), "unit": unit, "select": chosen}
    stimulus |= {} if key is None else {"key": key}
    title = "".join(c for c in f"Frames of {path.name}" if c.isprintable())
    data = {"title": title, "array": {"rows": rows, "cols": cols}, "stimulus": stimulus}
    if select == "spread":
        last = plan.make(from_data(data, scene)).frames - 1
        stimulus["select"] = sorted({round(i * last / 3) for i in range(4)})
    write_atomic(scene, tomli_w.dumps(data))
    return Case("frame_file", scene, readback=unit == "codes")


def run_case(case: Case, made: Plan, on_slots: Callable[[int], None]) -> list[verdict.Row]:
    """Read one scene through the chip, write its files and figures, and judge it."""
    options = {"simulator": case.simulator, "sync_latch": case.sync_latch, "record": case.record}
    result = cosim.run(made, on_slots, **options)
    expected = np.round(made.timing.gate_clocks * made.duty_ideal()).astype(int) if case.readback else None
    begin = cpu_time.cpu_used_s()
    rows = compare(made, result, case.name, expected)
    if case.record:
        _, v_int = waves.integrator_waves(result.info["records"][0], made.cols)
        name, swing = f"frame.integrator_swing_v.{case.name}", float(np.ptp(v_int, axis=1).max())
        rows.append(verdict.report(name, swing, "V", "largest of the columns"))
    result.info["check_cpu_s"] = cpu_time.cpu_used_s() - begin
    chip = f"{case.simulator}, {'flip-flop + latch' if case.sync_latch else 'flip-flop + flip-flop'}"
    for row in rows:
        row["note"] += "" if row["status"] == "SKIP" else f"; {chip}"

    def draw(directory: Path) -> None:
        if case.record:
            waves.write(directory, made, result)
            figures.transient_figure(made, result, directory / "transient.png")
        figures.frame_figure(made, result.codes, fit_residual(made, result.codes), directory / "frame.png")

    output.write(OUT / case.name, made, result, rows, draw)
    return rows


def draw_indenters() -> None:
    """Draw the paper's Fig. 10 from the middle row of three cases: codes (a) above force profiles (b)."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    upper, profile = figure.subplots(2, 1, sharex=True)
    for shape, colour, marker in zip(INDENTERS, figures.COLOURS, "os^", strict=False):
        case = f"{shape}_indenter"
        made = plan.load(SCENES / f"{case}.toml", "cosim")
        codes = np.load(OUT / case / "codes.npy")[0, made.rows // 2]
        upper.plot(codes, marker=marker, color=colour, label=shape, lw=1.2, mfc="none")
        force = made.force_n[0, made.rows // 2]
        profile.step(np.arange(codes.size), force, where="mid", color=colour, lw=1.4)
    upper.legend(frameon=False, fontsize=9, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    upper.set_ylabel("(a)  code of the chip")
    profile.set(xlabel="taxel of the line", ylabel="(b)  force on the taxel / N")
    profile.locator_params(axis="x", integer=True)
    for axes in (upper, profile):
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0)
    figures.save(figure, OUT / "indenters.png")


def run(cases: list[Case]) -> tuple[list[verdict.Row], bool]:
    """Run cases in parallel; return the rows in order, and True if a simulator failed."""
    tasks: dict[str, tuple[int, cosims.Task]] = {}
    for case in cases:
        engines.check(made := plan.load(case.scene, "cosim"))
        tasks[case.name] = made.frames * made.rows, partial(run_case, case, made)
    with contextlib.ExitStack() as places:
        for case in cases:
            places.enter_context(output.place(OUT / case.name))
        read = cosims.run("reading the array", tasks)
    rows: list[verdict.Row] = []
    for name, found in read.items():
        failed = isinstance(found, SimulatorError)
        rows += [verdict.error(f"frame.code_error_lsb.{name}", str(found))] if failed else found
    return rows, any(isinstance(found, SimulatorError) for found in read.values())


@click.command("sim", context_settings=SHOW)
@click.option(
    "--frames", type=click.Path(path_type=Path), help="Also read this frame file (csv, npy or npz)."
)
@click.option(
    "--select", default="spread", help="Frames: spread (4 of them), all, first, last, or numbers, 0,10,20."
)
@click.option("--unit", type=click.Choice(["codes", "newtons"]), default="codes", help="Unit of the file.")
@click.option("--key", help="Name of the array in an npz file.")
@click.option("--rows", type=click.IntRange(1, 256), default=16, help="Rows of a frame of the file.")
@click.option("--cols", type=click.IntRange(1, 256), default=16, help="Columns of a frame of the file.")
@click.option("--only", multiple=True, help="Only this case (repeatable).")
@click.option("--docs", is_flag=True, help="Also redraw the figures in docs/figures.")
def sim_command(frames: Path | None, only: tuple[str, ...], docs: bool, **of_file: Any) -> int:
    """Run whole frames through the Verilog and ngspice; judge every code.

    Results, figures and waves are in build/sim/CASE, the table in build/sim.json.
    """
    cases = list(CASES)
    if frames is not None:
        cases.append(frame_file_case(frames, **of_file))
    known = {case.name: case for case in cases}
    if unknown := [name for name in only if name not in known]:
        raise InputError("command line", "--only", unknown[0], f"one of {', '.join(known)}")
    cases = [case for name, case in known.items() if not only or name in only]
    verdicts, failed = run(cases)
    if not failed and {f"{shape}_indenter" for shape in INDENTERS} <= {case.name for case in cases}:
        draw_indenters()
    code = finish("sim", verdicts, "Full-array regression: Verilog and ngspice against the exact count")
    if docs and not failed:
        for name, source in FIGURES.items():
            write_atomic(ROOT / "docs" / "figures" / name, (OUT / source).read_bytes())
    click.echo(f"codes, figures and waves are in {os.path.relpath(OUT)}")
    return SimulatorError.exit_code if failed else code
