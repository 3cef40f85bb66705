# SPDX-License-Identifier: Apache-2.0
"""Laws that hold for every scene: each takes a `Subject` and yields one line for each violation.

A law yields COMPARED first where it applies. Laws that need further runs are asked for a share of the
scenes (`ENGINES`). `judge` asks all laws about one world.
"""

import dataclasses
import functools
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dermis import engines
from dermis import plan as planning
from dermis.converter import coupling, vfc, walk
from dermis.engines import Result, closed, event
from dermis.errors import InputError, SimulatorError
from dermis.ndarrays import Floats
from dermis.records import Plan
from tb.reference.converter_walk import walk_reference
from tb.reference.scenes import World

COMPARED = ""

# Star-mesh elimination never subtracts: n^2 roundings of 1e-16 at 20 x 20 taxels are 4e-14; the
# rest is margin for divisions afterwards. Two orders of the same elimination differ by no more.
_SOLVED = 1e-9
# Packets a clock: no gate of 2^24 clocks makes a visible part of a packet of it.
_NOTHING = 1e-15

# Fields that make a conversion depend on its place or time.
_IN_TIME = frozenset({"ripple", "motion", "q_mirror_c", "c_row_f", "c_column_f", "c_taxel_f"})
_SOURCES = frozenset({"v_column_offset_v", "i_leak_a"})
_CONVERTER = frozenset(f.name for f in dataclasses.fields(vfc.Converter))
# Fields of the converter that the count formula takes: other levels and packets.
_FORMULA = closed.HONOURS & _CONVERTER


class Subject:
    """A world, its files in a directory, with results that laws need and a seed for what they draw."""

    def __init__(self, world: World, directory: Path, seed: int) -> None:
        self.directory, self.seed = directory, seed
        self.scene = world.read(directory)
        self.auto = self.scene.table.effects.auto is not None
        self.plan = planning.whole(self.scene, "event")  # with all effects that auto considers

    def rng(self, name: str) -> np.random.Generator:
        """Return random numbers of one law, independent of other laws."""
        return np.random.default_rng([self.seed, *name.encode()])

    @functools.cached_property
    def active(self) -> frozenset[str]:
        return self.plan.active_fields()

    @functools.cached_property
    def chosen(self) -> Plan:
        """Plan that auto makes of the scene."""
        return planning.make(self.scene)

    @functools.cached_property
    def result(self) -> Result:
        engines.check(self.plan)
        return engines.run(self.plan)

    @property
    def x(self) -> Floats:
        """Duties of the codes."""
        return self.result.info["x"]

    def cell(self, rng: np.random.Generator) -> tuple[int, int, int]:
        """Draw a taxel of a frame."""
        return tuple(int(rng.integers(n)) for n in self.plan.resistance_ohm.shape)  # type: ignore[return-value]

    @property
    def noisy(self) -> bool:
        """True if random numbers are drawn while frames are read."""
        return bool(self.active & walk.RANDOM)

    @property
    def memoryless(self) -> bool:
        """True if a conversion depends on its own frame alone and nothing changes within a gate."""
        return not self.active & _IN_TIME


def _first(wrong: Any, text: str, *values: Any) -> Iterator[str]:
    """Yield `text` with the values at the first place where something is wrong."""
    if np.any(wrong):
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        said = text.format(*(np.asarray(v)[at].item() for v in values))
        yield f"{said} at {list(at)}, {int(wrong.sum())} of {wrong.size}"


def typed_errors(s: Subject) -> Iterator[str]:
    """Nothing but the project's own errors, no floating-point exception, no warning."""
    yield COMPARED  # `judge` sees the others


def numbers(s: Subject) -> Iterator[str]:
    """Codes lie in range and nothing is not a number."""
    yield COMPARED
    codes = s.result.codes
    if codes.shape != s.plan.resistance_ohm.shape:
        yield f"shape {codes.shape}"
    yield from _first(codes > s.plan.timing.code_max, "a code of {} beyond full scale", codes)
    for name in ("x", "w_end"):
        yield from _first(np.isnan(s.result.info[name]), f"{name} is not a number")


def closed_equals_event(s: Subject) -> Iterator[str]:
    """Engine closed gives the codes of engine event wherever it can do the scene."""
    plan = dataclasses.replace(s.plan, engine="closed")
    if engines.refused(plan, "closed"):
        return
    yield COMPARED
    codes, other = engines.run(plan).codes, s.result.codes
    yield from _first(codes != other, "closed reads {}, event {}, x = {}", codes, other, s.x)


