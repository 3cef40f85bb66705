# SPDX-License-Identifier: Apache-2.0
"""Draws processor time against exactness of the stored scenes: engine closed, auto and everything on."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dermis import auto, engines
from dermis import plan as planning
from dermis.engines import event
from dermis.errors import InputError
from dermis.report import figures
from dermis.scene import scene
from dermis.scene.scene import SCENES

WAYS = {
    "closed": ("engine closed", "o", figures.ORANGE),
    "auto": ("auto", "D", figures.BLUE),
    "everything": ("engine event, everything on", "s", figures.GREY),
}
"""Label, marker and colour of each way to simulate a scene."""

_REPEATS = 3
"""Runs of which the fastest counts, after one that compiles."""


@dataclass(frozen=True)
class Point:
    """A scene simulated one way: processor time a frame in s, with planning, and the share of codes that differ."""

    scene: str
    way: str
    seconds: float
    different: float


def _for_closed(world: scene.Scene) -> scene.Scene:
    """Return the scene with every effect that engine closed honours."""
    plan = planning.whole(world, "closed")
    lost = {name for field in engines.refused(plan, "closed") for name in plan.effects_of_field(field)}
    kept = world.table.effects.model_copy(update={"auto": None} | dict.fromkeys(lost, False))
    on = {name: True for name in world.effects if name not in lost and getattr(kept, name) is None}
    return scene.with_effects(world, kept.model_copy(update=on), None)


def _timed(run: Callable[[], engines.Result]) -> tuple[engines.Result, float]:
    result, seconds = run(), []
    for _ in range(_REPEATS):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return result, min(seconds)


def measure(names: list[str] | None = None) -> list[Point]:
    """Return the points of the stored scenes that engine event takes with everything on."""
    points = []
    for path in sorted(SCENES.glob("*.toml")):
        if names is not None and path.stem not in names:
            continue
        world = auto.with_auto(scene.load(path))
        simple = _for_closed(world)
        try:
            whole, whole_s = _timed(lambda world=world: event.run(planning.whole(world, "event")))
            found = {
                "closed": _timed(lambda world=simple: engines.run(planning.make(world, "closed"))),
                "auto": _timed(lambda world=world: engines.run(planning.make(world, "event"))),
            }
        except InputError:  # event refuses the scene, so nothing is compared
            continue
        frames = whole.codes.shape[0]
        for way, (result, seconds) in (found | {"everything": (whole, whole_s)}).items():
            different = float(np.mean(result.codes != whole.codes))
            points.append(Point(path.stem, way, seconds / frames, different))
    return points


def draw(points: list[Point], path: Path) -> None:
    """Draw the points; a line joins those of a scene."""
    figure = Figure(figsize=(8.5, 6.0), layout="constrained")
    axes, below = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    scenes = list(dict.fromkeys(point.scene for point in points))
    ms, percent = (
        np.array([[getattr(p, of) for p in points if p.scene == name] for name in scenes]) * scale
        for of, scale in (("seconds", 1e3), ("different", 100.0))
    )
    axes.plot(ms.T, percent.T, color="0.85", lw=0.8, zorder=1)
    below.plot(ms.T, [0, -1, -2], color="0.85", lw=0.8, zorder=0)
    for n, (label, marker, colour) in enumerate(WAYS.values()):
        style = {"s": 28, "marker": marker, "color": colour}
        middle = float(np.median(ms[:, n]))
        axes.scatter(ms[:, n], percent[:, n], alpha=0.75, label=f"{label}: median {middle:.2g} ms", **style)
        below.scatter(ms[:, n], np.full(len(scenes), -n), **style)
        below.plot([middle, middle], [-n - 0.3, -n + 0.3], color="black")
    below.set_yticks([0, -1, -2], [label for label, _, _ in WAYS.values()])
    below.set_ylim(-2.6, 0.6)
    below.set_xlabel("processor time of a frame, with planning / ms")
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1e-3)
    axes.set_ylim(-4e-4, 200.0)
    axes.set_ylabel("codes that differ from everything on / %")
    axes.legend(loc="upper right", fontsize=8)
    for each in (axes, below):
        each.grid(visible=True, color="0.93")
    figures.save(figure, path)
