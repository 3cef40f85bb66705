# SPDX-License-Identifier: Apache-2.0
"""Run hard duties and converters in each engine, whole gates, against tb/reference/exact.py."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.chip import hdl
from dermis.converter import walk
from dermis.engines import closed, cosim, rtl
from dermis.records import Plan
from dermis.scene import scene
from tb.programs.hard.case import Measured
from tb.reference import exact

Floats = NDArray[np.float64]

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
    data = {
        "array": {"rows": world.rows, "cols": cols},
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
    x = np.zeros(frames * world.rows * cols)
    x[: len(world.x)] = world.x
    return dataclasses.replace(made, timing=timing), x.reshape(frames, world.rows, cols)


# ---- engines -------------------------------------------------------------------------------------------------


def _closed(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "closed")
    return closed.codes_of(made, made.converter.gain * x)


def _event(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "event")
    cells = walk.cells_of(made, made.converter.gain * x, made.conductance_s())
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
        made = dataclasses.replace(made, resistance_ohm=np.divide(unit_ohm, np.abs(x)), force_n=None)
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


# ---- converters below scenes, long gates -------------------------------------------------------------------------


def loop(cells: Mapping[str, Sequence[float]], clocks: int) -> tuple[NDArray[Any], Floats]:
    """Return counts and charges of cells by the loops of event; fields that are not given are ideal."""
    size = max(len(values) for values in cells.values())
    ideal = {"w0": -0.5, "packet": 1.0, "low": -np.inf, "high": np.inf}
    whole = {
        f.name: np.array(cells.get(f.name, [ideal.get(f.name, 0.0)] * size), dtype=float)
        for f in dataclasses.fields(walk.Cells)
    }
    return walk.count_cells(walk.Cells(**whole), clocks, 1.0)


def cells(fields: Mapping[str, float], duties: Sequence[float]) -> Measured:
    """Compare counts of converters given in packets and clocks with the walk in fifty digits."""
    found, _ = loop({"x": duties, **{name: [value] * len(duties) for name, value in fields.items()}}, GATE)
    expected = [exact.interval({**exact.IDEAL, **fields, "x": Fraction(x)}, GATE)[0] for x in duties]
    return Measured(float(np.abs(found - expected).max()), f"{found.tolist()}, exactly {expected}")
