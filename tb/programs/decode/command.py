# SPDX-License-Identifier: Apache-2.0
"""`dermis decode`: every figure of decoding against truth, into build/decode.json."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.array.array import Network, column_currents
from dermis.decode import crosstalk, identify, law, memory, recording
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import SATURATED, Decoder, Forces
from dermis.engines import closed, event
from dermis.errors import InputError
from dermis.places import BUILD
from dermis.records import Plan
from dermis.report import read, verdict
from dermis.scene import scene as scenes
from dermis.skin import Skin
from tb.programs.decode import published

Floats = NDArray[np.float64]

FULL_N = 15.0
"""Full scale of the design's sheet."""
SLACK = 1 + 1e-9
"""Rounding of a force that lies on the end of its interval."""


def made(stimulus: dict[str, Any] | None = None, engine: str = "closed", **tables: Any) -> Plan:
    """Plan a scene of this program."""
    data = {"stimulus": stimulus or {"kind": "uniform", "force_n": [0.0]}, **tables}
    return planning.make(scenes.from_data(data, Path("decode program")), engine)


def noise_free(seed: int = 0) -> verdict.Row:
    """Random arrays solved backwards from exact currents."""
    rng, worst, cases, proven = np.random.default_rng(seed), 0.0, 0, 0
    for rows, cols in ((4, 4), (8, 8), (16, 16), (5, 12), (12, 5)):
        for r_column in (0.0, 0.5, 5.0, 25.0, 50.0):
            g = 10 ** rng.uniform(-5, np.log10(2e-3), (8, rows, cols))
            network = Network(g[0], 0.5, 25.0, 25.0, r_column, g_lateral_row_s=1e-3)  # type: ignore[arg-type]
            solved = crosstalk.solve(network, column_currents(network, g))
            worst = max(worst, float(np.abs(solved.conductance_s / g - 1).max()))
            cases, proven = cases + len(g), proven + int(np.isfinite(solved.error_s).sum())
    note = f"{cases} arrays of 100 kohm to 500 ohm, inputs of 0 to 50 ohm; proven bound for {proven}"
    return verdict.judge("decode.noise_free_error", worst, note)


def tables() -> list[verdict.Row]:
    """Compare the published tables with their recomputation."""
    size, ohm = published.WORST
    four, six = published.cells(4), published.cells(6)
    judged = [cell for cell in four if cell.part != "wu"]
    met = [cell for cell in six if not cell.overloaded]
    off = [cell for cell in six if cell.overloaded]
    with_limit = [
        abs(abs(published.corrected(cell, published.overloaded_currents(cell))) - cell.error)
        for cell in off
        if cell.size == size
    ]
    unknown = "48 cells: they have no term of 2 Rs / R, against table 6 (b); the circuit cannot be had"
    overload = "100 ohm in 14 x 14 after one step, in 16 x 16 after one and two: amplifier overloaded?"
    limited = f"the two cells of 16 x 16, with an amplifier that delivers {published.LIMIT_S:g} A/V"
    return [
        verdict.judge(
            "decode.table4_miss", max(map(published.miss, judged)), f"(a), (c), (d), {len(judged)} cells"
        ),
        verdict.skip("decode.table4_wu_miss", unknown),
        verdict.judge("decode.table6_miss", max(map(published.miss, met)), f"{len(met)} of {len(six)} cells"),
        verdict.report("decode.table6_overload_miss", max(map(published.miss, off)), "pp", overload),
        verdict.report("decode.table6_limited_miss", max(with_limit), "pp", limited),
        verdict.judge("decode.table6_worst", published.ours(size, ohm), "published after two steps: 1.56 %"),
    ]


def codes_of_force(plan: Plan, force: Floats) -> Floats:
    """Return forces in codes of an ideal chip, with fractions."""
    with np.errstate(divide="ignore"):
        duty = plan.v_bias_v / (plan.converter.k * plan.converter.i0_a) / plan.sensor.resistance_ohm(force)
    return plan.timing.gate_clocks * duty


def worn() -> tuple[Plan, Forces, verdict.Row]:
    """Decode worn_fsr_sheet from its codes, with every effect known."""
    plan = planning.load(scenes.find("worn_fsr_sheet"), "closed")
    found = Decoder(Calibration.of_plan(plan), plan.drive.t_frame_s).decode(closed.run(plan).codes)
    off = codes_of_force(plan, found.force_n) - codes_of_force(plan, plan.force_n)
    plain = codes_of_force(plan, plan.force_of_duty(closed.run(plan).codes / plan.timing.gate_clocks))
    before = np.sqrt(np.mean((plain - codes_of_force(plan, plan.force_n)) ** 2))
    note = f"largest {np.abs(off).max():.3g} at the turn of the load; uncorrected {before:.3g} rms"
    return plan, found, verdict.judge("decode.force_error_lsb", float(np.sqrt(np.mean(off**2))), note)


