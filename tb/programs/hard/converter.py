# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the charge-balance converter: whole gates against exact arithmetic.

A code is right or wrong; where a level lies within what an engine rounds (6e-14 packets in a gate of
sums, 1e-12 with exponentials, ngspice 1e-5: spec.toml cosim.edge_error_v), both neighbours are right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from tb.programs.hard import converter_runs as runs
from tb.programs.hard.case import Case, Measured
from tb.programs.hard.converter_runs import GATE, World
from tb.reference import exact

EXACT = runs.ALL[:-1]
LOOPS = runs.ALL[1:]

_NOT = {
    "closed": "a formula of straight lines, without state inside a clock",
    "event": "runs in the Verilog alone",
    "icarus": "its inputs come from scenes, which do not go there",
    "verilator": "a build of 20 s for this alone; Icarus runs the same Verilog",
    "cosim": "ngspice places a crossing to 1e-5 packets, wider than this, or reads the same elsewhere",
}


def _around(values: Sequence[float]) -> tuple[float, ...]:
    """Return each value with the next doubles below and above it."""
    return tuple(v for x in values for v in (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf)))


def _crossings(codes: Sequence[int], clocks: float, before: float = 0.0) -> tuple[float, ...]:
    """Return duties whose last one crosses the level `clocks` before and after the last sample."""
    return tuple((c - 0.5) / (GATE - before + side * clocks) for c in codes for side in (-1, 1))


def _dips(window: float, clocks: float) -> tuple[float, ...]:
    """Return duties whose charge, with a latch, dips below a window for `clocks`, or misses it.

    The first one comes at clock 2 with the charge at 2 x - 1/2; its packet lasts from 2.5 to 3.5. There the charge is
    3.5 x - 3/2, and has been below a level that it passes by e for e / (1 - x) + e / x.
    """
    middle = (1.5 - window / 2) / 3.5
    by = clocks / (1 / (1 - middle) + 1 / middle)
    return tuple((1.5 - window / 2 + side * by) / 3.5 for side in (-1, 1))


def _asymptote(beside: float) -> World:
    """Return duties whose charge ends `beside` of a level below and above it, with a leak of 0.01."""
    effects = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 400.0}, "comparator_offset": {"v_v": 0.2}}
    cell = exact.cell_of(0.0, effects, {})
    level = cell["rise"] * cell["leak"]
    duties = tuple(float(level * (1 + Fraction(side * beside))) for side in (-1, 1))
    return World(duties, effects, engines=LOOPS[:-1])


def _leak(seconds: float, engines: tuple[str, ...]) -> World:
    """Return a leak with a time constant R C (1 + A) at a gain of 1 and 5 pF."""
    effects = {"integrator_gain": {"gain_dc": 1.0, "r_in_ohm": seconds / 1e-11}}
    return World((0.1, 1 / 3, 0.4999), effects, engines=engines)


def _near_poles() -> dict[str, Any]:
    """Return leak and bandwidth with the closest time constants: lag across = 1 at a gain of 1."""
    gbw_hz, share, f_clk_hz, c_int_f = 1e6, 0.5, 5e6, 5e-12
    lag = share * f_clk_hz / (2 * math.pi * gbw_hz)
    return {
        "integrator_gain": {"gain_dc": 1.0, "r_in_ohm": lag / (c_int_f * f_clk_hz)},
        "integrator_bandwidth": {"gbw_hz": gbw_hz},
    }


EVERY_CODE = tuple(c / GATE for c in range(256))
_SOME = (0.0, 2 / GATE, 0.1, 1 / 3, 0.4999, 0.5, 0.75, 1.0)
_FEW = (2 / GATE, 0.1, 1 / 3, 0.4999)
_FEMTO = 5e-9  # a femtosecond in clocks of 200 ns
_TOGETHER = {
    "integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 1e5},
    "comparator_hysteresis": {"v_v": 0.3},
    "comparator_delay": {"t_s": 1.3e-8},
    "integrator_range": {"v_max_v": 0.7, "v_min_v": -0.6},
    "preset_error": {"v_v": 0.05},
}


_SUPPLIES = "the integrator leaves the supplies of its deck"
_REFUSED = {
    "current_that_flows_out": {"cosim": "a resistance cannot draw a negative current"},
    "preset_far_above_the_level": {"cosim": _SUPPLIES},
    "packets_nearly_gone": {"cosim": _SUPPLIES},
}
"""Reasons of a case in place of those in `_NOT`."""


