# SPDX-License-Identifier: Apache-2.0
"""Effects of the k:1 mirror between conveyor and converter."""

from typing import Any

import numpy as np

from dermis import bounds
from dermis.effects.effect import (
    MIRRORED,
    Effect,
    Setting,
    column,
    exact_effect,
    not_negative,
    positive,
    small,
)


def _gain(p: Any, setting: Setting) -> Any:
    gain = 1.0 + np.asarray(p.ratio_error, dtype=float)
    if p.spread:
        gain = gain * (1.0 + p.spread * setting.rng("mirror_ratio").standard_normal(setting.cols))
    return gain


EFFECTS = (
    exact_effect(
        "mirror_ratio",
        "ratio error of the k:1 mirror, systematic and from column to column",
        {
            "ratio_error": column("Relative error of the current delivered", 0.02, (1e-3, 0.05), gt=-1),
            "spread": small("Rms relative error from column to column", 0.01, (1e-4, 0.05), default=0.0),
        },
        {"ratio_error": "mirror.ratio_error"},
        converter={"gain": _gain},
        topologies=MIRRORED,
    ),
    exact_effect(
        "mirror_output",
        "finite output resistance of the mirror, across the integrator's input",
        {"r_out_ohm": positive("Across the mirror's output, in ohm", 1e4, (1e5, 1e8))},
        {"r_out_ohm": "mirror.r_out_ohm"},
        converter={"g_in_s": lambda p, _: 1.0 / p.r_out_ohm},
        topologies=MIRRORED,
        needs={"integrator_gain": {"gain_dc": 100.0}},
    ),
    Effect(
        "mirror_lag",
        "slow mirror at low current: a rest of the previous row's current when the gate opens",
        {"q_c": positive("Time constant times output current, in C", 4e-11, (1e-15, 1e-11))},
        {"q_c": "mirror.q_lag_c"},
        converter={"q_mirror_c": "q_c"},
        topologies=MIRRORED,
        bound=bounds.mirror_lag,
    ),
    exact_effect(
        "range_switch",
        "resistance of the switches that set k: compression at high current",
        {
            "r_ohm": not_negative("In series with the mirror's input devices, in ohm", 100.0, (0.01, 10.0)),
            "v_overdrive_v": positive("Overdrive of those devices, in V", 0.3, (0.1, 0.4)),
        },
        {"r_ohm": "mirror.r_switch_ohm", "v_overdrive_v": "mirror.v_overdrive_v"},
        converter={"inv_i_range_a": lambda p, _: p.r_ohm / p.v_overdrive_v},
        topologies=MIRRORED,
    ),
)
