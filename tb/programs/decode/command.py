# SPDX-License-Identifier: Apache-2.0
"""`dermis decode`: every figure of decoding against truth, into build/decode.json."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.array.array import Network, column_currents
from dermis.decode import calibration, crosstalk, identify, law, memory, recording
from dermis.decode.calibration import Calibration, Mode
from dermis.decode.decoder import SATURATED, Decoder, Forces
from dermis.engines import closed, event
from dermis.errors import InputError
from dermis.places import BUILD
from dermis.records import Plan
from dermis.report import calibrate, read, verdict
from dermis.scene import scene as scenes
from dermis.skin import Skin
from tb.programs.decode import published, session

Floats = NDArray[np.float64]

SEED = 20_261_123
"""Seed of all that is judged here. Constants of the decoder were chosen with others: 0 to 10, 18, 19, 101 to 110."""
FULL_N = 15.0
"""Full scale of the design's sheet."""
COVERAGE_MIN = 0.999
"""Least share of forces in their interval, as for `decode.interval_coverage`."""
SLACK = 1 + 1e-9
"""Rounding of a force that lies on the end of its interval."""


def made(stimulus: dict[str, Any] | None = None, engine: str = "closed", **tables: Any) -> Plan:
    """Plan a scene of this program."""
    data = {"stimulus": stimulus or {"kind": "uniform", "force_n": [0.0]}, **tables}
    return planning.make(scenes.from_data(data, Path("decode program")), engine)


def noise_free() -> verdict.Row:
    """Random arrays solved backwards from exact currents."""
    rng, worst, cases, proven = np.random.default_rng(SEED), 0.0, 0, 0
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


def identified(plan: Plan, forces_n: Floats, kind: str = "linear", seed: int = 0) -> Calibration:
    """Return the calibration that `dermis calibrate` makes of a simulated session of the plan's sheet."""
    with tempfile.TemporaryDirectory() as directory:
        made, _ = calibrate.session(session.write(Path(directory), Skin(plan), forces_n, kind, seed))
        made.save(Path(directory) / "sheet.toml")
        return calibration.load(Path(directory) / "sheet.toml")


def covered(found: Forces, force: Floats) -> NDArray[np.bool_]:
    """Return True where a force lies in its interval."""
    return (found.low_n <= force * SLACK) & (force <= found.high_n * SLACK)


def worn() -> tuple[Plan, Forces, verdict.Row]:
    """Decode worn_fsr_sheet from its codes, with the calibration of a session of the same sheet."""
    plan = planning.load(scenes.find("worn_fsr_sheet"), "closed")
    codes = closed.run(plan).codes
    true = codes_of_force(plan, plan.force_n)
    known = identified(plan, np.geomspace(0.5, 20.0, 40), "table")
    found = Decoder(known, plan.drive.t_frame_s).decode(codes)
    exact = Decoder(Calibration.of_plan(plan), plan.drive.t_frame_s).decode(codes)
    plain = plan.force_of_duty(codes / plan.timing.gate_clocks)
    off, least, before = (codes_of_force(plan, f) - true for f in (found.force_n, exact.force_n, plain))
    rms, rms_exact, rms_before = (float(np.sqrt(np.mean(e**2))) for e in (off, least, before))
    note = (
        f"largest {np.abs(off).max():.3g} at the turn of the load; {rms_exact:.3g} rms with exact parameters, "
        f"{rms_before:.3g} uncorrected; {covered(found, plan.force_n).mean():.4%} in their interval"
    )
    return plan, found, verdict.judge("decode.force_error_lsb", rms, note)


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
    for seed in range(SEED, SEED + 10):
        skin.reset()
        force = cycles(seed, 1500, 16).reshape(-1, 4, 4)
        codes = skin.read(force, 2e-3)
        decoded = Decoder(found, 2e-3).decode(codes)
        uncorrected = Decoder(blind, 2e-3).decode(codes)
        used = decoded.flags & SATURATED == 0
        off.append((decoded.force_n - force)[used])
        plain.append((uncorrected.force_n - force)[used])
        if seed == SEED:
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
        "sensor_hysteresis": {"relative": float(rng.uniform(0.02, 0.12))},
        "sensor_creep": {"per_decade": float(rng.uniform(0.01, 0.08))},
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


def judged(known: Calibration, plan: Plan, engine: Any = closed) -> tuple[NDArray[np.bool_], Floats]:
    """Return which forces of a scene lie in their interval, and the widths in LSB of pressed taxels."""
    codes = engine.run(plan).codes
    found = Decoder(known, plan.drive.t_frame_s).decode(codes)
    pressed = (codes > 0) & (codes < plan.timing.code_max)
    return covered(found, plan.force_n), (found.high_n - found.low_n)[pressed] / (FULL_N / 255)