def fifty_digits(s: Subject) -> Iterator[str]:
    """The compiled loops give the bits of the slow reference in fifty digits."""
    if s.noisy or not s.memoryless:
        return
    rng = s.rng("fifty_digits")
    f, r, c = s.cell(rng)
    every = slice(0, s.plan.frames)
    coupled = coupling.coupling(s.plan, every)
    cells = walk.cells_of(s.plan, s.x, coupling.columns_in_gates(s.plan, every), coupled)
    cell = {k.name: float(getattr(cells, k.name)[f, r, c]) for k in dataclasses.fields(walk.Cells)}
    if abs(cell["x"]) > 1e6 or cell["across"] > 1e6:  # the reference stops at every change
        return
    yield COMPARED
    clocks = min(int(rng.integers(1, 40)), s.plan.timing.gate_clocks)
    exact = walk_reference(cell, clocks, s.plan.timing.charge_delay_clocks)
    one = walk.Cells(**{name: np.array([value]) for name, value in cell.items()})
    count = int(walk.count_cells(one, clocks, s.plan.timing.charge_delay_clocks)[0][0])
    # Errors of 1e-12 packet (docs/event.md) may decide a state that is as close to a level.
    if count != sum(exact.bits) and exact.nearest > 1e-9 * max(1.0, abs(cell["x"])):
        yield f"{count} ones in {clocks} clocks, the reference {sum(exact.bits)}, cell {f}, {r}, {c}: {cell}"


def parts(s: Subject) -> Iterator[str]:
    """Codes do not depend on how frames are cut into parts."""
    if s.plan.frames < 2:
        return
    yield COMPARED
    cut = int(s.rng("parts").integers(1, s.plan.frames))
    found = [engines.run(s.plan.part(*ends)) for ends in ((0, cut), (cut, s.plan.frames))]
    codes, whole = np.concatenate([r.codes for r in found]), s.result.codes
    yield from _first(codes != whole, f"codes cut at frame {cut}: {{}}, {{}} uncut", codes, whole)
    x = np.concatenate([r.info["x"] for r in found])
    yield from _first(x != s.x, f"duty cut at frame {cut}: {{!r}}, {{!r}} uncut", x, s.x)


def repeated(s: Subject) -> Iterator[str]:
    """The same plan gives the same codes again, and so does the resolved scene."""
    yield COMPARED
    again = engines.run(s.plan)
    if not np.array_equal(again.codes, s.result.codes):
        yield "a second run gives other codes"
    if not s.auto:
        path = s.directory / "resolved.toml"
        path.write_text(s.plan.resolved_toml(s.directory))
        back = planning.load(path, "event", s.scene.design)
        if not np.array_equal(engines.run(back).codes, s.result.codes):
            yield "the resolved scene gives other codes"


