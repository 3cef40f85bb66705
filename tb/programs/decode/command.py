# SPDX-License-Identifier: Apache-2.0
"""`dermis decode`: every figure of decoding against truth, into build/decode.json."""

import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import plan as planning
from dermis.array.array import Network, column_currents
from dermis.decode import calibration, crosstalk, identify, memory, recording
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import SATURATED, Decoder, Forces
from dermis.engines import closed, event
from dermis.ndarrays import Floats
from dermis.places import BUILD
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import calibrate, read, verdict
from dermis.scene import scene as scenes
from dermis.skin import Skin
from scripts import judged
from tb.programs.decode import board, files, kinds, published, session

SEED = 20_261_123
"""Seed of all that is judged here. Constants of the decoder were chosen with others: 0 to 10, 18, 19, 101 to 110."""
FULL_N = 15.0
"""Full scale of the design's sheet."""
FILES = 2000
"""Recordings that are drawn."""


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
    rows = [
        verdict.judge(f"decode.table{n}_miss", max(map(published.miss, cells)), f"{len(cells)} cells")
        for n, cells in ((n, published.cells(n)) for n in (4, 6))
    ]
    worst = published.ours(*published.WORST)
    return [*rows, verdict.judge("decode.table6_worst", worst, "published after two steps: 1.56 %")]


def codes_of_force(plan: Plan, force: Floats) -> Floats:
    """Return forces in codes of an ideal chip, with fractions."""
    with np.errstate(divide="ignore"):
        duty = plan.v_bias_v / (plan.converter.k * plan.converter.i0_a) / plan.sensor.resistance_ohm(force)
    return plan.timing.gate_clocks * duty


def without_memory(known: Calibration) -> Calibration:
    """Return a calibration that knows neither hysteresis nor creep."""
    return dataclasses.replace(known, memory=memory.MemoryLaw(np.empty(0), np.empty(0)))


def rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def worn() -> verdict.Row:
    """Decode worn_fsr_sheet from its codes, with the calibration of a session of the same sheet."""
    plan = planning.load(scenes.find("worn_fsr_sheet"), "closed")
    codes = closed.run(plan).codes
    true = codes_of_force(plan, plan.force_n)
    with tempfile.TemporaryDirectory() as held:
        file = Path(held) / "sheet.toml"
        path = session.write(Path(held), Skin(plan), np.geomspace(0.5, 20.0, 40), "table")
        identified, _ = calibrate.session(path)
        identified.save(file)
        known = calibration.load(file)
    found = Decoder(known, plan.drive.t_frame_s).decode(codes)
    exact = Decoder(Calibration.of_plan(plan), plan.drive.t_frame_s).decode(codes)
    plain = plan.force_of_duty(codes / plan.timing.gate_clocks)
    off, least, before = (codes_of_force(plan, f) - true for f in (found.force_n, exact.force_n, plain))
    note = (
        f"largest {np.abs(off).max():.3g} at the turn of the load; {rms(least):.3g} rms with exact parameters, "
        f"{rms(before):.3g} uncorrected; {found.holds(plan.force_n).mean():.4%} in their interval"
    )
    return verdict.judge("decode.force_error_lsb", rms(off), note)


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


def hysteresis() -> verdict.Row:
    """Identify hysteresis and creep from one cycle of codes, and judge them on others."""
    size = {"rows": 4, "cols": 4}
    skin = Skin(array=size, effects={"sensor_hysteresis": True, "sensor_creep": True})
    blind = without_memory(Calibration.of_plan(skin.plan))
    force, codes = session.cycle(skin, 13.0)
    found, values = identify.fit_memory(blind, codes, force, session.T_FRAME_S)
    off = []
    for seed in range(SEED, SEED + 10):
        skin.reset()
        force = cycles(seed, 1500, 16).reshape(-1, 4, 4)
        codes = skin.read(force, 2e-3)
        decoded = [Decoder(known, 2e-3).decode(codes) for known in (blind, found)]
        used = decoded[1].flags & SATURATED == 0
        off.append([(one_way.force_n - force)[used] / FULL_N * 100 for one_way in decoded])
    before, after = np.concatenate(off, axis=1)
    note = (
        f"rms over 10 x 16 unseen cycles; largest {np.abs(after).max():.3g} %, where a loop is flat; uncorrected "
        f"rms {rms(before):.3g} %, largest {np.abs(before).max():.3g} %; "
        f"loop {values['hysteresis'][0]:.2%}, creep {values['creep_per_decade'][0]:.2%} a decade"
    )
    return verdict.judge("decode.hysteresis_error", rms(after), note)


