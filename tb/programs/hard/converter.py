# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the charge-balance converter: whole gates against exact arithmetic."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from tb.programs.hard import converter_inputs, converter_runs
from tb.programs.hard.case import Case, Measured, case, texts
from tb.programs.hard.converter_runs import GATE, World

GROUP = "converter"

_WALK = "walk through every clock in integers (tb.reference.exact.count), from x at its binary value"
_DIGITS = "walk through every clock in 50 digits (tb.reference.exact.cell_of), from the circuit's values"
_ROUNDING = (
    "a code is right or wrong; where a level lies within what an engine rounds (a sum a clock, {0}), both "
    "neighbours are right"
)
_IDEAL = _ROUNDING.format("6e-14 packets in a gate; ngspice 1e-5 packets, spec.toml cosim.edge_error_v")
_BENT = _ROUNDING.format(
    "1e-12 packets with the exponentials of a clock; ngspice 1e-5 packets, spec.toml cosim.edge_error_v"
)
_SURE = "a code is right or wrong: no level is near, or the arithmetic is exact in doubles"
_TYPED = "0: an error names the key; 1: it does not"

_NO_LEAK = {"closed": "a formula of straight lines without state inside a clock, so no {0}"}
_LATER = {"verilator": "a build of 20 s for this alone; Icarus runs the same Verilog"}
_ANALOG = {"cosim": "ngspice places a crossing to 1e-5 packets, which is wider than this"}
_BELOW_SCENES = {
    "icarus": "its inputs come from scenes, which do not go there",
    "verilator": "its inputs come from scenes, which do not go there",
    "cosim": "its inputs come from scenes, which do not go there",
}

ALL = ("closed", "event", "icarus", "verilator", "cosim")
EXACT = ALL[:-1]
LOOPS = ("event", "icarus", "verilator", "cosim")


def _case(
    name: str,
    world: World,
    engines: Sequence[str],
    *,
    analog: World | None = None,
    certificate: float | None = None,
    limit_s: float = 10.0,
    **other: Any,
) -> Case:
    """Return a case with the same duties for every engine; `analog` has fewer of them for
    ngspice.
    """
    runs: dict[str, Callable[[], Measured]] = {
        engine: functools.partial(
            converter_runs.codes, engine, analog if engine == "cosim" and analog is not None else world
        )
        for engine in engines
    }
    if certificate is not None:
        runs["certificate"] = functools.partial(converter_runs.certificate, analog or world, certificate)
    text = texts().get(name, {})
    if "tolerance" not in text:
        other = {"tolerance": _BENT if world.effects else _IDEAL} | other
    if "source" not in text:
        other = {"source": _DIGITS if world.effects else _WALK} | other
    # ngspice, cocotb and Icarus start in 2.5 s on an idle machine, and in 10 s with seven other
    # runs.
    limit_s = max(limit_s, 30.0) if "cosim" in runs else limit_s
    return case(GROUP, name, runs, limit_s=limit_s, **other)


def _measured(name: str, runs: Mapping[str, Callable[[], Measured]], **other: Any) -> Case:
    if "tolerance" not in texts().get(name, {}):
        other = {"tolerance": _SURE} | other
    return case(GROUP, name, runs, **other)


def cases() -> list[Case]:
    """Return every case of this module."""
    return [
        *_of_duty(),
        *_of_ties(),
        *_of_leak(),
        *_of_levels(),
        *_of_scale(),
        *_of_time(),
        *_of_traps(),
        *_of_refusals(),
    ]


def prepare(chosen: Sequence[Case]) -> None:
    """Compile the loops and build the Verilog of the cases by one run of each engine except
    ngspice.
    """
    for one in chosen:
        for engine, run in one.runs.items():
            if engine not in ("event", "verilator") or not isinstance(run, functools.partial):
                continue
            if run.func is converter_runs.codes:
                converter_runs.ENGINES[engine](run.args[1])
            elif run.func is converter_inputs.locking:
                converter_inputs.locking((2,), Fraction(1, 2), 10, 0.1)
            elif run.func in (converter_inputs.ripple, converter_inputs.cells, converter_inputs.jitter):
                run()
            elif run.func is converter_runs.many_clocks:
                converter_runs.many_clocks(
                    "event", 10**5, (0.1,)
                )  # a gate of this length has a separate loop


