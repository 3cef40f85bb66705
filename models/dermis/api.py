# SPDX-License-Identifier: Apache-2.0
"""The library: `simulate` a scene or arrays, and turn codes back into `newtons`."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis import engines, plan
from dermis.decode import force
from dermis.engines import batch
from dermis.errors import InputError, optional
from dermis.ndarrays import Floats, unmasked
from dermis.records import Plan
from dermis.scene import design as designs
from dermis.scene import scene as scenes
from dermis.scene import schema
from dermis.scene.design import Design
from dermis.scene.scene import Scene
from dermis.scene.stimulus import FramesTable, ResistanceTable

if TYPE_CHECKING:
    import pandas
    import xarray

SceneLike = str | os.PathLike[str] | Mapping[str, Any]
DesignLike = Design | str | os.PathLike[str] | Mapping[str, Any]

_HERE = "simulate"
"""Name of the caller's own values in errors, where a scene file would be named."""

_ARRAYS = {
    "force_n": {"kind": "frames", "unit": "newtons", "file": "force_n"},
    "resistance_ohm": {"kind": "resistance", "file": "resistance_ohm"},
}


@dataclass
class Result(engines.Result):
    """Codes of a simulation and their meaning. All arrays are shaped [frames, rows, cols].

    Attributes
    ----------
    codes : ndarray
        Unsigned integers, 0 to 255 in the default design.
    info : dict
        Further results of the engine, among them the error of the array solve.
    plan : Plan
        The scene with its defaults, the effects on and off with reasons, and the engine.
    """

    plan: Plan = field(kw_only=True)

    @functools.cached_property
    def _decoded(self) -> force.Decoded:
        return force.decode(self.plan, self.codes)

    @property
    def force_n(self) -> Floats:
        """Decoded forces in newtons, each in the middle of its code."""
        return self._decoded.force_n

    @property
    def force_low_n(self) -> Floats:
        """Smallest force in newtons that an ideal chip reads as this code."""
        return self._decoded.force_low_n

    @property
    def force_high_n(self) -> Floats:
        """Largest force in newtons that an ideal chip reads as this code; inf at full scale."""
        return self._decoded.force_high_n

    @property
    def resistance_ohm(self) -> Floats:
        """Decoded resistances in ohm; inf for code 0."""
        return self._decoded.resistance_ohm

    @property
    def applied_force_n(self) -> Floats:
        """Forces of the stimulus in newtons; of resistances, those of the sensor's law."""
        assert self.plan.force_n is not None
        return self.plan.force_n

    @property
    def time_s(self) -> Floats:
        """Start of each frame in seconds, [frames]."""
        return (self.plan.first_frame + np.arange(self.plan.frames)) * self.plan.drive.t_frame_s

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray dataset with dimensions frame, row, col and the coordinate time_s.

        Raises InputError if xarray is not installed.
        """
        module = optional("xarray", "tables")
        names = ("frame", "row", "col")
        data = {
            "code": (names, self.codes, {"units": "1"}),
            "force_n": (names, self.force_n, {"units": "N"}),
            "applied_force_n": (names, self.applied_force_n, {"units": "N"}),
        }
        coords = {name: np.arange(size) for name, size in zip(names, self.codes.shape, strict=True)}
        attributes = {"title": self.plan.scene.title, "engine": self.plan.engine, "seed": self.plan.seed}
        time = ("frame", self.time_s, {"units": "s"})
        return module.Dataset(data, {**coords, "time_s": time}, attributes)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table with one line a taxel and the index frame, row, col.

        Raises InputError if pandas or xarray is not installed.
        """
        optional("pandas", "tables")
        return self.to_xarray().drop_vars("time_s").to_dataframe()


