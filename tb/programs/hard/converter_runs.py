# SPDX-License-Identifier: Apache-2.0
"""Run hard duties and converters in each engine, whole gates, against the exact counts of
tb/reference/exact.py.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.chip import hdl
from dermis.converter import vfc
from dermis.engines import closed, cosim, event, rtl
from dermis.engines.certificate import certify
from dermis.records import Plan
from dermis.scene import scene
from tb.programs.hard.case import Measured
from tb.reference import exact

Floats = NDArray[np.float64]

COLS = 8
"""Columns of a chip of one row, so that few builds serve every case; duties fill its frames."""

GATE = 510

# A decision at clock n depends on n sums, each rounded by half an ulp of a charge below 2.
_SUMS = 2.0**-53
# The coefficients of a clock (exponentials and their integrals) are right to a few ulp each, and a
# whole gate of them to 1e-12 of a packet: tb/model/test_engines ties the loops to fifty digits
# with it.
_LOOPS = 1e-12
# spec.toml, cosim.edge_error_v: 1e-6 V where a packet is 0.1 V.
_SPICE = 1e-5


@dataclass(frozen=True)
class World:
    """Duties at the input of one kind of converter.

    Parameters
    ----------
    x : sequence of float
        Packets a clock; their binary values are exact.
    effects, interface : mapping
        As in a scene.
    gate : int
        Clocks.
    latch : bool
        The flip-flop + latch synchronizer: the packet begins half a clock after its decision.
    exactly : bool
        No margin for rounding: the arithmetic of this case is exact in doubles.
    """

    x: tuple[float, ...]
    effects: Mapping[str, Any] = field(default_factory=dict)
    interface: Mapping[str, Any] = field(default_factory=dict)
    gate: int = GATE
    latch: bool = False
    exactly: bool = False

    @property
    def late(self) -> float:
        """Clocks from a decision to its packet."""
        return 0.5 if self.latch else 1.0

    def margin(self, engine: str, x: float) -> float:
        """Return the rounding of an engine: largest distance of its levels from the exact ones, in
        packets.
        """
        if engine == "cosim":
            return _SPICE
        if self.exactly:
            return 0.0
        if self.effects:
            return _LOOPS
        reach = max(1.0, abs(x)) if np.isfinite(x) else 1.0
        # closed: N x and the difference to the start, an ulp of the larger; the loops: a sum a
        # clock.
        return (2.0 * self.gate if engine == "closed" else self.gate) * _SUMS * reach


def make_plan(world: World, engine: str, cols: int = COLS, rows: int = 1) -> tuple[Plan, Floats]:
    """Return a plan of open taxels, and the duties that replace them, [frames, rows, cols]."""
    frames = -(-len(world.x) // (rows * cols))
    data = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "uniform", "code": [0] * frames},
        "interface": dict(world.interface),
        "effects": {name: dict(value) for name, value in world.effects.items()},
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), engine)
    timing = dataclasses.replace(
        made.timing,
        gate_clocks=world.gate,
        slot_clocks=made.timing.settle_clocks + world.gate,
        charge_delay_clocks=world.late,
    )
    x = np.zeros(frames * rows * cols)
    x[: len(world.x)] = world.x
    return dataclasses.replace(made, timing=timing), x.reshape(frames, rows, cols)


# ---- engines -------------------------------------------------------------------------------------------------


def _closed(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "closed")
    return closed.codes_of(made, made.converter.gain * x)


def _event(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "event")
    return event.codes_of(made, x)


# Parameters of the Verilator build with all effects; an effect that is off has its neutral
# value. (DELAY has none: without it the comparator is sampled at the clock.)
_EVERY = ("PACKET", "W_PRESET", "RISE", "FALL", "W_LOW", "LEAK")


def _rtl(world: World, simulator: str) -> NDArray[Any]:
    made, x = make_plan(world, "rtl")
    bits = rtl.effect_bits(made)
    if bits and simulator == "verilator":
        bits |= sum(1 << rtl.value_places()[name] for name in _EVERY)
    return through_verilog(made, x, bits, simulator, world.latch)


def through_verilog(
    made: Plan, x: Floats, bits: int, simulator: str, latch: bool = False, instead: Sequence[Path] = ()
) -> NDArray[Any]:
    """Read codes of duties through the Verilog; `instead` has files that replace modules."""
    most = made.converter.drowning()
    currents = rtl.Currents(np.clip(x, -most, most)[..., np.newaxis], np.ones((1, 1)))
    with hdl.work_directory("rtl_runs", made, None) as files:
        command = rtl.build(made, bits, currents, simulator, latch, instead=instead)
        rtl.write_inputs(made, slice(0, made.frames), files, currents, bits, latch)
        return rtl.simulate(made, command, files, made.frames, lambda rows: None)


def resistances(x: Floats, unit_ohm: float) -> Floats:
    """Return resistances of duties; 0 is an open taxel."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.divide(unit_ohm, np.abs(x))