# ---- duties --------------------------------------------------------------------------------------------------


def _around(values: Sequence[float]) -> tuple[float, ...]:
    """Return each value with the next doubles below and above it."""
    return tuple(v for x in values for v in (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf)))


EVERY_CODE = tuple(c / GATE for c in range(256))
_SOME = (0.0, 2 / GATE, 0.1, 1 / 3, 0.4999, 0.5, 0.75, 1.0)
_FEW = (2 / GATE, 0.1, 1 / 3, 0.4999)


def _of_duty() -> list[Case]:
    tiny = (0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-12)
    huge = (1.0, 1.5, 2.0, 1e3, 1e9, 1e15, 1e300, math.inf)
    one = 1 / GATE
    return [
        _case("zero_and_next_to_zero", World(tiny), ALL, analog=World((0.0, 1e-30, 1e-12)), short=True),
        _case("one_half_and_its_neighbours", World(_around([0.5])), ALL, certificate=1e-9, short=True),
        _case(
            "one_half_in_an_odd_gate",
            World(_around([0.5]), gate=509, exactly=True),
            ("closed", "event", "icarus"),
            tolerance=_SURE,
            refused=_ANALOG | _LATER,
        ),
        _case(
            "full_current_and_far_above",
            World(_around([1.0]) + huge),
            ALL,
            analog=World((1.0, 1.5, 1e3, math.inf)),
            certificate=1e-9,
            short=True,
        ),
        _case(
            "just_above_one_half",
            World((math.nextafter(0.5, 1), 0.5 + 1e-12, 0.5 + 1e-6, 0.5 + one, 0.51, 0.6)),
            ALL,
            analog=World((0.5 + 1e-6, 0.5 + one, 0.51, 0.6)),
        ),
        _case(
            "every_code_exactly",
            World(EVERY_CODE),
            ALL,
            analog=World(EVERY_CODE[::5]),
            short=True,
            limit_s=30.0,
        ),
        _case("every_code_and_its_neighbours", World(_around(EVERY_CODE)), EXACT, refused=_ANALOG),
        _case(
            "between_two_codes",
            World(_around([(c + 0.5) / GATE for c in range(255)])),
            EXACT,
            refused=_ANALOG,
        ),
        _case(
            "a_billionth_of_a_code_beside_the_step",
            World(tuple((c + 0.5) / GATE * (1 + s * 2e-12) for c in range(255) for s in (-1, 1))),
            EXACT,
            refused=_ANALOG,
            tolerance=_SURE,
        ),
        _case(
            "current_that_flows_out",
            World((-1e-9, -0.1, -0.5, -3.0, -1e12), {"preset_error": {"v_v": 3.25}}),
            ("closed", "event", "icarus", "verilator"),
            refused={"cosim": "a resistance cannot draw a negative current"},
        ),
        _case(
            "shortest_gate_of_the_chip",
            World(tuple((c + d) / 32 for c in range(17) for d in (0.0, 0.49, -0.49)), gate=32),
            ("closed", "event", "icarus"),
            refused=_LATER | {"cosim": "a gate of 510 gives the same at this accuracy"},
        ),
        _measured(
            "two_windows_differ_by_one_at_most",
            {"event": functools.partial(converter_inputs.windows, 97, 40)},
            refused={"closed": "counts from the preset only"}
            | dict.fromkeys(("icarus", "verilator", "cosim"), "every gate begins with the preset"),
        ),
    ]


