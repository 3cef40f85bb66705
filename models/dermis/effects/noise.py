# SPDX-License-Identifier: Apache-2.0
"""Random effects: noise of currents, voltages and packets, jitter of clocks, metastability."""

import functools
import math
from typing import Any

from dermis import bounds
from dermis.effects.effect import Effect, Setting, below_one_clock, celsius, not_negative, small, within_clock
from dermis.scene.design import ABSOLUTE_ZERO_C, ELECTRON_C, K_BOLTZMANN_J_PER_K

# Jitter of an edge in clocks. Two edges in a row are 1 apart and move by sqrt(2) of it against each
# other: at a tenth they keep their order to 7 sigma, once in 1e12 edges; from half a clock on every
# third pair would change places, and what is counted is no clock any more.
JITTER_MAX = 0.1

_Random = functools.partial(Effect, random=True)


def _kt_j(temperature_c: float) -> float:
    return K_BOLTZMANN_J_PER_K * (temperature_c - ABSOLUTE_ZERO_C)


def _overtaking(p: Any, setting: Setting) -> list[tuple[str, str]]:
    most_s = JITTER_MAX * (1.0 / setting.design.converter.f_clk_hz)
    if p.t_s <= most_s:
        return []
    return [("t_s", f"at most a tenth of a clock ({most_s:g} s), or edges would overtake each other")]


EFFECTS = (
    _Random(
        "comparator_noise",
        "noise of the decision level",
        {"v_v": not_negative("Of every decision, rms in V", 0.05, (2e-6, 6e-3))},
        {"v_v": "comparator.v_noise_v"},
        converter={"v_comp_noise_v": "v_v"},
        bound=bounds.comparator_noise,
    ),
    _Random(
        "metastability",
        "metastability: a crossing close to a clock edge may be seen one clock late",
        {
            "t_aperture_s": within_clock(
                "Crossings within half of it either side of a clock edge are decided by a coin, in s",
                1e-7,
                (1e-14, 1e-7),
            )
        },
        {"t_aperture_s": "comparator.t_aperture_s"},
        converter={"t_meta_s": "t_aperture_s"},
        wrong=below_one_clock("t_aperture_s"),
        bound=bounds.metastability,
    ),
    _Random(
        "clock_jitter",
        "jitter of clock edges: it moves samples and changes the width of packets",
        {
            "t_s": not_negative(
                "Of every edge, rms in s",
                5e-9,
                (1e-13, 1.5e-8),
                "a finite number >= 0, at most a tenth of a clock",
            )
        },
        {"t_s": "converter.t_jitter_s"},
        converter={"t_jitter_s": "t_s"},
        wrong=_overtaking,
        bound=bounds.clock_jitter,
    ),
    _Random(
        "thermal_noise",
        "thermal noise current of every conductance on a column",
        {
            "temperature_c": celsius("Of sheet and chip, in degrees Celsius", 27.0, (1.0, 125.0)),
            "factor": not_negative("Noise power over that of the taxels alone", 2e5, (0.02, 60.0)),
        },
        {"temperature_c": "ambient.temperature_c", "factor": "ambient.noise_factor"},
        converter={"kt_noise_j": lambda p, _: _kt_j(p.temperature_c) * p.factor},
        bound=bounds.thermal_noise,
    ),
    _Random(
        "shot_noise",
        "shot noise of input current and packets",
        {"factor": not_negative("Noise power over that of single electrons", 3e3, (0.01, 30.0), default=1.0)},
        converter={"q_shot_c": lambda p, _: ELECTRON_C * p.factor},
        bound=bounds.shot_noise,
    ),
    _Random(
        "ktc_noise",
        "sampled noise of the preset switch on the capacitor",
        {"temperature_c": celsius("Of the preset switch, in degrees Celsius", 27.0, (1.0, 125.0))},
        {"temperature_c": "ambient.temperature_c"},
        converter={
            "v_preset_noise_v": lambda p, setting: math.sqrt(_kt_j(p.temperature_c) / setting.c_int_f)
        },
        bound=bounds.ktc_noise,
    ),
    _Random(
        "flicker_noise",
        "slow noise of the reference: the packet size differs from slot to slot",
        {"relative": small("Of the packets from slot to slot, rms relative", 5e-3, (5e-7, 2e-3))},
        {"relative": "charge.flicker"},
        converter={"packet_flicker": "relative"},
        bound=bounds.flicker_noise,
    ),
)
