# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the charge-balance converter: whole gates against exact arithmetic.

A code is right or wrong; where a level lies within what an engine rounds (6e-14 packets in a gate of
sums, 1e-12 with exponentials, ngspice 1e-5: spec.toml cosim.edge_error_v), both neighbours are right.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.chip import hdl
from dermis.converter import walk
from dermis.converter.coupling import on_columns
from dermis.engines import closed, cosim, rtl
from dermis.ndarrays import Floats
from dermis.records import Plan
from tb.programs.hard.case import Case, Measured
from tb.reference import exact, scenes

COLS = 8
"""Columns of a chip of one row, so that few builds serve every case; duties fill its frames."""

GATE, FULL = 510, 255
ALL = ("closed", "event", "icarus", "verilator", "cosim")

# A decision at clock n depends on n sums, each rounded by half an ulp of a charge below 2.
_SUMS = 2.0**-53
# The coefficients of a clock (exponentials and their integrals) are right to a few ulp each, and a
# whole gate of them to 1e-12 of a packet.
_LOOPS = 1e-12
# spec.toml, cosim.edge_error_v: 1e-6 V where a packet is 0.1 V.
_SPICE = 1e-5


@dataclass(frozen=True)
class World:
    """Duties at the input of one kind of converter.

    Attributes
    ----------
    x : packets a clock; their binary values are exact
    effects, interface : as in a scene
    analog : fewer duties for ngspice; default all
    gate, rows : clocks; rows of the chip
    latch : the flip-flop + latch synchronizer: a packet begins half a clock after its decision
    exactly : no margin for rounding: the arithmetic of this case is exact in doubles
    engines, short : engines that run it; part of the short set
    """

    x: tuple[float, ...]
    effects: Mapping[str, Any] = field(default_factory=dict)
    interface: Mapping[str, Any] = field(default_factory=dict)
    analog: tuple[float, ...] = ()
    gate: int = GATE
    rows: int = 1
    latch: bool = False
    exactly: bool = False
    engines: tuple[str, ...] = ALL
    short: bool = False

    @property
    def late(self) -> float:
        """Clocks from a decision to its packet."""
        return 0.5 if self.latch else 1.0

    def margin(self, engine: str, x: float) -> float:
        """Return the largest distance of an engine's levels from the exact ones, in packets."""
        if engine == "cosim":
            return _SPICE
        if self.exactly:
            return 0.0
        if self.effects:
            return _LOOPS
        reach = max(1.0, abs(x)) if np.isfinite(x) else 1.0
        # closed: N x and the difference to the start, an ulp of the larger; loops: a sum a clock.
        return (2.0 * self.gate if engine == "closed" else self.gate) * _SUMS * reach