def _of_ties() -> list[Case]:
    femto, atto = 1e-15 * 5e6, 1e-18 * 5e6

    def beside(clocks: float) -> tuple[float, ...]:
        """Return duties whose last one crosses the level `clocks` before and after the last edge of
        the gate.
        """
        return tuple((c - 0.5) / (GATE + side * clocks) for c in range(1, 256, 2) for side in (-1, 1))

    dips = converter_inputs.dips(0.1, 1e-12 * 5e6)
    return [
        _case(
            "tie_on_every_clock_edge",
            World(tuple(2.0**-k for k in range(1, 14)), exactly=True),
            ALL,
            tolerance=_SURE + "; ngspice 1e-5 packets either way",
            analog=World((0.5, 0.25, 0.125, 2.0**-9)),
            certificate=1e-9,
            short=True,
        ),
        _case(
            "tie_before_the_first_clock",
            World((0.0, 1e-9, 0.25, 0.5), {"comparator_offset": {"v_v": -0.5}}, exactly=True),
            ALL,
            tolerance=_SURE + "; ngspice 1e-5 packets either way",
        ),
        _case(
            "crossing_in_the_last_femtosecond", World(beside(femto)), EXACT, refused=_ANALOG, tolerance=_SURE
        ),
        _case(
            "crossing_in_the_last_attosecond",
            World(tuple(x for x in beside(atto) if x > 0.05)),
            EXACT,
            refused=_ANALOG,
        ),
        _case(
            "crossing_in_the_last_femtosecond_before_a_delayed_sample",
            World(
                tuple((c - 0.5) / (GATE - 0.065 + s * femto) for c in range(3, 256, 36) for s in (-1, 1)),
                {"comparator_delay": {"t_s": 1.3e-8}},
            ),
            ("event", "icarus", "verilator"),
            refused={"closed": _NO_LEAK["closed"].format("delay")} | _ANALOG,
        ),
        _case(
            "dip_of_one_picosecond",
            World(dips, {"comparator_hysteresis": {"v_v": 0.1}}, latch=True),
            ("event", "icarus", "verilator"),
            refused={"closed": _NO_LEAK["closed"].format("window")} | _ANALOG,
        ),
        _measured(
            "pulses_of_one_picosecond_at_the_synchronizer",
            {"icarus": functools.partial(converter_inputs.glitches, "dermis_sync_ff")},
            refused={
                "verilator": "two changes within a clock need an event simulator",
                "closed": "has no pulses, only counts",
                "event": "its comparator does not chatter",
                "cosim": "as event; its deck passes levels at clock edges only",
            },
        ),
        _case(
            "asymptote_beside_the_level",
            converter_inputs.asymptote(1e-9),
            ("event", "icarus", "verilator"),
            refused={"closed": _NO_LEAK["closed"].format("leak")} | _ANALOG,
        ),
    ]


# ---- leak and bandwidth --------------------------------------------------------------------------------------


def _of_leak() -> list[Case]:
    no_leak = {"closed": _NO_LEAK["closed"].format("leak")}
    leak = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 4e4}}
    found = []
    for q in range(2, 13):
        found.append(
            _measured(
                f"locking_plateau_q{q}",
                {"event": functools.partial(converter_inputs.locking, (q,), Fraction(99, 100), 12000, 1e-12)},
                why=f"A leaky integrator locks to every p/{q} over a plateau; 1e-12 inside its edges the rate "
                "stands still, outside not.",
                **texts()["locking_plateau"],
                refused=no_leak
                | {
                    "icarus": "12000 clocks of a plateau saturate the code; see plateau_one_half_in_a_gate",
                    "verilator": "as icarus",
                    "cosim": "as icarus",
                },
                short=q in (2, 5),
            )
        )
    edges = converter_inputs.plateau_edges(leak, margin=1e-9)
    return [
        *found,
        _measured(
            "locking_plateaus_of_a_strong_leak",
            {"event": functools.partial(converter_inputs.locking, range(2, 13), Fraction(1, 2), 2000, 1e-12)},
            refused=no_leak | _BELOW_SCENES,
        ),
        _measured(
            "locking_plateaus_of_a_weak_leak",
            {"event": functools.partial(converter_inputs.locking, (2, 3), Fraction(999, 1000), 60000, 1e-9)},
            refused=no_leak | _BELOW_SCENES,
            limit_s=30.0,
        ),
        _case(
            "plateau_one_half_in_a_gate",
            World(edges, leak),
            LOOPS,
            refused=no_leak,
            analog=World(edges[:4], leak),
            certificate=1e-6,
        ),
        _leaks("leak_time_constants_1e_12_to_1e_4_s", -12, -4),
        _leaks("leak_time_constants_1e_3_to_1e15_s", -3, 15),
        _case(
            "output_that_follows_within_attoseconds",
            World(_FEW, {"integrator_bandwidth": {"gbw_hz": 1e18}}),
            ("event", "icarus"),
            refused={"closed": _NO_LEAK["closed"].format("bandwidth")}
            | _LATER
            | {
                "cosim": (
                    "a pole of 1e18 Hz is below any step; slow_output_that_never_catches_up has one that "
                    "ngspice can resolve"
                )
            },
            limit_s=30.0,
        ),
        _case(
            "slow_output_that_never_catches_up",
            World((0.1, 0.4999, 0.75), {"integrator_bandwidth": {"gbw_hz": 1e4}}),
            ("event", "icarus", "cosim"),
            refused={"closed": _NO_LEAK["closed"].format("bandwidth")} | _LATER,
            analog=World((0.1,), {"integrator_bandwidth": {"gbw_hz": 1e4}}),
            certificate=1e-3,
            limit_s=30.0,
        ),
        _case(
            "two_poles_as_near_as_they_get",
            World(_FEW, converter_inputs.near_poles()),
            ("event", "icarus", "cosim"),
            refused=no_leak | _LATER,
            limit_s=30.0,
        ),
    ]


