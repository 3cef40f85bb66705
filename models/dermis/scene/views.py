# SPDX-License-Identifier: Apache-2.0
"""Which view of the SPICE blocks a co-simulation takes: models or sky130 transistors, by block and by column.

Names and pins of a block are the same in both, so a view is the folder that its file is included from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from dermis.errors import InputError
from dermis.scene.schema import Strict, entry

View = Literal["behavioural", "sky130"]
Corner = Literal["tt", "ff", "ss", "sf", "fs"]

BLOCKS = ("row_driver", "conveyor", "integrator", "comparator", "charge_source")
"""What a view may be chosen for. The mirror goes with its conveyor: they share a pedestal, and a level."""

CONVERTER = ("integrator", "comparator", "charge_source")

_VIEWS = 'one of "behavioural", "sky130"'


def _block(meaning: str) -> Any:
    return entry(None, meaning, _VIEWS, default_from="run.views.default")


class ViewsTable(Strict):
    """[run] views = { ... }: a view for each block, and the conditions of the transistors."""

    default: View = entry("sky130", "Of every block that is not named", _VIEWS)
    row_driver: View | None = _block("Of the switches of the rows")
    conveyor: View | None = _block("Of the conveyor with its mirror; of nothing in the direct interface")
    integrator: View | None = _block("Of the integrator with its preset")
    comparator: View | None = _block("Of the comparator")
    charge_source: View | None = _block("Of the charge source")
    columns: list[int] | None = entry(
        None,
        "Columns whose channels take these views; the others are behavioural",
        "a list of different whole numbers from 0, below array.cols",
        default_from="all of them",
    )
    corner: Corner = entry("tt", "Of the transistors' process", 'one of "tt", "ff", "ss", "sf", "fs"')
    temperature_c: float = entry(
        27.0, "Of the transistors, in degrees C", "a finite number from -40 to 125", ge=-40, le=125
    )
    supply_scale: float = entry(
        1.0, "Times both supplies of the design", "a finite number from 0.9 to 1.1", ge=0.9, le=1.1
    )


@dataclass(frozen=True)
class Views:
    """The view of every block; see `ViewsTable`. `columns` is None for all of them."""

    row_driver: View = "behavioural"
    conveyor: View = "behavioural"
    integrator: View = "behavioural"
    comparator: View = "behavioural"
    charge_source: View = "behavioural"
    columns: tuple[int, ...] | None = None
    corner: Corner = "tt"
    temperature_c: float = 27.0
    supply_scale: float = 1.0

    @classmethod
    def of(cls, said: str | ViewsTable) -> Views:
        """The views of a scene, as they stand in its [run]."""
        if isinstance(said, str):
            return cls(**dict.fromkeys(BLOCKS, said))
        values = {name: getattr(said, name) or said.default for name in BLOCKS}
        columns = None if said.columns is None else tuple(said.columns)
        return cls(**values, columns=columns, **{n: getattr(said, n) for n in _CONDITIONS})

    def in_transistors(self, topology: str) -> frozenset[str]:
        """The blocks of a topology that are transistors; all of them where only some columns are."""
        blocks = (b for b in BLOCKS if topology != "direct" or b != "conveyor")
        return frozenset(b for b in blocks if getattr(self, b) == "sky130")

    def has_transistors(self, column: int, topology: str) -> bool:
        """Whether anything of a column's channel is transistors."""
        listed = self.columns is None or column in self.columns
        return listed and bool(self.in_transistors(topology) - {"row_driver"})

    def at(self, columns: tuple[int, ...]) -> Views:
        """The views of a deck that has these columns, which are all alike."""
        if self.columns is None or set(columns) <= set(self.columns):
            return replace(self, columns=None)
        channel = dict.fromkeys(BLOCKS, "behavioural") | {"row_driver": self.row_driver}
        return replace(self, **channel, columns=None)

    def conditions(self) -> Mapping[str, Any]:
        """Corner, temperature and supply, for reports."""
        return {name: getattr(self, name) for name in _CONDITIONS}


_CONDITIONS = ("corner", "temperature_c", "supply_scale")

BEHAVIOURAL = Views()


def resolve(said: str | ViewsTable, cols: int, path: Path) -> str | ViewsTable:
    """Fill in the view of every block, and check the columns.

    Raises
    ------
    InputError
        A column that the array has not, or one named twice; columns or conditions of transistors without any.
    """
    if said == "behavioural":
        return said
    views = Views.of(said)
    columns = views.columns
    if columns is not None and (
        len(set(columns)) < len(columns) or not columns or not all(0 <= c < cols for c in columns)
    ):
        allowed = f"a list of different whole numbers from 0, below array.cols = {cols}"
        raise InputError(path, "run.views.columns", list(columns), allowed)
    if not any(getattr(views, name) == "sky130" for name in BLOCKS):
        for name, default in {"columns": None, **BEHAVIOURAL.conditions()}.items():
            if (value := getattr(said, name)) != default:
                raise InputError(path, f"run.views.{name}", value, 'nothing where no block is "sky130"')
    values = asdict(views) | {"columns": None if columns is None else list(columns)}
    default = "sky130" if isinstance(said, str) else said.default
    return ViewsTable(default=default, **values)
