# SPDX-License-Identifier: Apache-2.0
"""Targets `scene` and `design`: bytes of a scene, of design.toml or of spec.toml, up to plan and
deck.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import math
import os
import pickle
import random
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from dermis import engines, records
from dermis import plan as planning
from dermis.array import array
from dermis.chip import netlist, sky130
from dermis.errors import InputError
from dermis.scene import design as designs
from dermis.scene import scene as scenes
from dermis.scene.schema import write_toml
from scripts import generate
from tb.programs.fuzz import deck, inputs, oracle
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target
from tb.reference.scenes import PROFILES, random_scene

DECK_TAXELS = 300
"""Taxels of the largest array whose deck is checked line by line."""

_SMALL = b"[array]\nrows = 3\ncols = 2\n"
_BODY = b'shape = "flat"\nforce_n = [1.0, 2.0]\n'
_STIMULI = (
    b'kind = "several"\n[[stimulus.parts]]\nkind = "indenter"\n' + _BODY,
    b'kind = "uniform"\nr_ohm = [inf, 0.0]\nt_frame_s = 0.01\nresample = "linear"\n',
    b'kind = "frames"\nfile = "frames.csv"\nunit = "codes"\n',
    b'kind = "frames"\nfile = "frames.npz"\nkey = "other"\nunit = "newtons"\nselect = [0, 2]\n',
    b'kind = "resistance"\nfile = "frames.npy"\n',
    b'kind = "resistance"\nfile = "pickled.npy"\n',
    b'kind = "resistance"\nfile = "pipe.csv"\n',
)
_LARGE = (
    b'[stimulus]\nkind = "slip"\nspeed_pitch_per_s = 1.0\nshape = "flat"\nforce_n = 1.0\nframes = 33554432\n',
    b'[stimulus]\nkind = "slip"\nspeed_pitch_per_s = 1.0\nshape = "flat"\nforce_n = 1.0\nduration_s = 1e9\n',
    b'[array]\nrows = 1000000\ncols = 1000000\n[stimulus]\nkind = "uniform"\ncode = [3, 4]\n',
    b"a" + b".a" * 15_000 + b" = 1\n",
)
_EVERY = b"[effects]\n" + b"".join(f"{name} = true\n".encode() for name in scenes.EFFECTS)


class Touch:
    """Creates a directory when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("fuzz_was_here",)


