# SPDX-License-Identifier: Apache-2.0
"""Target `design`: bytes of design.toml or spec.toml, up to parameters and plans."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from dermis import plan as planning
from dermis.errors import InputError
from dermis.scene import design as designs
from dermis.scene import scene as scenes
from scripts import generate
from tb.programs.fuzz import deck, inputs, oracle, target_scene
from tb.programs.fuzz.oracle import Finding

_ARRAY = {"rows": 3, "cols": 2}
_ON = ("lateral", "trace", "row_driver", "integrator_gain", "supply_ripple")
_SCENES: tuple[dict[str, Any], ...] = (
    {"array": _ARRAY, "stimulus": {"kind": "uniform", "code": 3}},
    {"array": _ARRAY, "sensor": {"law": "power"}, "stimulus": {"kind": "ramp", "force_n": [0.0, 1.0]},
     "effects": dict.fromkeys(_ON, True)},
)  # fmt: skip


def strategy() -> st.SearchStrategy[bytes]:
    """Draw design.toml or spec.toml; the first byte is "d" or "s"."""
    design, spec = designs.DESIGN_FILE.read_bytes(), designs.SPEC_FILE.read_bytes()
    bare = b"\n".join(line for line in design.split(b"\n") if not line.startswith(b"#"))
    limits = [f"{name}.{key}" for name in list(designs.spec())[:5] for key in ("min", "max", "unit", "gate")]
    known = [(key.split("."), "a finite number") for key in (*designs.load().stored(), *limits)]
    files = inputs.toml([bare, bare, spec[:2500].rpartition(b"\n[")[0] + b"\n", b""], known)
    return st.builds(bytes.__add__, st.sampled_from((b"d", b"d", b"s")), files)


def prepare(place: Path) -> None:
    """Load everything that a design may load."""
    target_scene.prepare(place)
    run(b"d" + designs.DESIGN_FILE.read_bytes(), place)


def run(data: bytes, place: Path) -> str:
    """Load a file as the design or as the limits, and use the design for parameters and scenes."""
    path = place / "design.toml"
    path.write_bytes(data[1:])

    def one() -> None:
        if data[:1] == b"s":
            limits = [v for limit in designs.load_spec(path).values() for v in (limit.min, limit.max)]
            if any(math.isnan(v) for v in limits if v is not None):
                raise Finding("value", "design.load_spec", "a limit that is NaN")
            return
        design = designs.load(path)
        for name, value in design.derived().items():
            if not math.isfinite(value):
                raise Finding("value", "design.derived", f"{name} = {value}")
        if strange := deck.strange_parameters(generate.spice_params(design)):
            raise Finding("deck", "generate.spice_params", repr(strange[0]))
        for scene in _SCENES:
            with contextlib.suppress(InputError):  # a design may leave no room for a scene
                made = planning.make(scenes.from_data(scene, place / "scene.toml", design))
                target_scene.look(made, place, again=False)

    return oracle.judge(one)