def _leaks(name: str, first: int, last: int) -> Case:
    return _measured(
        name,
        {e: functools.partial(converter_inputs.leaks, e, first, last) for e in ("event", "icarus")},
        source=_DIGITS,
        tolerance=_BENT,
        refused={"closed": _NO_LEAK["closed"].format("leak"), "cosim": "see plateau_one_half_in_a_gate"}
        | _LATER,
        limit_s=30.0,
    )


# ---- levels and ranges ---------------------------------------------------------------------------------------


def _of_levels() -> list[Case]:
    window = {"comparator_hysteresis": {"v_v": 0.999999}}
    late = {"comparator_delay": {"t_s": 2e-7 * (1 - 1e-9)}}
    early = {"comparator_delay": {"t_s": 1e-30}}
    tight = {"integrator_range": {"v_max_v": 0.500001, "v_min_v": -0.6}}
    together = {
        "integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 1e5},
        "comparator_hysteresis": {"v_v": 0.3},
        "comparator_delay": {"t_s": 1.3e-8},
        "integrator_range": {"v_max_v": 0.7, "v_min_v": -0.6},
        "preset_error": {"v_v": 0.05},
    }

    def no(what: str) -> dict[str, str]:
        return {"closed": _NO_LEAK["closed"].format(what)}

    return [
        _case(
            "hysteresis_of_nearly_a_packet",
            World(_SOME, window),
            LOOPS,
            refused=no("window"),
            analog=World((0.1, 1 / 3, 0.4999, 0.75), window),
        ),
        _measured(
            "hysteresis_larger_than_a_packet",
            {
                "scene": functools.partial(
                    converter_inputs.refused,
                    {"effects": {"comparator_hysteresis": {"v_v": 1.5}}},
                    "effects.comparator_hysteresis.v_v",
                ),
                "event": functools.partial(
                    converter_inputs.cells, {"rise": 0.75, "fall": -0.75}, (0.0, 0.1, 0.3, 0.49, 0.75, 1.5)
                ),
            },
            tolerance=_TYPED + "; " + _BENT,
            refused=_BELOW_SCENES,
            short=True,
        ),
        _case(
            "comparator_delay_of_nearly_a_clock",
            World(_SOME, late),
            LOOPS,
            refused=no("delay"),
            analog=World(_FEW, late),
        ),
        _case(
            "comparator_delay_of_next_to_nothing",
            World(_SOME, early),
            LOOPS,
            refused=no("delay"),
            analog=World(_FEW, early),
        ),
        _measured(
            "comparator_delay_of_a_clock_and_more",
            {
                f"scene_{word}": functools.partial(
                    converter_inputs.refused,
                    {"effects": {"comparator_delay": {"t_s": t_s}}},
                    "effects.comparator_delay.t_s",
                )
                for word, t_s in (("one_clock", 2e-7), ("two_clocks", 4e-7), ("a_second", 1.0))
            },
            tolerance=_TYPED,
            short=True,
        ),
        _case(
            "range_that_just_holds_the_preset",
            World(_SOME, tight),
            LOOPS,
            refused=no("range"),
            analog=World(_FEW, tight),
        ),
        _measured(
            "range_smaller_than_a_packet",
            {
                "scene": functools.partial(
                    converter_inputs.refused,
                    {"effects": {"integrator_range": {"v_max_v": 0.3, "v_min_v": -0.3}}},
                    "effects.integrator_range",
                ),
                "event": functools.partial(
                    converter_inputs.cells,
                    {"low": -0.3, "high": 0.3, "w0": -0.3},
                    (0.0, 0.1, 0.299, 0.3, 0.31, 0.5, 0.75, 1.5, 100.0),
                ),
            },
            tolerance=_TYPED + "; " + _BENT,
            refused=_BELOW_SCENES,
        ),
        _case(
            "preset_far_above_the_level",
            World((0.0, 1e-9, 0.1, 0.25, 0.4999), {"preset_error": {"v_v": 100.25}}),
            ("closed", "event", "icarus", "verilator"),
            refused={"cosim": "100 V on the integrator of a 3.3 V chip: the deck's supplies hold it"},
        ),
        _case(
            "packets_nearly_gone_and_nearly_doubled",
            World(_SOME, {"charge_packet": {"packet_error": -0.999}}),
            ("closed", "event", "icarus", "verilator"),
            refused={"cosim": "the integrator leaves its supplies; see packets_nearly_doubled"},
        ),
        _case(
            "packets_nearly_doubled",
            World(_SOME, {"charge_packet": {"packet_error": 0.999}}),
            ALL,
            analog=World(_FEW, {"charge_packet": {"packet_error": 0.999}}),
        ),
        _case(
            "all_effects_at_once",
            World(_SOME, together),
            ("event", "icarus", "verilator", "cosim"),
            refused=no("leak, window, delay or range"),
            analog=World(_FEW, together),
            certificate=1e-6,
        ),
        _case(
            "opposite_edge_latch",
            World(EVERY_CODE, latch=True),
            ("event", "icarus", "cosim"),
            refused={"closed": "has no charge delay: the same formula"} | _LATER,
            analog=World((2 / GATE, 0.1, 1 / 3, 0.5), latch=True),
            short=True,
        ),
    ]


