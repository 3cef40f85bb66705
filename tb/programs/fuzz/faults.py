# SPDX-License-Identifier: Apache-2.0
"""Seeded faults: each replaces one function of the package, and shows that an oracle works."""

from __future__ import annotations

from typing import Any

from dermis.chip import netlist
from dermis.scene import schema, stimulus


def _title_in_deck(whole: Any) -> Any:
    def titled(made: Any, *rest: Any, **more: Any) -> Any:
        deck = whole(made, *rest, **more)
        return deck.__class__(**{**vars(deck), "lines": (f"* {made.scene.title}", *deck.lines)})

    return titled


def _digit(whole: Any) -> Any:
    return lambda v: f"{v:.1g}" if isinstance(v, float) and v % 1 else whole(v)


FAULTS = {
    "title_in_deck": ("scene", netlist, "frame_deck", _title_in_deck),
    "resolved_keeps_one_digit": ("scene", schema, "_toml_value", _digit),
    "room_for_the_limit": (
        "frames",
        stimulus,
        "read_bytes",
        lambda _: lambda path, limit, by=None: open(path, "rb").read(limit),
    ),
    "nan_accepted": ("frames", stimulus, "_check_values", lambda _: lambda *given: None),
}
"""Target that must meet a fault, then the attribute of a module and its replacement as a function of it."""


def seed_fault(fault: str) -> None:
    """Break the package of this process."""
    _, of, attribute, change = FAULTS[fault]
    setattr(of, attribute, change(getattr(of, attribute)))