def simulate(
    scene: SceneLike | None = None,
    *,
    force_n: ArrayLike | None = None,
    resistance_ohm: ArrayLike | None = None,
    engine: str | None = None,
    effects: Mapping[str, Any] | None = None,
    seed: int | None = None,
    design: DesignLike | None = None,
    processes: int = 1,
    simulator: str | None = None,
    **tables: Any,
) -> Result:
    """Simulate the read-out of one scene.

    Parameters
    ----------
    scene : path, name or dict, optional
        A scene file, the name of a scene that comes with the package (`scene_names()`), or the same
        tables as a dict, whose file names are relative to the working directory.
    force_n, resistance_ohm : array_like, optional
        Stimulus in newtons or in ohm, [rows, cols] or [frames, rows, cols], in place of the scene's own.
        One of the two. Without a size in the scene, the array has the size of the sheet. `stimulus` may
        then hold t_frame_s, resample and select.
    engine : str, optional
        "closed", "event", "rtl" or "cosim"; by default the scene's own, or the cheapest that can do it.
    effects : dict, optional
        Effects to add, by name, or to replace with all their parameters: those, True for the defaults, False for off.
    seed : int, optional
        Seed of everything random.
    design : path, dict or Design, optional
        A design file, or values to change in the default one: `{"converter": {"f_clk_hz": 1e7}}`.
    processes : int
        Processes of this machine for the frames. A script must then guard its own code by
        `if __name__ == "__main__"`.
    simulator : str, optional
        "icarus" or "verilator", for engines rtl and cosim.
    **tables
        Other tables of a scene: array, sensor, stimulus, interface, run, title. Their keys are added to
        those of `scene`; a stimulus of another kind replaces it.

    Raises
    ------
    InputError
        A value is wrong; the one line names it and what is allowed.
    SimulatorError
        A simulator failed; the line says where its log is.
    """
    given = _given(force_n=force_n, resistance_ohm=resistance_ohm)
    world = _scene(scene, given, design, engine, effects, seed, tables)
    options: dict[str, Any] = {} if simulator is None else {"simulator": simulator}
    made = plan.make(world)
    if options and made.engine not in ("rtl", "cosim"):
        raise InputError(_HERE, "simulator", schema.quoted(simulator), "engine rtl or cosim")
    if not isinstance(processes, int) or not 1 <= processes <= 1024:
        raise InputError(_HERE, "processes", processes, "a whole number 1..1024")
    done = batch.run(made, processes=processes, **options)
    return Result(done.codes, done.info, plan=made)


def newtons(
    codes: ArrayLike, scene: SceneLike | Result, *, corrected: bool = False, design: DesignLike | None = None
) -> Floats:
    """Decode codes of the chip into forces.

    Parameters
    ----------
    codes : array_like
        Integers [..., rows, cols].
    scene : path, name, dict or Result
        What the codes were read from: its sensor law, interface and, with `corrected`, its network.
    corrected : bool
        Take off what the network and the converters of the scene do. Effects of the sheet, as its temperature, stay:
        those are of a calibration (`Skin`, `dermis read --calibration`). Beside a taxel at full scale, whose current
        no code tells, forces read low: `Skin.decode` flags them and gives intervals.
    design : path, dict or Design, optional
        As for `simulate`.

    Returns
    -------
    ndarray
        Newtons, shaped as the codes.

    Raises
    ------
    InputError
        The scene is wrong, or the codes do not fit it.
    """
    if isinstance(scene, dict):
        scene = {"stimulus": {"kind": "uniform", "force_n": [0.0]}} | scene
    made = scene.plan if isinstance(scene, Result) else plan.make(_scene(scene, None, design))
    try:
        return force.decode(made, codes, corrected).force_n
    except ValueError as error:
        raise InputError("newtons", "codes", f"shape {list(np.shape(codes))}", str(error)) from None


def scene_names() -> list[str]:
    """Return the names of the scenes that come with the package."""
    return scenes.names()