# ---- scale ---------------------------------------------------------------------------------------------------


def _of_scale() -> list[Case]:
    slow = 1e-9 / 5e6
    return [
        _measured(
            "packets_of_1e_21_to_1e_9_coulomb",
            {e: functools.partial(converter_inputs.packets, e) for e in ("closed", "event", "icarus")},
            refused=_LATER | {"cosim": "see packets_of_the_range_of_scenes"},
            short=True,
        ),
        _case(
            "packets_of_the_range_of_scenes",
            World((0.0, *_FEW), interface={"i0_a": 1e-9, "c_int_f": 1e-15}),
            ALL,
            why=f"The lowest reference current that a scene may have: packets of {slow:.0e} C, where a "
            "simulator's abstol is 1e-12 A.",
            analog=World(_FEW, interface={"i0_a": 1e-9, "c_int_f": 1e-15}),
        ),
        _case(
            "largest_reference_current",
            World((0.0, *_FEW), interface={"i0_a": 1.0, "c_int_f": 1e-6}),
            ALL,
            analog=World(_FEW, interface={"i0_a": 1.0, "c_int_f": 1e-6}),
        ),
        *(
            _case(
                f"{word}_mirror_ratio",
                World(EVERY_CODE[::3], interface={"k": k}),
                ALL,
                analog=World(_FEW, interface={"k": k}),
            )
            for word, k in (("smallest", 20), ("largest", 160))
        ),
        _case(
            "counters_at_full_scale",
            World((0.05, 0.1, 0.1275, 0.128, 0.2, 0.2555, 0.256, 0.3, 0.5, 0.75, 2.0), gate=2000),
            ("closed", "event", "icarus"),
            refused=_LATER
            | {"cosim": "the counter is the same Verilog; four gates of ngspice would show no more"},
        ),
    ]


