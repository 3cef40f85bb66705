# SPDX-License-Identifier: Apache-2.0
"""Target `design`: the bytes of models/design.toml and models/spec.toml, and what is generated from a design."""

from __future__ import annotations

import contextlib
import math
import random
from pathlib import Path
from typing import Any

from dermis import plan as planning
from dermis.errors import InputError
from dermis.scene import design as designs
from dermis.scene import scene as scenes
from scripts import generate
from tb.programs.fuzz import deck, grammar, oracle, scene_target
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target

SCENES: tuple[dict[str, Any], ...] = (
    {"array": {"rows": 3, "cols": 2}, "stimulus": {"kind": "uniform", "code": 3}},
    {
        "array": {"rows": 3, "cols": 2},
        "sensor": {"law": "power"},
        "stimulus": {"kind": "ramp", "force_n": [0.0, 1.0]},
        "effects": {
            "lateral": True,
            "trace": True,
            "row_driver": True,
            "integrator_gain": True,
            "supply_ripple": True,
        },
    },
)


def _words() -> grammar.Vocabulary:
    numbers = "a finite number"
    rows = [(key, numbers) for key in designs.load().stored()]
    names = [
        (f"{name}.{key}", numbers)
        for name in list(designs.spec())[:5]
        for key in ("min", "max", "unit", "gate")
    ]
    return grammar.vocabulary([*rows, *names])


WORDS = _words()


def seeds() -> list[bytes]:
    """The two files; the first byte says which of them it is read as."""
    design, spec = designs.DESIGN_FILE.read_bytes(), designs.SPEC_FILE.read_bytes()
    bare = b"\n".join(line for line in design.split(b"\n") if not line.startswith(b"#"))
    return [
        b"d" + bare,
        b"d" + design,
        b"s" + spec[:2500].rpartition(b"\n[")[0] + b"\n",
        b"d",
        b"s",
        b"s" + bare,
        b"d" + spec[:900],
    ]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Another file."""
    return (data[:1] or b"d") + grammar.mutate_toml(data[1:], rng, WORDS)


def prepare(place: Path) -> None:
    """Everything loaded that a plan may load."""
    scene_target.prepare(place)
    run(seeds()[0], place)


def look(design: designs.Design, place: Path) -> None:
    """Hold what is derived, what is generated and what a scene makes of a design against what it must be.

    Raises
    ------
    Finding
        A value that follows is not finite, or a generated line could be a command.
    """
    for name, value in design.derived().items():
        if not math.isfinite(value):
            raise Finding("value", "design.derived", f"{name} = {value}")
    parameters = generate.spice_params(design)
    if strange := deck.strange_parameters(parameters):
        raise Finding("deck", "generate.spice_params", repr(strange[0][:200]))
    for data in SCENES:
        with contextlib.suppress(
            InputError
        ):  # a design may leave no room for a scene; the refusal is judged elsewhere
            scene_target.look(
                planning.make(scenes.from_data(data, place / "scene.toml", design)), place, again=False
            )


def run(data: bytes, place: Path) -> str:
    """Load a file as the design or as the limits."""
    path = place / "design.toml"
    path.write_bytes(data[1:])

    def one() -> None:
        if data[:1] == b"s":
            for limit in designs.load_spec(path).values():
                if any(math.isnan(v) for v in (limit.min, limit.max) if v is not None):
                    raise Finding("value", "design.load_spec", "a limit that is NaN")
        else:
            look(designs.load(path), place)

    return oracle.judge(one, lambda path: False)


TARGET = Target("design", "design.toml and spec.toml", seeds, mutate, prepare, run)