def make_plan(world: World, engine: str, cols: int = COLS) -> tuple[Plan, Floats]:
    """Return a plan of open taxels, and the duties that replace them, [frames, rows, cols]."""
    frames = -(-len(world.x) // (world.rows * cols))
    open_ohm = np.full((frames, world.rows, cols), np.inf)
    made = plan.make(scenes.of_resistances(open_ohm, dict(world.effects), dict(world.interface)), engine)
    timing = dataclasses.replace(
        made.timing,
        gate_clocks=world.gate,
        slot_clocks=made.timing.settle_clocks + world.gate,
        charge_delay_clocks=world.late,
    )
    x = np.zeros(open_ohm.shape)
    x.flat[: len(world.x)] = world.x
    return dataclasses.replace(made, timing=timing), x


def _closed(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "closed")
    return closed.codes_of(made, made.converter.gain * x)


def _event(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "event")
    cells = walk.cells_of(made, made.converter.gain * x, on_columns(made.conductance_s()))
    counts, _ = walk.count_cells(cells, made.timing.gate_clocks, made.timing.charge_delay_clocks)
    return np.minimum(counts, made.timing.code_max)


# Parameters of the Verilator build with all effects; one that is off has its neutral value. DELAY has none.
_EVERY = ("PACKET", "W_PRESET", "RISE", "FALL", "W_LOW", "LEAK")


def _rtl(world: World, simulator: str) -> NDArray[Any]:
    made, x = make_plan(world, "rtl")
    bits = rtl.effect_bits(made)
    if bits and simulator == "verilator":
        bits |= sum(1 << rtl.value_places()[name] for name in _EVERY)
    most = made.converter.saturating_duty()
    currents = rtl.Currents(np.clip(x, -most, most)[..., np.newaxis], np.ones((1, 1)))
    with hdl.work_directory("rtl_runs", made, None) as files:
        command = rtl.build(made, bits, currents, simulator, world.latch)
        rtl.write_inputs(made, slice(0, made.frames), files, currents, bits, world.latch)
        return rtl.simulate(made, command, files, made.frames, lambda rows: None)


def _cosim(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "cosim", cols=min(4, len(world.x) // world.rows))
    unit_ohm = made.v_bias_v / float(made.converter.k[0] * made.converter.i0_a[0])
    with np.errstate(divide="ignore", over="ignore"):
        made = dataclasses.replace(made, resistance_ohm=np.divide(unit_ohm, np.abs(x)))
    return cosim.run(made, sync_latch=world.latch).codes


ENGINES: dict[str, Callable[[World], NDArray[Any]]] = {
    "closed": _closed,
    "event": _event,
    "icarus": lambda world: _rtl(world, "icarus"),
    "verilator": lambda world: _rtl(world, "verilator"),
    "cosim": _cosim,
}

# Icarus takes 40 ms for eight duties: of longer lists every fifth, prime to their pairs and triples.
_MANY, _EVERY_SO_MANY = 200, 5


def codes(engine: str, *worlds: World) -> Measured:
    """Return the largest error of an engine in codes; ngspice takes the first and the last world."""
    worst, where, near = 0, "", 0
    for world in (worlds[0], *worlds[1:][-1:]) if engine == "cosim" else worlds:
        if engine == "icarus" and len(world.x) > _MANY:
            world = dataclasses.replace(world, x=world.x[::_EVERY_SO_MANY])
        if engine == "cosim" and world.analog:
            world = dataclasses.replace(world, x=world.analog)
        found = ENGINES[engine](world).reshape(-1)[: len(world.x)].astype(int)
        for x, code in zip(world.x, found, strict=True):
            cell = exact.cell_of(x, world.effects, world.interface)
            low, high = exact.interval(cell, world.gate, world.late)
            if code != min(low, FULL):
                low, high = exact.interval(cell, world.gate, world.late, world.margin(engine, x))
                near += 1
            miss = max(min(low, FULL) - code, code - min(high, FULL), 0)
            if miss > worst:
                to = f" to {high}" if high > low else ""
                worst, where = miss, f"x = {x!r}: {code}, exactly {low}{to}"
    return Measured(float(worst), where or (f"{near} within rounding of a level" if near else ""))


def cells(fields: Mapping[str, float], duties: Sequence[float]) -> Measured:
    """Compare counts of converters given in packets and clocks with the walk in fifty digits."""
    given = exact.IDEAL | fields | {"x": duties}
    whole = {name: np.array(np.broadcast_to(value, len(duties)), float) for name, value in given.items()}
    found, _ = walk.count_cells(walk.Cells(**whole), GATE, 1.0)
    expected = [exact.interval({**exact.IDEAL, **fields, "x": Fraction(x)}, GATE)[0] for x in duties]
    return Measured(float(np.abs(found - expected).max()), f"{found.tolist()}, exactly {expected}")


EXACT = ALL[:-1]
LOOPS = ALL[1:]

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


def _leak(seconds: float) -> World:
    """Return a leak with a time constant R C (1 + A) at a gain of 1 and 5 pF."""
    effects = {"integrator_gain": {"gain_dc": 1.0, "r_in_ohm": seconds / 1e-11}}
    return World((0.1, 1 / 3, 0.4999), effects, engines=("event", "icarus"))


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
    no_ngspice, slow = ("closed", "event", "icarus"), ("event", "icarus", "cosim")
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
        "leak_time_constants_1e_12_to_1e15_s": [_leak(10.0**n) for n in range(-12, 16)],
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
        run = {engine: partial(codes, engine, *worlds) for engine in worlds[0].engines}
        found.append(case(name, run, worlds[0].short))
    wide = partial(cells, {"rise": 0.75, "fall": -0.75}, (0.0, 0.1, 0.3, 0.49, 0.75, 1.5))
    return [*found, case("hysteresis_larger_than_a_packet", {"event": wide}, True)]
