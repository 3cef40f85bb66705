# SPDX-License-Identifier: Apache-2.0
"""Forces for `Skin.read` from the tactile sensors of MuJoCo; mujoco itself is not imported."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dermis.ndarrays import Floats


def touch_grid(model: Any, sensordata: ArrayLike, name: str, rows: int, cols: int) -> Floats:
    """Return the normal forces [..., rows, cols] in newtons of a sensor of the plugin `touch_grid`.

    `sensordata` is [..., nsensordata], as `data.sensordata` or of many worlds; the model's XML gives the size as
    "cols rows". Rows go along y, columns along x. The sign of the grid's normal differs between versions: a push is
    positive here. ValueError for another sensor, or data of another model.
    """
    sensor, values = _values(model, sensordata, name)
    plugin = int(model.sensor_plugin[sensor])
    if plugin < 0:
        raise ValueError(f"sensor {name} is no touch_grid")
    # Values of the keys of the plugin, each ended by a zero byte.
    texts = bytes(np.asarray(model.plugin_attr[int(model.plugin_attradr[plugin]) :], np.uint8)).split(b"\0")
    if f"{cols} {rows}".encode() not in [b" ".join(text.split()) for text in texts]:
        raise ValueError(f'sensor {name} has no size="{cols} {rows}", which is cols and rows')
    return np.abs(_channels(values, name, rows, cols)[..., 0, :, :])


def tactile(
    model: Any, sensordata: ArrayLike, name: str, rows: int, cols: int, stiffness_n_per_m: float
) -> Floats:
    """Return the normal forces [..., rows, cols] in newtons of a sensor `tactile`, which reports depths in metres.

    The vertices of the sensor's mesh are the taxels, row 0 first, in their order in its file or XML; the skin over one
    has this stiffness. ValueError as for `touch_grid`, or for a stiffness that is not finite and above 0.
    """
    if not 0 < stiffness_n_per_m < np.inf:
        raise ValueError("stiffness_n_per_m must be finite and above 0")
    sensor, values = _values(model, sensordata, name)
    mesh = int(model.sensor_objid[sensor])
    vertices = int(model.mesh_vertnum[mesh]) if 0 <= mesh < len(model.mesh_vertnum) else 0
    if int(model.sensor_plugin[sensor]) >= 0 or vertices != rows * cols:
        raise ValueError(f"sensor {name} is no tactile sensor with {rows} x {cols} vertices, but {vertices}")
    return stiffness_n_per_m * np.maximum(_channels(values, name, rows, cols)[..., 0, :, :], 0.0)


def _values(model: Any, sensordata: ArrayLike, name: str) -> tuple[int, Floats]:
    """Return the number of a sensor and its values [..., dim]."""
    data = np.asarray(sensordata, dtype=float)
    try:
        sensor = int(model.sensor(name).id)
    except KeyError:
        raise ValueError(f"the model has no sensor {name}") from None
    if data.ndim == 0 or data.shape[-1] != model.nsensordata:
        raise ValueError(f"sensordata must be [..., {model.nsensordata}], not {list(data.shape)}")
    first = int(model.sensor_adr[sensor])
    return sensor, data[..., first : first + int(model.sensor_dim[sensor])]


def _channels(values: Floats, name: str, rows: int, cols: int) -> Floats:
    if (found := values.shape[-1]) % (rows * cols):
        raise ValueError(f"sensor {name} has {found} values, no whole number of channels of {rows} x {cols}")
    return values.reshape(*values.shape[:-1], -1, rows, cols)
