# SPDX-License-Identifier: Apache-2.0
"""Target `command`: the words of a command line, up to the files of a small run.

Words are separated by NUL; `{place}` stands for the directory of the input.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import os
import re
import shutil
import sys
import traceback
import types
from pathlib import Path
from typing import Any

import click
from hypothesis import strategies as st

from dermis import auto, cli, engines, plan
from dermis.engines import batch, cosim, rtl
from dermis.report import figures, output, plan_table, verdict
from dermis.scene import scene as scenes
from scripts import calculator, regression
from tb.programs.fuzz import inputs, oracle, target_scene
from tb.programs.fuzz.oracle import Finding, Taken

FOLLOWED = ("run", "plan", "calc", "sim")
"""Commands that run; of others the command line is parsed."""

CPU_S = 10.0
"""Processor time of one input; a run of the largest scene here, with its tables, takes 2 s."""

_SCENES = (
    "{place}/scene.toml", "{place}/scene.toml", "scene.toml", "single_touch", "no_such_scene", "", ".", "..",
    "/", "-", "{place}", "{place}/none.toml", "{place}/..toml", "{place}/a\nb.toml", "{place}/$(touch x).toml",
    "{place}/pipe.toml", "/dev/zero", "/dev/stdin", "~", "\x1b[31m.toml", "{place}/empty.toml", "{place}/scene.toml/",
    "x" * 300 + ".toml", "x" * 5000, "\udcff.toml",
)  # fmt: skip
_OUTS = (
    "{place}/out", "{place}/out", "{place}/out/a/b", "{place}/out/../out", "{place}/scene.toml",
    "{place}/scene.toml/x", "{place}/link_out", "/dev/null", "/proc/self/x", "", ".", "{place}/occupied",
    "{place}/out\n.control", "{place}/" + "n" * 300, "{place}/-out", "/", "~", "out", "{place}/\udcff",
    "{place}/loop_out", "{place}/$(touch x)",
)  # fmt: skip
_FRAMES = (
    "{place}/frames.csv", "{place}/frames.npy", "{place}/frames.npz", "{place}/wide.npy", "{place}/none.csv",
    "{place}", "/dev/zero", "{place}/pipe.csv", "", "{place}/a\nb.csv", "{place}/pickled.npy", "{place}/zero.csv",
)  # fmt: skip
_SELECTS = ("spread", "all", "0", "0,1", "-1", "", ",", "x", "1e3", "9" * 5000, "0,0,0", " 0 ", "\u0663")
_VALUES = (
    "1", "2", "3", "16", "0.5", "1e-3", "1e-9", "100", "5e6", "closed", "event", "rtl", "cosim", "1" * 5000, "1e400",
    "-1", "nan", "inf", "0", "", "x", "1e-320", "16.0", "0x10", "1_0",
)  # fmt: skip
_NAMED = {"out": _OUTS, "directory": _OUTS, "frames": _FRAMES, "select": _SELECTS}

_escaped: list[BaseException] = []


@functools.cache
def _commands() -> dict[str, click.Command]:
    """Return every command by name."""
    context = click.Context(cli.cli)
    names = [name for name in cli.cli.list_commands(context) if name != "fuzz"]
    return {name: command for name in names if (command := cli.cli.get_command(context, name)) is not None}


@st.composite
def strategy(draw: st.DrawFn) -> bytes:
    """Draw a command with options, values and words in any place."""
    name = draw(st.sampled_from((*FOLLOWED, *FOLLOWED, *_commands())))
    options = [p for p in _commands()[name].params if isinstance(p, click.Option)]
    words = [name]
    if name in ("run", "plan"):
        words.append(draw(st.sampled_from(_SCENES)))
    if name == "run":
        words += ["--out", draw(st.sampled_from(_OUTS))]
    if name == "sim":
        words += ["--frames", draw(st.sampled_from(_FRAMES)), "--rows", "3", "--cols", "2"]
    for option in draw(st.lists(st.sampled_from(options), max_size=3)) if options else ():
        known = st.sampled_from(_NAMED.get(option.name or "", _VALUES))
        if isinstance(option.type, click.Choice):
            known |= st.sampled_from([str(c) for c in option.type.choices])
        flag, value = (
            draw(st.sampled_from((*option.opts, *option.secondary_opts))),
            draw(known | inputs.texts),
        )
        given = [[flag]] if option.is_flag else [[flag, value], [f"{flag}={value}"], [flag]]
        words += draw(st.sampled_from(given))
    for _ in range(draw(st.sampled_from((0, 0, 0, 1, 2)))):
        at = draw(st.integers(0, len(words)))
        words[at : at + draw(st.integers(0, 1))] = draw(st.lists(inputs.texts, max_size=2))
    words = [word.replace("\0", "").encode("utf-8", "surrogateescape") for word in words]
    return b"\0".join(words)[: inputs.SIZE_MAX // 2]


def _taken(*_: Any, **__: Any) -> None:
    raise Taken


def _remember() -> str:
    if (error := sys.exc_info()[1]) is not None:
        _escaped.append(error)
    return traceback.format_exc()


def prepare(place: Path) -> None:
    """Write files, redirect the output of the project into the directory, and replace what starts
    simulators.
    """
    target_scene.prepare(place)
    for name in ("scene.toml", "..toml", "a\nb.toml", "$(touch x).toml"):
        (place / name).write_text(target_scene.SMALL + target_scene.CODES)
    for engine in ("closed", "event"):  # loops compile on first use, and take more memory than an input may
        engines.run(plan.load(place / "scene.toml", engine))
    everything = plan.make(auto.with_auto(scenes.load(scenes.find("single_touch"))))
    engines.run(everything)
    (place / "empty.toml").touch()
    (place / "link_out").symlink_to("elsewhere")
    (place / "loop_out").symlink_to("loop_out")
    for name in ("elsewhere", "cwd", "occupied/codes.npy"):
        (place / name).mkdir(parents=True)
    os.mkfifo(place / "pipe.toml")
    os.chdir(place / "cwd")
    cli.BUILD = verdict.BUILD = place / "root" / "build"
    regression.ROOT, regression.OUT = place / "root", place / "root" / "build" / "sim"
    cli.traceback = types.SimpleNamespace(format_exc=_remember)
    output.versions = dict
    figures.frame_figure = lambda made, codes, fit, path: path.write_bytes(b"")
    cosim.run = rtl.run = plan_table.print_answer = calculator.write_design = _taken
    whole = batch.run
    batch.run = lambda made, *rest, processes=1, scheduler=None, **more: (
        _taken() if processes > 1 or scheduler else whole(made, *rest, **more)
    )
    for name, command in _commands().items():
        if name not in FOLLOWED:
            command.callback = _taken
    for words in ("run {place}/scene.toml --out {place}/out", "calc", "plan single_touch --auto"):
        run(words.replace(" ", "\0").encode(), place)


def _policy(words: list[str], place: Path) -> oracle.Policy:
    """Allow the output of the project, and OUT or the page of --html with their working copies
    (.NAME.partial_N, .NAME.N).
    """
    named = [b for a, b in itertools.pairwise(words) if a in ("--out", "--html")]
    named += [word.partition("=")[2] for word in words if word.startswith(("--out=", "--html="))]
    outs = [Path(real(out)) for out in named for real in (os.path.realpath, os.path.abspath)]
    build = place / "root" / "build"

    def allowed(path: Path) -> bool:
        around = [path, *path.parents]
        final = [p.with_name(re.sub(r"^\.(.+)\.[^.]+$", r"\1", p.name)) for p in around if p.name]
        if build in around or path == build.parent:
            return True
        if any(out in (*around, *final) or path in out.parents for out in outs):
            if place not in around:
                raise Taken  # a path that the user names elsewhere ends the input before anything is written
            return True
        return False

    return allowed


def run(data: bytes, place: Path) -> str:
    """Run a command line in this process."""
    text = data.decode("utf-8", "surrogateescape").replace("{place}", str(place))
    words = text.split("\0") if text else []
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="strict", write_through=True)
    err = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace", write_through=True)
    ended: list[Any] = []
    _escaped.clear()

    def one() -> None:
        before, sys.argv = sys.argv, ["dermis", *words]
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
        for name in ("out", "out\n.control", "-out", "root", "elsewhere"):
            shutil.rmtree(place / name, ignore_errors=True)
        (place / "elsewhere").mkdir(exist_ok=True)
    if _escaped:
        error = _escaped[0]
        raise Finding("escape", oracle.place_of(error), f"{type(error).__name__}: {error!s:.200}")
    if not ended:
        return outcome
    said = err.buffer.getvalue().decode("utf-8")
    if ended[0] not in (0, 1, 2):  # no input here starts a simulator
        raise Finding("exit", "cli.main", f"exit {ended[0]!r}: {said!r}")
    if ended[0] == 2 and (said.count("\n") != 1 or not said.rstrip("\n").isprintable() or len(said) < 10):
        raise Finding("line", "cli.main", f"exit 2 with {said!r}")
    return "refused" if ended[0] == 2 else "taken"
