# SPDX-License-Identifier: Apache-2.0
"""Seeded faults: each replaces one function of the package, and shows that an oracle works."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from dermis.chip import netlist
from dermis.scene import schema, stimulus


class Fault(NamedTuple):
    """A seeded fault: the target that must meet it, and the replacement of an attribute as a function
    of what stands there.
    """

    target: str
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


def _digit(whole: Any) -> Any:
    return lambda v: f"{v:.1g}" if isinstance(v, float) and v % 1 else whole(v)


FAULTS = {
    "title_in_deck": Fault("scene", netlist, "frame_deck", _title_in_deck),
    "resolved_keeps_one_digit": Fault("scene", schema, "_toml_value", _digit),
    "room_for_the_limit": Fault(
        "frames", stimulus, "read_bytes", lambda _: lambda path, limit, by=None: open(path, "rb").read(limit)
    ),
    "nan_accepted": Fault("frames", stimulus, "_check_values", lambda _: lambda *given: None),
}
