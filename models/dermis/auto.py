# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: every effect with defaults is on, and engine event walks only cells that its
bounds leave open.
"""

from __future__ import annotations

from dermis.effects import AutoTable
from dermis.scene import scene
from dermis.scene.scene import Scene


def with_auto(world: Scene) -> Scene:
    """Return the same scene as if it said [effects] auto = {}."""
    return scene.with_effects(world, world.table.effects.model_copy(update={"auto": AutoTable()}), None)
