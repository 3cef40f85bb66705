# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: every effect with defaults is on, and engine event walks only cells that its
bounds leave open.
"""

from __future__ import annotations

from dermis.effects import AutoTable
from dermis.scene import scene
from dermis.scene.scene import Scene
from dermis.scene.schema import Strict


def with_auto(world: Scene) -> Scene:
    """Return the same scene as if it said [effects] auto = {}."""
    return scene.with_effects(world, world.table.effects.model_copy(update={"auto": AutoTable()}), None)


def candidates(world: Scene) -> dict[str, Strict]:
    """Return what auto switches on: what a scene names, and every further effect with physical
    defaults.
    """
    return with_auto(world).effects
