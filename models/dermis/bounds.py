# SPDX-License-Identifier: Apache-2.0
"""Error bounds of the filter by name, and the table of converters that they read.

The bounds are compiled, in `dermis.converter.bound_loops`: an effect names its own without loading
numba. An effect that engine `closed` honours has no error here. One without a bound keeps every cell
open.
"""

from dataclasses import dataclass

import numpy as np

from dermis.converter.vfc import W_PRESET, Converter
from dermis.ndarrays import Floats

# Engine event stops drawing where a decision is eight standard deviations away: it is wrong once in 1e15.
SIGMAS = 8.0
# Lag of an integrator's output in clocks beyond which counts do not follow the order of levels: several packets are
# under way at once, and a lower level may count less.
SLOW_CLOCKS = 1.0
# Current in full scales that stands for any larger one.
_TOP = 1e9


@dataclass(frozen=True)
class Bounding:
    """Bound of an effect: the number of its function in `converter.bound_loops`, and a factor on all of it, for
    tests.
    """

    number: int
    factor: float = 1.0


honoured = Bounding(-1)
"""Engine closed does all of it."""
unknown = Bounding(0)
"""Nothing is known: every cell stays open."""
supply_ripple, motion, mirror_lag = (Bounding(n) for n in range(1, 4))
comparator_hysteresis, comparator_delay, integrator_bandwidth = (Bounding(n) for n in range(4, 7))
integrator_gain, integrator_range = Bounding(7), Bounding(8)
thermal_noise, shot_noise, clock_jitter, comparator_noise = (Bounding(n) for n in range(9, 13))
metastability, ktc_noise, flicker_noise = (Bounding(n) for n in range(13, 16))
COUNT = 16


# Rows of the table of converters [25, cols] that `columns` makes.
(
    TOP, PER_A, SQUEEZE, OFFSET, KAPPA, PACKET, LEVEL, BEGIN, AWAY, WINDOW, DELAY, LAG, G_IN, CROSS, LEAK,
    LOW, HIGH, PRESET, NOISE, APERTURE, JITTER, THERMAL, SHOT, PRESET_NOISE, FLICKER,
) = range(25)  # fmt: skip


def columns(c: Converter) -> Floats:
    """Converters in packets and clocks, [25, cols]; the rows are named above."""
    f, amplitude = c.f_clk_hz, 1.0 / (1.0 + c.inv_gain_dc)
    packet_v = c.packet_v()
    output_v = packet_v * amplitude
    low, high = c.range_v() / output_v
    full = c.k * c.i0_a
    gain = np.abs(c.gain)
    begin = W_PRESET + c.preset_error_v / packet_v
    return np.array(
        [
            _TOP * full, c.gain / full, c.inv_i_range_a * full / np.maximum(gain, 1e-30), c.i_offset_a / c.i0_a,
            c.q_mirror_c * f / c.i0_a, 1.0 + c.packet_error, c.v_comp_offset_v / output_v,
            np.minimum(np.maximum(begin, low), high), c.v_comp_offset_v / packet_v,
            c.v_hysteresis_v / output_v, c.t_comp_delay_s * f, c.t_gbw_s * f * amplitude, c.g_in_s,
            1.0 / (c.c_int_f * f), c.inv_gain_dc * amplitude, low, high, np.abs(c.preset_error_v) / packet_v,
            c.v_comp_noise_v / output_v, 0.5 * c.t_meta_s * f, c.t_jitter_s * f,
            2.0 * c.kt_noise_j * (c.gain / c.k) ** 2 * f / c.i0_a**2, c.q_shot_c * f / c.i0_a,
            c.v_preset_noise_v / packet_v, c.packet_flicker,
        ]
    )  # fmt: skip
