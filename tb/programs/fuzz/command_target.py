# SPDX-License-Identifier: Apache-2.0
"""Target `command`: the words of a command line, from the parser to the files that a small run leaves."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import os
import random
import shutil
import sys
import traceback
import types
from pathlib import Path
from typing import Any

import click

from dermis import cli
from dermis.engines import batch, cosim, rtl
from dermis.report import figures, output, plan_table, verdict
from scripts import regression
from tb.programs.fuzz import grammar, oracle, scene_target
from tb.programs.fuzz.oracle import Finding, Taken
from tb.programs.fuzz.target import Target

FOLLOWED = ("run", "plan", "calc", "sim")
"""Commands that are run; of all others the command line is read, and there it ends."""

CPU_S = 10.0
"""Processor time of one input: a run of the largest scene that comes along, its judge and its tables take 2 s."""

CODES = (0, 1, 2)
"""Exit codes of inputs that start no simulator."""

SPLIT, PLACE = b"\0", "{place}"
"""Words are apart by a byte that no word may hold; the directory of the input stands for itself."""

SCENES = (
    "scene.toml", "single_touch", "uniform_staircase", "recorded_touch", "humming_supply", "no_such_scene",
    "", ".", "..", "/", "-", "--",
    "{place}", "{place}/scene.toml", "{place}/none.toml", "{place}/...toml", "{place}/..toml",
    "{place}/.toml", "{place}/a\nb.toml",
    "{place}/$(touch x).toml", "{place}/pipe.toml", "{place}/zero.toml", "/dev/zero", "/dev/stdin",
    "../scene.toml", "~", "SINGLE_TOUCH",
    "\x1b[31m.toml", "single_touch.toml", "{place}/empty.toml", "{place}/scene.toml/", "x" * 300 + ".toml",
    "x" * 5000, "\udcff.toml",
)  # fmt: skip

OUTS = (
    "{place}/out", "{place}/out/a/b", "{place}/out/../out", "{place}/scene.toml", "{place}/scene.toml/x",
    "{place}/link_out", "/dev/null",
    "/dev/null/x", "/proc/self/x", "", ".", "{place}/occupied", "{place}/out\n.control",
    "{place}/" + "n" * 300, "{place}/out ",
    "{place}/-out", "/", "~", "out", "{place}/\udcff", "{place}/loop_out", "{place}/$(touch x)",
)  # fmt: skip

FRAMES = (
    "{place}/frames.csv", "{place}/frames.npy", "{place}/frames.npz", "{place}/wide.npy", "{place}/none.csv",
    "{place}", "/dev/zero",
    "{place}/pipe.csv", "", "{place}/a\nb.csv", "{place}/pickled.npy", "{place}/zero.csv",
)  # fmt: skip

SELECTS = (
    "spread",
    "all",
    "first",
    "last",
    "0",
    "0,1",
    "-1",
    "1,-1",
    "",
    ",",
    "x",
    "1e3",
    "9" * 30,
    "9" * 5000,
    "0,0,0",
    " 0 ",
    "٣",
)

_escaped: list[BaseException] = []


@functools.cache
def commands() -> dict[str, click.Command]:
    """Every command by name."""
    context = click.Context(cli.cli)
    found = {}
    for name in cli.cli.list_commands(context):
        command = cli.cli.get_command(context, name)
        if command is not None and name != "fuzz":
            found[name] = command
    return found


def _options(name: str) -> list[click.Option]:
    return [p for p in commands()[name].params if isinstance(p, click.Option)] if name in commands() else []


def seeds() -> list[bytes]:
    """Right and wrong calls of every command."""
    lines: list[list[str]] = [[], ["--help"], ["--version"], ["-x"], ["no_such_command"], ["--", "run"]]
    scene, out = "{place}/scene.toml", "{place}/out"
    lines += [["calc"], ["calc", "--rows", "16"], ["calc", "--rows", "0"], ["calc", "--bits", "nan"]]
    for engine in ("closed", "event", "rtl", "cosim", "spice", ""):
        lines.append(["run", scene, "--engine", engine, "--out", out])
    lines += [["run", name, "--out", out] for name in SCENES]
    lines += [["run", scene, "--out", where] for where in OUTS]
    lines += [
        ["run", scene, "--processes", n, "--out", out] for n in ("1", "0", "-1", "1025", "x", "1" * 5000)
    ]
    lines += [
        ["run", scene, "--waves"],
        ["run", scene, "--simulator", "icarus"],
        ["run", scene, scene],
        ["run"],
    ]
    lines += [["plan", name] for name in SCENES[:12]]
    lines += [["plan", scene, "--auto", "--engine", "event"], ["plan"], ["plan", scene, "--engine", "x"]]
    lines += [["sim", "--frames", file, "--rows", "3", "--cols", "2"] for file in FRAMES]
    lines += [
        ["sim", "--frames", FRAMES[0], "--rows", "3", "--cols", "2", "--select", select] for select in SELECTS
    ]
    lines += [
        ["sim", "--only", "x"],
        ["sim", "--frames", FRAMES[2], "--key", "other", "--rows", "3", "--cols", "2"],
    ]
    for name in commands():
        lines += [[name, "--help"], [name, "--no-such-option"], [name, "x", "y"]]
        for option in _options(name):
            lines += [[name, option.opts[0]], [name, option.opts[0], "1e400"], [name, option.opts[0], "16"]]
    return [encode(line) for line in lines]


def encode(words: list[str]) -> bytes:
    """An input of words."""
    return SPLIT.join(word.encode("utf-8", "surrogateescape") for word in words)


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Other words: options of the command with values, words dropped, doubled, moved, changed."""
    words = data.decode("utf-8", "surrogateescape").split("\0")
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randint(0, len(words))
        pick = rng.random()
        options = _options(words[0]) if words else []
        if pick < 0.45 and options:
            option = rng.choice(options)
            name = rng.choice([*option.opts, *option.secondary_opts])
            value = _value(option, rng)
            words[max(at, 1) : max(at, 1)] = (
                [f"{name}={value}"] if rng.random() < 0.2 else [name, value][: 1 if option.is_flag else 2]
            )
        elif pick < 0.55:
            words[at:at] = [rng.choice(grammar.TEXTS)]
        elif pick < 0.65 and words:
            del words[at % len(words)]
        elif pick < 0.7 and words:
            words[at:at] = [words[at % len(words)]] * rng.choice((1, 2, 50))
        elif pick < 0.75:
            words[:1] = [rng.choice([*commands(), "-h", "--version"])]
        elif words:
            word = words[at % len(words)]
            words[at % len(words)] = rng.choice(
                (
                    word[:-1],
                    word + rng.choice(grammar.TEXTS),
                    word.upper(),
                    rng.choice(SCENES),
                    rng.choice(OUTS),
                    word[::-1],
                )
            )
    return encode([word.replace("\0", "") for word in words])[: 1 << 14]