def random_world(rng: np.random.Generator) -> dict[str, Any]:
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
    shape = ["flat", "triangular", "cylindrical", "spherical"][rng.integers(4)]
    return {
        "kind": "ramp", "shape": shape, "force_n": [0.0, float(rng.uniform(3, 18)), 0.0], "frames": 25,
        "width": float(rng.uniform(4, 14)), "length": float(rng.uniform(4, 14)), "samples": 2,
        "center_row": float(rng.uniform(4, 12)), "center_col": float(rng.uniform(4, 12)),
    }  # fmt: skip


def known_chips() -> Iterator[tuple[Calibration, Plan, Any]]:
    """Yield random sheets whose hysteresis and creep come from a cycle; every sixth has the chip's noise.

    A sheet is its calibration, an unseen scene and the engine that reads it. Chip and network are
    known. Touches are other than the cycle. Noise is that of engine event.
    """
    for seed in range(30):
        rng = np.random.default_rng([SEED, 1, seed])
        effects, touch = random_world(rng), random_touch(rng)
        sheet = made(effects=effects if seed % 6 else effects | {"trace": False})
        blind = dataclasses.replace(without_memory(Calibration.of_plan(sheet)), uncorrected_part=0.0)
        force, codes = session.cycle(Skin(sheet), 12.0)
        known, _ = identify.fit_memory(blind, codes, force, session.T_FRAME_S)
        if seed % 6:
            yield known, made(touch, effects=effects), closed
            continue
        noise = dict.fromkeys(("thermal_noise", "shot_noise", "ktc_noise", "flicker_noise"), True)
        effects |= noise | {"trace": False}
        still = made({"kind": "uniform", "force_n": [5.0] * 20}, "event", effects=effects)
        known = dataclasses.replace(known, noise_code=identify.fit_noise(event.run(still).codes))
        yield known, made(touch, "event", effects=effects), event


def coverage_row() -> verdict.Row:
    """Judge the share of forces in their interval, and its median width in LSB where pressed, on known chips."""
    inside, widths = [], []
    for known, plan, engine in known_chips():
        codes = engine.run(plan).codes
        found = Decoder(known, plan.drive.t_frame_s).decode(codes)
        pressed = (codes > 0) & (codes < plan.timing.code_max)
        inside.append(found.holds(plan.force_n).ravel())
        widths.append((found.high_n - found.low_n)[pressed] / (FULL_N / 255))
    width, share = float(np.median(np.concatenate(widths))), np.concatenate(inside)
    note = f"{len(inside)} scenes, {share.size} readings; median width {width:.3g} LSB where pressed"
    row = verdict.judge("decode.interval_coverage", share.mean(), note)
    return row | ({} if width <= 2 else {"status": "FAIL"})


def kinds_row() -> verdict.Row:
    wrong, count = {}, len(kinds.CASES)
    for name, case in kinds.CASES.items():
        with tempfile.TemporaryDirectory() as held:
            if (said := kinds.fault(case, Path(held))) is not None:
                wrong[name] = said
    note = "; ".join(f"{name}: {said}" for name, said in wrong.items()) or f"{count} files"
    return verdict.judge("read.kinds", 1 - len(wrong) / count, note)


