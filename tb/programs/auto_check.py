# SPDX-License-Identifier: Apache-2.0
"""Random scenes through the plan's own choice and through engine event with everything on: do the bounds hold?"""

from __future__ import annotations

import contextlib
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import auto, effects, engines, records
from dermis import plan as planning
from dermis.engines import certificate, event
from dermis.errors import InputError
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design

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
    """One scene: who differs by how much, what is certified, how long it took (process time in s).

    `unbounded` conversions have noise beyond any code (a short in their column under thermal noise): every code is
    possible, the certificate says so, and what differs there is not counted in `largest`.
    """

    kind: str
    topology: str
    engine: str
    conversions: int
    differ: int
    largest: int
    unbounded: int
    allowed: int
    outside: int
    width: np.ndarray
    left_out_lsb: float
    seconds: float
    seconds_all: float


def random_scene(rng: np.random.Generator, directory: Path, frames: int = 24) -> dict[str, Any]:
    """Data of a random scene with auto on; files it needs are written into `directory`."""
    rows, cols = (16, 16) if rng.random() < 0.5 else (int(v) for v in rng.integers(3, 20, 2))
    topology = str(rng.choice(TOPOLOGIES))
    design = load_design()
    on: dict[str, Any] = {"auto": {"budget_lsb": float(rng.choice([0.1, 0.25, 0.5])), "sigma": 6.0}}
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


def compare(data: dict[str, Any], path: Path, warm: set[Any] | None = None) -> Outcome:
    """Run a scene as auto plans it and with everything on, and compare.

    With `warm`, a set to be handed from scene to scene, loops are compiled before they are timed.
    """
    world = scene.from_data(data, path)
    if warm is not None and _loops(chosen := planning.make(world)) not in warm:
        warm.add(_loops(chosen))
        certificate.certify(chosen, engines.run(chosen))
    start = time.process_time()
    chosen = planning.make(world)
    result = certificate.certify(chosen, engines.run(chosen))
    seconds = time.process_time() - start

    table = world.table.effects.model_copy(update={"auto": None} | world.effects)
    whole = replace(world, table=world.table.model_copy(update={"effects": table}))
    if warm is not None and _loops(everything := planning.whole(whole, "event")) not in warm:
        warm.add(_loops(everything))
        event.run(everything)
    start = time.process_time()
    full = event.run(planning.whole(whole, "event"))
    seconds_all = time.process_time() - start

    codes, low, high = (a.astype(int) for a in (result.codes, result.low, result.high))
    apart = np.abs(codes - full.codes)
    settings = world.table.effects.auto
    bounded = np.broadcast_to(chosen.margin_lsb, (chosen.cols,)) < chosen.timing.code_max
    return Outcome(
        kind=world.table.stimulus.kind,
        topology=chosen.topology,
        engine=chosen.engine,
        conversions=codes.size,
        differ=int((apart > 0).sum()),
        largest=int(np.where(bounded, apart, 0).max()),
        unbounded=int((~np.broadcast_to(bounded, codes.shape)).sum()),
        allowed=int(np.floor(settings.budget_lsb + 1.0)),
        outside=int(((full.codes < low) | (full.codes > high)).sum()),
        width=np.bincount((high - low).ravel(), minlength=2),
        left_out_lsb=float(chosen.left_out_lsb),
        seconds=seconds,
        seconds_all=seconds_all,
    )


def campaign(count: int, seed: int, frames: int) -> list[Outcome]:
    """Outcomes of `count` random scenes, without those that engine event refuses with everything on; the same for the
    same seed.
    """
    outcomes: list[Outcome] = []
    warm: set[Any] = set()
    with tempfile.TemporaryDirectory() as directory, slots("auto-check", count, "scenes") as on_done:
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            data = random_scene(rng, Path(directory), frames)
            with contextlib.suppress(InputError):  # a refusal, counted in `rows`
                outcomes.append(compare(data, Path(directory) / "scene.toml", warm))
            on_done(number + 1)
    return outcomes


def rows(outcomes: list[Outcome], count: int | None = None) -> list[verdict.Row]:
    """Verdict rows of a campaign of `count` scenes, or as many as there are outcomes."""
    refused = 0 if count is None else count - len(outcomes)
    total = sum(o.conversions for o in outcomes)
    length = max(o.width.size for o in outcomes)
    widths = sum(np.pad(o.width, (0, length - o.width.size)) for o in outcomes)
    cumulative = np.cumsum(widths)
    median = int(np.searchsorted(cumulative, total / 2))
    ratios = [o.seconds_all / o.seconds for o in outcomes]
    by_engine = ", ".join(f"{sum(o.engine == e for o in outcomes)} {e}" for e in auto.ENGINE_COST_NS)
    return [
        verdict.report("auto.scenes", len(outcomes), "scenes", by_engine),
        verdict.judge("auto.refused", refused / (len(outcomes) + refused), f"{refused} scenes"),
        verdict.judge("auto.conversions", total),
        verdict.judge(
            "auto.over_budget",
            sum(o.largest > o.allowed for o in outcomes),
            f"largest difference {max(o.largest for o in outcomes)}, "
            f"{sum(o.differ for o in outcomes) / total:.3%} of the codes differ; "
            f"{sum(o.unbounded for o in outcomes)} conversions have noise beyond any code and are not counted",
        ),
        verdict.judge("auto.outside_certified", sum(o.outside for o in outcomes), f"of {total} conversions"),
        verdict.judge("auto.median_width_lsb", median, f"mean {widths @ np.arange(length) / total:.3f}"),
        verdict.judge(
            "auto.speedup",
            float(np.median(ratios)),
            f"median of {len(ratios)}; quarters {np.quantile(ratios, 0.25):.3g} and {np.quantile(ratios, 0.75):.3g}",
        ),
    ]


@click.command("auto-check")
@click.option(
    "--scenes", default=1000, show_default=True, type=click.IntRange(min=1), help="How many scenes."
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Seed of the first.")
@click.option(
    "--frames", default=200, show_default=True, type=click.IntRange(min=2), help="Frames of a scene."
)
def auto_check_command(scenes: int, seed: int, frames: int) -> int:
    """Random scenes as auto plans them against everything on: budget, certified codes, speed."""
    outcomes = campaign(scenes, seed, frames)
    found = rows(outcomes, scenes)
    verdict.write_rows("auto_check", found)
    verdict.print_rows(found, f"{scenes} random scenes, auto against all effects in engine event")
    return verdict.exit_code(found)