def _value(option: click.Option, rng: random.Random) -> str:
    named = {"out": OUTS, "directory": OUTS, "frames": FRAMES, "select": SELECTS}
    if option.name in named and rng.random() < 0.8:
        return rng.choice(named[option.name])
    if isinstance(option.type, click.Choice) and rng.random() < 0.7:
        return str(rng.choice(list(option.type.choices)))
    if rng.random() < 0.5:
        return rng.choice(
            (
                "1",
                "2",
                "3",
                "16",
                "0.5",
                "1e-3",
                "1e-9",
                "100",
                "5e6",
                "closed",
                "event",
                "rtl",
                "cosim",
                "codes",
            )
        )
    return str(
        rng.choice(
            (
                "1" * 5000,
                "1e400",
                "-1",
                "nan",
                "inf",
                "0",
                "",
                "x",
                "1e-320",
                "16.0",
                "0x10",
                "1_0",
                rng.choice(grammar.TEXTS),
            )
        )
    )


def _taken(*_: Any, **__: Any) -> None:
    raise Taken


def _remember() -> str:
    error = sys.exc_info()[1]
    if error is not None:
        _escaped.append(error)
    return traceback.format_exc()


def prepare(place: Path) -> None:
    """Files in the directory, the tree's own output put there too, and what starts simulators put aside."""
    scene_target.prepare(place)
    small = '[array]\nrows = 3\ncols = 2\n[stimulus]\nkind = "frames"\nfile = "frames.csv"\nunit = "codes"\n'
    for name in ("scene.toml", "...toml", "..toml", ".toml", "a\nb.toml", "$(touch x).toml"):
        (place / name).write_text(small)
    (place / "empty.toml").touch()
    (place / "elsewhere").mkdir()
    (place / "link_out").symlink_to("elsewhere")
    (place / "loop_out").symlink_to("loop_out")
    (place / "occupied" / "codes.npy").mkdir(parents=True)
    (place / "zero.toml").symlink_to("/dev/zero")
    os.mkfifo(place / "pipe.toml")
    (place / "cwd").mkdir()
    os.chdir(place / "cwd")
    root = place / "root"
    for module in (cli, verdict):
        module.BUILD = root / "build"
    regression.ROOT = root
    regression.OUT = root / "build" / "sim"
    cli.traceback = types.SimpleNamespace(format_exc=_remember)
    output.versions = dict
    figures.frame_figure = lambda made, codes, fit, path: path.write_bytes(b"")
    cosim.run = rtl.run = plan_table.measure_costs = _taken
    whole = batch.run
    batch.run = lambda made, *rest, processes=1, scheduler=None, **more: (
        _taken() if processes > 1 or scheduler else whole(made, *rest, **more)
    )
    for name, command in commands().items():
        if name not in FOLLOWED:
            command.callback = _taken
    for words in (
        ["run", "{place}/scene.toml", "--out", "{place}/out"],
        ["calc"],
        ["plan", "single_touch", "--auto"],
    ):
        run(encode(words), place)