def recordings() -> list[verdict.Row]:
    """Judge files of random layouts, and codes that go through a file."""
    chip = read.chip_of(16, 16, None)
    rng = np.random.default_rng(SEED)
    alone = np.diag(rng.uniform(0, 9, chip.rows * chip.cols)).reshape(-1, chip.rows, chip.cols)
    force = np.concatenate([alone, rng.uniform(0, 9, (100, chip.rows, chip.cols))])
    with tempfile.TemporaryDirectory() as held:
        counts = files.count(Path(held), FILES)
        file = Path(held) / "codes.npy"
        np.save(file, Skin(chip).read(force))
        layout = recording.Layout(chip.rows, chip.cols, rate_hz=100.0)
        codes, found, _ = read.decode_frames(Skin(chip), recording.load(file, layout), str(file))
    error = np.abs(found.force_n - force)
    pressed = alone > 0
    # One code of a taxel that droops is more force than one of full scale by 255.
    more = Skin(chip).decode(codes[: len(alone)] + pressed.astype(codes.dtype)).force_n
    lsb_n = (more - found.force_n[: len(alone)])[pressed]
    worst = float((error[: len(alone)][pressed] / lsb_n).max())
    crowd = float(error[len(alone) :].max()) / (FULL_N / chip.timing.code_max)
    said = ", ".join(f"{n} {name}" for name, n in counts.items())
    note = f"all taxels pressed at once: {crowd:.2g} of {FULL_N:g} N / {chip.timing.code_max}"
    return [
        kinds_row(),
        verdict.judge("read.silent_wrong", counts["wrong"], said),
        verdict.judge("read.codes_roundtrip", worst, note),
    ]


def board_force() -> verdict.Row:
    """Judge the forces of a simulated board with dividers, calibrated by a session of weights."""
    errors, notes = [], []
    for bits in (12, 10):
        rng = np.random.default_rng([SEED, 2])
        divider_ohm = 22.0 * (1 + 0.01 * rng.uniform(-1, 1, 32))
        factor = np.exp(0.1 * rng.standard_normal((16, 32)))
        sheet = board.Board(16, 32, bits, divider_ohm, 1e3, factor, reference_v=1.1, multiplexer_ohm=4.0)
        with tempfile.TemporaryDirectory() as held:
            loads = session.rectangles(rng, np.geomspace(1.0, 12.0, 30), sheet.rows, sheet.cols)
            known, _ = calibrate.session(sheet.session(Path(held), loads, 22.0, rng))
        force = board.touches(rng, 60, sheet.rows, sheet.cols)
        counts = sheet.counts(force, rng)
        found = Decoder(known, 0.01).decode(counts)
        off, before = (sheet.alone(f) - sheet.alone(force) for f in (found.force_n, sheet.force_of(counts)))
        errors.append(rms(off))
        notes.append(
            f"{bits} bits {rms(off):.3g}, {rms(off[force > 0]):.3g} where pressed, {rms(before):.3g} uncorrected, "
            f"{rms(found.force_n - force):.3g} N, {found.holds(force).mean():.4%} in their interval"
        )
    return verdict.judge("board.force_error", max(errors), "; ".join(notes))


def seconds(work: Callable[[], object]) -> list[float]:
    """Return processor times of a call, without the first, which compiles."""
    work()
    return [cpu_time.cpu_seconds(work) for _ in range(5)]


def many_sheets() -> Iterator[verdict.Row]:
    """Sheets a second in one call, and the time of one frame; touches that move."""
    rng, row, col = np.random.default_rng(0), *np.mgrid[:16, :16]
    force = np.empty((4, 4096, 16, 16), np.float32)
    start = rng.uniform(2, 13, (2, 4096, 1, 1))
    for frame, place in zip(force, start + 0.3 * np.arange(4)[:, None, None, None, None], strict=True):
        frame[:] = 8 * np.maximum(1 - ((row - place[0]) ** 2 + (col - place[1]) ** 2) / 16, 0)
    effects: dict[str, Any] = {"row_driver": True, "column_offset": True}
    out = np.empty(force.shape[1:], np.uint8)
    for name, more in (("envs", ()), ("envs_memory", ("sensor_hysteresis", "sensor_creep"))):
        skin = Skin(envs=4096, effects=effects | dict.fromkeys(more, True))
        spent = seconds(lambda skin=skin: [skin.read(frame, out=out) for frame in force])  # type: ignore[misc]
        yield verdict.median(f"skin.{name}_frames_per_s", [4 * 4096 / t for t in spent], "frames/s")
    one, single = Skin("single_touch"), force[0, 0].astype(float)
    # Of many calls at once: looking at the time takes a seventh of one.
    spent = [1e6 * t / 500 for t in seconds(lambda: [one.read(single) for _ in range(500)])]
    yield verdict.median("skin.read_us", spent, "us", "with column inputs")


