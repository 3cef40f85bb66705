# SPDX-License-Identifier: Apache-2.0
"""Views of the SPICE blocks in a co-simulation: behavioural or sky130 transistors, by block and by column.

A block has the same name and pins in both, so a view is the folder from which its file is included.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from dermis.scene.schema import Strict, entry, filled, refuse

View = Literal["behavioural", "sky130"]
Corner = Literal["tt", "ff", "ss", "sf", "fs"]

BLOCKS = ("row_driver", "conveyor", "integrator", "comparator", "charge_source")
"""Blocks with a choice of view; the mirror has that of its conveyor."""

CONVERTER = ("integrator", "comparator", "charge_source")


def _block(meaning: str) -> Any:
    return entry(None, meaning, default_from="run.views.default")


class Views(Strict):
    """[run] views = { ... }: a view for each block, and the conditions of the transistors."""

    default: View = entry("sky130", "View of every block that is not named")
    row_driver: View | None = _block("View of the row switches")
    conveyor: View | None = _block("View of the conveyor and its mirror; no effect in the direct interface")
    integrator: View | None = _block("View of the integrator and its preset switch")
    comparator: View | None = _block("View of the comparator")
    charge_source: View | None = _block("View of the charge source")
    columns: list[int] | None = entry(
        None,
        "Columns whose channels take these views; the others are behavioural",
        "a list of different whole numbers from 0, below array.cols",
        default_from="all of them",
    )
    corner: Corner = entry("tt", "Process corner of the transistors")
    temperature_c: float = entry(27.0, "Temperature of the transistors, in degrees C", ge=-40, le=125)
    supply_scale: float = entry(1.0, "Factor on both supplies of the design", ge=0.9, le=1.1)

    @classmethod
    def of(cls, said: str | Views) -> Views:
        """Return the view of every block of [run] of a scene."""
        views = cls(default=said) if isinstance(said, str) else said
        return filled(views, dict.fromkeys(BLOCKS, views.default))

    def in_transistors(self, topology: str) -> frozenset[str]:
        """Return the blocks of a topology that are transistors in at least one column."""
        blocks = (b for b in BLOCKS if topology != "direct" or b != "conveyor")
        return frozenset(b for b in blocks if getattr(self, b) == "sky130")

    def has_transistors(self, column: int, topology: str) -> bool:
        """Return True if a block of a column's channel is transistors."""
        listed = self.columns is None or column in self.columns
        return listed and bool(self.in_transistors(topology) - {"row_driver"})

    def at(self, columns: tuple[int, ...]) -> Views:
        """Return the views of a deck with these columns, which all have the same; without any, of the row drivers."""
        if columns and (self.columns is None or set(columns) <= set(self.columns)):
            return self.model_copy(update={"columns": None})
        channel = dict.fromkeys(BLOCKS, "behavioural") | {"row_driver": self.row_driver}
        return self.model_copy(update=channel | {"columns": None})


BEHAVIOURAL = Views.of("behavioural")


def resolve(said: str | Views, cols: int, topology: str, path: Path) -> str | Views:
    """Fill in the view of every block.

    Raises InputError if a column is outside the array or named twice, or columns or conditions are given but no
    transistors.
    """
    if said == "behavioural":
        return said
    views = Views.of(said)
    refuse(_wrong(views, cols, topology), views, path, "run.views.")
    return views


def _wrong(views: Views, cols: int, topology: str) -> Iterator[tuple[str, str]]:
    columns = views.columns
    if columns is not None and not len(set(columns) & set(range(cols))) == len(columns) > 0:
        yield "columns", f"a list of different whole numbers from 0, below array.cols = {cols}"
    if not views.in_transistors(topology):
        for name in ("columns", "corner", "temperature_c", "supply_scale"):
            if getattr(views, name) != getattr(BEHAVIOURAL, name):
                yield name, 'nothing where no block of the topology is "sky130"'
