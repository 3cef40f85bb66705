# SPDX-License-Identifier: Apache-2.0
"""Seeded faults: each breaks the package in one place, and shows that an oracle works."""

from __future__ import annotations

import builtins
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dermis import errors, plan
from dermis.chip import netlist, spi_protocol
from dermis.report import output
from dermis.scene import design, scene, schema, stimulus
from tb.reference import chip


@dataclass(frozen=True)
class Fault:
    """A seeded fault: the target that must meet it, the kinds of finding it may be, its meaning,
    and the change.
    """

    target: str
    kinds: tuple[str, ...]
    meaning: str
    seed: Callable[[], None]


def _control_characters() -> None:
    errors.one_line = lambda value, length=60: str(value)[:length]


def _raw_validation() -> None:
    scene.validate = lambda model, data, file, prefix="": model.model_validate(data)


def _title_in_deck() -> None:
    whole = netlist.frame_deck

    def titled(made: Any, *rest: Any, **more: Any) -> Any:
        deck = whole(made, *rest, **more)
        return deck.__class__(**{**vars(deck), "lines": (f"* {made.scene.title}", *deck.lines)})

    netlist.frame_deck = titled


def _square_time() -> None:
    schema._LONG_KEY = schema.re.compile("(?!)")


def _writes_a_cache() -> None:
    whole = stimulus.make_frames

    def writing(table: Any, about: Any) -> Any:
        Path(about.scene.parent / "cache.npy").write_text("x")
        return whole(table, about)

    plan.make_frames = writing


def _resolved_loses() -> None:
    whole = schema._toml_value
    schema._toml_value = lambda v: f"{v:.1g}" if isinstance(v, float) and v % 1 else whole(v)


def _room_for_the_limit() -> None:
    stimulus.read_bytes = lambda path, limit, told_by=None: open(path, "rb").read(limit + 1)


def _runs_a_shell() -> None:
    whole = schema.read_bytes

    def running(path: Path, limit: int, told_by: Any = None) -> bytes:
        os.system(f"ls {path}")
        return whole(path, limit, told_by)

    stimulus.read_bytes = running


def _nan_accepted() -> None:
    stimulus._check_values = lambda values, shown, table: None


def _frame_without_crc() -> None:
    spi_protocol.crc16 = lambda data, crc=0: 0


def _short_answer() -> None:
    def unchecked(send: bytes) -> Any:
        return (yield send)

    spi_protocol._exchanged = unchecked


def _one_pedestal_short() -> None:
    chip.COLS = 15


def _derived_nan() -> None:
    whole, own = design.Design.derived, design.load()

    def derived(self: design.Design) -> dict[str, float | int]:
        return whole(self) if self == own else {**whole(self), "x": float("nan")}

    design.Design.derived = derived  # type: ignore[method-assign]


def _traceback_on_option() -> None:
    from scripts import calculator

    whole = calculator.make_targets

    def brittle(**targets: Any) -> Any:
        return whole(**targets) if all(value is None for value in targets.values()) else {}["rows"]

    calculator.make_targets = brittle


def _writes_outside_out() -> None:
    whole = output.prepare

    def escaping(out: Any) -> Any:
        made = whole(out)
        with builtins.open(made.parent / "last_run", "w") as file:
            file.write(str(made))
        return made

    output.prepare = escaping


FAULTS: dict[str, Fault] = {
    "control_characters": Fault("scene", ("line",), "a refusal quotes unprintable text", _control_characters),
    "raw_validation": Fault("scene", ("escape",), "an exception of the schema escapes", _raw_validation),
    "title_in_deck": Fault("scene", ("deck",), "the title is a comment of the deck", _title_in_deck),
    "square_time": Fault("scene", ("time", "memory"), "keys of any length go to the parser", _square_time),
    "writes_a_cache": Fault("scene", ("write",), "a cache is written next to the scene", _writes_a_cache),
    "resolved_loses": Fault("scene", ("again",), "the resolved scene keeps one digit", _resolved_loses),
    "room_for_the_limit": Fault("frames", ("memory",), "any file reserves 256 MB", _room_for_the_limit),
    "runs_a_shell": Fault("frames", ("process",), "a shell receives the name of the file", _runs_a_shell),
    "nan_accepted": Fault("frames", ("value", "escape"), "values of a file are not checked", _nan_accepted),
    "frame_without_crc": Fault("spi", ("again",), "the CRC of a frame is not compared", _frame_without_crc),
    "short_answer": Fault("spi", ("escape",), "a short answer of the driver is unpacked", _short_answer),
    "one_pedestal_short": Fault("registers", ("model",), "the model lacks a register", _one_pedestal_short),
    "derived_nan": Fault("design", ("value",), "a derived value is NaN", _derived_nan),
    "traceback_on_option": Fault(
        "command", ("escape", "exit"), "an option ends in a traceback", _traceback_on_option
    ),
    "writes_outside_out": Fault(
        "command", ("write",), "a run writes a file next to OUT", _writes_outside_out
    ),
}
