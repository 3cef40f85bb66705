# SPDX-License-Identifier: Apache-2.0
"""Effects of the integrator: its input current, gain, range and bandwidth."""

import math

from dermis import bounds
from dermis.effects.effect import Effect, column, exact_effect, number, positive

EFFECTS = (
    exact_effect(
        "offset_current",
        "constant current into every converter",
        {"i_a": column("Into every converter, after the mirror, in A", 3e-7, (1e-10, 3e-7), 1e-9)},
        converter={"i_offset_a": "i_a"},
    ),
    Effect(
        "integrator_gain",
        "finite gain: charge leaks through the conductance at the input (direct: the whole column)",
        {
            "gain_dc": number("Open-loop gain of the integrator", 100.0, (100.0, 1e5), ge=1),
            "r_in_ohm": positive("Across the integrator's input, in ohm", 1e4, (1e5, 1e9)),
        },
        {"gain_dc": "integrator.gain_dc", "r_in_ohm": "integrator.r_in_ohm"},
        converter={"inv_gain_dc": lambda p, _: 1.0 / p.gain_dc, "g_in_s": lambda p, _: 1.0 / p.r_in_ohm},
        direct={"gain_dc": 6e3},
        bound=bounds.integrator_gain,
    ),
    Effect(
        "integrator_range",
        "limits of the integrator's output: charge beyond them is lost",
        {
            "v_max_v": positive("Highest output of the integrator, in V", 0.7, (0.55, 1.6)),
            "v_min_v": number(
                "Lowest output of the integrator, in V", -0.6, (0.55, 1.6), "a finite number < 0", lt=0
            ),
        },
        {"v_max_v": "integrator.v_out_max_v", "v_min_v": "integrator.v_out_min_v"},
        converter={"v_int_max_v": "v_max_v", "v_int_min_v": "v_min_v"},
        direct={"v_max_v": 1.6, "v_min_v": -1.6},
        bound=bounds.integrator_range,
    ),
    Effect(
        "integrator_bandwidth",
        "finite gain-bandwidth product: the output lags behind the charge",
        {"gbw_hz": positive("Gain-bandwidth product, in Hz", 3e5, (1e6, 1e8))},
        {"gbw_hz": "integrator.gbw_hz"},
        converter={"t_gbw_s": lambda p, _: 1.0 / (2.0 * math.pi * p.gbw_hz)},
        direct={"gbw_hz": 2e6},
        bound=bounds.integrator_bandwidth,
    ),
)
