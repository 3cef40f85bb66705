# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the charge-balance converter: whole gates against exact arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import mpmath

from tb.programs.hard import converter_runs as runs
from tb.programs.hard.case import Case, Measured
from tb.programs.hard.converter_runs import GATE, World
from tb.reference import exact

_WALK = "walk through every clock in integers (tb.reference.exact.count), from x at its binary value"
_DIGITS = "walk through every clock in 50 digits (tb.reference.exact.cell_of), from the circuit's values"
_ROUNDING = (
    "a code is right or wrong; where a level lies within what an engine rounds (6e-14 packets in a gate of "
    "sums, 1e-12 with exponentials, ngspice 1e-5: spec.toml cosim.edge_error_v), both neighbours are right"
)
_EDGES = "edges in rationals (tb.reference.exact.plateau), counts by the recursion in 50 digits"

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
    why: str,
    expected: str,
    run: Mapping[str, Callable[[], Measured]],
    source: str,
    tolerance: str = _ROUNDING,
    refused: Mapping[str, str] | None = None,
    **other: Any,
) -> Case:
    """Return a case of a measurement; an engine without a run has its reason of `_NOT`."""
    reasons = {e: why for e, why in {**_NOT, **(refused or {})}.items() if e not in run}
    return Case(name, "converter", why, expected, run, source, tolerance, refused=reasons, **other)


def _gates(name: str, why: str, *worlds: World, engines: Sequence[str] = ALL, **other: Any) -> Case:
    """Return a case of the same duties in several engines."""
    run = {engine: partial(runs.codes, engine, *worlds) for engine in engines}
    source = _DIGITS if worlds[0].effects else _WALK
    return _case(name, why, other.pop("expected", "the count of the walk"), run, source, **other)


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


def _plateau_edges(leak: Mapping[str, Any], margin: float) -> tuple[float, ...]:
    """Return both edges of the plateaus of 1/2 and 1/3, inside and outside by a margin."""
    with mpmath.workdps(exact.DIGITS):
        of = exact.cell_of(0.0, leak, {})["leak"]
        keep = mpmath.exp(-mpmath.mpf(of.numerator) / of.denominator)
        rational = Fraction(int(mpmath.floor(keep * 2**160)), 2**160)
    edges = [edge for q in (2, 3) for edge in exact.plateau(1, q, rational)]
    return tuple(float(edge) * (1 + side * margin) for edge in edges for side in (-1, 1))


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
_FEMTO, _ATTO = 5e-9, 5e-12  # a femtosecond and an attosecond in clocks of 200 ns
_BILLION = 10**9
_LONG = (0.1, 123 / 510, 1 / 3, math.sqrt(2) / 3, 0.4999999999, 0.5)
_LEAK_100 = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 4e4}}
_TOGETHER = {
    "integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 1e5},
    "comparator_hysteresis": {"v_v": 0.3},
    "comparator_delay": {"t_s": 1.3e-8},
    "integrator_range": {"v_max_v": 0.7, "v_min_v": -0.6},
    "preset_error": {"v_v": 0.05},
}


