# SPDX-License-Identifier: Apache-2.0
"""What must hold for every scene whatever is in it: each law is a function that returns what breaks it, or nothing.

A law takes a `Subject` (a plan, what the engines made of it, random numbers of its own), yields COMPARED where it says
anything about such a scene, and one line for each thing that is wrong. Laws that need further runs say in `SHARE` for
which part of the scenes they are asked.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import auto, engines
from dermis import plan as planning
from dermis.array.array import column_currents, column_currents_by_source, column_currents_with_bounds
from dermis.converter import coupling, currents, vfc
from dermis.engines import Result, certificate, closed, event
from dermis.records import Plan
from tb.programs.campaign.world import World

Floats = NDArray[np.float64]

COMPARED = ""
"""What a law yields where a scene is one it can say something about, before what it finds."""

# Star-mesh elimination never subtracts: n^2 roundings of 1e-16 at 20 x 20 taxels are 4e-14; the rest is margin for what
# is divided afterwards. Two orders of the same elimination differ by no more.
_SOLVED = 1e-9
# Below this a current is no packet in any gate of 1e3 clocks at the smallest reference (1e-9 A): 1e-12 of a packet.
_NO_CURRENT_A = 1e-24

# Packets a clock that no gate of 2^24 clocks makes a visible part of a packet of.
_NOTHING = 1e-15

# Fields that make a conversion hang on where or when it is done.
_IN_TIME = frozenset({"ripple", "motion", "q_mirror_c", "c_row_f", "c_column_f", "c_taxel_f"})
_SOURCES = frozenset({"v_column_offset_v", "i_leak_a"})
# Fields of the converter that leave the count formula's machine: its levels and packets are other numbers at most.
_FORMULA = closed.HONOURS & {f.name for f in dataclasses.fields(vfc.Converter)}


class Subject:
    """A world on its way through the engines; everything that several laws want is worked out once.

    Parameters
    ----------
    world : World
    directory : Path
        For its files.
    seed : int
        Of the numbers that laws draw.
    engine : str
        What takes everything that is on: `result` is its own, but for cosim, where it is that of what auto chose.
    """

    def __init__(self, world: World, directory: Path, seed: int, engine: str = "event") -> None:
        self.world, self.directory = world, directory
        self.seed = seed
        self.scene = world.read(directory)
        auto = self.scene.table.effects.auto
        self.auto = auto is not None
        whole = self.scene
        if self.auto:  # all that auto considers, on
            table = whole.table.effects.model_copy(update={"auto": None} | whole.effects)
            whole = dataclasses.replace(whole, table=whole.table.model_copy(update={"effects": table}))
        self.plan = planning.make(whole, engine)

    def rng(self, name: str) -> np.random.Generator:
        """Random numbers of one law: those of the others do not move them."""
        return np.random.default_rng([self.seed, *name.encode()])

    @functools.cached_property
    def active(self) -> frozenset[str]:
        """Record fields that are on."""
        return self.plan.active_fields()

    @functools.cached_property
    def chosen(self) -> Plan:
        """What auto made of the scene."""
        return planning.make(self.scene)

    @functools.cached_property
    def result(self) -> Result:
        """Engine event; where everything goes through cosim, what auto chose."""
        plan = self.chosen if self.plan.engine == "cosim" else self.plan
        engines.check(plan)
        return certificate.certify(plan, engines.run(plan))

    @property
    def x(self) -> Floats:
        """Duty behind the codes."""
        return self.result.info["x"]

    def cell(self, rng: np.random.Generator) -> tuple[int, int, int]:
        """Any taxel of any frame."""
        return tuple(int(rng.integers(n)) for n in self.plan.resistance_ohm.shape)  # type: ignore[return-value]

    @property
    def noisy(self) -> bool:
        """Whether numbers are drawn while frames are read."""
        return bool(self.active & event.RANDOM)

    @property
    def memoryless(self) -> bool:
        """Whether a conversion hangs on its own frame and nothing in it changes inside a gate."""
        return not self.active & _IN_TIME

    @property
    def formula(self) -> bool:
        """Whether the converters are those of the count formula, with other levels and packets at most."""
        own = self.active & {f.name for f in dataclasses.fields(vfc.Converter)}
        return self.memoryless and own <= _FORMULA

    def steady(self) -> event.Cells:
        """The converters at a constant duty each."""
        coupled = coupling.coupling(self.plan, self.plan.conductance_s(), self.x)
        return event.cells_of(self.plan, self.x, self.plan.conductance_s(), coupled)


def _where(wrong: NDArray[np.bool_]) -> str:
    at = tuple(int(i) for i in np.argwhere(wrong)[0])
    return f"at {list(at)}, {int(wrong.sum())} of {wrong.size}"


def numbers(s: Subject) -> Iterator[str]:
    """Codes lie in range and nothing is not a number."""
    yield COMPARED
    r = s.result
    if r.codes.shape != s.plan.resistance_ohm.shape:
        yield f"shape {r.codes.shape}"
    if int(r.codes.max()) > s.plan.timing.code_max:
        yield f"a code of {int(r.codes.max())} above {s.plan.timing.code_max}"
    for name in ("x", "w_end"):
        values = r.info[name]
        if np.isnan(values).any():
            yield f"{name} is not a number {_where(np.isnan(values))}"


def certified(s: Subject) -> Iterator[str]:
    """The certified codes hold the codes."""
    yield COMPARED
    r = s.result
    outside = (r.codes < r.low) | (r.codes > r.high)
    if outside.any():
        at = tuple(np.argwhere(outside)[0])
        yield f"code {r.codes[at]} outside {r.low[at]} .. {r.high[at]} {_where(outside)}"


def closed_equals_event(s: Subject) -> Iterator[str]:
    """Engine closed gives the codes of engine event, to the last bit, wherever it can do the scene."""
    plan = dataclasses.replace(s.plan, engine="closed")
    if engines.refused(plan, "closed"):
        return
    yield COMPARED
    codes = engines.run(plan).codes
    differ = codes != s.result.codes
    if differ.any():
        at = tuple(np.argwhere(differ)[0])
        yield f"closed reads {codes[at]}, event {s.result.codes[at]} at x = {s.x[at]!r} {_where(differ)}"


def exact_arithmetic(s: Subject) -> Iterator[str]:
    """A converter of the count formula counts what exact rationals count, less than one from N x."""
    if not s.formula:
        return
    rng = s.rng("exact_arithmetic")
    f, r, c = s.cell(rng)
    x = float(s.x[f, r, c])
    if not abs(x) < 1e12:  # beyond, both only saturate
        return
    yield COMPARED
    plan, converter = s.plan, s.plan.converter
    packet_v = float(converter.packet_v()[c])
    w0 = vfc.W_PRESET + float(converter.preset_error_v[c]) / packet_v
    packet, level = 1.0 + float(converter.packet_error[c]), float(converter.v_comp_offset_v[c]) / packet_v
    clocks = plan.timing.gate_clocks
    exact = vfc.count_exact(x, clocks, w0, packet, level)
    code = int(s.result.codes[f, r, c])
    if code != min(exact, plan.timing.code_max):
        # One rounding of N x may decide a tie (docs of vfc.count): ask both neighbours of x.
        beside = {
            vfc.count_exact(float(np.nextafter(x, way)), clocks, w0, packet, level) for way in (-1e300, 1e300)
        }
        if code not in {min(n, plan.timing.code_max) for n in beside}:
            yield f"code {code}, exact arithmetic {exact} at x = {x!r}, cell {f}, {r}, {c}"
    if not s.active & {"packet_error", "preset_error_v", "v_comp_offset_v"} and 0 <= x <= 0.5:
        if abs(Fraction(x) * clocks - code) >= 1 and code < plan.timing.code_max:
            yield f"charge balance: code {code} at N x = {clocks * x!r}"


def words(s: Subject) -> Iterator[str]:
    """Ideal converters: equal windows differ by at most one, gaps take two values; all: never two ones in a row."""
    if s.noisy or not s.memoryless:
        return
    yield COMPARED
    rng = s.rng("words")
    f, r, c = s.cell(rng)
    cells = s.steady()
    one = event.Cells(
        **{k.name: getattr(cells, k.name)[f, r, c].reshape(1) for k in dataclasses.fields(event.Cells)}
    )
    delay, gate = s.plan.timing.charge_delay_clocks, s.plan.timing.gate_clocks
    ideal = s.formula and not s.active & {"packet_error", "preset_error_v", "v_comp_offset_v"}
    x = float(one.x[0])
    first, last = (0, gate) if ideal else (n := int(rng.integers(max(gate - 40, 1))), min(n + 40, gate))
    counts = [0] if first == 0 else []
    counts += [int(event.count_cells(one, n, delay)[0][0]) for n in range(max(first, 1), last + 1)]
    bits = np.diff(counts)
    if not np.isin(bits, (0, 1)).all():
        yield f"a longer gate counts {bits.min()} .. {bits.max()} more a clock, x = {x!r}, cell {f}, {r}, {c}"
    elif (bits[1:] & bits[:-1]).any():
        yield f"two ones in a row, x = {x!r}, cell {f}, {r}, {c}"
    if ideal and 0 < x <= 0.5:
        at = np.flatnonzero(bits)
        gaps = set(np.diff(at).tolist())
        allowed = set(vfc.gaps(Fraction(x)))
        # n x is rounded once: where 1 / x is next to a whole number the last bit of x decides.
        near = abs(1 / x - round(1 / x)) < 1e-9 / x
        if near:
            allowed |= {round(1 / x) - 1, round(1 / x), round(1 / x) + 1}
        if not gaps <= allowed:
            yield f"gaps {sorted(gaps)} at x = {x!r}, {sorted(allowed)} expected"
        window = int(rng.integers(1, gate + 1))
        total = np.concatenate([[0], np.cumsum(bits)])
        in_windows = total[window:] - total[:-window]
        if in_windows.max() - in_windows.min() > (2 if near else 1):
            yield f"windows of {window} clocks hold {in_windows.min()} .. {in_windows.max()} at x = {x!r}"


def fifty_digits(s: Subject) -> Iterator[str]:
    """The compiled loops give the bits of the slow reference in fifty digits."""
    if s.noisy or not s.memoryless:
        return
    rng = s.rng("fifty_digits")
    f, r, c = s.cell(rng)
    cells = s.steady()
    cell = {k.name: float(getattr(cells, k.name)[f, r, c]) for k in dataclasses.fields(event.Cells)}
    if (
        abs(cell["x"]) > 1e6 or cell["across"] > 1e6
    ):  # the reference stops at every instant where anything changes
        return
    yield COMPARED
    clocks = min(int(rng.integers(1, 40)), s.plan.timing.gate_clocks)
    walk = event.walk_reference(cell, clocks, s.plan.timing.charge_delay_clocks)
    one = event.Cells(**{name: np.array([value]) for name, value in cell.items()})
    count = int(event.count_cells(one, clocks, s.plan.timing.charge_delay_clocks)[0][0])
    # States of 1e-12 packet of error (docs/event.md) may decide what comes as close to a level.
    if count != sum(walk.bits) and walk.nearest > 1e-9 * max(1.0, abs(cell["x"])):
        yield f"{count} ones in {clocks} clocks, the reference {sum(walk.bits)}, cell {f}, {r}, {c}: {cell}"


def parts(s: Subject) -> Iterator[str]:
    """Codes do not depend on how frames are cut into parts."""
    if s.plan.frames < 2:
        return
    yield COMPARED
    cut = int(s.rng("parts").integers(1, s.plan.frames))
    found = []
    for first, stop in ((0, cut), (cut, s.plan.frames)):
        part = s.plan.part(first, stop)
        found.append(certificate.certify(part, engines.run(part)))
    for name in ("codes", "low", "high"):
        together = np.concatenate([getattr(r, name) for r in found])
        differ = together != getattr(s.result, name)
        # Certified codes of a part are those of its own frames: they may be narrower, never wider.
        if name == "low":
            differ = together < s.result.low
        elif name == "high":
            differ = together > s.result.high
        if differ.any():
            yield f"{name} of frames 0..{cut - 1} and {cut}.. differ from those of all {_where(differ)}"
    x = np.concatenate([r.info["x"] for r in found])
    if not np.array_equal(x, s.x):
        worst = float(np.abs(np.subtract(x, s.x, where=x != s.x, out=np.zeros_like(x))).max())
        yield f"duties of parts differ by {worst:.3g} {_where(x != s.x)}"


def repeated(s: Subject) -> Iterator[str]:
    """The same plan gives the same codes again, and so does the resolved scene."""
    yield COMPARED
    again = engines.run(s.plan)
    if not np.array_equal(again.codes, s.result.codes):
        yield "a second run gives other codes"
    if not s.auto:
        text = s.plan.resolved_toml(s.directory)
        path = s.directory / "resolved.toml"
        path.write_text(text)
        back = planning.load(path, "event", s.scene.design)
        if not np.array_equal(engines.run(back).codes, s.result.codes):
            yield "the resolved scene gives other codes"


def monotone(s: Subject) -> Iterator[str]:
    """More conductance of a taxel gives no smaller duty and no smaller code of its own, where the physics says so."""
    rising = _FORMULA | {"v_int_max_v", "v_int_min_v", "inv_gain_dc", "g_in_s", "inv_i_range_a"}
    own = s.active & {f.name for f in dataclasses.fields(vfc.Converter)}
    if not s.memoryless or s.active & _SOURCES or not own <= rising or s.noisy:
        return
    # Direct: the taxel also loads the integrator, so more current comes with more leak.
    if s.plan.topology == "direct" and "inv_gain_dc" in s.active:
        return
    rng = s.rng("monotone")
    at = s.cell(rng)
    ohm = s.plan.resistance_ohm.copy()
    if not np.isfinite(ohm[at]):
        return
    yield COMPARED
    ohm[at] *= float(rng.choice([0.0, 0.5, 0.97]))
    more = event.run(dataclasses.replace(s.plan, resistance_ohm=ohm))
    before, after = float(s.x[at]), float(more.info["x"][at])
    if after < before - _SOLVED * abs(before):
        yield f"x falls from {before!r} to {after!r} at {at}, where the conductance grows"
    if after >= before and more.codes[at] < s.result.codes[at]:
        yield f"code falls from {s.result.codes[at]} to {more.codes[at]} at {at}, x = {before!r} .. {after!r}"


def _permuted(plan: Plan, rows: Any, cols: Any) -> Plan:
    converter = {
        f.name: getattr(plan.converter, f.name)[cols]
        for f in dataclasses.fields(plan.converter)
        if f.name not in ("f_clk_hz", "v_sign")
    }
    around = {
        name: np.asarray(value)[cols] if np.ndim(value) else value for name, value in plan.surrounding.items()
    }
    return dataclasses.replace(
        plan,
        resistance_ohm=np.ascontiguousarray(plan.resistance_ohm[:, rows][:, :, cols]),
        force_n=None,
        converter=dataclasses.replace(plan.converter, **converter),
        surrounding=around,
    )


def symmetric(s: Subject) -> Iterator[str]:
    """Rows and columns in another order, or mirrored, give codes in that order."""
    if s.noisy:
        return
    yield COMPARED
    rng = s.rng("symmetric")
    rows, cols = np.arange(s.plan.rows), np.arange(s.plan.cols)
    if not s.active & (_IN_TIME | {"r_trace_column_ohm"}):
        rows = rng.permutation(rows)
    if "r_trace_row_ohm" not in s.active:
        cols = rng.permutation(cols) if "g_lateral_row_s" not in s.active else cols[::-1]
    other = event.run(_permuted(s.plan, rows, cols))
    expected, x = s.result.codes[:, rows][:, :, cols], s.x[:, rows][:, :, cols]
    # A short makes an infinite duty; beyond any that is clipped.
    most = s.plan.converter.drowning()[cols]
    before, after = (np.clip(v, -most, most) for v in (x, other.info["x"]))
    # Where offsets and leaks all but cancel what the bias makes, the sum is as exact as its parts.
    size = np.abs(before) + (_held(s)[:, rows][:, :, cols] if s.active & _SOURCES else 0.0)
    wrong = np.abs(after - before) > _SOLVED * size + _NOTHING + _coupled(s)[:, rows]
    if wrong.any():
        at = tuple(np.argwhere(wrong)[0])
        yield f"x = {x[at]!r} becomes {other.info['x'][at]!r} in another order {_where(wrong)}"
    far = np.abs(other.codes.astype(int) - expected) > 1
    if far.any():
        at = tuple(np.argwhere(far)[0])
        yield f"code {expected[at]} becomes {other.codes[at]} in another order {_where(far)}"


def _coupled(s: Subject) -> Floats:
    """Packets a clock [frames, rows, 1] to which engine event says it knows what columns do to each other."""
    plan, g = s.plan, s.plan.conductance_s()
    known = np.zeros((plan.frames, plan.rows, 1))
    for alike, slots in currents.groups(plan, slice(0, plan.frames)):
        if slots is None:
            x = plan.converter.duty(column_currents(plan.network(0), g[alike]))
            coupled = coupling.coupling(plan, g[alike], x)
        else:
            coupled = slots.coupling
        if coupled is not None:
            known[alike] = coupled.known / plan.timing.gate_clocks
    return known


def _held(s: Subject) -> Floats:
    """Packets a clock by which offsets and leaks move each column, all taken as positive."""
    network = s.plan.network(0)
    size = np.abs(network.v_column_offset_v)
    g = np.minimum(s.plan.conductance_s(), 1e22).sum(axis=1, keepdims=True)
    ampere = (size.max() * (g + network.rows * network.g_lateral_row_s * 2)) + np.abs(network.i_leak_a).max()
    c = s.plan.converter
    return np.broadcast_to(ampere * np.abs(c.gain) / (c.k * c.i0_a), s.plan.resistance_ohm.shape)


def superposed(s: Subject) -> Iterator[str]:
    """The network is linear and passive: sources add, currents follow the bias, no more comes out than goes in."""
    network, g = s.plan.network(0), s.plan.conductance_s()
    if not g.max() < 1e12:  # shorts: infinite currents, whose shares are limits
        return
    yield COMPARED
    found = column_currents_with_bounds(network, g)
    driven, rest = found.driven, found.rest
    twice, _ = column_currents_by_source(dataclasses.replace(network, v_bias_v=2.0 * network.v_bias_v), g)
    # Far along lateral resistors a current has fewer bits than a double, or none, and doubling it gives it one back.
    wrong = (twice != 2.0 * driven) & (np.abs(driven) > _NO_CURRENT_A)
    if wrong.any():
        yield f"twice the bias is not twice the current {_where(wrong)}"
    if (driven < 0).any():
        yield f"a current of {driven.min():.3g} A against the bias {_where(driven < 0)}"
    into, out = network.v_bias_v * g.sum(axis=2), driven.sum(axis=2)
    if (out > into * (1.0 + _SOLVED)).any():
        yield f"{float((out / np.maximum(into, 1e-300)).max())!r} of what an ideal driver would give comes out"
    if rest is not None:
        rng = s.rng("superposed")
        # Shares that round neither part: where offsets of columns cancel, a rounding of one is more than any bound.
        share = rng.choice([-1.0, 0.0, 0.5, 1.0, 2.0], network.cols)
        # What every solve says of itself: where offsets and leaks cancel it may be more than the current.
        halves, allowed = [], found.rest_error
        for one in (share, 1.0 - share):
            part = dataclasses.replace(
                network,
                v_column_offset_v=network.v_column_offset_v * one,
                i_leak_a=network.i_leak_a * one,
            )
            made = column_currents_with_bounds(part, g)
            halves.append(np.zeros_like(rest) if made.rest is None else made.rest)
            allowed = allowed + (0.0 if made.rest_error is None else made.rest_error)
        wrong = np.abs(halves[0] + halves[1] - rest) > allowed + _NO_CURRENT_A
        if wrong.any():
            at = tuple(np.argwhere(wrong)[0])
            yield f"offsets and leaks in two parts: {halves[0][at] + halves[1][at]!r}, not {rest[at]!r} {_where(wrong)}"


# Fields by how they scale where every resistance grows by a factor and every current shrinks by it.
_OHMS = ("r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm", "r_trace_row_ohm", "r_trace_column_ohm")
_SIEMENS = ("g_lateral_row_s", "g_lateral_column_s", "i_leak_a", "c_row_f", "c_column_f", "c_taxel_f")
_AMPERES = ("i0_a", "c_int_f", "i_offset_a", "g_in_s", "q_mirror_c")


# Between these the stand-ins for shorts and opens (dermis.array.array) are out of reach of 2^6 either way.
_LEAST_OHM, _LEAST, _MOST = 1e-6, 1e-15, 1e12


def scaled(s: Subject) -> Iterator[str]:
    """Resistances times a power of two and currents through it give the same codes, to the last bit."""
    ohm = s.plan.resistance_ohm
    finite = ohm[(ohm > 0) & np.isfinite(ohm)]
    absolute = [float(np.max(v)) for v in s.plan.surrounding.values()]
    # Stand-ins for shorts and opens do not scale; they are beyond any of these.
    if s.noisy or (finite.size and not (_LEAST_OHM <= finite.min() and finite.max() <= _MOST)):
        return
    if (ohm == 0).any() or any(v and not _LEAST < abs(v) < _MOST for v in absolute) or "t_meta_s" in s.active:
        return
    yield COMPARED
    factor = float(2.0 ** s.rng("scaled").integers(-6, 7))
    around = {}
    for name, value in s.plan.surrounding.items():
        power = 1.0 if name in _OHMS else (-1.0 if name in _SIEMENS else 0.0)
        around[name] = np.asarray(value) * factor**power if np.ndim(value) else value * factor**power
    converter = {name: getattr(s.plan.converter, name) / factor for name in _AMPERES}
    converter["inv_i_range_a"] = s.plan.converter.inv_i_range_a * factor
    other = event.run(
        dataclasses.replace(
            s.plan,
            resistance_ohm=ohm * factor,
            surrounding=around,
            converter=dataclasses.replace(s.plan.converter, **converter),
        )
    )
    differ = other.codes != s.result.codes
    if differ.any():
        at = tuple(np.argwhere(differ)[0])
        yield f"code {s.result.codes[at]} becomes {other.codes[at]} at {factor} times the ohms {_where(differ)}"


def budget(s: Subject) -> Iterator[str]:
    """What auto leaves out stays within its budget, and its certified codes hold those with everything on."""
    if not s.auto:
        return
    if engines.refuses(s.chosen, s.chosen.engine):
        return
    yield COMPARED
    yield from _within_budget(s, s.result.codes, certificate.certify(s.chosen, engines.run(s.chosen)), 0)


def _within_budget(s: Subject, codes: NDArray[Any], found: Result, apart_anyway: int) -> Iterator[str]:
    """Codes of everything on beside those of what auto chose, where engines may be so many apart by themselves."""
    codes = codes.astype(int)
    outside = (codes + apart_anyway < found.low) | (codes > found.high.astype(int) + apart_anyway)
    if outside.any():
        at = tuple(np.argwhere(outside)[0])
        yield f"everything on reads {codes[at]}, auto certifies {found.low[at]} .. {found.high[at]} {_where(outside)}"
    bounded = np.broadcast_to(s.chosen.margin_lsb, (s.chosen.cols,)) < s.chosen.timing.code_max
    apart = np.where(bounded, np.abs(codes - found.codes), 0)
    allowed = int(np.floor(s.scene.table.effects.auto.budget_lsb + 1.0)) + apart_anyway
    if (apart > allowed).any():
        yield f"auto reads {int(apart.max())} beside everything on, {allowed} allowed {_where(apart > allowed)}"


def through_verilog(s: Subject) -> Iterator[str]:
    """Engine rtl reads what engine event reads, at most one apart."""
    yield from _beside(s, "rtl", simulator="icarus")


def through_spice(s: Subject) -> Iterator[str]:
    """Engine cosim reads what engine event reads, at most one apart."""
    yield from _beside(s, "cosim", simulator="icarus")


def budget_through_spice(s: Subject) -> Iterator[str]:
    """What auto leaves out stays within its budget beside everything on in engine cosim, at most one apart besides."""
    # A bound of nothing is a claim as well; what is on and changes no field is none.
    out = s.plan.on.keys() - s.chosen.on.keys()
    if not any(auto.fields_of(s.plan, name) & s.active for name in out):
        return
    engines.check(s.plan)
    codes = engines.run(s.plan, simulator="icarus").codes
    yield COMPARED
    yield from _within_budget(s, codes, s.result, 1)


def _beside(s: Subject, engine: str, **options: Any) -> Iterator[str]:
    plan = dataclasses.replace(s.plan, engine=engine)
    engines.check(plan)
    codes = engines.run(plan, **options).codes.astype(int)
    yield COMPARED
    ideal = not s.active
    apart = np.abs(codes - s.result.codes)
    most = 0 if ideal and engine == "rtl" else 1
    if (apart > most).any():
        at = tuple(np.argwhere(apart > most)[0])
        yield f"{engine} reads {codes[at]}, event {s.result.codes[at]}, x = {s.x[at]!r} {_where(apart > most)}"


Law = Callable[[Subject], Iterator[str]]
# Law -> the share of scenes it is asked for: what costs another run is not asked each time.
SHARE: dict[str, tuple[Law, float]] = {
    law.__name__: (law, share)
    for law, share in (
        (numbers, 1.0),
        (certified, 1.0),
        (closed_equals_event, 1.0),
        (exact_arithmetic, 0.5),
        (words, 0.05),
        (fifty_digits, 0.02),
        (parts, 0.5),
        (repeated, 0.02),
        (monotone, 0.4),
        (symmetric, 0.4),
        (superposed, 0.4),
        (scaled, 0.3),
        (budget, 1.0),
    )
}
ENGINES: dict[str, dict[str, tuple[Law, float]]] = {
    "closed,event": SHARE,
    "rtl": {"numbers": (numbers, 1.0), "through_verilog": (through_verilog, 1.0)},
    "cosim": {"numbers": (numbers, 1.0), "through_spice": (through_spice, 1.0)},
    # Event refuses some of what is on here, and auto may still leave it out: by bounds that event cannot speak for.
    "auto,cosim": {"budget_through_spice": (budget_through_spice, 1.0)},
}
# The engine that takes everything that is on.
WHOLE = dict.fromkeys(ENGINES, "event") | {"auto,cosim": "cosim"}


def meaning(engines: str, name: str) -> str:
    """What a law says, in one line."""
    if name == "typed_errors":
        return "Nothing but the project's own errors, no floating-point exception, no warning"
    law = ENGINES[engines][name][0]
    return (law.__doc__ or "").splitlines()[0].rstrip(".")
