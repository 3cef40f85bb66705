# SPDX-License-Identifier: Apache-2.0
"""Effects of the sheet itself; they change the resistances before any engine sees them."""

import functools

from dermis.effects.effect import exact_effect, not_negative, number, share, too_warm

_Sheet = functools.partial(exact_effect, considered=False)

EFFECTS = (
    _Sheet(
        "sensor_hysteresis",
        "hysteresis of a taxel: higher conductance for falling force",
        {"relative": share("Relative decrease of the resistance on the way back", 0.2, (1e-3, 0.9))},
        {"relative": "sensor.hysteresis"},
        sensor={"hysteresis": "relative"},
    ),
    _Sheet(
        "sensor_creep",
        "creep of a taxel: the conductance grows with every decade of time under load",
        {"per_decade": not_negative("Relative growth of conductance a decade of time", 0.1, (5e-4, 0.5))},
        {"per_decade": "sensor.creep_per_decade"},
        sensor={"creep_per_decade": "per_decade"},
    ),
    _Sheet(
        "sensor_temperature",
        "temperature coefficient of the sheet's conductance",
        {
            "tc_per_k": number("Relative change of conductance a kelvin", 3e-3, (3e-5, 5e-3)),
            "delta_k": number("How far the sheet is from where it was measured, in K", 30.0, (1.0, 60.0)),
        },
        {"tc_per_k": "sensor.tc_per_k", "delta_k": "ambient.delta_k"},
        sensor={"temperature_error": lambda p, _: p.tc_per_k * p.delta_k},
        wrong=too_warm,
    ),
    _Sheet(
        "sensor_spread",
        "random factor on the conductance of each taxel",
        {"relative": share("Relative standard deviation from taxel to taxel", 0.1, (1e-3, 0.5))},
        {"relative": "sensor.spread"},
        sensor={"spread": "relative"},
    ),
)
