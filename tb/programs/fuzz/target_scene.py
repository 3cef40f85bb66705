# SPDX-License-Identifier: Apache-2.0
"""Target `scene`: bytes of a scene, up to its plan and its decks."""

import contextlib
import dataclasses
import io
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
from dermis.scene import scene as scenes
from dermis.scene import stimulus
from dermis.scene.schema import write_toml
from tb.programs.fuzz import deck, inputs, oracle
from tb.programs.fuzz.oracle import Finding
from tb.reference.scenes import PROFILES, random_scene

DECK_TAXELS = 300  # taxels of the largest array whose deck is checked line by line
SMALL = "[array]\nrows = 3\ncols = 2\n[stimulus]\n"
CODES = 'kind = "frames"\nfile = "frames.csv"\nunit = "codes"\n'
_FLAT = 'shape = "flat"\nforce_n = 1.0\n'
_BASES = (
    SMALL + 'kind = "several"\n[[stimulus.parts]]\nkind = "indenter"\n' + _FLAT,
    SMALL + 'kind = "uniform"\nr_ohm = [inf, 0.0]\nt_frame_s = 0.01\nresample = "linear"\n',
    SMALL + 'kind = "frames"\nfile = "frames.npz"\nkey = "other"\nunit = "newtons"\nselect = [0, 2]\n',
    *(SMALL + f'kind = "resistance"\nfile = "{name}"\n' for name in ("frames.npy", "pickled.npy", "pipe.csv")),
    SMALL + CODES + "[effects]\n" + "".join(f"{name} = true\n" for name in scenes.EFFECTS),
    '[stimulus]\nkind = "slip"\nspeed_pitch_per_s = 1.0\nframes = 33554432\n' + _FLAT,
    '[stimulus]\nkind = "slip"\nspeed_pitch_per_s = 1.0\nduration_s = 1e9\n' + _FLAT,
    '[array]\nrows = 1000000\ncols = 1000000\n[stimulus]\nkind = "uniform"\ncode = [3, 4]\n',
    "a" + ".a" * 15_000 + " = 1\n",
)  # fmt: skip


class Touch:
    """Creates a directory when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("fuzz_was_here",)


def pickled() -> bytes:
    """Return an npy file of objects, whose loading runs code."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": (3, 2)})
    return stream.getvalue() + pickle.dumps([Touch()] * 6)


def _words() -> inputs.Words:
    """Return every key of a scene; the schema names those of a stimulus "stimulus kind KIND.KEY"."""
    rows = [(key, allowed) for key, _, allowed, _ in scenes.schema_rows()]
    kinds = {key.split(".")[0].split()[-1] for key, _ in rows if key.startswith("stimulus kind")}
    named = ", ".join(f'"{kind}"' for kind in sorted(kinds))
    split = [(("stimulus", k.rpartition(".")[2]) if " " in k else k.split("."), a) for k, a in rows]
    return [(("stimulus", "kind"), named), *split]


def _bases() -> list[bytes]:
    """Return the scenes of the project, small and large ones, and random ones."""
    found = [path.read_bytes() for path in sorted(scenes.SCENES.glob("*.toml"))]
    found += [text.encode() for text in (SMALL + CODES, *_BASES)]
    for n in range(40):
        world = random_scene(random.Random(n), dataclasses.replace(PROFILES["closed,event"], auto=0.4))
        scene = world.scene | {"array": {"rows": 3, "cols": 2}}
        if world.files:
            scene["stimulus"] = {"kind": "resistance", "file": "frames.csv"}
        found.append(write_toml(scene).encode())
    return found


def strategy() -> st.SearchStrategy[bytes]:
    return inputs.toml(_bases(), _words())


def prepare(place: Path) -> None:
    """Write frame files, good ones and others, and load everything that a plan may load."""
    codes = np.array([[1, 2], [3, 4], [5, 6]], dtype=np.uint8)
    (place / "frames.csv").write_text("1,2\n3,4\n5,6\n")
    (place / "resolved.toml").touch()
    np.save(place / "frames.npy", codes)
    np.savez(place / "frames.npz", codes=codes, other=codes[None].repeat(3, 0))
    np.save(place / "wide.npy", np.arange(256, dtype=np.uint8).reshape(16, 16))
    (place / "pickled.npy").write_bytes(pickled())
    (place / "directory.csv").mkdir()
    (place / "link.csv").symlink_to("link.csv")
    (place / "zero.csv").symlink_to("/dev/zero")
    os.mkfifo(place / "pipe.csv")
    for corner in sky130.CORNERS:  # build/ holds the models that decks include, written on first use
        sky130.models(corner)
    deck.includes()
    for scene in _bases()[:-40:2]:
        (place / "scene.toml").write_bytes(scene)
        with contextlib.suppress(InputError):  # some bases are refused by design
            look(planning.load(place / "scene.toml"), place, again=True)
    # Loops compile on first use, for longer than an input may take: arrays with traces, offsets and leaks.
    lines = array.Network(np.full((3, 3), 1e-3), 0.5, 1.0, 2.0, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1)
    for rest in ({}, {"v_column_offset_v": np.full(3, 1e-3), "i_leak_a": np.full(3, 1e-9)}):
        array.column_currents(dataclasses.replace(lines, **rest))
    stimulus.VALUES_MAX = 1 << 18  # the largest array has 2 MB, so that memory that is taken too early shows


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
            raise Finding("again", "scene.to_toml", f"refused: {error}") from None
        same = np.array_equal(ohm, back.resistance_ohm) and made.drive == back.drive
        if not same or back.resolved_toml(place) != text:
            raise Finding("again", "scene.to_toml", "another plan")
    if made.rows * made.cols <= DECK_TAXELS and not engines.refused(made, "cosim"):
        levels = [0.0] * (made.rows + 1 + made.cols)
        for frame in {0, made.frames - 1}:
            for columns in {tuple(range(made.cols)), *netlist.parts(made)}:
                written = netlist.frame_deck(made, frame, levels, record=True, columns=columns)
                if strange := deck.strange_lines(written.lines):
                    raise Finding("deck", "netlist.frame_deck", repr(strange[0]))


def run(data: bytes, place: Path) -> str:
    """Plan a scene, as `dermis run` does before it makes OUT."""
    path = place / "scene.toml"
    path.write_bytes(data)

    def one() -> None:
        made = planning.load(path)
        engines.check(made)
        look(made, place, again=zlib.crc32(data) % 4 == 0)

    return oracle.judge(one)