def _worlds() -> dict[str, World | list[World]]:
    """Return the duties of each case, counted by the walk in integers or in 50 digits."""
    far = (*_around([1.0]), 1.5, 2.0, 1e3, 1e9, 1e15, 1e300, math.inf)
    beside_steps = tuple((c + 0.5) / GATE * (1 + s * 2e-12) for c in range(255) for s in (-1, 1))
    delay, nearly_a_clock = ({"comparator_delay": {"t_s": t}} for t in (1.3e-8, 2e-7 * (1 - 1e-9)))
    window, wide_window = ({"comparator_hysteresis": {"v_v": v}} for v in (0.1, 0.999999))
    late_crossings = _crossings(range(3, 256, 36), _FEMTO, 0.065)
    ends = {"integrator_range": {"v_max_v": 0.500001, "v_min_v": -0.6}}
    counters = (0.05, 0.1, 0.1275, 0.128, 0.2, 0.2555, 0.256, 0.3, 0.5, 0.75, 2.0)
    decades = [{"i0_a": 10.0**n, "c_int_f": 10.0 ** (n - 6)} for n in range(-9, 1)]
    no_ngspice, icarus, slow = (
        ("closed", "event", "icarus"),
        ("event", "icarus"),
        ("event", "icarus", "cosim"),
    )
    return {
        "zero_and_next_to_zero": World(
            (0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-12), analog=(0.0, 1e-30, 1e-12), short=True
        ),
        "one_half_and_its_neighbours": World(_around([0.5]), short=True),
        "one_half_in_an_odd_gate": World(_around([0.5]), gate=509, exactly=True, engines=no_ngspice),
        "full_current_and_far_above": World(far, analog=(1.0, 1.5, 1e3, math.inf), short=True),
        "every_code_and_its_neighbours": World(_around(EVERY_CODE), analog=EVERY_CODE[::5], short=True),
        "between_two_codes": World(_around([(c + 0.5) / GATE for c in range(255)]), engines=EXACT),
        "a_billionth_of_a_code_beside_the_step": World(beside_steps, engines=EXACT),
        "current_that_flows_out": World(
            (-1e-9, -0.1, -0.5, -3.0, -1e12), {"preset_error": {"v_v": 3.25}}, engines=EXACT
        ),
        "shortest_gate_of_the_chip": World(
            tuple((c + d) / 32 for c in range(17) for d in (0.0, 0.49, -0.49)), gate=32, engines=no_ngspice
        ),
        "tie_on_every_clock_edge": World(
            tuple(2.0**-k for k in range(1, 14)), analog=(0.5, 0.25, 0.125, 2.0**-9), exactly=True, short=True
        ),
        "crossing_in_the_last_femtosecond": World(_crossings(range(1, 256, 2), _FEMTO), engines=EXACT),
        "crossing_in_the_last_femtosecond_before_a_delayed_sample": World(
            late_crossings, delay, engines=LOOPS[:-1]
        ),
        "dip_of_one_picosecond": World(_dips(0.1, 1e-12 * 5e6), window, latch=True, engines=LOOPS[:-1]),
        "asymptote_beside_the_level": _asymptote(1e-9),
        "leak_time_constants_1e_12_to_1e15_s": [_leak(10.0**n, icarus) for n in range(-12, 16)],
        "slow_output_that_never_catches_up": World(
            (0.1, 0.4999, 0.75), {"integrator_bandwidth": {"gbw_hz": 1e4}}, analog=(0.1,), engines=slow
        ),
        "two_poles_as_near_as_they_get": World(_FEW, _near_poles(), engines=slow),
        "hysteresis_of_nearly_a_packet": World(
            _SOME, wide_window, analog=(0.1, 1 / 3, 0.4999, 0.75), engines=LOOPS
        ),
        "comparator_delay_of_nearly_a_clock": World(_SOME, nearly_a_clock, analog=_FEW, engines=LOOPS),
        "range_that_just_holds_the_preset": World(_SOME, ends, analog=_FEW, engines=LOOPS),
        "preset_far_above_the_level": World(
            (0.0, 1e-9, 0.1, 0.25, 0.4999), {"preset_error": {"v_v": 100.25}}, engines=EXACT
        ),
        "packets_nearly_gone": World(_SOME, {"charge_packet": {"packet_error": -0.999}}, engines=EXACT),
        "all_effects_at_once": World(_SOME, _TOGETHER, analog=_FEW, engines=LOOPS),
        "opposite_edge_latch": World(
            EVERY_CODE, latch=True, analog=(2 / GATE, 0.1, 1 / 3, 0.5), engines=slow, short=True
        ),
        "ghost_behind_312_ohm": World(
            (250 / 312,) * 8 + (2 / GATE,) * 8,
            rows=2,
            analog=(250 / 312,) * 2 + (2 / GATE,) * 2,
            engines=(*no_ngspice, "cosim"),
            short=True,
        ),
        "reference_currents_of_the_range_of_scenes": [
            World((0.0, *_FEW), interface=decade, analog=_FEW) for decade in decades
        ],
        "counters_at_full_scale": World(counters, gate=2000, engines=no_ngspice),
    }


def cases() -> list[Case]:
    """Return every case of this module; an engine that does not run one has its reason."""

    def case(name: str, run: Mapping[str, Callable[[], Measured]], short: bool) -> Case:
        reasons = {e: why for e, why in (_NOT | _REFUSED.get(name, {})).items() if e not in run}
        return Case(name, "converter", run, short=short, refused=reasons)

    found = []
    for name, worlds in _worlds().items():
        worlds = worlds if isinstance(worlds, list) else [worlds]
        run = {engine: partial(runs.codes, engine, *worlds) for engine in worlds[0].engines}
        found.append(case(name, run, worlds[0].short))
    wide = partial(runs.cells, {"rise": 0.75, "fall": -0.75}, (0.0, 0.1, 0.3, 0.49, 0.75, 1.5))
    return [*found, case("hysteresis_larger_than_a_packet", {"event": wide}, True)]