def coverage(count: int = 30) -> verdict.Row:
    """Judge intervals on random sheets whose hysteresis and creep come from a cycle; a sixth with the chip's noise.

    Chip and network are known. Touches are other than the cycle. Noise is that of engine event.
    """
    inside, widths, noisy = [], [], 0
    for seed in range(count):
        rng = np.random.default_rng([SEED, 1, seed])
        effects, touch = random_world(rng), random_touch(rng)
        noise: dict[str, Any] = {}
        if seed % 6 == 0:
            effects.pop("trace", None)
            noise = dict.fromkeys(("thermal_noise", "shot_noise", "ktc_noise", "flicker_noise"), True)
        sheet = made(effects=effects)
        blind = dataclasses.replace(
            Calibration.of_plan(sheet),
            memory=memory.MemoryLaw(np.empty(0), np.empty(0)),
            uncorrected_part=0.0,
        )
        force, codes = session.cycle(Skin(sheet), 12.0)
        known, _ = identify.fit_memory(blind, codes, force, session.T_FRAME_S)
        if noise:
            still = made({"kind": "uniform", "force_n": [5.0] * 20}, "event", effects=effects | noise)
            known = dataclasses.replace(known, noise_code=identify.fit_noise(event.run(still).codes))
        plan = made(touch, "event" if noise else "closed", effects=effects | noise)
        good, width = judged(known, plan, event if noise else closed)
        inside.append(good.ravel())
        widths.append(width)
        noisy += bool(noise)
    width = float(np.median(np.concatenate(widths)))
    share = np.concatenate(inside)
    note = (
        f"{count} sheets whose hysteresis and creep are identified, {noisy} with noise, {share.size} readings; "
        f"median width {width:.3g} LSB where pressed"
    )
    row = verdict.judge("decode.interval_coverage", float(share.mean()), note)
    return row if width <= 2 else row | {"status": "FAIL"}


def identified_coverage(count: int = 6) -> verdict.Row:
    """Judge intervals where everything, the network too, comes from the session of the sheet."""
    inside, widths = [], []
    for seed in range(count):
        rng = np.random.default_rng([SEED, 2, seed])
        effects, size = random_world(rng), {"rows": 8, "cols": 8}
        effects.pop("trace", None)
        known = identified(made(effects=effects, array=size), rng.uniform(1.0, 14.0, 30), seed=SEED + seed)
        for _ in range(4):
            touch = random_touch(rng) | {"center_row": 4.0, "center_col": 4.0}
            good, width = judged(known, made(touch, effects=effects, array=size))
            inside.append(good.ravel())
            widths.append(width)
    width = float(np.median(np.concatenate(widths)))
    note = f"{count} sheets of 8 x 8, all parameters from sessions; median width {width:.3g} LSB"
    share = float(np.concatenate(inside).mean())
    return verdict.within("decode.identified_coverage", share, "1", COVERAGE_MIN, None, note)


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
    network = cross.plan.surrounding
    modes = tuple(
        Mode({name: 1.1 * np.asarray(network[name])}, np.zeros((16, 16)))
        for name in ("r_row_driven_ohm", "r_column_ohm", "g_lateral_row_s")
    )
    known = dataclasses.replace(Calibration.of_plan(cross.plan), modes=modes, offset_v2=1e-9)
    unsure = Decoder(known, cross.t_frame_s)
    places = Forces(*(np.empty(codes.shape) for _ in range(3)), np.empty(codes.shape, np.uint8))
    one = rate(lambda: [cross.decode(frame) for frame in codes[:200]], 200, 5)
    return [
        verdict.median("skin.read_frames_per_s", rate(lambda: droop.read(force, out=out), 3000, 5), "frames/s"),
        verdict.median(
            "skin.decode_frames_per_s", rate(lambda: cross.decode(codes, out=places), 3000, 5), "frames/s",
            "with crosstalk and intervals",
        ),
        verdict.median(
            "skin.decode_identified_frames_per_s", rate(lambda: unsure.decode(codes, out=places), 3000, 5),
            "frames/s", "with the uncertainty of a network that loads identified",
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
    rows += [row, *loop, coverage(), identified_coverage(), *brimacombe(), *rates(), *recordings(data)]
    figures.write(pictures, plan, found, kept)
    verdict.write_rows("decode", rows)
    verdict.print_rows(rows, "codes to newtons")
    click.echo(f"figures are in {pictures}")
    return verdict.exit_code(rows)
