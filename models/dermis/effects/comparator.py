# SPDX-License-Identifier: Apache-2.0
"""Effects of the comparator: its level, its window and its delay."""

import functools

from dermis import bounds
from dermis.effects.effect import Effect, below_one_clock, column, exact_effect, not_negative, within_clock

within_packet = functools.partial(not_negative, allowed="a finite number >= 0, below one packet")

EFFECTS = (
    exact_effect(
        "comparator_offset",
        "offset of the decision level",
        {"v_v": column("Decision level, in V of the integrator; plus needs more charge", 0.3, (1e-3, 0.3))},
        {"v_v": "comparator.v_offset_v"},
        converter={"v_comp_offset_v": "v_v"},
    ),
    Effect(
        "comparator_hysteresis",
        "hysteresis of the comparator: it switches half a window past its level",
        {"v_v": within_packet("Full width of the window around the level, in V", 0.3, (1e-4, 0.3))},
        {"v_v": "comparator.v_hysteresis_v"},
        converter={"v_hysteresis_v": "v_v"},
        bound=bounds.comparator_hysteresis,
    ),
    Effect(
        "comparator_delay",
        "delay of the comparator before the synchronizer",
        {"t_s": within_clock("From crossing to output, in s", 1.3e-7, (1e-10, 2e-8))},
        {"t_s": "comparator.t_delay_s"},
        converter={"t_comp_delay_s": "t_s"},
        wrong=below_one_clock("t_s"),
        bound=bounds.comparator_delay,
    ),
)