# ---- time ----------------------------------------------------------------------------------------------------


def _of_time() -> list[Case]:
    duties = (0.1, 123 / 510, 1 / 3, math.sqrt(2) / 3, 0.4999999999, 0.5)
    billion = 10**9
    return [
        _measured(
            "a_billion_clocks",
            {
                "closed": functools.partial(converter_runs.many_clocks, "closed", billion, duties),
                "event": functools.partial(converter_runs.many_clocks, "event", billion, duties[:1]),
                "event_shorter": functools.partial(
                    converter_runs.many_clocks, "event", billion // 20, duties
                ),
            },
            limit=2.0**-52,
            unit="packets",
            refused=_BELOW_SCENES,
        ),
        _measured(
            "ripple_after_a_billion_frames",
            {"event": functools.partial(converter_inputs.ripple, billion)},
            limit=1e-13,
            unit="packets a clock",
            refused={
                "closed": _NO_LEAK["closed"].format("ripple"),
                "icarus": "reads the same currents as event",
                "verilator": "as icarus",
                "cosim": "a run of ngspice begins with its first frame",
            },
        ),
        _measured(
            "jitter_of_a_clock_and_more",
            {
                f"scene_{word}": functools.partial(
                    converter_inputs.refused,
                    {"effects": {"clock_jitter": {"t_s": t_s}}},
                    "effects.clock_jitter.t_s",
                )
                for word, t_s in (("three_clocks", 6e-7), ("a_clock", 2e-7), ("just_above", 2.0001e-8))
            },
            tolerance=_TYPED,
            short=True,
        ),
        _measured(
            "jitter_of_a_tenth_of_a_clock",
            {"event": functools.partial(converter_inputs.jitter, 2e-8)},
            limit=5.0,
            unit="sigma",
            refused={"closed": _NO_LEAK["closed"].format("jitter")}
            | dict.fromkeys(("icarus", "verilator", "cosim"), "draws no random numbers: event does"),
        ),
    ]


# ---- traps ---------------------------------------------------------------------------------------------------


def _of_traps() -> list[Case]:
    same = {
        "verilator": "a build of 20 s for this alone; tb/rtl/traps has both simulators",
        "cosim": "as verilator",
    }
    return [
        _measured(
            "ghost_behind_312_ohm_with_preset",
            {e: functools.partial(converter_inputs.ghost, e) for e in ALL},
            short=True,
        ),
        _measured(
            "ghost_behind_312_ohm_without_preset",
            {e: functools.partial(converter_inputs.ghost_unpreset, e) for e in ("closed", "event", "icarus")},
            refused=same,
        ),
        *(
            _measured(
                name,
                {"icarus": functools.partial(converter_inputs.trap, trap)},
                refused={"closed": "knows the right synchronizer only", "event": "as closed"} | same,
            )
            for name, trap in (
                ("synchronizer_gated_by_its_second_flop", "sync_second_qbar"),
                ("synchronizer_gated_by_both_flops", "sync_both_qbar"),
            )
        ),
    ]


# ---- refusals ------------------------------------------------------------------------------------------------


def _of_refusals() -> list[Case]:
    return [
        _measured(
            "every_number_of_a_scene_as_nan_and_infinity",
            {"scene": converter_inputs.every_number_refused},
            tolerance=_TYPED,
            unit="keys let through",
            limit_s=30.0,
        ),
        _measured(
            "resistances_that_are_none",
            {"scene": converter_inputs.bad_resistances},
            tolerance=_TYPED,
            unit="let through",
            short=True,
        ),
        _measured(
            "duty_that_is_no_number",
            {"closed": converter_inputs.nan_duty},
            tolerance=_TYPED,
            unit="let through",
            short=True,
            refused=dict.fromkeys(
                ("event", "icarus", "verilator", "cosim"),
                "its duties come from currents, which are checked where they are solved",
            ),
        ),
    ]