def pickled() -> bytes:
    """Return an npy file of objects, whose loading runs code."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": (3, 2)})
    return stream.getvalue() + pickle.dumps([Touch()] * 6)


def files(place: Path) -> None:
    """Write frame files that a scene may name, good ones and others."""
    codes = np.array([[1, 2], [3, 4], [5, 6]], dtype=np.uint8)
    (place / "frames.csv").write_text("1,2\n3,4\n5,6\n")
    np.save(place / "frames.npy", codes)
    np.savez(place / "frames.npz", codes=codes, other=codes[None].repeat(3, 0))
    np.save(place / "wide.npy", np.arange(256, dtype=np.uint8).reshape(16, 16))
    (place / "pickled.npy").write_bytes(pickled())
    (place / "directory.csv").mkdir()
    (place / "link.csv").symlink_to("link.csv")
    (place / "zero.csv").symlink_to("/dev/zero")
    os.mkfifo(place / "pipe.csv")


def _words() -> inputs.Words:
    """Return every key of a scene; the schema names those of a stimulus "stimulus kind
    KIND.KEY".
    """
    rows = [(key, allowed) for key, _, allowed, _ in scenes.schema_rows()]
    kinds = sorted({key.split(".")[0].split()[-1] for key, _ in rows if key.startswith("stimulus kind")})
    named = ", ".join(f'"{kind}"' for kind in kinds)
    return [
        *inputs.words([("stimulus.kind", named)]),
        *(
            (("stimulus", key.rpartition(".")[2]) if " " in key else tuple(key.split(".")), a)
            for key, a in rows
        ),
    ]


def bases() -> list[bytes]:
    """Return the scenes of the project, small and large ones, and random ones."""
    found = [path.read_bytes() for path in sorted(scenes.SCENES.glob("*.toml"))]
    found += [_SMALL + b"[stimulus]\n" + stimulus for stimulus in _STIMULI]
    found += [_SMALL + b"[stimulus]\n" + _STIMULI[2] + _EVERY, *_LARGE]
    for n in range(40):
        world = random_scene(random.Random(n), dataclasses.replace(PROFILES["closed,event"], auto=0.4))
        scene = world.scene | {"array": {"rows": 3, "cols": 2}}
        if world.files:
            scene["stimulus"] = {"kind": "resistance", "file": "frames.csv"}
        found.append(write_toml(scene).encode())
    return found


def prepare(place: Path) -> None:
    """Write the files of a scene, and load everything that a plan may load."""
    files(place)
    for corner in sky130.CORNERS:  # build/ holds the models that decks include, written on first use
        sky130.models(corner)
    deck.includes()
    for scene in bases()[:-40:2]:
        (place / "scene.toml").write_bytes(scene)
        # Some bases are refused by design; what counts is that loading has loaded its modules.
        with contextlib.suppress(InputError):
            look(planning.load(place / "scene.toml"), place, again=True)
    # Loops compile on first use, for longer than an input may take: arrays with traces, offsets and
    # leaks.
    lines = array.Network(np.full((3, 3), 1e-3), 0.5, 1.0, 2.0, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1)
    for rest in ({}, {"v_column_offset_v": np.full(3, 1e-3), "i_leak_a": np.full(3, 1e-9)}):
        array.column_currents(dataclasses.replace(lines, **rest))
    oracle.small_limits()


def look(made: records.Plan, place: Path, again: bool) -> None:
    """Raise Finding unless a plan is finite, reads back the same, and has decks of known lines."""
    ohm = made.resistance_ohm
    if ohm.ndim != 3 or not (ohm >= 0).all():
        raise Finding("value", "plan.make", f"resistances of shape {ohm.shape} that are NaN or below 0")
    if made.force_n is not None and (made.force_n.shape != ohm.shape or not (made.force_n >= 0).all()):
        raise Finding("value", "plan.make", "forces that are NaN, below 0 or of another shape")
    if again:
        path, text = place / "resolved.toml", made.resolved_toml(place)
        path.write_text(text, encoding="utf-8")
        try:
            back = planning.load(path)
        except InputError as error:
            raise Finding("again", "scene.to_toml", f"refused: {str(error)[:300]}") from None
        same = np.array_equal(ohm, back.resistance_ohm) and made.drive == back.drive
        if not same or back.resolved_toml(place) != text:
            raise Finding("again", "scene.to_toml", "another plan")
    if made.rows * made.cols <= DECK_TAXELS and not engines.refused(made, "cosim"):
        levels = [0.0] * (made.rows + 1 + made.cols)
        for frame in {0, made.frames - 1}:
            for columns in {tuple(range(made.cols)), *netlist.parts(made)}:
                written = netlist.frame_deck(made, frame, levels, record=True, columns=columns)
                if strange := deck.strange_lines(written.lines):
                    raise Finding("deck", "netlist.frame_deck", repr(strange[0][:300]))


def run(data: bytes, place: Path) -> str:
    """Plan a scene, as `dermis run` does before it makes OUT."""
    path, resolved = place / "scene.toml", place / "resolved.toml"
    path.write_bytes(data)

    def one() -> None:
        made = planning.load(path)
        engines.check(made)
        look(made, place, again=zlib.crc32(data) % 4 == 0)

    return oracle.judge(one, lambda path: path == resolved)


_SCENES: tuple[dict[str, Any], ...] = (
    {"array": {"rows": 3, "cols": 2}, "stimulus": {"kind": "uniform", "code": 3}},
    {
        "array": {"rows": 3, "cols": 2},
        "sensor": {"law": "power"},
        "stimulus": {"kind": "ramp", "force_n": [0.0, 1.0]},
        "effects": dict.fromkeys(
            ("lateral", "trace", "row_driver", "integrator_gain", "supply_ripple"), True
        ),
    },
)


def design_inputs() -> st.SearchStrategy[bytes]:
    """Draw design.toml or spec.toml; the first byte is "d" or "s"."""
    design, spec = designs.DESIGN_FILE.read_bytes(), designs.SPEC_FILE.read_bytes()
    bare = b"\n".join(line for line in design.split(b"\n") if not line.startswith(b"#"))
    rows = [(key, "a finite number") for key in designs.load().stored()]
    names = [f"{name}.{key}" for name in list(designs.spec())[:5] for key in ("min", "max", "unit", "gate")]
    known = inputs.words([*rows, *((name, "a finite number") for name in names)])
    files = inputs.toml([bare, bare, spec[:2500].rpartition(b"\n[")[0] + b"\n", b""], known)
    return st.builds(bytes.__add__, st.sampled_from((b"d", b"d", b"s")), files)


def design_run(data: bytes, place: Path) -> str:
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
            raise Finding("deck", "generate.spice_params", repr(strange[0][:200]))
        for scene in _SCENES:
            with contextlib.suppress(InputError):  # a design may leave no room for a scene
                look(planning.make(scenes.from_data(scene, place / "scene.toml", design)), place, again=False)

    return oracle.judge(one, lambda path: False)


def _prepare_design(place: Path) -> None:
    prepare(place)
    design_run(b"d" + designs.DESIGN_FILE.read_bytes(), place)


_READS = (
    "dermis.scene.scene",
    "dermis.scene.schema",
    "dermis.errors",
    "dermis.scene.stimulus",
    "dermis.plan",
)
TARGETS = {
    "scene": Target(
        lambda: inputs.toml(bases(), _words()),
        prepare,
        run,
        (*_READS, "dermis.effects", "dermis.chip.netlist"),
    ),
    "design": Target(design_inputs, _prepare_design, design_run, ("dermis.scene.design", "scripts.generate")),
}