def _cosim(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "cosim", cols=min(4, len(world.x)))
    unit_ohm = made.v_bias_v / float(made.converter.k[0] * made.converter.i0_a[0])
    made = dataclasses.replace(made, resistance_ohm=resistances(x, unit_ohm), force_n=None)
    return cosim.run(made, sync_latch=world.latch).codes


ENGINES: dict[str, Callable[[World], NDArray[Any]]] = {
    "closed": _closed,
    "event": _event,
    "icarus": lambda world: _rtl(world, "icarus"),
    "verilator": lambda world: _rtl(world, "verilator"),
    "cosim": _cosim,
}

# Icarus takes 40 ms for eight duties: of longer lists every fifth, which is prime to the pairs and
# triples in them.
_MANY, _EVERY_SO_MANY = 200, 5


def codes(engine: str, world: World) -> Measured:
    """Return the largest error of an engine in codes outside the interval of the exact walk."""
    if engine == "icarus" and len(world.x) > _MANY:
        world = dataclasses.replace(world, x=world.x[::_EVERY_SO_MANY])
    begin = time.perf_counter()
    found = ENGINES[engine](world).reshape(-1)[: len(world.x)].astype(int)
    seconds = time.perf_counter() - begin
    worst, where, near = 0, "", 0
    full = 255
    for x, code in zip(world.x, found, strict=True):
        cell = exact.cell_of(x, world.effects, world.interface)
        low, high = exact.interval(cell, world.gate, world.late)
        if code != min(low, full):
            low, high = exact.interval(cell, world.gate, world.late, world.margin(engine, x))
            near += 1
        miss = max(min(low, full) - code, code - min(high, full), 0)
        if miss > worst:
            worst, where = miss, f"x = {x!r}: {code}, exactly {low}" + (f" to {high}" if high > low else "")
    said = [where] if where else []
    if near and not worst:
        said.append(f"{near} of {len(found)} within rounding of a level")
    return Measured(float(worst), "; ".join(said), seconds)


# ---- certificates --------------------------------------------------------------------------------------------


def certificate(world: World, margin: float) -> Measured:
    """Return the largest distance of exact codes, with levels anywhere within the margin, from the
    certified ones.
    """
    made, x = make_plan(world, "event")
    unit_ohm = made.v_bias_v / float(made.converter.k[0] * made.converter.i0_a[0])
    made = dataclasses.replace(made, resistance_ohm=resistances(x, unit_ohm), force_n=None, margin_lsb=margin)
    begin = time.perf_counter()
    result = certify(made, event.run(made))
    seconds = time.perf_counter() - begin
    assert result.low is not None
    assert result.high is not None
    worst, where, wide = 0, "", 0
    for x_one, low, high in zip(world.x, result.low.ravel(), result.high.ravel(), strict=False):
        cell = exact.cell_of(x_one, world.effects, world.interface)
        least, most = exact.interval(cell, world.gate, world.late, margin)
        miss = max(int(low) - least, min(most, 255) - int(high), 0)
        wide = max(wide, int(high) - int(low))
        if miss > worst:
            worst, where = miss, f"x = {x_one!r}: certified {low} to {high}, exactly {least} to {most}"
    return Measured(float(worst), where or f"at most {wide} codes wide", seconds)


# ---- long gates ----------------------------------------------------------------------------------------


def loop(cells: Mapping[str, Sequence[float]], clocks: int, late: float = 1.0) -> tuple[NDArray[Any], Floats]:
    """Return counts and charges of cells (fields of event.Cells; the others ideal) by the loops of
    engine event.
    """
    size = max(len(values) for values in cells.values())
    ideal = {"w0": -0.5, "packet": 1.0, "low": -np.inf, "high": np.inf}
    whole = {
        f.name: np.array(cells[f.name], dtype=float)
        if f.name in cells
        else np.full(size, ideal.get(f.name, 0.0))
        for f in dataclasses.fields(event.Cells)
    }
    return event.count_cells(event.Cells(**whole), clocks, late)


def many_clocks(engine: str, clocks: int, duties: Sequence[float]) -> Measured:
    """Return the largest error of the count, and of the remaining charge, after very many
    clocks.
    """
    begin = time.perf_counter()
    if engine == "closed":
        found, rest = vfc.count(np.array(duties), clocks), None
    else:
        found, rest = loop({"x": duties}, clocks)
    seconds = time.perf_counter() - begin
    worst = 0.0
    for i, x in enumerate(duties):
        ones, charge = exact.count_and_rest(x, clocks)
        worst = max(worst, float(abs(int(found[i]) - ones)))
        if rest is not None:
            # The packet of a one in the last two clocks is still in the integrator.
            away = abs(exact.Fraction(float(rest[i])) - charge)
            worst = max(worst, float(min(away, abs(away - 1))))
    return Measured(worst, f"{len(duties)} duties of {clocks:.0e} clocks", seconds)
