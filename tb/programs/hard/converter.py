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

ALL = ("closed", "event", "icarus", "verilator", "cosim")
EXACT = ALL[:-1]
LOOPS = ALL[1:]

_NOT = {
    "closed": "a formula of straight lines, without state inside a clock",
    "event": "runs in the Verilog alone",
    "icarus": "its inputs come from scenes, which do not go there",
    "verilator": "a build of 20 s for this alone; Icarus runs the same Verilog",
    "cosim": "ngspice places a crossing to 1e-5 packets, wider than this, or reads the same elsewhere",
}


def _case(
    name: str,
    run: Mapping[str, Callable[[], Measured]],
    short: bool = False,
    refused: Mapping[str, str] | None = None,
) -> Case:
    """Return a case of a measurement; an engine without a run has its reason of `_NOT`."""
    reasons = {e: why for e, why in {**_NOT, **(refused or {})}.items() if e not in run}
    return Case(name, "converter", run, short=short, refused=reasons)


def _gates(name: str, *worlds: World, engines: Sequence[str] = ALL, **other: Any) -> Case:
    """Return a case of the same duties in several engines: the count of the walk in integers or in 50
    digits.
    """
    return _case(name, {engine: partial(runs.codes, engine, *worlds) for engine in engines}, **other)


def _around(values: Sequence[float]) -> tuple[float, ...]:
    """Return each value with the next doubles below and above it."""
    return tuple(v for x in values for v in (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf)))


def _crossings(codes: Sequence[int], clocks: float, before: float = 0.0) -> tuple[float, ...]:
    """Return duties whose last one crosses the level `clocks` before and after the last sample."""
    return tuple((c - 0.5) / (GATE - before + side * clocks) for c in codes for side in (-1, 1))


def _dips(window: float, clocks: float) -> tuple[float, ...]:
    """Return duties whose charge, with a latch, dips below the lower level of a window for
    `clocks`, or misses it.

    The first one comes at clock 2 with the charge at 2 x - 1/2; its packet lasts from 2.5 to 3.5. There the charge is
    3.5 x - 3/2, and has been below a level that it passes by e for e / (1 - x) + e / x.
    """
    middle = (1.5 - window / 2) / 3.5
    by = clocks / (1 / (1 - middle) + 1 / middle)
    return tuple((1.5 - window / 2 + side * by) / 3.5 for side in (-1, 1))


def _asymptote(beside: float) -> World:
    """Return duties whose charge ends at a relative distance `beside` below and above the level,
    with a leak of 0.01 a clock.
    """
    effects = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 400.0}, "comparator_offset": {"v_v": 0.2}}
    cell = exact.cell_of(0.0, effects, {})
    level = cell["rise"] * cell["leak"]
    return World(tuple(float(level * (1 + Fraction(side * beside))) for side in (-1, 1)), effects)


def _leak(seconds: float) -> World:
    """Return a leak with a time constant R C (1 + A) at a gain of 1 and 5 pF."""
    return World((0.1, 1 / 3, 0.4999), {"integrator_gain": {"gain_dc": 1.0, "r_in_ohm": seconds / 1e-11}})


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