def _outs(words: list[str]) -> list[Path]:
    found = [b for a, b in itertools.pairwise(words) if a == "--out"]
    found += [word.removeprefix("--out=") for word in words if word.startswith("--out=")]
    # As it is named, and where a link of this name leads.
    return [Path(way(out)) for out in found if "\0" not in out for way in (os.path.realpath, os.path.abspath)]


def _beside(path: Path) -> list[Path]:
    """The directories that a path is the working copy of: OUT has the name .OUT.partial_1234 until it is whole."""
    return [
        part.parent / part.name[1:].rpartition(".partial_")[0]
        for part in (path, *path.parents)
        if part.name.startswith(".") and ".partial_" in part.name
    ]


def _policy(words: list[str], place: Path) -> oracle.Policy:
    build = place / "root" / "build"
    outs = _outs(words)

    def allowed(path: Path) -> bool:
        if path in (place / "root", build, build / "run", build / "sim", build / "frame_files") or (
            path.parent == build and path.name.startswith(".")
        ):
            return True
        if path.parent == build:
            return path.suffix == ".json" or path.name == "internal_error.log"
        if any(build / made in path.parents for made in ("run", "sim", "frame_files")):
            return ".." not in path.parts
        if any(out in (path, *path.parents, *_beside(path)) or path in out.parents for out in outs):
            if place not in path.parents and path != place:
                raise Taken  # what the user names is the user's; here it ends before anything is written
            return True
        return False

    return allowed


def run(data: bytes, place: Path) -> str:
    """Run a command line in this process, as a shell would with this directory as its own."""
    words = (
        [w.replace(PLACE, str(place)) for w in data.decode("utf-8", "surrogateescape").split("\0")]
        if data
        else []
    )
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="strict", write_through=True)
    err = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace", write_through=True)
    ended: list[Any] = []
    _escaped.clear()

    def one() -> None:
        before = sys.argv
        sys.argv = ["dermis", *words]
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                cli.main()
        except SystemExit as error:
            ended.append(error.code)
        finally:
            sys.argv = before

    try:
        outcome = oracle.judge(one, _policy(words, place), follow=True, cpu_s=CPU_S)
    finally:
        for name in ("out", "out ", "-out", "root", "elsewhere"):
            shutil.rmtree(place / name, ignore_errors=True)
        (place / "elsewhere").mkdir(exist_ok=True)
    if _escaped:
        error = _escaped[0]
        raise Finding("escape", oracle.place_of(error), f"{type(error).__name__}: {str(error)[:200]!r}")
    if not ended:
        return outcome
    said = err.buffer.getvalue().decode("utf-8")
    if ended[0] not in CODES:
        raise Finding("exit", "cli.main", f"exit {ended[0]!r}: {said[:200]!r}")
    if ended[0] == 2 and (said.count("\n") != 1 or not said.rstrip("\n").isprintable() or len(said) < 10):
        raise Finding("line", "cli.main", f"exit 2 with {said[:300]!r}")
    return "refused" if ended[0] == 2 else "taken"


TARGET = Target("command", "command lines", seeds, mutate, prepare, run)