def _of_duties() -> list[Case]:
    return [
        _gates(
            "zero_and_next_to_zero",
            "Zero, minus zero and subnormal current: a division by zero, or a charge that never leaves the preset.",
            World((0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-12), analog=(0.0, 1e-30, 1e-12)),
            short=True,
            expected="code 0",
        ),
        _gates(
            "one_half_and_its_neighbours",
            "The gating by the last bit starts here: it never acts one double below, and always one above.",
            World(_around([0.5])),
            short=True,
            expected="code 255 on all three",
        ),
        _gates(
            "one_half_in_an_odd_gate",
            "In 509 clocks one half starts with a one; the double below starts a clock later: 254, 255, 255.",
            World(_around([0.5]), gate=509, exactly=True),
            engines=("closed", "event", "icarus"),
        ),
        _gates(
            "full_current_and_far_above",
            "Charge grows by (2 x - 1) / 2 packets a clock, to infinity for a short: the sum loses the packet.",
            World(
                (*_around([1.0]), 1.5, 2.0, 1e3, 1e9, 1e15, 1e300, math.inf), analog=(1.0, 1.5, 1e3, math.inf)
            ),
            short=True,
            expected="code 255",
        ),
        _gates(
            "just_above_one_half",
            "The rate stays at one half while the charge drifts by 510 x 2^-53, a millionth, or a packet.",
            World((math.nextafter(0.5, 1), 0.5 + 1e-12, 0.5 + 1e-6, 0.5 + 1 / GATE, 0.51, 0.6)),
            expected="code 255",
        ),
        _gates(
            "every_code_and_its_neighbours",
            "c / 510 is not a double unless c divides: all 256 codes must return, on both sides too.",
            World(_around(EVERY_CODE), analog=EVERY_CODE[::5]),
            short=True,
            expected="code c on all three",
        ),
        _gates(
            "between_two_codes",
            "(c + 1/2) / 510 lies on the step, and its neighbours an ulp away: the hardest comparison.",
            World(_around([(c + 0.5) / GATE for c in range(255)])),
            engines=EXACT,
            expected="c or c + 1 by the binary value; both where a gate of sums rounds across the step",
        ),
        _gates(
            "a_billionth_of_a_code_beside_the_step",
            "A force 1e-12 from a step has its own code: unequal values must not compare as equal.",
            World(tuple((c + 0.5) / GATE * (1 + s * 2e-12) for c in range(255) for s in (-1, 1))),
            engines=EXACT,
            expected="c below and c + 1 above (c + 1/2) / 510",
        ),
        _gates(
            "current_that_flows_out",
            "A negative duty (offset current) removes charge all the time; a start above the level still counts.",
            World((-1e-9, -0.1, -0.5, -3.0, -1e12), {"preset_error": {"v_v": 3.25}}),
            engines=EXACT,
            refused={"cosim": "a resistance cannot draw a negative current"},
            expected="the number that the start provides",
        ),
        _gates(
            "shortest_gate_of_the_chip",
            "A gate of 32 clocks, the shortest in which the packer handles eight columns: exact to the clock.",
            World(tuple((c + d) / 32 for c in range(17) for d in (0.0, 0.49, -0.49)), gate=32),
            engines=("closed", "event", "icarus"),
            expected="round(32 x), every second clock above 1/2",
        ),
        _case(
            "two_windows_differ_by_one_at_most",
            "A Sturmian word: equal windows of one duty differ by at most one, at any phase.",
            "floor and ceiling of N x only",
            {"event": partial(runs.windows, 97, 40)},
            "Morse and Hedlund 1940, and the walk in rationals",
            refused=dict.fromkeys(("closed", "icarus", "verilator", "cosim"), "counts from the preset only"),
        ),
        _gates(
            "tie_on_every_clock_edge",
            "x = 2^-k brings the charge to the level exactly on an edge, repeatedly: equality counts as reached.",
            World(tuple(2.0**-k for k in range(1, 14)), analog=(0.5, 0.25, 0.125, 2.0**-9), exactly=True),
            short=True,
            expected="round half up of 510 x",
        ),
        _gates(
            "tie_before_the_first_clock",
            "The comparator's offset sets its level equal to the preset: without current it ties at every clock.",
            World((0.0, 1e-9, 0.25, 0.5), {"comparator_offset": {"v_v": -0.5}}, exactly=True),
            expected="the first clock has a one; with x = 0 it is the only one",
        ),
        _gates(
            "crossing_in_the_last_femtosecond",
            "The last one of a gate crosses 1 fs before or after the last edge: 5e-9 clocks, 1e-11 of the duty.",
            World(_crossings(range(1, 256, 2), _FEMTO)),
            engines=EXACT,
            expected="c before, c - 1 after",
        ),
        _gates(
            "crossing_in_the_last_attosecond",
            "The same with 1 as: 2.5e-13 packets at a duty of 0.05, where a gate rounds by 6e-14.",
            World(_crossings(range(27, 256, 2), _ATTO)),
            engines=EXACT,
            expected="c before, c - 1 after",
        ),
        _gates(
            "crossing_in_the_last_femtosecond_before_a_delayed_sample",
            "The comparator is sampled a delay before the edge, so the last femtosecond is in the middle of a clock.",
            World(_crossings(range(3, 256, 36), _FEMTO, 0.065), {"comparator_delay": {"t_s": 1.3e-8}}),
            engines=LOOPS[:-1],
            expected="c before, c - 1 after",
        ),
        _gates(
            "dip_of_one_picosecond",
            "With a latch the charge dips below a window for 1 ps between two samples, or just misses it.",
            World(_dips(0.1, 1e-12 * 5e6), {"comparator_hysteresis": {"v_v": 0.1}}, latch=True),
            engines=LOOPS[:-1],
            expected="the state of the window decides, not the sample",
        ),
        _gates(
            "asymptote_beside_the_level",
            "A leaky charge approaches x / leak and never exceeds it: the level is 1e-9 of it below or above.",
            _asymptote(1e-9),
            engines=LOOPS[:-1],
            expected="ones, or none at all",
        ),
    ]