def cycles(seed: int, frames: int, taxels: int) -> Floats:
    """Return load cycles [frames, taxels] in newtons: smooth and straight ones by turns, other peaks every time."""
    rng, t = np.random.default_rng(seed), np.arange(frames) * 2e-3
    out = np.empty((frames, taxels))
    for k in range(taxels):
        period = rng.uniform(0.6, 1.5)
        turns = np.r_[0, rng.uniform(0.4, 1, 20)] * FULL_N * 0.9
        if k % 2:
            out[:, k] = turns[1 + (t // period).astype(int)] * np.sin(np.pi * t / period) ** 2
        else:
            corners = np.where(np.arange(21) % 2, turns, turns * rng.uniform(0, 0.5, 21))
            out[:, k] = np.interp(t / (period / 2), np.arange(21), corners)
    return out


def hysteresis() -> tuple[list[verdict.Row], dict[str, Floats]]:
    """Identify hysteresis and creep from one cycle of codes, and judge them on others."""
    effects = {"sensor_hysteresis": True, "sensor_creep": True}
    size = {"rows": 4, "cols": 4}
    skin = Skin(made(array=size, effects=effects))
    one = np.broadcast_to((13 * np.sin(np.pi * np.arange(500) * 2e-3) ** 2)[:, None, None], (500, 4, 4))
    true = Calibration.of_plan(skin.plan)
    blind = dataclasses.replace(true, memory=memory.MemoryLaw(np.empty(0), np.empty(0)))
    found, values = identify.fit_memory(blind, skin.read(one, 2e-3), one, 2e-3)
    off, plain, kept = [], [], {}
    for seed in range(1, 11):
        skin.reset()
        force = cycles(seed, 1500, 16).reshape(-1, 4, 4)
        codes = skin.read(force, 2e-3)
        decoded = Decoder(found, 2e-3).decode(codes)
        uncorrected = Decoder(blind, 2e-3).decode(codes)
        used = decoded.flags & SATURATED == 0
        off.append((decoded.force_n - force)[used])
        plain.append((uncorrected.force_n - force)[used])
        if seed == 1:
            kept = {"force": force, "before": uncorrected.force_n, "after": decoded.force_n,
                    "low": decoded.low_n, "high": decoded.high_n}  # fmt: skip
    errors, before = np.concatenate(off) / FULL_N * 100, np.concatenate(plain) / FULL_N * 100
    rms = float(np.sqrt(np.mean(errors**2)))
    note = (
        f"rms over 10 x 16 unseen cycles; largest {np.abs(errors).max():.3g} %, where a loop is flat; uncorrected "
        f"rms {np.sqrt(np.mean(before**2)):.3g} %, largest {np.abs(before).max():.3g} %; "
        f"loop {values['hysteresis'][0]:.2%}, creep {values['creep_per_decade'][0]:.2%} a decade"
    )
    return [verdict.judge("decode.hysteresis_error", rms, note)], kept


def random_world(rng: np.random.Generator) -> dict[str, Any]:
    """Return the effects of an unseen scene."""
    effects: dict[str, Any] = {
        "row_driver": {"r_ohm": float(rng.uniform(0, 10))},
        "column_input": {"r_ohm": float(rng.uniform(0, 5))},
        "lateral": {"r_ohm": float(rng.uniform(500, 5000))},
        "column_offset": {"v_v": float(rng.normal(0, 3e-4))},
        "mirror_ratio": {"ratio_error": float(rng.normal(0, 0.01)), "spread": 0.01},
        "sensor_spread": True,
    }
    if rng.random() < 0.3:
        effects["trace"] = {"r_row_ohm": 0.1, "r_column_ohm": 0.1}
    return effects


def random_touch(rng: np.random.Generator) -> dict[str, Any]:
    """Return the stimulus of an unseen scene."""
    shape = ["flat", "triangular", "cylindrical", "spherical"][rng.integers(4)]
    return {
        "kind": "ramp", "shape": shape, "force_n": [0.0, float(rng.uniform(3, 18)), 0.0], "frames": 25,
        "width": float(rng.uniform(4, 14)), "length": float(rng.uniform(4, 14)), "samples": 2,
        "center_row": float(rng.uniform(4, 12)), "center_col": float(rng.uniform(4, 12)),
    }  # fmt: skip


def coverage(count: int = 60) -> verdict.Row:
    """Coverage of the intervals on random scenes, a sixth of them with the noise of the chip in engine event."""
    inside = total = 0
    widths, noisy = [], 0
    for seed in range(count):
        rng = np.random.default_rng([18, seed])
        effects, touch = random_world(rng), random_touch(rng)
        calibration = Calibration.of_plan(made(touch, effects=effects))
        if seed % 6:
            plan = made(touch, effects=effects)
            codes = closed.run(plan).codes
        else:
            noise = dict.fromkeys(("thermal_noise", "shot_noise", "ktc_noise", "flicker_noise"), True)
            effects.pop("trace", None)
            still = made({"kind": "uniform", "force_n": [5.0] * 20}, "event", effects=effects | noise)
            calibration = Calibration.of_plan(made(touch, effects=effects))
            repeated = event.run(still).codes
            calibration = dataclasses.replace(calibration, noise_code=identify.fit_noise(repeated))
            plan = made(touch, "event", effects=effects | noise)
            codes = event.run(plan).codes
            noisy += 1
        found = Decoder(calibration, plan.drive.t_frame_s).decode(codes)
        force = plan.force_n
        inside += int(((found.low_n <= force * SLACK) & (force <= found.high_n * SLACK)).sum())
        total += force.size
        pressed = (codes > 0) & (codes < plan.timing.code_max)
        widths.append((found.high_n - found.low_n)[pressed])
    width = float(np.median(np.concatenate(widths))) / (FULL_N / 255)
    note = f"{count} scenes, {noisy} with noise, {total} readings; median width {width:.3g} LSB where pressed"
    row = verdict.judge("decode.interval_coverage", inside / total, note)
    return row if width <= 2 else row | {"status": "FAIL"}


def rates() -> list[verdict.Row]:
    """Frames a second of one core, by processor time."""
    rng = np.random.default_rng(0)
    force = rng.uniform(0, 10, (3000, 16, 16))
    out = np.empty(force.shape, np.uint8)

    def rate(work: Any, frames: int, repeats: int) -> list[float]:
        found = []
        for _ in range(repeats + 1):
            start = time.process_time()
            work()
            found.append(frames / max(time.process_time() - start, 1e-9))
        return found[1:]  # the first compiles

    droop = Skin(made(effects={"row_driver": True, "column_offset": True}))
    cross = Skin(made(effects={"row_driver": True, "column_input": True, "lateral": True}))
    codes = cross.read(force)
    places = Forces(*(np.empty(codes.shape) for _ in range(3)), np.empty(codes.shape, np.uint8))
    one = rate(lambda: [cross.decode(frame) for frame in codes[:200]], 200, 5)
    return [
        verdict.median("skin.read_frames_per_s", rate(lambda: droop.read(force, out=out), 3000, 5), "frames/s"),
        verdict.median(
            "skin.decode_frames_per_s", rate(lambda: cross.decode(codes, out=places), 3000, 5), "frames/s",
            "with crosstalk and intervals",
        ),
        verdict.median("skin.decode_one_frame_s", [1 / value for value in one], "s", "one call a frame"),
    ]  # fmt: skip


def brimacombe() -> list[verdict.Row]:
    """Fit the laws that Brimacombe 2009 compares to the curve of an FSR."""
    plan = made(sensor={"law": "power"})
    force = np.linspace(0.5, 20, 40)
    g = 1 / plan.sensor.resistance_ohm(force)
    found = []
    for kind in law.KINDS:
        error = 100 * law.rms_error_n(law.fit(kind, g, force), g, force) / 20.0
        found.append(
            verdict.report(f"decode.law_error.{kind}", error, "% of range", "curve of the FSR, 0.5 to 20 N")
        )
    return found


def recordings(data: Path | None) -> list[verdict.Row]:
    """Real recordings through the chip and back."""
    files = {
        "fscan_16x16": ("fscan_gait_16x16.csv", recording.Layout(rate_hz=31.25)),
        "fscan_60x21": ("fscan_gait_60x21.npz", recording.Layout(key="codes", rate_hz=31.25, missing=255.0)),
    }
    rows = []
    for name, (file, layout) in files.items():
        if data is None or not (data / file).is_file():
            rows.append(verdict.skip(f"decode.{name}", "the recording is not here: --data DIRECTORY"))
            continue
        rec = recording.load(data / file, layout)
        plan = read.chip_of(*rec.present.shape, None)
        force = np.where(rec.present, read.forces_of(rec.values, "codes", plan, None, 1.0), 0.0)
        _, _, judged = read.read_frames(Skin(plan), rec, force)
        rows += [row | {"name": row["name"].replace("read.", f"decode.{name}.")} for row in judged]
    return rows


@click.command("decode")
@click.option("--data", type=click.Path(path_type=Path), help="Directory of the F-Scan recordings.")
@click.option(
    "--pictures", type=click.Path(path_type=Path), default=BUILD / "decode", help="Where figures go."
)
def decode_command(data: Path | None, pictures: Path) -> int:
    """Decoding against truth: solver, tables, hysteresis, intervals, rates, recordings, figures."""
    from tb.programs.decode import figures

    if data is not None and not data.is_dir():
        raise InputError("command line", "--data", str(data), "a directory")
    rows = [noise_free(), *tables()]
    plan, found, row = worn()
    loop, kept = hysteresis()
    rows += [row, *loop, coverage(), *brimacombe(), *rates(), *recordings(data)]
    figures.write(pictures, plan, found, kept)
    verdict.write_rows("decode", rows)
    verdict.print_rows(rows, "codes to newtons")
    click.echo(f"figures are in {pictures}")
    return verdict.exit_code(rows)