def warm_up() -> None:
    """Compile the loops of `simulate`, `newtons` and `Skin` now, for later processes as well.

    It takes a minute or two once an installation, and says so on standard error; afterwards half a second.
    """
    from dermis.skin import Skin  # compiled: numba takes 0.4 s to load

    worn = dict.fromkeys(("row_driver", "sensor_hysteresis", "sensor_creep"), True)
    size, force_n = {"rows": 2, "cols": 2}, np.ones((2, 2, 2))
    for effects in (worn, worn | {"column_input": True, "trace": True}):
        skin = Skin(array=size, effects=effects)
        skin.decode(skin.read(force_n))
    runs = {"closed": ("row_driver", "column_input"), "event": ("thermal_noise", "integrator_gain")}
    for engine, names in runs.items():
        made = simulate(force_n=force_n, effects=dict.fromkeys(names, True), engine=engine)
        newtons(made.codes, made, corrected=True)


def _given(**arrays: ArrayLike | None) -> tuple[str, NDArray[Any]] | None:
    """Return the one array of a stimulus that was given, with its name."""
    given = {name: values for name, values in arrays.items() if values is not None}
    if len(given) > 1:
        raise InputError(_HERE, " and ".join(given), "both", "one of the two")
    for name, values in given.items():
        try:
            return name, unmasked(values, name)
        except ValueError as error:  # lists of unequal lengths as well
            raise InputError(_HERE, name, "(an array)", f"numbers [frames, rows, cols] ({error})") from None
    return None


def _scene(
    scene: SceneLike | None,
    given: tuple[str, NDArray[Any]] | None,
    design: DesignLike | None,
    engine: str | None = None,
    effects: Mapping[str, Any] | None = None,
    seed: int | None = None,
    tables: Mapping[str, Any] | None = None,
) -> Scene:
    allowed = "a path, a name or a dict; for arrays, force_n=... or resistance_ohm=..."
    path, data = scenes.tables_of(scene, _HERE, allowed)
    run = {name: value for name, value in (("engine", engine), ("seed", seed)) if value is not None}
    if given is not None:
        name, values = given
        data["stimulus"] = _in_place(data.get("stimulus", {}), name, (tables or {}).get("stimulus", {}), path)
        if values.ndim in (2, 3):
            size = {"rows": values.shape[-2], "cols": values.shape[-1]}
            data = schema.merged({"array": size}, data)
    table = schema.validate(scenes.SceneTable, scenes.changed(data, path, tables, run, effects), path)
    if given is not None:
        stimulus = table.stimulus
        if not isinstance(stimulus, FramesTable | ResistanceTable):
            raise InputError(path, "stimulus.kind", schema.quoted(stimulus.kind), f"none with {given[0]}")
        table = table.model_copy(update={"stimulus": stimulus.given(given[1])})
    return scenes.resolve(table, path, _design(design))


def _in_place(own: Any, name: str, asked: Any, path: Path) -> Any:
    """Return the stimulus of an array in place of a scene's own.

    Without a kind the scene's keys belong to the array. A scene's own stimulus goes as a whole, so a key of it that
    an array has as well must be given again, or it would be lost without a word.
    """
    if not isinstance(own, dict):
        return own
    kept = {} if "kind" in own else own
    given = kept | dict(asked if isinstance(asked, Mapping) else {})
    for key in ("file", "unit"):
        if key in given:
            raise InputError(path, f"stimulus.{key}", schema.quoted(given[key]), f"not with {name}")
    for key in ("t_frame_s", "resample", "select"):
        if key in own and key not in given:
            allowed = f"not used with {name}; for the array give stimulus={{{key!r}: ...}} as an argument"
            raise InputError(path, f"stimulus.{key}", schema.quoted(own[key]), allowed)
    return kept | _ARRAYS[name]


def _design(design: DesignLike | None) -> Design:
    if isinstance(design, Mapping):
        return designs.load().replace(**schema.plain(design))
    return design if isinstance(design, Design) else designs.load(design)
