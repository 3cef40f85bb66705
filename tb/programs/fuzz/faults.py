# SPDX-License-Identifier: Apache-2.0
"""Faults put into the package on purpose: what is broken, and which oracle must see it."""

from __future__ import annotations

import builtins
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dermis import errors, plan
from dermis.chip import netlist, spi_protocol
from dermis.scene import design, schema, stimulus
from tb.reference import chip


@dataclass(frozen=True)
class Fault:
    """A seeded fault: the target whose inputs must meet it, the kinds of finding it may be, and how it is put in."""

    target: str
    kinds: tuple[str, ...]
    what: str
    break_it: Callable[[], None]


def _control_characters() -> None:
    errors.one_line = lambda value, length=60: str(value)[:length]


def _no_allowed() -> None:
    whole = errors.InputError.__init__

    def bare(self: Any, file: Any, key: str, value: Any, allowed: str) -> None:
        whole(self, file, key, value, "" if key.startswith("effects") else allowed)

    errors.InputError.__init__ = bare  # type: ignore[method-assign]


def _raw_validation() -> None:
    from dermis.scene import scene

    scene.validate = lambda model, data, file, prefix="": model.model_validate(data)


def _title_in_deck() -> None:
    whole = netlist.frame_deck

    def titled(made: Any, *rest: Any, **more: Any) -> Any:
        deck = whole(made, *rest, **more)
        return deck.__class__(**{**vars(deck), "lines": (f"* {made.scene.title}", *deck.lines)})

    netlist.frame_deck = titled


def _text_in_number() -> None:
    netlist.spice_number = lambda value: f"{float(value):.6G}"


def _count_unchecked() -> None:
    whole = stimulus._count

    def unchecked(table: Any, about: Any, listed: Any) -> int:
        before, stimulus.VALUES_MAX = stimulus.VALUES_MAX, 1 << 60
        try:
            return whole(table, about, listed)
        finally:
            stimulus.VALUES_MAX = before

    stimulus._count = unchecked


def _header_believed() -> None:
    whole = stimulus._npy

    def believed(data: bytes, shown: str) -> Any:
        if data[:6] == b"\x93NUMPY" and b"9999" in data[:200]:
            np.ones(1 << 28, dtype=np.uint8)
        return whole(data, shown)

    stimulus._npy = believed


def _room_for_the_limit() -> None:
    stimulus.read_bytes = lambda path, limit, told_by=None: open(path, "rb").read(limit + 1)


def _devices_opened() -> None:
    stimulus.read_bytes = lambda path, limit, told_by=None: open(path, "rb").read()


def _writes_beside() -> None:
    whole = stimulus.make_frames

    def writing(table: Any, about: Any) -> Any:
        if "pipe" in str(getattr(table, "file", "")) or getattr(table, "kind", "") == "ramp":
            Path(about.scene.parent / "cache.npy").write_text("x")
        return whole(table, about)

    plan.make_frames = writing


def _runs_a_shell() -> None:
    whole = schema.read_bytes

    def running(path: Path, limit: int, told_by: Any = None) -> bytes:
        if told_by is not None:
            os.system(f"ls {path}")
        return whole(path, limit, told_by)

    stimulus.read_bytes = running


def _unpickles() -> None:
    def loading(data: bytes, shown: str) -> Any:
        import io

        return np.load(io.BytesIO(data), allow_pickle=True)

    stimulus._npy = loading


def _nan_taken() -> None:
    stimulus._check_values = lambda values, shown, table: None


def _square_time() -> None:
    schema._LONG_KEY = schema.re.compile("(?!)")


def _resolved_loses() -> None:
    whole = schema._toml_value
    schema._toml_value = lambda value: (
        f"{value:.1g}" if isinstance(value, float) and value % 1 else whole(value)
    )


def _frame_without_crc() -> None:
    spi_protocol.crc16 = lambda data, crc=0: 0


def _short_answer() -> None:
    def unchecked(send: bytes) -> Any:
        return (yield send)

    spi_protocol._exchanged = unchecked


def _write_without_crc() -> None:
    chip.crc8 = lambda data: 0


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
        if targets.get("rows") is not None:
            raise KeyError("rows")
        return whole(**targets)

    calculator.make_targets = brittle


def _stem_as_path() -> None:
    from dermis.report import output

    whole = output.prepare

    def escaping(out: Any) -> Any:
        made = whole(out)
        with builtins.open(made.parent / "last_run", "w") as file:
            file.write(str(made))
        return made

    output.prepare = escaping


FAULTS: dict[str, Fault] = {
    "control_characters": Fault(
        "scene", ("line",), "a refusal quotes what it was given as it is", _control_characters
    ),
    "no_allowed": Fault("scene", ("line",), "a refusal does not say what is allowed", _no_allowed),
    "raw_validation": Fault(
        "scene", ("escape",), "the schema's own exception comes through", _raw_validation
    ),
    "title_in_deck": Fault("scene", ("deck",), "the title is a comment of the deck", _title_in_deck),
    "text_in_number": Fault("scene", ("deck",), "numbers of a deck are written as 1E-05", _text_in_number),
    "count_unchecked": Fault(
        "scene", ("memory",), "a scene of 2^25 frames takes its memory first", _count_unchecked
    ),
    "square_time": Fault(
        "scene", ("time", "memory"), "dotted keys of any length go to the parser", _square_time
    ),
    "writes_beside": Fault("scene", ("write",), "a cache is written beside the scene", _writes_beside),
    "resolved_loses": Fault("scene", ("again",), "the resolved scene keeps one digit", _resolved_loses),
    "header_believed": Fault(
        "frames", ("memory",), "memory is taken as an npy header says", _header_believed
    ),
    "room_for_the_limit": Fault(
        "frames", ("memory",), "256 MB are set aside to read any file", _room_for_the_limit
    ),
    "devices_opened": Fault(
        "frames", ("time", "memory", "escape"), "pipes and devices are read", _devices_opened
    ),
    "runs_a_shell": Fault("frames", ("process",), "a shell is given the name of the file", _runs_a_shell),
    "unpickles": Fault("frames", ("process", "escape", "memory"), "object arrays are unpickled", _unpickles),
    "nan_taken": Fault("frames", ("value", "escape"), "values of a file are not looked at", _nan_taken),
    "frame_without_crc": Fault("spi", ("again",), "a frame's CRC is not compared", _frame_without_crc),
    "short_answer": Fault("spi", ("escape",), "too short an answer of the driver is unpacked", _short_answer),
    "write_without_crc": Fault(
        "registers", ("model",), "model and Verilog differ in the CRC", _write_without_crc
    ),
    "one_pedestal_short": Fault(
        "registers", ("model",), "model and Verilog differ by one register", _one_pedestal_short
    ),
    "derived_nan": Fault("design", ("value",), "a derived value is NaN for any other design", _derived_nan),
    "traceback_on_option": Fault(
        "command", ("escape", "exit"), "an option ends in a traceback", _traceback_on_option
    ),
    "stem_as_path": Fault("command", ("write",), "a run leaves a file beside OUT", _stem_as_path),
}
"""Name -> fault, each put in alone."""
