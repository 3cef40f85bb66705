# SPDX-License-Identifier: Apache-2.0
"""Seeded faults: each replaces one function of the package, and shows that an oracle works."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from dermis import errors, plan
from dermis.chip import netlist, spi_protocol
from dermis.report import output
from dermis.scene import design, schema, stimulus
from scripts import calculator
from tb.reference import chip


class Fault(NamedTuple):
    """A seeded fault: the target that must meet it, the kinds of finding that it may be, its
    meaning, and the replacement of an attribute as a function of what stands there.
    """

    target: str
    kinds: tuple[str, ...]
    meaning: str
    of: Any
    attribute: str
    change: Callable[[Any], Any]

    def seed(self) -> None:
        """Break the package of this process."""
        setattr(self.of, self.attribute, self.change(getattr(self.of, self.attribute)))


def _title_in_deck(whole: Any) -> Any:
    def titled(made: Any, *rest: Any, **more: Any) -> Any:
        deck = whole(made, *rest, **more)
        return deck.__class__(**{**vars(deck), "lines": (f"* {made.scene.title}", *deck.lines)})

    return titled


def _calls_first(action: Callable[..., object]) -> Callable[[Any], Any]:
    """Return a change that calls something else with the same arguments before."""
    return lambda whole: lambda *given, **more: (action(*given), whole(*given, **more))[1]


def _brittle(whole: Any) -> Any:
    return lambda **targets: whole(**targets) if all(v is None for v in targets.values()) else {}["rows"]


def _derived_nan(whole: Any) -> Any:
    own = design.load()
    return lambda self: whole(self) if self == own else {**whole(self), "x": float("nan")}


def _read_to_the_limit(whole: Any) -> Any:
    return lambda path, limit, told_by=None: open(path, "rb").read(limit + 1)


FAULTS: dict[str, Fault] = {
    "control_characters": Fault(
        "scene", ("line",), "a refusal quotes unprintable text",
        errors, "one_line", lambda whole: lambda value, length=60: str(value)[:length],
    ),
    "title_in_deck": Fault(
        "scene", ("deck",), "the title is a comment of the deck", netlist, "frame_deck", _title_in_deck
    ),
    "square_time": Fault(
        "scene", ("time", "memory"), "keys of any length go to the parser",
        schema, "_LONG_KEY", lambda whole: schema.re.compile("(?!)"),
    ),
    "writes_a_cache": Fault(
        "scene", ("write",), "a cache is written next to the scene", plan, "make_frames",
        _calls_first(lambda table, about: Path(about.scene.parent / "cache.npy").write_text("x")),
    ),
    "resolved_loses": Fault(
        "scene", ("again",), "the resolved scene keeps one digit", schema, "_toml_value",
        lambda whole: lambda v: f"{v:.1g}" if isinstance(v, float) and v % 1 else whole(v),
    ),
    "room_for_the_limit": Fault(
        "frames", ("memory",), "any file reserves 256 MB", stimulus, "read_bytes", _read_to_the_limit
    ),
    "runs_a_shell": Fault(
        "frames", ("process",), "a shell receives the name of the file",
        stimulus, "read_bytes", _calls_first(lambda path, *rest: os.system(f"ls {path}")),
    ),
    "nan_accepted": Fault(
        "frames", ("value", "escape"), "values of a file are not checked",
        stimulus, "_check_values", lambda whole: lambda values, shown, table: None,
    ),
    "short_answer": Fault(
        "spi", ("escape",), "a short answer of the driver is unpacked", spi_protocol, "_exchanged",
        lambda whole: lambda send: (yield send),
    ),
    "one_pedestal_short": Fault(
        "registers", ("model",), "the model lacks a register", chip, "COLS", lambda whole: whole - 1
    ),
    "derived_nan": Fault(
        "design", ("value",), "a derived value is NaN", design.Design, "derived", _derived_nan
    ),
    "traceback_on_option": Fault(
        "command", ("escape", "exit"), "an option ends in a traceback", calculator, "make_targets", _brittle
    ),
    "writes_outside_out": Fault(
        "command", ("write",), "a run writes a file next to OUT", output, "prepare",
        _calls_first(lambda out: Path(out).absolute().with_name("last_run").write_text(str(out))),
    ),
}  # fmt: skip
