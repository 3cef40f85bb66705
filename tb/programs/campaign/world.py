# SPDX-License-Identifier: Apache-2.0
"""One scene of a campaign with everything it hangs on in one piece: scene, changes of the design, files beside it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dermis import plan as planning
from dermis.records import Plan
from dermis.scene import scene as scenes
from dermis.scene.design import Design
from dermis.scene.design import load as load_design
from dermis.scene.schema import write_toml

Data = dict[str, Any]


@dataclass(frozen=True)
class World:
    """What makes a plan, as plain data.

    Attributes
    ----------
    scene : dict
        The tables of a scene file.
    design : dict
        Section -> key -> value: what differs from models/design.toml.
    files : dict
        Name of a csv file beside the scene -> its lines of numbers.
    why, engines : str
        For a stored case: what went wrong with it, and whose laws it is held against.
    refused : str
        For a stored case: what the one line says with which it is refused; empty where it is not.
    """

    scene: Data
    design: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    files: Mapping[str, list[list[float]]] = field(default_factory=dict)
    why: str = ""
    engines: str = "closed,event"
    refused: str = ""

    def design_of(self) -> Design:
        """The design with its changes."""
        base = load_design()
        return (
            base.replace(**{name: dict(keys) for name, keys in self.design.items()}) if self.design else base
        )

    def read(self, directory: Path) -> scenes.Scene:
        """The scene, its files written into `directory`.

        Raises
        ------
        InputError
            As for a scene that a user wrote.
        """
        for name, lines in self.files.items():
            text = "\n".join(",".join(map(repr, line)) for line in lines) + "\n"
            (directory / name).write_text(text, encoding="ascii")
        return scenes.from_data(self.scene, directory / "scene.toml", self.design_of())

    def plan(self, directory: Path, engine: str | None) -> Plan:
        """The plan of the scene; with `engine` None as a user's run without one would have it."""
        return planning.make(self.read(directory), engine)

    def to_toml(self) -> str:
        """All of it as one TOML file, which `load` reads."""
        head = {"why": self.why or None, "engines": self.engines, "refused": self.refused or None}
        tables: Data = {f"scene.{name}": table for name, table in self.scene.items()}
        tables |= {f"design.{name}": dict(keys) for name, keys in self.design.items()}
        if self.files:
            tables["files"] = {f'"{name}"': lines for name, lines in self.files.items()}
        return "# SPDX-License-Identifier: Apache-2.0\n" + write_toml(head | tables)


def load(path: Path) -> World:
    """Read what `World.to_toml` wrote."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    head = {name: data[name] for name in ("why", "engines", "refused") if name in data}
    return World(data["scene"], data.get("design", {}), data.get("files", {}), **head)


def lines_of(frames: Any) -> list[list[float]]:
    """Frames [frames, rows, cols] as the lines of a csv file, one row a line."""
    return [[float(v) for v in row] for frame in frames for row in frame]


def size(world: World) -> float:
    """How much there is to a world: what shrinking makes smaller."""
    count = 0.0

    def add(value: Any) -> None:
        nonlocal count
        if isinstance(value, Mapping):
            for inner in value.values():
                count += 3
                add(inner)
        elif isinstance(value, (list, tuple)):
            for inner in value:
                count += 1
                add(inner)
        elif isinstance(value, float) and math.isfinite(value):
            # The digits it takes to write it down: 500.0 is simpler than 512.3871.
            count += 0.02 * len(repr(value))
        elif isinstance(value, int):
            count += 1e-3 * math.log1p(abs(value))

    add(world.scene)
    add(world.design)
    add(world.files)
    return count