def monotone(s: Subject) -> Iterator[str]:
    """More conductance of a taxel gives no smaller duty and no smaller code of its own."""
    rising = _FORMULA | {"v_int_max_v", "v_int_min_v", "inv_gain_dc", "g_in_s", "inv_i_range_a"}
    if not s.memoryless or s.active & _SOURCES or not s.active & _CONVERTER <= rising or s.noisy:
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
    names = _CONVERTER - {"f_clk_hz", "v_sign"}
    converter = {name: getattr(plan.converter, name)[cols] for name in names}
    return dataclasses.replace(
        plan,
        resistance_ohm=np.ascontiguousarray(plan.resistance_ohm[:, rows][:, :, cols]),
        force_n=None,
        converter=dataclasses.replace(plan.converter, **converter),
        surrounding={n: np.asarray(v)[cols] if np.ndim(v) else v for n, v in plan.surrounding.items()},
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
    # A short makes an infinite duty.
    most = s.plan.converter.saturating_duty()[cols]
    before, after = (np.clip(v, -most, most) for v in (x, other.info["x"]))
    # Offsets and leaks may nearly cancel the current of the bias; the sum is as exact as its parts.
    size = np.abs(before) + (_held(s)[:, rows][:, :, cols] if s.active & _SOURCES else 0.0)
    wrong = np.abs(after - before) > _SOLVED * size + _NOTHING + _given(s, rows)
    yield from _first(wrong, "x = {!r} becomes {!r} in another order", x, other.info["x"])
    far = np.abs(other.codes.astype(int) - expected) > 1
    yield from _first(far, "code {} becomes {} in another order", expected, other.codes)


def _given(s: Subject, rows: Any) -> Floats | float:
    """Return what one packet a clock later in every other column adds to a duty: a rounding may decide its clock."""
    coupled = coupling.coupling(s.plan, slice(0, s.plan.frames))
    if coupled is None:
        return 0.0
    strongest = np.abs(coupled.links[..., 0, :]).sum(axis=-1).max(axis=2, keepdims=True)
    return strongest[:, rows] / s.plan.timing.gate_clocks


def _held(s: Subject) -> Floats:
    """Return the sum of magnitudes of offsets and leaks, packets a clock."""
    network = s.plan.network(0)
    volt, leak = (np.abs(v).max() for v in (network.v_column_offset_v, network.i_leak_a))
    g = np.minimum(s.plan.conductance_s(), 1e22).sum(axis=1, keepdims=True)
    ampere = volt * (g + network.rows * network.g_lateral_row_s * 2) + leak
    c = s.plan.converter
    return np.broadcast_to(ampere * np.abs(c.gain) / (c.k * c.i0_a), s.plan.resistance_ohm.shape)


def budget(s: Subject) -> Iterator[str]:
    """Effects that auto leaves out stay within its budget."""
    if not s.auto or engines.refuses(s.chosen, s.chosen.engine):
        return
    yield COMPARED
    apart = np.abs(s.result.codes.astype(int) - engines.run(s.chosen).codes)
    budget_lsb = s.scene.table.effects.auto.budget_lsb
    allowed = int(np.floor(budget_lsb + 1.0)) if budget_lsb else 0
    yield from _first(apart > allowed, f"auto differs by {{}} from all effects on, {allowed} allowed", apart)


def through_verilog(s: Subject) -> Iterator[str]:
    """Engine rtl reads the codes of engine event, at most one apart."""
    yield from _neighbour(s, "rtl")


def through_spice(s: Subject) -> Iterator[str]:
    """Engine cosim reads the codes of engine event, at most one apart."""
    yield from _neighbour(s, "cosim")


def _neighbour(s: Subject, engine: str) -> Iterator[str]:
    plan = dataclasses.replace(s.plan, engine=engine)
    engines.check(plan)
    codes = engines.run(plan, simulator="icarus").codes.astype(int)
    yield COMPARED
    apart = np.abs(codes - s.result.codes) > (0 if engine == "rtl" and not s.active else 1)
    yield from _first(apart, f"{engine} reads {{}}, event {{}}, x = {{!r}}", codes, s.result.codes, s.x)


Law = Callable[[Subject], Iterator[str]]
_ALWAYS = 1.0
_EVERY = {typed_errors: _ALWAYS, numbers: _ALWAYS}
_LAWS: dict[str, dict[Law, float]] = {
    "closed,event": _EVERY | {
        closed_equals_event: _ALWAYS, fifty_digits: 0.1, parts: 0.5,
        repeated: 0.02, monotone: 0.4, symmetric: 0.4, budget: _ALWAYS,
    },
    "rtl": _EVERY | {through_verilog: _ALWAYS},
    "cosim": _EVERY | {through_spice: _ALWAYS},
}  # fmt: skip
ENGINES = {name: {law.__name__: (law, share) for law, share in laws.items()} for name, laws in _LAWS.items()}
"""Engines of a campaign -> law by name, and the share of scenes that it is asked about."""


def meaning(engines_: str, name: str) -> str:
    return (ENGINES[engines_][name][0].__doc__ or "").splitlines()[0].rstrip(".")


@dataclass
class Outcome:
    refused: str = ""  # message of the InputError, or of the SimulatorError of an array solve
    given_up: bool = False  # the latter, exit 3
    broken: list[tuple[str, str]] = field(default_factory=list)  # law and line
    asked: Counter[str] = field(default_factory=Counter)
    compared: Counter[str] = field(default_factory=Counter)  # laws that applied
    conversions: int = 0


def judge(world: World, engines_: str, seed: int, only: Iterable[str] | None = None) -> Outcome:
    """Ask the laws of some engines about a world, those of `only` without chance.

    Invalid floating-point operations, warnings and exceptions other than the project's own break
    `typed_errors`.
    """
    outcome = Outcome()
    with (
        tempfile.TemporaryDirectory() as directory,
        warnings.catch_warnings(),
        np.errstate(divide="raise", over="raise", invalid="raise", under="ignore"),
    ):
        warnings.simplefilter("error")
        try:
            subject = Subject(world, Path(directory), seed)
            outcome.conversions = subject.result.codes.size
        except (InputError, SimulatorError) as error:
            outcome.refused = str(error).replace(directory, "")
            outcome.given_up = isinstance(error, SimulatorError)
            return outcome
        except Exception as error:  # any other exception is a finding
            outcome.broken.append(("typed_errors", _line(error)))
            return outcome
        chance = np.random.default_rng([seed, 1])
        for name, (law, share) in ENGINES[engines_].items():
            if (chance.random() < share) if only is None else (name in only):
                outcome.asked[name] += 1
                _ask(law, subject, engines_, outcome)
    return outcome


def _ask(law: Law, subject: Subject, engines_: str, outcome: Outcome) -> None:
    name = law.__name__
    try:
        said = list(law(subject))
    except InputError:  # a further run of the law may be more than an engine takes
        return
    except SimulatorError as error:
        said = [] if engines_ == "closed,event" else [f"exit 3: {error}"]  # the latter of Verilog or ngspice
    except Exception as error:  # any other exception is a finding
        said = [_line(error)]
    outcome.compared[name] += COMPARED in said
    outcome.broken += [(name, line) for line in said if line != COMPARED]


def _line(error: Exception) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    own = [f"{Path(f.filename).name}:{f.lineno}" for f in frames if "dermis" in f.filename]
    return f"{type(error).__name__}: {error} ({' '.join(own[-2:])})"
