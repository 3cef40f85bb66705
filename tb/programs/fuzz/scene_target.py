# SPDX-License-Identifier: Apache-2.0
"""Target `scene`: the bytes of a scene file, from the parser to the plan, its deck and its resolved copy."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import pickle
import random
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from dermis import engines, records
from dermis import plan as planning
from dermis.array import array
from dermis.chip import netlist, sky130
from dermis.errors import InputError
from dermis.scene import scene as scenes
from tb.programs.fuzz import deck, grammar, oracle
from tb.programs.fuzz.oracle import Finding
from tb.programs.fuzz.target import Target

DECK_TAXELS = 300
"""Taxels of the largest array whose deck is written and looked at line by line."""

PEOPLE = "for people: .control $(touch x)"


class Touch:
    """What a pickle in a frame file would do if anybody unpickled it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("fuzz_was_here",)


def files(place: Path) -> None:
    """Put the files that a scene may name beside it: good ones, and what only looks like one."""
    codes = np.array([[1, 2], [3, 4], [5, 6]], dtype=np.uint8)
    (place / "frames.csv").write_text("1,2\n3,4\n5,6\n")
    np.save(place / "frames.npy", codes)
    np.savez(place / "frames.npz", codes=codes, other=codes[None].repeat(3, 0))
    np.save(place / "wide.npy", np.arange(256, dtype=np.uint8).reshape(16, 16))
    (place / "pickled.npy").write_bytes(pickled())
    (place / "directory.csv").mkdir(exist_ok=True)
    for name, make in (
        ("link.csv", lambda p: p.symlink_to("link.csv")),
        ("zero.csv", lambda p: p.symlink_to("/dev/zero")),
        ("pipe.csv", lambda p: os.mkfifo(p)),
    ):
        if not (place / name).is_symlink() and not (place / name).exists():
            make(place / name)


def pickled() -> bytes:
    """An npy file of objects, whose loading runs what it says."""
    stream = io.BytesIO()
    header = {"descr": "|O", "fortran_order": False, "shape": (3, 2)}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + pickle.dumps([Touch()] * 6)


def _words() -> dict[str, grammar.Vocabulary]:
    """The keys that a scene may have, by the kind of its stimulus."""
    rows = [(key.rpartition(".")[0], key, allowed) for key, _, allowed, _ in scenes.schema_rows()]
    kinds = {head.rpartition(" ")[2]: head for head, _, _ in rows if head.startswith("stimulus kind")}
    common = [(key, allowed) for head, key, allowed in rows if not head.startswith("stimulus")]
    any_kind = ("stimulus.kind", ", ".join(f'"{kind}"' for kind in kinds))
    return {
        kind: grammar.vocabulary(
            [
                *common,
                any_kind,
                *((f"stimulus.{key.rpartition('.')[2]}", allowed) for h, key, allowed in rows if h == head),
            ]
        )
        for kind, head in kinds.items()
    }


WORDS = _words()