def rates() -> Iterator[verdict.Row]:
    """Frames a second of one core, by processor time."""
    force = np.random.default_rng(0).uniform(0, 10, (3000, 16, 16))
    droop = Skin(effects={"row_driver": True, "column_offset": True})
    cross = Skin(effects={"row_driver": True, "column_input": True, "lateral": True})
    out, codes = np.empty(force.shape, np.uint8), cross.read(force)
    places = Forces.empty(codes.shape)
    reading = [len(codes) / t for t in seconds(lambda: droop.read(force, out=out))]
    yield verdict.median("skin.read_frames_per_s", reading, "frames/s")
    decoding = [len(codes) / t for t in seconds(lambda: cross.decode(codes, out=places))]
    yield verdict.median("skin.decode_frames_per_s", decoding, "frames/s", "with crosstalk and intervals")
    single = [t / 200 for t in seconds(lambda: [cross.decode(frame) for frame in codes[:200]])]
    yield verdict.median("skin.decode_one_frame_s", single, "s", "one call a frame")
    yield from many_sheets()


ROUND_TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": 12.0, "width": 13, "length": 13}
DROOPING_CHIP = {
    "row_driver": {"r_ohm": 4.0}, "column_input": {"r_ohm": 2.0}, "lateral": {"r_ohm": 1000.0},
    "mirror_ratio": {"ratio_error": 0.0, "spread": 0.01}, "column_offset": {"v_v": 5e-4}, "sensor_spread": True,
}  # fmt: skip


def error_maps(path: Path) -> None:
    """Draw the error of a round touch after every further correction."""
    from matplotlib.figure import Figure

    from dermis.report import figures

    plan = made(ROUND_TOUCH, effects=DROOPING_CHIP)
    codes, full = closed.run(plan).codes, Calibration.of_plan(plan)
    step_a = float(full.step_a.mean())
    network = dataclasses.replace(full, factor=1.0)
    rows = {name: plan.surrounding[name] for name in ("r_row_driven_ohm", "r_row_grounded_ohm")}
    stages = {
        "as read": dataclasses.replace(network, network={}, step_a=step_a, start_code=0.0),
        "+ gain and offset": dataclasses.replace(network, network={}),
        "+ row droop": dataclasses.replace(network, network=rows),
        "+ all crosstalk": network,
        "+ taxel spread": full,
    }
    errors = [Decoder(known, 2e-3).decode(codes).force_n[0] - plan.force_n[0] for known in stages.values()]
    most = max(np.abs(e).max() for e in errors)
    figure = Figure(figsize=(13, 3.1), layout="constrained")
    axes = figure.subplots(1, len(errors), sharex=True, sharey=True)
    axes[0].set(xlabel="column", ylabel="row")
    for axis, name, error in zip(axes, stages, errors, strict=True):
        image = axis.imshow(error, vmin=-most, vmax=most, cmap="RdBu_r")
        axis.set_title(f"{name}\nrms {rms(error):.3f} N", fontsize=10)
    figure.colorbar(image, ax=axes, label="error in N", shrink=0.85)
    figures.save(figure, path)


@click.command("decode")
def decode_command() -> int:
    """Decoding against truth: solver, tables, hysteresis, intervals, rates; a figure in build/decode."""
    rows = [noise_free(), *tables(), worn(), hysteresis(), coverage_row(), *recordings(), board_force()]
    rows += rates()
    error_maps(BUILD / "decode" / "decode_error_maps.png")
    return judged.finish("decode", rows, "codes to newtons")