def cases() -> list[Case]:
    """Return every case of this module."""
    window = {"comparator_hysteresis": {"v_v": 0.999999}}
    decades = [{"i0_a": 10.0**n, "c_int_f": 10.0 ** (n - 6)} for n in range(-9, 1)]
    return [
        _gates(
            "zero_and_next_to_zero",
            World((0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-12), analog=(0.0, 1e-30, 1e-12)),
            short=True,
        ),
        _gates("one_half_and_its_neighbours", World(_around([0.5])), short=True),
        _gates(
            "one_half_in_an_odd_gate",
            World(_around([0.5]), gate=509, exactly=True),
            engines=("closed", "event", "icarus"),
        ),
        _gates(
            "full_current_and_far_above",
            World(
                (*_around([1.0]), 1.5, 2.0, 1e3, 1e9, 1e15, 1e300, math.inf), analog=(1.0, 1.5, 1e3, math.inf)
            ),
            short=True,
        ),
        _gates(
            "every_code_and_its_neighbours", World(_around(EVERY_CODE), analog=EVERY_CODE[::5]), short=True
        ),
        _gates("between_two_codes", World(_around([(c + 0.5) / GATE for c in range(255)])), engines=EXACT),
        _gates(
            "a_billionth_of_a_code_beside_the_step",
            World(tuple((c + 0.5) / GATE * (1 + s * 2e-12) for c in range(255) for s in (-1, 1))),
            engines=EXACT,
        ),
        _gates(
            "current_that_flows_out",
            World((-1e-9, -0.1, -0.5, -3.0, -1e12), {"preset_error": {"v_v": 3.25}}),
            engines=EXACT,
            refused={"cosim": "a resistance cannot draw a negative current"},
        ),
        _gates(
            "shortest_gate_of_the_chip",
            World(tuple((c + d) / 32 for c in range(17) for d in (0.0, 0.49, -0.49)), gate=32),
            engines=("closed", "event", "icarus"),
        ),
        _gates(
            "tie_on_every_clock_edge",
            World(tuple(2.0**-k for k in range(1, 14)), analog=(0.5, 0.25, 0.125, 2.0**-9), exactly=True),
            short=True,
        ),
        _gates(
            "crossing_in_the_last_femtosecond", World(_crossings(range(1, 256, 2), _FEMTO)), engines=EXACT
        ),
        _gates(
            "crossing_in_the_last_femtosecond_before_a_delayed_sample",
            World(_crossings(range(3, 256, 36), _FEMTO, 0.065), {"comparator_delay": {"t_s": 1.3e-8}}),
            engines=LOOPS[:-1],
        ),
        _gates(
            "dip_of_one_picosecond",
            World(_dips(0.1, 1e-12 * 5e6), {"comparator_hysteresis": {"v_v": 0.1}}, latch=True),
            engines=LOOPS[:-1],
        ),
        _gates("asymptote_beside_the_level", _asymptote(1e-9), engines=LOOPS[:-1]),
        _gates(
            "leak_time_constants_1e_12_to_1e15_s",
            *(_leak(10.0**n) for n in range(-12, 16)),
            engines=("event", "icarus"),
        ),
        _gates(
            "slow_output_that_never_catches_up",
            World((0.1, 0.4999, 0.75), {"integrator_bandwidth": {"gbw_hz": 1e4}}, analog=(0.1,)),
            engines=("event", "icarus", "cosim"),
        ),
        _gates(
            "two_poles_as_near_as_they_get", World(_FEW, _near_poles()), engines=("event", "icarus", "cosim")
        ),
        _gates(
            "hysteresis_of_nearly_a_packet",
            World(_SOME, window, analog=(0.1, 1 / 3, 0.4999, 0.75)),
            engines=LOOPS,
        ),
        _case(
            "hysteresis_larger_than_a_packet",
            {"event": partial(runs.cells, {"rise": 0.75, "fall": -0.75}, (0.0, 0.1, 0.3, 0.49, 0.75, 1.5))},
            short=True,
        ),
        _gates(
            "comparator_delay_of_nearly_a_clock",
            World(_SOME, {"comparator_delay": {"t_s": 2e-7 * (1 - 1e-9)}}, analog=_FEW),
            engines=LOOPS,
        ),
        _gates(
            "range_that_just_holds_the_preset",
            World(_SOME, {"integrator_range": {"v_max_v": 0.500001, "v_min_v": -0.6}}, analog=_FEW),
            engines=LOOPS,
        ),
        _gates(
            "preset_far_above_the_level",
            World((0.0, 1e-9, 0.1, 0.25, 0.4999), {"preset_error": {"v_v": 100.25}}),
            engines=EXACT,
            refused={"cosim": "the integrator leaves the supplies of its deck"},
        ),
        _gates(
            "packets_nearly_gone",
            World(_SOME, {"charge_packet": {"packet_error": -0.999}}),
            engines=EXACT,
            refused={"cosim": "the integrator leaves the supplies of its deck"},
        ),
        _gates("all_effects_at_once", World(_SOME, _TOGETHER, analog=_FEW), engines=LOOPS),
        _gates(
            "opposite_edge_latch",
            World(EVERY_CODE, latch=True, analog=(2 / GATE, 0.1, 1 / 3, 0.5)),
            engines=("event", "icarus", "cosim"),
            short=True,
        ),
        _gates(
            "ghost_behind_312_ohm",
            World((250 / 312,) * 8 + (2 / GATE,) * 8, rows=2, analog=(250 / 312,) * 2 + (2 / GATE,) * 2),
            engines=("closed", "event", "icarus", "cosim"),
            short=True,
        ),
        _gates(
            "reference_currents_of_the_range_of_scenes",
            *(World((0.0, *_FEW), interface=decade, analog=_FEW) for decade in decades),
        ),
        _gates(
            "counters_at_full_scale",
            World((0.05, 0.1, 0.1275, 0.128, 0.2, 0.2555, 0.256, 0.3, 0.5, 0.75, 2.0), gate=2000),
            engines=("closed", "event", "icarus"),
        ),
    ]