def seeds() -> list[bytes]:
    """The scenes that come along, made small, and one of each stimulus."""
    found = [path.read_bytes() for path in sorted(scenes.SCENES.glob("*.toml"))]
    small = b"[array]\nrows = 3\ncols = 2\n"
    body = b'shape = "flat"\nforce_n = [1.0, 2.0]\n'
    stimuli = (
        b'kind = "indenter"\n' + body,
        b'kind = "slip"\nspeed_pitch_per_s = 10.0\nframes = 2\nshape = "round"\ntotal_force_n = 3.0\n',
        b'kind = "tapping"\nfrequency_hz = 10.0\nduration_s = 0.005\n' + body,
        b'kind = "ramp"\n' + body,
        b'kind = "several"\n[[stimulus.parts]]\nkind = "indenter"\n' + body,
        b'kind = "uniform"\ncode = [3, 4]\n',
        b'kind = "uniform"\nr_ohm = [inf, 0.0]\nt_frame_s = 0.01\nresample = "linear"\n',
        b'kind = "frames"\nfile = "frames.csv"\nunit = "codes"\n',
        b'kind = "frames"\nfile = "frames.npz"\nkey = "other"\nunit = "newtons"\nselect = [0, 2]\n',
        b'kind = "resistance"\nfile = "frames.npy"\n',
        b'kind = "resistance"\nfile = "pickled.npy"\n',
    )
    effects = (
        b"",
        b"[effects]\nauto = {}\n",
        b"[effects]\nauto = { budget_lsb = 0.1 }\nlateral = false\n",
        b"[effects]\n" + b"".join(f"{name} = true\n".encode() for name in list(scenes.EFFECTS)[:6]),
        b"[effects]\n" + b"".join(f"{name} = true\n".encode() for name in scenes.EFFECTS),
        b"[effects]\nlateral = { r_ohm = 1e3 }\nmotion = true\ntrace = true\n",
    )
    for n, stimulus in enumerate(stimuli):
        found.append(small + b"[stimulus]\n" + stimulus + effects[n % len(effects)])
    # What asks for more than there is: refused with what is allowed before any memory is taken.
    sizes = (b"frames = 33554432\n", b"frames = 1000000000\n", b"duration_s = 1e9\n")
    for size in sizes:
        found.append(
            b'[stimulus]\nkind = "slip"\nspeed_pitch_per_s = 1.0\nshape = "flat"\nforce_n = 1.0\n' + size
        )
    found.append(b"[array]\nrows = 1000000\ncols = 1000000\n[stimulus]\n" + stimuli[5])
    found.append(
        b'[array]\nrows = 256\ncols = 256\n[stimulus]\nkind = "uniform"\ncode = [' + b"1, " * 3000 + b"1]\n"
    )
    found.append(b"a" + b".a" * 15_000 + b" = 1\n")
    topologies = ("direct", "conveyor_mirror", "conveyor_mirror_inverted", "multi_output_conveyor")
    for n, topology in enumerate(topologies):
        found.append(
            small
            + b"[stimulus]\n"
            + stimuli[n]
            + f'[interface]\ntopology = "{topology}"\nk = 80\n'.encode()
            + effects[5]
            + b'[run]\nengine = "event"\nseed = 7\n'
        )
    return found


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Another scene, most often of keys that its stimulus may have."""
    found = re.search(rb'kind *= *"([a-z]+)"', data)
    kind = found[1].decode() if found else ""
    words = WORDS.get(kind) if rng.random() < 0.9 else None
    return grammar.mutate_toml(data, rng, words or rng.choice(list(WORDS.values())))


def prepare(place: Path) -> None:
    """Files beside the scene, and everything loaded that a plan may load."""
    files(place)
    for name in records.ENGINES:
        engines.honours(name)
    # What decks of transistors include is kept in build/ and written on first use.
    for corner in sky130.CORNERS:
        sky130.models(corner)
    deck.includes()
    for scene in seeds()[-15:]:  # the small ones
        (place / "scene.toml").write_bytes(scene)
        with contextlib.suppress(InputError):  # one of them is refused, and all load what they need
            planning.load(place / "scene.toml")
    # Loops compile on first use, for longer than an input may take: those of arrays with traces, offsets and leaks.
    lines = array.Network(np.full((3, 3), 1e-3), 0.5, 1.0, 2.0, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1)
    for rest in ({}, {"v_column_offset_v": np.full(3, 1e-3), "i_leak_a": np.full(3, 1e-9)}):
        array.column_currents(dataclasses.replace(lines, **rest))
    oracle.small_limits()


def look(made: records.Plan, place: Path, again: bool) -> None:
    """Hold what was taken against what a plan must be.

    Raises
    ------
    Finding
        It is not finite, not of its shape, its resolved scene makes another plan, or its deck holds a strange line.
    """
    ohm = made.resistance_ohm
    if ohm.ndim != 3 or not (ohm >= 0).all():
        raise Finding("value", "plan.make", f"resistances of shape {ohm.shape} that are NaN or below 0")
    if made.force_n is not None and (made.force_n.shape != ohm.shape or not (made.force_n >= 0).all()):
        raise Finding("value", "plan.make", "forces that are NaN, below 0 or of another shape")
    margin = np.asarray(made.margin_lsb)
    if np.isnan(margin).any() or np.isnan(made.left_out_lsb):
        raise Finding("value", "auto.choose", "a margin that is NaN")
    if again:
        path = place / "resolved.toml"
        text = made.resolved_toml(place)
        path.write_text(text, encoding="utf-8")
        try:
            back = planning.load(path)
        except InputError as error:
            raise Finding("again", "scene.to_toml", f"refused: {str(error)[:300]}") from None
        same = np.array_equal(ohm, back.resistance_ohm) and made.drive == back.drive
        if not same or back.resolved_toml(place) != text:
            raise Finding("again", "scene.to_toml", "another plan")
    if made.rows * made.cols <= DECK_TAXELS and not engines.refused(made, "cosim"):
        check_deck(made)


def check_deck(made: records.Plan) -> None:
    """Write the decks of the first and the last frame, with all columns and of each part, and look at every line.

    Raises
    ------
    Finding
        One has none of the allowed forms.
    """
    for frame in {0, made.frames - 1}:
        levels = [0.0] * (made.rows + 1 + made.cols)
        for columns in {tuple(range(made.cols)), *netlist.parts(made)}:
            written = netlist.frame_deck(made, frame, levels, record=True, columns=columns)
            strange = deck.strange_lines(written.lines)
            if strange:
                raise Finding("deck", "netlist.frame_deck", repr(strange[0][:300]))


def run(data: bytes, place: Path) -> str:
    """Plan a scene, as `dermis run` does before it makes OUT."""
    path = place / "scene.toml"
    path.write_bytes(data)

    def one() -> None:
        made = planning.load(path)
        engines.check(made)
        look(made, place, again=zlib.crc32(data) % 4 == 0)

    resolved = place / "resolved.toml"
    return oracle.judge(one, lambda path: path == resolved)


TARGET = Target("scene", "scene files", seeds, mutate, prepare, run)