def _of_leak() -> list[Case]:
    edges = _plateau_edges(_LEAK_100, margin=1e-9)
    found = [
        _case(
            f"locking_plateaus_{name}",
            f"A leaky integrator locks to every p/q over a plateau: {why}.",
            "p ones in every q clocks inside; the walk's count outside",
            {"event": partial(runs.locking, periods, keep, clocks, nudge)},
            _EDGES,
            tolerance,
            refused={"verilator": _NOT["icarus"], "cosim": _NOT["icarus"]},
            short=clocks < 10000,
        )
        for name, why, periods, keep, clocks, nudge, tolerance in (
            (
                "up_to_q_12",
                "1e-12 inside its edges the rate stands still, outside not",
                range(2, 13),
                Fraction(99, 100),
                12000,
                1e-12,
                "1e-12 of x is 1e-10 of charge behind a leak of 0.01 a clock; the loop forgets its rounding as fast",
            ),
            (
                "of_a_strong_leak",
                "half of the charge leaks each clock, they cover nearly every duty; those of q = 12 are 2e-4 wide",
                range(2, 13),
                Fraction(1, 2),
                2000,
                1e-12,
                "the loop forgets twice a clock",
            ),
            (
                "of_a_weak_leak",
                "one part in 1000 a clock, they are narrow, and the start matters for 30 000 clocks",
                (2, 3),
                Fraction(999, 1000),
                60000,
                1e-9,
                "1e-9 of x is 1e-6 of charge behind such a leak; the loop rounds by 1e-12",
            ),
        )
    ]
    return [
        *found,
        _gates(
            "plateau_one_half_in_a_gate",
            "A gate of 510 clocks at both edges of the plateaus of 1/2 and 1/3, where the preset still matters.",
            World(edges, _LEAK_100, analog=edges[:4]),
            engines=LOOPS,
            expected="the walk's count; 254 where the leak costs the first one",
        ),
        _gates(
            "leak_time_constants_1e_12_to_1e15_s",
            "A clock is 200 000 time constants, or 1e-22 of one: exp underflows, 1 - exp cancels.",
            *(_leak(10.0**n) for n in range(-12, 16)),
            engines=("event", "icarus"),
            expected="170 (every third clock) where a clock forgets all, up to the ideal code where nothing is lost",
        ),
        _gates(
            "output_that_follows_within_attoseconds",
            "A gain-bandwidth product of 1e18 Hz: two time constants 12 decades apart in one clock.",
            World(_FEW, {"integrator_bandwidth": {"gbw_hz": 1e18}}),
            engines=("event", "icarus"),
            expected="the ideal codes",
        ),
        _gates(
            "slow_output_that_never_catches_up",
            "At 10 kHz the output lags the charge by a hundred clocks and overshoots by as many packets.",
            World((0.1, 0.4999, 0.75), {"integrator_bandwidth": {"gbw_hz": 1e4}}, analog=(0.1,)),
            engines=("event", "icarus", "cosim"),
        ),
        _gates(
            "two_poles_as_near_as_they_get",
            "Leak and bandwidth with 1 / lag = across and a gain of 1: the two time constants are closest.",
            World(_FEW, _near_poles()),
            engines=("event", "icarus", "cosim"),
        ),
    ]


