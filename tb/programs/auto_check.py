# SPDX-License-Identifier: Apache-2.0
"""Compares codes and processor time of [effects] auto with engine event and everything on, over many scenes."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import auto, bounds, effects, engines, records
from dermis import plan as planning
from dermis.engines import event
from dermis.errors import InputError
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design
from dermis.scene.scene import SCENES

_LONG = 200
"""Frames of a long scene."""
KINDS = ("indenter", "slip", "tapping", "ramp", "several", "uniform", "frames", "resistance")
# Values of effects are drawn this many decades below and above their defaults.
_DECADES = (-3.0, 0.3)
_SIGNED = {"ratio_error", "packet_error", "v_v", "i_a", "delta_k", "tc_per_k"}
_BELOW = {"t_aperture_s": 1e-7, "t_s": 1e-7, "relative": 0.5}


# These couple the columns of topology direct; where they do so by more than a count, engine event refuses them
# together with finite gain.
_COUPLING = ("lateral", "row_driver", "column_input", "trace")
# Those that have resistance in the way of a taxel's current.
_LINES = ("row_driver", "column_input", "trace")


@dataclass(frozen=True)
class Outcome:
    """One scene: codes that differ from everything on, verdicts, and processor time in s."""

    name: str
    topology: str
    conversions: int
    wrong: int
    walked: int
    reason: str
    looseness: float
    seconds: float
    seconds_all: float

    @property
    def speedup(self) -> float:
        """Processor time of everything on over that of auto, both with planning."""
        return self.seconds_all / self.seconds

    @property
    def open(self) -> float:
        """Part of the cells that engine event walked."""
        return self.walked / self.conversions


def random_scene(rng: np.random.Generator, directory: Path, frames: int = 24) -> dict[str, Any]:
    """Data of a random scene with auto on; files it needs are written into `directory`."""
    rows, cols = (16, 16) if rng.random() < 0.5 else (int(v) for v in rng.integers(3, 20, 2))
    topology = str(rng.choice(TOPOLOGIES))
    design = load_design()
    on: dict[str, Any] = {"auto": {}}
    motion = rng.random() < 0.15
    for effect in effects.EFFECTS.values():
        if topology not in effect.topologies:
            continue
        if effect.name.startswith("sensor_") and rng.random() < 0.8:
            continue
        if effect.name == "motion":
            if motion:
                on["motion"] = {}
            continue
        values = effect.table().model_dump() | effect.defaults(design, topology)
        if None in values.values():
            values = {name: 10.0 ** rng.uniform(-1, 1) if v is None else v for name, v in values.items()}
        if rng.random() < 0.7:
            signed = effect.name not in ("comparator_noise", "comparator_hysteresis")
            on[effect.name] = {name: _drawn(rng, name, v, signed) for name, v in values.items()}
    if topology == "direct":
        couples = rng.random() < 0.5
        on |= dict.fromkeys(("integrator_gain", "integrator_bandwidth") if couples else _COUPLING, False)
    law, kind = str(rng.choice(["inverse", "inverse", "power"])), str(rng.choice(KINDS))
    if kind == "resistance" and not any(on.get(name, True) for name in _LINES):
        # A short across sources of unlike voltages is refused.
        on["column_offset"] = False
    return {
        "array": {"rows": rows, "cols": cols},
        "sensor": {"law": law},
        "stimulus": stimulus(rng, kind, rows, cols, frames, directory),
        "interface": {
            "topology": topology,
            "k": int(rng.choice(design.interface.k_options)),
            "v_bias_v": float(rng.uniform(0.25, 0.6)),
        },
        "effects": on,
        "run": {"seed": int(rng.integers(1 << 31))},
    }


def _drawn(rng: np.random.Generator, name: str, default: Any, signed: bool) -> Any:
    if name in ("v_max_v", "v_min_v", "v_overdrive_v", "temperature_c", "frequency_hz"):
        return float(default) * float(rng.uniform(0.85, 1.1))
    if name == "phase_deg":
        return float(rng.uniform(-180, 180))
    if name == "spread":
        return 0.0 if rng.random() < 0.5 else float(10 ** rng.uniform(-4, -2))
    if name in ("gain_dc", "gbw_hz", "r_in_ohm", "r_out_ohm"):  # the larger the better
        return float(default) * float(10 ** -rng.uniform(*_DECADES))
    value = float(default) * float(10 ** rng.uniform(*_DECADES))
    value = min(value, _BELOW.get(name, np.inf))
    return -value if signed and name in _SIGNED and rng.random() < 0.5 else value


def body(rng: np.random.Generator, rows: int, cols: int) -> dict[str, Any]:
    """Shape, size and place of a random body."""
    return {
        "shape": str(rng.choice(["flat", "triangular", "cylindrical", "spherical", "round"])),
        "width": float(rng.uniform(1, cols)),
        "length": float(rng.uniform(1, rows)),
        "center_row": float(rng.uniform(0, rows - 1)),
        "center_col": float(rng.uniform(0, cols - 1)),
        "angle_deg": float(rng.uniform(-180, 180)),
        "samples": int(rng.integers(1, 4)),
    }


def stimulus(
    rng: np.random.Generator, kind: str, rows: int, cols: int, frames: int, directory: Path
) -> dict[str, Any]:
    """[stimulus] of a kind; what it reads goes into `directory`."""
    forces = [float(f) for f in rng.uniform(0, 18, frames)]
    if kind == "uniform":
        codes = [int(c) for c in rng.integers(0, 256, frames)]
        ohms = [float(r) for r in 10.0 ** rng.uniform(2.4, 5, frames)]
        choice = [{"code": codes}, {"force_n": forces}, {"r_ohm": ohms}][rng.integers(3)]
        return {"kind": kind} | choice
    if kind in ("frames", "resistance"):
        shape = (frames, rows, cols)
        if kind == "frames":
            touched = rng.random(shape) < rng.uniform(0.05, 1.0)
            values, more = np.where(touched, rng.integers(0, 256, shape), 0), {"unit": "codes"}
        else:
            values, more = 10.0 ** rng.uniform(2.6, 6, shape), {}
            values[rng.random(shape) < 0.3] = np.inf
            if rng.random() < 0.3:
                values[0, 0, 0] = 0.0
        np.save(directory / f"{kind}.npy", values)
        return {"kind": kind, "file": f"{kind}.npy"} | more
    form = body(rng, rows, cols)
    if kind == "indenter":
        return {"kind": kind, "force_n": forces} | form
    if kind == "slip":
        speed, way = float(10 ** rng.uniform(0, 3)), float(rng.uniform(-180, 180))
        moving = {"speed_pitch_per_s": speed, "direction_deg": way, "force_n": forces[0]}
        return {"kind": kind, "frames": frames} | moving | form
    if kind == "tapping":
        return {
            "kind": kind,
            "frames": frames,
            "frequency_hz": float(rng.uniform(5, 80)),
            "force_n": forces[0],
        } | form
    if kind == "ramp":
        return {"kind": kind, "frames": frames, "force_n": forces[:4]} | form
    parts = [
        {"kind": "ramp", "frames": frames, "force_n": forces[:3]} | body(rng, rows, cols) for _ in range(2)
    ]
    return {"kind": "several", "parts": parts}


# Each of these is on or off in a compiled loop of its own.
_LOOPS = (
    {"ripple", "motion"},
    {"c_row_f", "c_column_f", "c_taxel_f"},
    {"q_mirror_c"},
    {"inv_i_range_a"},
    {"t_gbw_s"},
    {"t_comp_delay_s"},
    {"v_hysteresis_v"},
    {"v_int_max_v", "v_int_min_v"},
    event.RANDOM,
)


def _loops(plan: records.Plan) -> tuple[Any, ...]:
    active = plan.active_fields()
    return (plan.engine, plan.topology == "direct", *(bool(active & group) for group in _LOOPS))


def compare(world: scene.Scene, name: str, warm: set[Any] | None = None, repeats: int = 1) -> Outcome:
    """Run a scene with auto and with everything on, and compare.

    With `warm`, a set to be handed from scene to scene, loops are compiled before they are timed. Times are the least
    of `repeats` runs.

    Raises
    ------
    InputError
        Engine event refuses the scene with everything on.
    """

    def everything() -> engines.Result:
        return event.run(planning.whole(world, "event"))

    def filtered() -> engines.Result:
        return engines.run(planning.make(world, "event"))

    chosen = planning.make(world, "event")
    if warm is not None and _loops(chosen) not in warm:
        warm.add(_loops(chosen))
        everything(), filtered()
    seconds, seconds_all = [], []
    for _ in range(repeats):
        start = time.process_time()
        result = filtered()
        middle = time.process_time()
        full = everything()
        seconds.append(middle - start)
        seconds_all.append(time.process_time() - middle)
    found = result.info["filter"]
    return Outcome(
        name=name,
        topology=chosen.topology,
        conversions=result.codes.size,
        wrong=int((result.codes != full.codes).sum()),
        walked=found["everything"],
        reason=found["reason"],
        looseness=found["bound_over_shift"],
        seconds=min(seconds),
        seconds_all=min(seconds_all),
    )


def campaign(count: int, seed: int, frames: int, stored: bool = False) -> tuple[list[Outcome], list[str]]:
    """Outcomes of `count` random scenes, and of every stored one if asked; and the names of those refused.

    A refusal is engine event's, with everything on. The same seed gives the same scenes.
    """
    outcomes: list[Outcome] = []
    refused: list[str] = []
    warm: set[Any] = set()

    def take(world: scene.Scene, name: str) -> None:
        try:
            outcomes.append(compare(world, name, warm))
        except InputError:
            refused.append(name)

    with tempfile.TemporaryDirectory() as directory, slots("auto-check", count, "scenes") as on_done:
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            data = random_scene(rng, Path(directory), frames)
            take(scene.from_data(data, Path(directory) / "scene.toml"), f"random {number}")
            on_done(number + 1)
    for path in sorted(SCENES.glob("*.toml")) if stored else ():
        take(auto.with_auto(scene.load(path)), path.stem)
    return outcomes, refused


def mutants(count: int, seed: int, frames: int) -> tuple[list[str], list[str]]:
    """Effects whose bound, halved, lets a wrong code through in some of `count` random scenes; and the others."""
    caught: list[str] = []
    missed: list[str] = []
    names = [name for name, effect in effects.EFFECTS.items() if effect.bound is not bounds.honoured]
    for name in names:
        effect = effects.EFFECTS[name]

        def halved(s: bounds.Solved, own: bounds.Bounding = effect.bound) -> bounds.Bound:
            bound = own(s)
            parts = (None if v is None else 0.5 * np.asarray(v) for v in bound[:6])
            return bounds.Bound(*parts, level=bound.level)

        effects.EFFECTS[name] = replace(effect, bound=halved)
        try:
            wrong = any(o.wrong for o in campaign(count, seed, frames)[0])
        finally:
            effects.EFFECTS[name] = effect
        (caught if wrong else missed).append(name)
    return caught, missed


def rows(
    few: list[Outcome],
    many: list[Outcome],
    refused: list[str],
    halved: tuple[list[str], list[str]] | None = None,
) -> list[verdict.Row]:
    """Verdict rows: outcomes of short scenes, of long ones, names of refused scenes, and what `mutants` found."""
    every = [*few, *many]
    wrong = [f"{o.name} ({o.wrong})" for o in every if o.wrong]
    mostly = [f"{o.name} ({o.reason or o.topology})" for o in every if o.open > 0.5]
    total = sum(o.conversions for o in every)
    walked = sum(o.walked for o in every) / total
    found = [
        verdict.report(
            "auto.scenes", len(every), "scenes", f"{walked:.2%} of the cells are walked by engine event"
        ),
        verdict.judge("auto.refused", len(refused) / (len(every) + len(refused)), ", ".join(refused)),
        verdict.judge("auto.conversions", total),
        verdict.judge("auto.wrong_codes", sum(o.wrong for o in every), ", ".join(wrong)),
        verdict.judge("auto.scenes_mostly_open", len(mostly) / len(every), ", ".join(mostly)),
    ]
    loose = [o.looseness for o in every if o.looseness > 0]
    if loose:
        found.append(
            verdict.judge("auto.bound_over_shift.median", float(np.median(loose)), f"of {len(loose)} scenes")
        )
    for name, outcomes in (("12_frames", few), ("200_frames", many)):
        if not outcomes:
            continue
        ratios = [o.speedup for o in outcomes]
        note = f"of {len(ratios)} scenes; quarters {np.quantile(ratios, 0.25):.3g} and {np.quantile(ratios, 0.75):.3g}"
        found.append(verdict.judge(f"auto.speedup.median_{name}", float(np.median(ratios)), note))
        if outcomes is few:
            lower = float(np.quantile(ratios, 0.25))
            found.append(verdict.judge(f"auto.speedup.lower_quarter_{name}", lower, note))
    if halved is not None:
        caught, missed = halved
        note = f"not caught: {', '.join(missed) or 'none'}"
        found.append(
            verdict.judge("auto.mutated_bounds_caught", len(caught) / (len(caught) + len(missed)), note)
        )
    return found


@click.command("auto-check")
@click.option("--scenes", default=1000, show_default=True, type=click.IntRange(min=1), help="Random scenes.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Seed of the first.")
@click.option(
    "--frames", default=12, show_default=True, type=click.IntRange(min=2), help="Frames of a scene."
)
@click.option(
    "--long", default=40, show_default=True, type=click.IntRange(min=0), help="Scenes of 200 frames."
)
@click.option(
    "--mutants",
    "halved",
    default=0,
    show_default=True,
    type=click.IntRange(min=0),
    help="Scenes a halved bound.",
)
def auto_check_command(scenes: int, seed: int, frames: int, long: int, halved: int) -> int:
    """Random and stored scenes with auto against everything on: codes, verdicts, processor time."""
    few, refused = campaign(scenes, seed, frames, stored=True)
    many, more = campaign(long, seed, _LONG) if long else ([], [])
    found = rows(few, many, refused + more, mutants(halved, seed, frames) if halved else None)
    verdict.write_rows("auto", found)
    verdict.print_rows(
        found, f"{scenes} random scenes and every stored one, auto against all effects in engine event"
    )
    return verdict.exit_code(found)
