# SPDX-License-Identifier: Apache-2.0
"""Fields of the records that effects write: a field at its default is the ideal."""

import dataclasses
import functools
from typing import Any

import numpy as np

FAMILIES = {
    "array": frozenset(
        "r_row_driven_ohm r_row_grounded_ohm r_column_ohm r_pad_row_ohm r_pad_column_ohm r_return_ohm "
        "v_column_offset_v g_lateral_row_s g_lateral_column_s i_leak_a".split()
    ),
    "lines": frozenset("r_trace_row_ohm r_trace_column_ohm c_row_f c_column_f c_taxel_f".split()),
    "mirror": frozenset("gain inv_i_range_a q_mirror_c g_in_s".split()),
    "integrator": frozenset("i_offset_a inv_gain_dc t_gbw_s v_int_max_v v_int_min_v".split()),
    "comparator": frozenset("v_comp_offset_v v_hysteresis_v t_comp_delay_s".split()),
    "packet": frozenset("packet_error preset_error_v".split()),
    "noise": frozenset(
        "v_comp_noise_v t_meta_s t_jitter_s kt_noise_j q_shot_c v_preset_noise_v packet_flicker".split()
    ),
    "motion": frozenset("ripple motion".split()),
}
"""Fields of Network, Converter and Drive by family. A field that is in none is refused by every engine."""


def of(*families: str) -> frozenset[str]:
    """Return the fields of some families."""
    return frozenset().union(*(FAMILIES[family] for family in families))


@functools.cache
def _defaults(kind: type, given: frozenset[str]) -> tuple[tuple[str, Any], ...]:
    return tuple((f.name, f.default) for f in dataclasses.fields(kind) if f.name not in given)


def active(record: Any, given: frozenset[str]) -> frozenset[str]:
    """Return the fields of a record that are away from their defaults; `given` are those that a scene always sets.

    Every other field counts, whoever added it: an engine refuses each one that it does not list.
    """
    found = []
    for name, default in _defaults(type(record), given):
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            # The first element decides most of them.
            if (value.flat[0] != default) or (value != default).any():
                found.append(name)
        elif value != default:
            found.append(name)
    return frozenset(found)