def _of_levels() -> list[Case]:
    window = {"comparator_hysteresis": {"v_v": 0.999999}}
    return [
        _gates(
            "hysteresis_of_nearly_a_packet",
            "The window is a packet less a millionth: each decision depends on its far edge.",
            World(_SOME, window, analog=(0.1, 1 / 3, 0.4999, 0.75)),
            engines=LOOPS,
        ),
        _case(
            "hysteresis_larger_than_a_packet",
            "A packet does not cross the window: the comparator latches up.",
            "the walk's count",
            {"event": partial(runs.cells, {"rise": 0.75, "fall": -0.75}, (0.0, 0.1, 0.3, 0.49, 0.75, 1.5))},
            _DIGITS,
            short=True,
        ),
        _gates(
            "comparator_delay_of_nearly_a_clock",
            "The comparator is sampled 0.2 fs after the previous edge: every decision is a clock old.",
            World(_SOME, {"comparator_delay": {"t_s": 2e-7 * (1 - 1e-9)}}, analog=_FEW),
            engines=LOOPS,
        ),
        _gates(
            "comparator_delay_of_next_to_nothing",
            "A delay of 1e-30 s: 1 - 5e-24 is 1 in doubles, and the sample must stay at the clock.",
            World(_SOME, {"comparator_delay": {"t_s": 1e-30}}, analog=_FEW),
            engines=LOOPS,
            expected="the ideal codes",
        ),
        _gates(
            "range_that_just_holds_the_preset",
            "The output saturates a millionth of a packet beyond the preset, a tenth on the other side.",
            World(_SOME, {"integrator_range": {"v_max_v": 0.500001, "v_min_v": -0.6}}, analog=_FEW),
            engines=LOOPS,
        ),
        _case(
            "range_smaller_than_a_packet",
            "Limits closer than the preset: charge is lost at both ends.",
            "the walk's count",
            {
                "event": partial(
                    runs.cells,
                    {"low": -0.3, "high": 0.3, "w0": -0.3},
                    (0.0, 0.1, 0.299, 0.3, 0.31, 0.5, 0.75, 1.5, 100.0),
                )
            },
            _DIGITS,
        ),
        _gates(
            "preset_far_above_the_level",
            "The integrator starts hundreds of packets above the level and counts them at every second clock.",
            World((0.0, 1e-9, 0.1, 0.25, 0.4999), {"preset_error": {"v_v": 100.25}}),
            engines=EXACT,
            refused={"cosim": "the integrator leaves the supplies of its deck"},
            expected="every second clock until they are used up, then the ideal",
        ),
        _gates(
            "packets_nearly_gone",
            "A packet of a thousandth saturates at once.",
            World(_SOME, {"charge_packet": {"packet_error": -0.999}}),
            engines=EXACT,
            refused={"cosim": "the integrator leaves the supplies of its deck"},
        ),
        _gates(
            "packets_nearly_doubled",
            "A packet of 1.999 ideal ones takes the charge far below the preset each time: half of the codes.",
            World(_SOME, {"charge_packet": {"packet_error": 0.999}}, analog=_FEW),
        ),
        _gates(
            "all_effects_at_once",
            "Leak, window, delay, range and preset error together: five kinds of interval in a clock.",
            World(_SOME, _TOGETHER, analog=_FEW),
            engines=LOOPS,
        ),
        _gates(
            "opposite_edge_latch",
            "The flip-flop + latch of Fig. 2 takes the packet half a clock earlier; every code stays the same.",
            World(EVERY_CODE, latch=True, analog=(2 / GATE, 0.1, 1 / 3, 0.5)),
            engines=("event", "icarus", "cosim"),
            short=True,
            expected="code c of x = c / 510",
        ),
        _gates(
            "ghost_behind_312_ohm",
            "x = 0.8 leaves 153 packets in its slot; the preset must remove all of them before the next row.",
            World((250 / 312,) * 8 + (2 / GATE,) * 8, rows=2, analog=(250 / 312,) * 2 + (2 / GATE,) * 2),
            engines=("closed", "event", "icarus", "cosim"),
            short=True,
            expected="255, then 2",
        ),
    ]


