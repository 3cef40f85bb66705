# SPDX-License-Identifier: Apache-2.0
"""Simulator of a readout chip for resistive artificial skin, and models of the chip.

`simulate` runs a scene or an array of forces through the chip, `newtons` turns codes back into
forces, `Skin` does both in compiled loops for a robot simulator, `RowsOfInterest` chooses the rows of
a host's next frame, `scene_names` lists the scenes that come with the package, and `warm_up`
compiles ahead. Errors of scenes, files and runs are `InputError` and `SimulatorError`, both a
`DermisError`; frames of a wrong shape, kind or range are a `ValueError` of `Skin`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dermis.machine_code import drop_stale

if TYPE_CHECKING:
    from dermis.api import Result, newtons, scene_names, simulate, warm_up
    from dermis.chip.spi_protocol import RowsOfInterest
    from dermis.errors import DermisError, InputError, SimulatorError
    from dermis.skin import Skin

__version__ = "0.2.0"

drop_stale(Path(__file__).parent)

_NAMES = {
    **dict.fromkeys(("DermisError", "InputError", "SimulatorError"), "dermis.errors"),
    **dict.fromkeys(("Result", "newtons", "scene_names", "simulate", "warm_up"), "dermis.api"),
    "RowsOfInterest": "dermis.chip.spi_protocol",
    "Skin": "dermis.skin",
}

__all__ = [
    "DermisError",
    "InputError",
    "Result",
    "RowsOfInterest",
    "SimulatorError",
    "Skin",
    "__version__",
    "newtons",
    "scene_names",
    "simulate",
    "warm_up",
]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    """Load a name of the library when it is first used: the command line starts without it."""
    if name not in _NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_NAMES[name]), name)
