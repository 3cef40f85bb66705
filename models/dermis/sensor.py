# SPDX-License-Identifier: Apache-2.0
"""The taxel: what resistance a force makes, and what force a resistance means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.schema import Strict, entry


class SensorTable(Strict):
    """[sensor]: the law between force and resistance."""

    law: Literal["inverse"] = entry(
        "inverse", 'Force law; "inverse" is Force = K/R, the paper\'s', 'one of "inverse"'
    )
    k_force_n_ohm: float | None = entry(
        None,
        "K of Force = K/R, in N.ohm",
        "a finite number > 0",
        default_from="sensor.force_max_n * sensor.r_min_ohm",
        gt=0,
    )


@dataclass(frozen=True)
class InverseSensor:
    """Force = K/R.

    Every law has these two methods and nothing else, so that one with memory can keep its state in the
    sequence of frames it is given (axis 0 is time).

    Parameters
    ----------
    k_force_n_ohm : float
        K in N.ohm.
    """

    k_force_n_ohm: float

    def resistance_ohm(self, force_n: ArrayLike) -> NDArray[np.float64]:
        """R = K/F of a force in newtons, any shape; F = 0 gives inf and F = inf gives 0."""
        # + 0.0 turns -0.0 into 0.0, whose inverse is +inf.
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(self.k_force_n_ohm, np.asarray(force_n, dtype=float) + 0.0)

    def force_n(self, resistance_ohm: ArrayLike) -> NDArray[np.float64]:
        """F = K/R of a resistance in ohm, any shape; R = inf gives 0 and R = 0 gives inf."""
        # + 0.0 turns -0.0 into 0.0, whose inverse is +inf.
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(self.k_force_n_ohm, np.asarray(resistance_ohm, dtype=float) + 0.0)


def make_sensor(table: SensorTable) -> InverseSensor:
    """Make the sensor of a resolved [sensor] table."""
    if table.k_force_n_ohm is None:
        raise ValueError("the [sensor] table is not resolved: k_force_n_ohm has no value")
    return InverseSensor(table.k_force_n_ohm)