def _of_scale_and_time() -> list[Case]:
    decades = [{"i0_a": 10.0**n, "c_int_f": 10.0 ** (n - 6)} for n in range(-9, 1)]
    return [
        _gates(
            "reference_currents_of_the_range_of_scenes",
            "Packets of 2e-16 to 2e-7 C, down to a thousand electrons, where a simulator's abstol is 1e-12 A.",
            *(World((0.0, *_FEW), interface=decade, analog=_FEW) for decade in decades),
            expected="the ideal codes: only ratios count",
        ),
        _gates(
            "smallest_and_largest_mirror_ratio",
            "k = 20 and 160: the unit of resistance is 1000 and 125 ohm, whose last digit every taxel inherits.",
            *(World(EVERY_CODE[::3], interface={"k": k}, analog=_FEW) for k in (20, 160)),
            expected="the ideal codes",
        ),
        _gates(
            "counters_at_full_scale",
            "A gate of 2000 clocks gives 1000 ones to a counter of 8 bits and a spare one: it must saturate.",
            World((0.05, 0.1, 0.1275, 0.128, 0.2, 0.2555, 0.256, 0.3, 0.5, 0.75, 2.0), gate=2000),
            engines=("closed", "event", "icarus"),
            expected="min(255, count)",
        ),
        _case(
            "a_billion_clocks",
            "A sum of 10^9 duties without a short binary form: one rounding a clock is 5e-8 packets.",
            "floor(10^9 x + 1/2), with a remaining charge of -1/2 + 10^9 x less that",
            {
                "closed": partial(runs.many_clocks, "closed", _BILLION, _LONG),
                "event": partial(runs.many_clocks, "event", _BILLION, _LONG[:1]),
                "event_shorter": partial(runs.many_clocks, "event", _BILLION // 20, _LONG),
            },
            "the only count that leaves a charge in -1 .. 0, in rationals (exact.count_and_rest)",
            "the rounding of each sum is carried on, so the last two remain: twice half an ulp below 1, 2^-53",
            limit=2.0**-52,
            unit="packets",
        ),
        _case(
            "ripple_after_a_billion_frames",
            "The supply has rippled for 23 days: the phase in a slot is the remainder of 2e11 turns.",
            "the mean of 1 + r sin over the gate",
            {"event": partial(runs.ripple, _BILLION)},
            "phase in rationals from whole clocks, integral in 50 digits",
            "a sum of 510 sines rounds by 1e-13 of a duty of 0.2; a phase lost to time showed as 2e-8",
            limit=1e-13,
            unit="packets a clock",
            refused={"icarus": "reads the same currents as event"},
        ),
        _case(
            "jitter_of_a_tenth_of_a_clock",
            "The largest jitter allowed: 1.4 packets rms in a gate, samples a tenth of a clock early or late.",
            "mean and spread of the codes of a walk from edge to edge with its own random numbers",
            {"event": partial(runs.jitter, 2e-8)},
            "5120 such walks (converter_runs.jitter)",
            "five standard errors, exceeded by chance once in a million; the seeds are fixed",
            limit=5.0,
            unit="sigma",
            refused={"icarus": "draws no random numbers: event does"},
        ),
    ]


def cases() -> list[Case]:
    """Return every case of this module."""
    return [*_of_duties(), *_of_leak(), *_of_levels(), *_of_scale_and_time()]
