# SPDX-License-Identifier: Apache-2.0
"""Hard circuits, at which ngspice aborts, rings, starts wrongly or must refuse; each has an exact
answer.

Engines: `lockstep` is ngspice as the analog half with row scanner and flip-flops in Python
(tb/system ties such a chip to the Verilog), `batch` a deck through `ngspice -b`, both on the ladder
(docs/ladder.md); `event` and `closed` are those of a scene.
"""

from __future__ import annotations

import functools
import math
import random
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from dermis import engines as engine_modules
from dermis import plan, records
from dermis.chip import ladder, netlist, spice_batch
from dermis.chip.analog import Edge
from dermis.chip.ngspice import Deck, NgspiceHalf
from dermis.chip.spice_text import array_subckt
from dermis.converter import vfc
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design
from tb.programs.hard.case import Case, Measured, case, texts

Rows = NDArray[np.float64]
# Tolerances of the decks without a pole (netlist.py): Newton's method ends a step beyond them.
TIGHT = ".options reltol=1e-6 abstol=1e-13 vntol=1e-9"


# ---- run of a circuit --------------------------------------------------------------------------------------


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="dermis_hard_") as name:
        yield Path(name)


def lockstep(
    lines: Sequence[str],
    probes: Sequence[str],
    times: Sequence[float],
    edges: Mapping[float, Sequence[tuple[int, float]]] | None = None,
    *,
    levels: Sequence[float] = (),
    abrupt: Sequence[bool] = (),
    t_edge_s: float = 1e-9,
    t_max_step_s: float = 1e-7,
    use_ic: bool = False,
) -> tuple[Rows, ladder.Climb]:
    """Return samples [times, probes] of a circuit with sources `v_d0 d0 0 external` ..., and its
    rungs of the ladder.

    Parameters
    ----------
    lines : elements and options
    times : seconds, ascending; the last one ends the transient
    edges : edges that begin at one of the times, or at 0: (source, level in volt)
    levels, abrupt : of the sources; see dermis.chip.ngspice.Deck
    """
    names = tuple(f"v_d{i}" for i in range(len(levels)))
    told = edges or {}
    deck = Deck(
        ("a hard circuit", *lines, *(f"{name} {name[2:]} 0 external" for name in names)),
        names,
        tuple(levels),
        tuple(abrupt) or (False,) * len(levels),
        tuple(probes),
    )

    def attempt(level: ladder.Level) -> Rows:
        half = NgspiceHalf(
            deck,
            t_edge_s=t_edge_s,
            t_max_step_s=t_max_step_s,
            t_stop_s=times[-1],
            log=folder / "ngspice.log",
            use_ic=use_ic,
            level=level,
        )
        found = []
        half.advance(0.0, [])
        ahead: list[Edge] = [(0.0, *edge) for edge in told.get(0.0, ())]
        for time in times:
            found.append(half.advance(time, ahead).copy())
            ahead = [(time, *edge) for edge in told.get(time, ())]
        half.close()
        return np.array(found)

    with _folder() as folder:
        way = ladder.Climb("hard circuit", report=lambda line: None)
        return ladder.climb(attempt, way), way


def batch(lines: Sequence[str], analysis: str, measures: Sequence[str]) -> spice_batch.Measured:
    """Return the measurements of a deck in `ngspice -b`; `measures` are the words after `.meas`."""
    with _folder() as folder:
        deck = folder / "circuit.sp"
        body = ["a hard circuit", *lines, analysis, *(f".meas {text}" for text in measures)]
        deck.write_text("\n".join([*body, ".end", ""]))
        return spice_batch.run(deck, limit_s=8.0)


def _said(way: ladder.Climb | Sequence[ladder.Retry]) -> str:
    retries = way.retries if isinstance(way, ladder.Climb) else way
    return "gave up " + ", ".join(retry.rung for retry in retries) if retries else ""


def refused(run: Callable[[], object], *causes: str) -> Measured:
    """Return 0 if a run ends with an error of dermis that names each cause, else 1."""
    try:
        run()
    except (SimulatorError, InputError) as error:
        lost = [cause for cause in causes if cause not in str(error)]
        return Measured(
            float(bool(lost)), f"does not say {lost}: {error}" if lost else f"exit {error.exit_code}"
        )
    return Measured(1.0, "no error")


# ---- the converter of fourteen transistors ---------------------------------------------------------------------

T_CLK_S = 1e-6
SETTLE, GATE = 4, 200
DUTY = Fraction(3, 8)


def transistor_converter(size: int) -> list[str]:
    """Return a converter of fourteen level-1 transistors: two amplifiers of seven, one integrates,
    one compares.

    1 MHz, 10 pF, packets of 1 uA; widths are drawn with `size` as seed. Its transistors have
    Meyer's gate capacitances only, and `vref` and `vbn` are ideal sources that drive
    only gates.
    """
    draw = random.Random(size)

    def width(um: float) -> float:
        return um * 1e-6 * draw.uniform(0.5, 2.0)

    def amplifier(
        k: str, inverting: str, other: str, out: str, pair: float, load: float, tail: float
    ) -> list[str]:
        second = draw.uniform(2.0, 8.0)
        return [
            f"m1{k} x{k} {inverting} t{k} vss n w={pair:.4g} l=1u",
            f"m2{k} y{k} {other} t{k} vss n w={pair:.4g} l=1u",
            f"m3{k} x{k} x{k} vdd vdd p w={load:.4g} l=1u",
            f"m4{k} y{k} x{k} vdd vdd p w={load:.4g} l=1u",
            f"m5{k} t{k} vbn vss vss n w={tail:.4g} l=2u",
            f"m6{k} {out} y{k} vdd vdd p w={load * second:.4g} l=1u",
            f"m7{k} {out} vbn vss vss n w={0.5 * tail * second:.4g} l=2u",
        ]

    return [
        ".model n nmos level=1 vto=0.5 kp=170u lambda=0.05 gamma=0.4 phi=0.7 tox=7.6n",
        ".model p pmos level=1 vto=-0.6 kp=60u lambda=0.08 gamma=0.4 phi=0.7 tox=7.6n",
        "vdd vdd 0 1.65",
        "vss vss 0 -1.65",
        "vref vref 0 0",
        "vbn vbn vss 0.8",
        *amplifier("a", "sum", "vref", "int", width(40), width(20), width(20)),
        *amplifier("c", "int", "vref", "comp", width(20), width(10), width(10)),
        "cmiller ya int 0.5p",
        f"iin 0 sum {float(DUTY)}u",
        "gpacket sum 0 d0 0 1u",
        "cint sum int 10p",
        ".nodeset v(d1)=1",
        "bpreset int sum i = v(d1) > 0.95 ? (v(d1) - 0.95)*(v(int,sum) - 0.05)*2e-2 : 0",
        # ngspice's default tolerances, at which it is known to abort
        ".options reltol=1e-3",
    ]


def count_pulses(lines: Sequence[str], level: ladder.Level) -> int:
    """Count packets of a converter in GATE clocks, with its two flip-flops in Python."""
    names = ("v_d0", "v_d1")
    deck = Deck(
        ("converter", *lines, "v_d0 d0 0 external", "v_d1 d1 0 external"),
        names,
        (0.0, 1.0),
        (False, True),
        ("comp",),
    )
    with _folder() as folder:
        half = NgspiceHalf(
            deck,
            t_edge_s=1e-9,
            t_max_step_s=T_CLK_S,
            t_stop_s=(GATE + SETTLE) * T_CLK_S,
            log=folder / "ngspice.log",
            level=level,
        )
        half.advance(0.0, [])
        edges: list[Edge] = []
        first = second = pulses = 0
        for clock in range(1, GATE + SETTLE + 1):
            high = half.advance(clock * T_CLK_S, edges)[0] > 0.0
            told = first
            first = int(high and not first) if SETTLE <= clock < SETTLE + GATE else 0
            pulses += first
            edges = [(clock * T_CLK_S, 0, float(told))] if told != second else []
            second = told
            if clock == SETTLE - 1:
                edges.append((clock * T_CLK_S, 1, 0.0))
        half.close()
    return pulses


SIZES = range(14)
ABORTING = (1, 2, 3, 5, 6, 7, 11, 12, 13)
"""Sizes of SIZES at which plain ngspice aborts a step."""


def transistors(begin: str, sizes: Sequence[int]) -> Measured:
    """Return the largest count error over sizes, starting at a rung; each of ABORTING must fail on
    `plain`.
    """
    foot = [rung.name for rung in ladder.STEPS].index(begin)
    worst, climbed, ends = 0.0, [], set()
    for size in sizes:
        way = ladder.Climb(f"size {size}", ladder.Level(0, foot), report=lambda line: None)
        pulses = ladder.climb(functools.partial(count_pulses, transistor_converter(size)), way)
        worst = max(worst, abs(pulses - float(DUTY * GATE)))
        ends.add(way.level.name)
        if way.level.steps > foot:
            climbed.append(size)
    if begin == "plain" and (lost := set(ABORTING) & set(sizes) - set(climbed)):
        return Measured(float(GATE), f"not hard: plain ngspice solved sizes {sorted(lost)}")
    said = (
        f"{len(climbed)} of {len(sizes)} sizes abort on {begin} {climbed}; ended on {', '.join(sorted(ends))}"
    )
    return Measured(worst, said)


def transistors_plain() -> Measured:
    """Check that the abort names time, node and phase."""
    try:
        count_pulses(transistor_converter(2), ladder.PLAIN)
    except ladder.Abort as abort:
        named = (
            abort.phase == "steps" and abort.time_s > 0 and abort.node and "Timestep too small" in abort.said
        )
        return Measured(float(not named), str(abort).partition(" (log")[0])
    return Measured(1.0, "no abort")


# ---- circuits that need a rung -----------------------------------------------------------------------------------

_DIODE = "bx b 0 i = 1e-14*(exp(v(b)/0.02) - 1)"
_LOCKED = "bo o 0 v = (v(a) > 0.5 && v(a) < 29.5) ? (v(n) > 0.5 ? 0 : 1) : 0.2"
NEEDS = {
    "gmin_stepping": ("v1 a 0 1", "r1 a b 1k", "bx b 0 i = 1e-3*tanh(1e6*(v(b) - 0.5)) + 1e-12*exp(40*v(b))"),
    "source_stepping": ("v1 a 0 30", "r1 a b 10", _DIODE, TIGHT),
    "ramp": ("v1 a 0 30", "r1 a b 10", _DIODE, _LOCKED, "r2 o n 1k", "c2 n 0 1n", TIGHT),
}
"""By rung, a circuit with one operating point, at node b, that no lower rung finds: a
saturating element of 1 A/uV without damping; an exponential of 20 mV from 0 V on; the same with a
loop that has no state at a fraction of the supply, where source stepping stops."""


LEAP = (
    "vleap high 0 1",
    "rleap high leap 1meg",
    "bleap leap 0 i = time > 60u ? 1e-6*tanh(200*(v(leap) - 0.5)) : 0",
)
"""A saturating law that begins at 60 us, at a node without charge: no sequence of steps leads from
1 V to its final value.
"""


def leap_v() -> float:
    """Return v(leap) after the leap: 1 - v = tanh(200 (v - 1/2))."""
    return float(mpmath.findroot(lambda v: 1 - v - mpmath.tanh(200 * (v - 0.5)), (0.5026, 0.5028)))


def needed_operating_point(rung: str) -> mpmath.mpf:
    """Return v(b) of a circuit of NEEDS in thirty digits."""
    with mpmath.workdps(30):
        if rung == "gmin_stepping":
            # with v = 1/2 + d: 1/2 - d = tanh(1e6 d) + 1e-9 exp(20 + 40 d), solved for the argument
            # of tanh
            def law(d: mpmath.mpf) -> mpmath.mpf:
                rest = mpmath.mpf(0.5) - d - mpmath.exp(20 + 40 * d) / 10**9
                return d - mpmath.atanh(rest) / 10**6

            lean = mpmath.findroot(law, (1e-8, 2e-8))
            return mpmath.mpf(0.5) + lean
        law = lambda v: (30 - v) / 10 - mpmath.mpf("1e-14") * (mpmath.exp(v / mpmath.mpf("0.02")) - 1)  # noqa: E731
        return mpmath.findroot(law, mpmath.mpf("0.66"))


def start(rung: str, engine: str) -> Measured:
    """Return the error of an operating point, which must be found on the rung."""
    if engine == "batch":
        found = batch(NEEDS[rung], ".tran 1n 10n", ["tran b find v(b) at=5n"])
        value, retries = found.values["b"], found.retries
        last = retries[-1].next if retries else None
    else:
        samples, way = lockstep(NEEDS[rung], ["b"], [1e-8], t_max_step_s=1e-9)
        value, retries, last = float(samples[-1, 0]), tuple(way.retries), way.level.name
    if last != rung:
        return Measured(1.0, f"ended on {last}, not on {rung}")
    return Measured(abs(value - float(needed_operating_point(rung))), _said(retries))


# ---- circuits without an answer ------------------------------------------------------------------------------------

FLOATING = ("v1 a 0 1", "c1 a b 1p", "c2 b 0 3p", "r1 a 0 1k")
LOOP = ("v1 a 0 1", "v2 a 0 2", "r1 a 0 1k")
RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = v(c) > 0.5 ? 0 : 1")
LATE_RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = time > 1.5e-6 ? (v(c) > 0.5 ? 0 : 1) : 0.2")
NOT_A_NUMBER = ("v1 a 0 1", "r1 a b 1k", "c1 b 0 1n", "bx c 0 v = time > 1.5e-6 ? 1e200*v(a)*1e200*v(a) : 0")


def no_answer(lines: Sequence[str], engine: str, *causes: str) -> Measured:
    """Check that a circuit without an answer ends with an error that names its cause."""
    if engine == "batch":
        return refused(lambda: batch(lines, ".tran 10n 3u 0 10n", ["tran a find v(a) at=1u"]), *causes)
    probe = "c" if any(line.startswith("bx c") for line in lines) else "a"
    return refused(lambda: lockstep(lines, [probe], [1e-6, 2e-6, 3e-6]), *causes)


CLASHES = {"element": "R1 b 0 1k", "block": "x1 b 0 no_such_block", "source": "v_d7 b 0 external"}


def clash(what: str) -> Measured:
    """Check the error of a name used in another case, a missing block, or a source that is not
    driven.
    """
    name = {"element": "already exists", "block": "no_such_block", "source": "v_d7"}[what]
    return refused(lambda: lockstep(["v1 a 0 1", "r1 a b 1k", CLASHES[what]], ["b"], [1e-6]), name)


def folded_case() -> Measured:
    """Check that names which differ in case only are one node."""
    samples, _ = lockstep(("v1 IN 0 1", "r1 in Mid 1k", "r2 mID 0 3k"), ["MID"], [1e-6])
    return Measured(abs(float(samples[0, 0]) - 0.75))


def nan_in(what: str) -> Measured:
    """Check that NaN is refused before a deck is written."""
    if what == "array":
        return refused(lambda: array_subckt(1, 2, [[math.nan, 1e3]]), "nan", "[0, 0]")
    data = {
        "array": {"rows": 1, "cols": 1},
        "stimulus": {"kind": "uniform", "code": [1]},
        "interface": {"v_bias_v": math.nan},
        "effects": {},
    }
    return refused(lambda: scene.from_data(data, Path("hard.toml")), "hard.toml", "v_bias_v", "nan")


# ---- transients with an exact solution -------------------------------------------------------------------------------


def gate_only(engine: str) -> Measured:
    """Solve an inverter in its linear region whose input is an ideal source at a gate."""
    lines = (
        ".model n nmos level=1 vto=0.5 kp=100u lambda=0",
        "vdd vdd 0 2",
        "vin g 0 1.5",
        "rload vdd out 100k",
        "m1 out g 0 0 n w=10u l=1u",
        TIGHT,
    )
    # (2 - v) / 100k = 1 mA/V^2 ((1.5 - 0.5) v - v^2 / 2), bulk at source: 50 v^2 - 101 v + 2 = 0
    exact = float((101 - mpmath.sqrt(101**2 - 400)) / 100)
    if engine == "batch":
        return Measured(abs(batch(lines, ".tran 1n 10n", ["tran v find v(out) at=5n"]).values["v"] - exact))
    return Measured(abs(float(lockstep(lines, ["out"], [1e-8])[0][0, 0]) - exact))


def divided_charge() -> Measured:
    """Check that a node between two capacitors with a given start follows an edge by their
    ratio.
    """
    lines = ("c1 d0 b 1p", "c2 b 0 3p", ".ic v(b)=0.25", TIGHT)
    times = [1e-6, 2e-6, 1e-5]
    samples, way = lockstep(lines, ["b"], times, {1e-6: [(0, 2.0)]}, levels=[0.0], use_ic=True)
    return Measured(float(np.max(np.abs(samples[:, 0] - [0.25, 0.75, 0.75]))), _said(way))


def closing_switch(abrupt: bool) -> Measured:
    """Charge a capacitor through a closing switch, then drain it by 1 uA: ringing would
    continue.
    """
    lines = (
        "bclose a b i = v(d0) > 0.95 ? (v(d0) - 0.95)*20*v(a,b)*1e3 : 0",
        "v1 a 0 1",
        "c1 b 0 5p",
        "iload b 0 1u",
        "rb b 0 1e15",
        ".nodeset v(d0)=1",
        TIGHT,
    )
    times = [k * 2e-7 for k in range(1, 16)]
    samples, way = lockstep(
        lines, ["b"], times, {times[4]: [(0, 0.0)]}, levels=[1.0], abrupt=[abrupt], t_max_step_s=1e-6
    )
    # It opens at the first of its edge; 1 mohm below 1 V until then.
    exact = [1.0 - 1e-9 if k <= 4 else 1.0 - 1e-6 * (t - times[4]) / 5e-12 for k, t in enumerate(times)]
    return Measured(float(np.max(np.abs(samples[:, 0] - exact))), _said(way))


def inconsistent_start() -> Measured:
    """Start two capacitors of 1 V and 0 V joined by 1 uohm, and one whose start contradicts its
    ideal source.
    """
    lines = (
        "c1 a 0 1p",
        "c2 b 0 1p",
        "rshort a b 1u",
        "vforce f 0 0.3",
        "c3 f 0 1p",
        ".ic v(a)=1 v(b)=0 v(f)=0.9",
        TIGHT,
    )
    samples, way = lockstep(lines, ["a", "b", "f"], [1e-9, 1e-7, 1e-6], use_ic=True)
    return Measured(float(np.max(np.abs(samples[1:] - [0.5, 0.5, 0.3]))), _said(way))


def supply_ramp() -> Measured:
    """Ramp the supply of a latch, one side of which has 10 Mohm to the supply and must win."""
    lines = (
        ".model n nmos level=1 vto=0.5 kp=100u",
        ".model p pmos level=1 vto=-0.5 kp=50u",
        "mp1 q p d0 d0 p w=2u l=1u",
        "mn1 q p 0 0 n w=1u l=1u",
        "mp2 p q d0 d0 p w=2u l=1u",
        "mn2 p q 0 0 n w=1u l=1u",
        "rhint d0 q 10meg",
        "cq q 0 10f",
        "cp p 0 10f",
        TIGHT,
    )
    samples, way = lockstep(
        lines, ["q", "p"], [1e-7, 2e-4], {1e-7: [(0, 2.0)]}, levels=[0.0], t_edge_s=1e-4, t_max_step_s=1e-6
    )
    # Both cut off: q at the supply, p at ground, except for gmin's 1e-12 S at two junctions each
    # against 10 Mohm or 30 kohm.
    return Measured(float(np.max(np.abs(samples[-1] - [2.0, 0.0]))), _said(way))


def switch_extremes() -> Measured:
    """Switch between 0 and 1e12 ohm into 1 Mohm, ten times."""
    lines = ("v1 a 0 1", "bswitch a b i = v(a,b)*(v(d0) > 0.5 ? 1e9 : 1e-12)", "rload b 0 1meg", TIGHT)
    times = [k * 1e-6 for k in range(1, 21)]
    edges = {t: [(0, float(k % 2))] for k, t in enumerate(times[:-1])}
    samples, way = lockstep(lines, ["b"], times, edges, levels=[0.0], abrupt=[True])
    on, off = float(1 / (1 + Fraction(1, 10**15))), float(Fraction(1, 10**6 + 1))
    exact = [off, *(on if k % 2 else off for k in range(19))]
    return Measured(float(np.max(np.abs(samples[:, 0] - exact))), _said(way))


def stiff_pair() -> Measured:
    """Charge a stage of 1 s through one of 1e-15 s, for a second."""
    # abstol and vntol are 1e-9 of the largest current (1 uA) and voltage (1 V)
    lines = (
        "r1 d0 a 1",
        "c1 a 0 1f",
        "r2 a b 1meg",
        "c2 b 0 1u",
        ".options reltol=1e-6 abstol=1e-15 vntol=1e-9",
    )
    times = [0.01, 0.1, 0.5, 1.01]
    samples, way = lockstep(
        lines, ["b", "a"], times, {0.01: [(0, 1.0)]}, levels=[0.0], t_edge_s=1e-9, t_max_step_s=1e-3
    )
    # a is 1 except for 1e-6 of the rest of b; b charges with 1 s, 1e-6 slower, from the middle of
    # the edge on.
    slow = mpmath.mpf(1) + mpmath.mpf("1e-6")
    exact_b = [0.0] + [
        float(1 - mpmath.exp(-(mpmath.mpf(repr(t)) - 0.01 - 0.5e-9) / slow)) for t in times[1:]
    ]
    return Measured(float(np.max(np.abs(samples[:, 0] - exact_b))), _said(way))


def gyrator(options: str) -> Measured:
    """Run two capacitors and a gyrator for ten periods of 1 us: amplitude and phase of the
    trapezoidal rule.
    """
    c = 1e-9
    g = 2 * math.pi * 1e6 * c
    lines = (
        f"g1 0 a b 0 {g!r}",
        f"g2 b 0 a 0 {g!r}",
        f"c1 a 0 {c}",
        f"c2 b 0 {c}",
        ".ic v(a)=1 v(b)=0",
        options,
    )
    times = [k * 1e-6 for k in range(1, 11)]
    samples, way = lockstep(lines, ["a"], times, t_max_step_s=2e-9, use_ic=True)
    return Measured(float(np.max(np.abs(samples[:, 0] - 1.0))), _said(way))


def huge_and_tiny() -> Measured:
    """Solve 1e30 V with 1e30 ohm, 1e-18 A into 1e18 ohm, and a volt; return relative errors."""
    lines = (
        "v1 a 0 1e30",
        "r1 a b 1e30",
        "r2 b 0 1",
        "i1 0 c 1e-18",
        "r3 c 0 1e18",
        "v3 e 0 1",
        "r4 e 0 1k",
        TIGHT,
    )
    samples, way = lockstep(lines, ["b", "c", "e"], [1e-6])
    return Measured(float(np.max(np.abs(samples[0] - 1.0))), _said(way))


# ---- whole chips -----------------------------------------------------------------------------------------------------

EXTREME_OHM = (0.0, 1e-3, 1.0, 249.0, 500.0, 510.0, 7.5e3, 123456.0, 1e6, 1e9, 1e12, 1e15)
BENT_OHM = (500.0, 510.0, 7.5e3, 1e6)
COLS = 4

CORNERS: dict[str, dict[str, Any]] = {
    "nominal": {},
    "low": {"v_bias_v": 0.4, "k": 40},
    "high": {"v_bias_v": 0.6, "k": 160},
}


def chip(
    topology: str,
    corner: str = "nominal",
    effects: Mapping[str, Any] | None = None,
    ohms: Sequence[float] = EXTREME_OHM,
) -> records.Plan:
    """Return a plan with these resistances in an array of four columns."""
    interface = {"topology": topology, **(CORNERS[corner] if topology != "direct" else {})}
    data = {
        "array": {"rows": len(ohms) // COLS, "cols": COLS},
        "stimulus": {"kind": "uniform", "code": [0]},
        "interface": interface,
        "effects": dict(effects or {}),
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), "cosim")
    ohm = np.array(ohms).reshape(1, -1, COLS)
    return replace(made, resistance_ohm=ohm, force_n=None)


def exact_codes(made: records.Plan) -> NDArray[np.int64]:
    """Return the codes of charge balance in exact rationals; a short is the floor of the design."""
    floor = load_design().array.r_floor_ohm
    interface = made.scene.table.interface
    unit = Fraction(repr(interface.v_bias_v)) / (interface.k * Fraction(repr(interface.i0_a)))
    gate = made.timing.gate_clocks
    codes = [
        min(vfc.count_rational(unit / Fraction(repr(max(r, floor))), gate), made.timing.code_max)
        for r in EXTREME_OHM
    ]
    return np.array(codes).reshape(1, -1, COLS)


def extremes(engine: str, topology: str, corner: str = "nominal") -> Measured:
    """Return the largest error of a code against charge balance."""
    made, note = chip(topology, corner), ""
    if engine == "lockstep":
        codes, way = read_frame(made)
        note = _said(way)
    else:
        codes = engine_modules.runner(engine)(made).codes.astype(np.int64)
    return Measured(float(np.abs(codes - exact_codes(made)).max()), note)


STEPS_S = {"step_100_ns": 1e-7, "step_1_us": 1e-6, "step_10_us": 1e-5}
BENDS = {"comparator_delay": {"t_s": 8e-9}, "integrator_bandwidth": {"gbw_hz": 5e6}}
# ten times the tolerances of netlist.py for a deck with poles
CHANGES = {
    **dict.fromkeys(STEPS_S, ""),
    "gear": ".options method=gear maxord=2",
    "reltol_ten_times": ".options reltol=1e-3",
    "all_tolerances_ten_times": ".options reltol=1e-3 abstol=1e-11 vntol=1e-6 chgtol=1e-13",
}


def unmoved(change: str, bent: bool) -> Measured:
    """Return the largest error of a code against charge balance (engine event, with poles) under a
    change.
    """
    made = chip("conveyor_mirror", effects=BENDS, ohms=BENT_OHM) if bent else chip("conveyor_mirror")
    codes, way = read_frame(made, CHANGES[change], STEPS_S.get(change, 1e-6))
    exact = engine_modules.runner("event")(made).codes.astype(np.int64) if bent else exact_codes(made)
    return Measured(float(np.abs(codes - exact).max()), _said(way))


def read_frame(
    made: records.Plan, options: str = "", t_max_step_s: float = 1e-6, begin: ladder.Level = ladder.PLAIN
) -> tuple[NDArray[np.int64], ladder.Climb]:
    """Return codes [1, rows, cols] of the first frame: its deck with row scanner and flip-flops in
    Python.
    """
    timing, rows, cols = made.timing, made.rows, made.cols
    deck = netlist.frame_deck(made, 0, [1.0] + [0.0] * (rows - 1) + [1.0] + [0.0] * cols)
    if options:
        deck = replace(deck, lines=(*deck.lines, options))
    t_clk = 1.0 / timing.f_clk_hz

    def attempt(level: ladder.Level) -> NDArray[np.int64]:
        half = NgspiceHalf(
            deck,
            t_edge_s=1e-9,
            t_max_step_s=t_max_step_s,
            t_stop_s=(rows * timing.slot_clocks - timing.break_clocks) * t_clk,
            log=folder / "ngspice.log",
            level=level,
        )
        counts = np.zeros((1, rows, cols), dtype=np.int64)
        first = second = np.zeros(cols, dtype=bool)
        edges: list[Edge] = []
        half.advance(0.0, [])
        # The deck starts where row 0 is driven.
        for clock in range(timing.break_clocks + 1, rows * timing.slot_clocks + 1):
            now = (clock - timing.break_clocks) * t_clk
            high = half.advance(now, edges)[:cols] > 0.0
            row, at = divmod(clock - 1, timing.slot_clocks)
            told, first = first, (high & ~first) & (at >= timing.settle_clocks)
            counts[0, row] += first
            edges = [(now, rows + 1 + int(c), float(told[c])) for c in np.flatnonzero(told != second)]
            second = told
            if at + 1 == timing.settle_clocks:
                edges.append((now, rows, 0.0))
            if at + 1 == timing.slot_clocks:
                edges += [(now, rows, 1.0), (now, row, 0.0)]
                at, row = -1, row + 1
            if at + 1 == timing.break_clocks and 0 < row < rows:
                edges.append((now, row, 1.0))
        half.close()
        return np.minimum(counts, timing.code_max)

    with _folder() as folder:
        way = ladder.Climb("hard chip", begin, report=lambda line: None)
        return ladder.climb(attempt, way), way


# ---- the cases -------------------------------------------------------------------------------------------------------

_FEMTO = "two roundings of a volt; vntol 1e-9 V and reltol 1e-6 are not used up by Newton's last step"
_OP = "reltol 1e-6 of the volt that Newton's method may leave, twice"
_NAMED = "an error that names its cause, exit 2 or 3; 0: it does, 1: it does not"
_COUNT = "counts are whole numbers"


def _both(function: Callable[..., Measured], *arguments: Any) -> dict[str, Callable[[], Measured]]:
    return {engine: functools.partial(function, *arguments, engine) for engine in ("lockstep", "batch")}


def _no_answer(name: str, lines: Sequence[str], causes: Sequence[str]) -> Case:
    runs = {e: functools.partial(no_answer, tuple(lines), e, *causes) for e in ("lockstep", "batch")}
    said = " and ".join(f'"{cause}"' for cause in causes)
    source = "Kirchhoff's laws: no state fulfils them, or every state does"
    text = {"expected": f"an error that says {said}", "source": source, "tolerance": _NAMED}
    return case("circuit", name, runs, unit="1", short=True, **text)


def cases() -> list[Case]:
    """Return every hard circuit."""
    lock = "lockstep"
    found = [
        case(
            "circuit",
            "transistor_converter",
            expected=f"{DUTY * GATE} packets in {GATE} clocks at x = {DUTY}, for {len(SIZES)} sizes of which "
            f"{len(ABORTING)} need a rung above plain; the same starting at rung gear",
            tolerance=_COUNT,
            limit=0.0,
            unit="packets",
            runs={
                lock: functools.partial(transistors, "plain", SIZES),
                "from_gear": functools.partial(transistors, "gear", ABORTING[::3]),
            },
        ),
        case(
            "circuit",
            "transistor_converter_plain",
            tolerance=_NAMED,
            limit=0.0,
            unit="1",
            runs={lock: transistors_plain},
            short=True,
        ),
        case(
            "circuit",
            "gate_only_source",
            tolerance=_OP,
            limit=4e-6,
            unit="V",
            runs=_both(gate_only),
            short=True,
        ),
        _no_answer("floating_node", FLOATING, ("singular matrix", " b")),
        case(
            "circuit",
            "divided_charge",
            tolerance=_FEMTO,
            limit=1e-8,
            unit="V",
            runs={lock: divided_charge},
            short=True,
        ),
        _no_answer("loop_of_sources", LOOP, ("singular matrix", "branch")),
        _no_answer("relay_that_contradicts_itself", RELAY, ("c", "tried")),
        _no_answer(
            "relay_that_contradicts_itself_later", LATE_RELAY, ("Timestep too small", "1.5", "tried", "gear")
        ),
        _no_answer("number_beyond_range", NOT_A_NUMBER, ("1.5", "tried")),
        case(
            "circuit",
            "name_clash",
            tolerance=_NAMED,
            limit=0.0,
            unit="1",
            runs={what: functools.partial(clash, what) for what in CLASHES},
            short=True,
        ),
        case(
            "circuit",
            "names_that_differ_in_case",
            tolerance=_FEMTO,
            limit=1e-9,
            unit="V",
            runs={lock: folded_case},
            short=True,
        ),
        case(
            "circuit",
            "not_a_number_in",
            tolerance=_NAMED,
            limit=0.0,
            unit="1",
            runs={"array": functools.partial(nan_in, "array"), "scene": functools.partial(nan_in, "scene")},
            short=True,
        ),
        case(
            "circuit",
            "closing_switch",
            limit=1e-6,
            unit="V",
            runs={lock: functools.partial(closing_switch, True)},
            short=True,
        ),
        case(
            "circuit",
            "inconsistent_start",
            limit=1.1e-4,
            unit="V",
            runs={lock: inconsistent_start},
            short=True,
        ),
        case("circuit", "supply_ramp", limit=2e-5, unit="V", runs={lock: supply_ramp}, short=True),
        case(
            "circuit",
            "switch_from_0_to_1e12_ohm",
            tolerance=_OP,
            limit=2e-6,
            unit="V",
            runs={lock: switch_extremes},
            short=True,
        ),
        case("circuit", "stiff_pair", limit=2e-6, unit="V", runs={lock: stiff_pair}, short=True),
        case(
            "circuit",
            "resonance_without_inductor",
            limit=8.5e-5,
            unit="V",
            runs={lock: functools.partial(gyrator, TIGHT)},
        ),
        case(
            "circuit", "huge_and_tiny_sources", limit=2e-6, unit="1", runs={lock: huge_and_tiny}, short=True
        ),
    ]
    for rung in NEEDS:
        expected = mpmath.nstr(needed_operating_point(rung), 12) + f" V on rung {rung}"
        text = {"expected": expected, "tolerance": _OP}
        found.append(
            case("circuit", f"needs_{rung}", _both(start, rung), limit=2e-6, unit="V", short=True, **text)
        )
    engines = ("closed", "event", "lockstep")
    for topology in TOPOLOGIES:
        runs = {e: functools.partial(extremes, e, topology) for e in engines}
        text = texts()["extreme_resistances"]
        found.append(case("circuit", f"extreme_resistances_{topology}", runs, tolerance=_COUNT, **text))
    for corner in ("low", "high"):
        runs = {e: functools.partial(extremes, e, "conveyor_mirror", corner) for e in engines}
        text = texts()["extreme_resistances"] | {"why": f"the same at {CORNERS[corner]}"}
        name = f"extreme_resistances_{corner}_corner"
        found.append(case("circuit", name, runs, tolerance=_COUNT, **text))
    for bent, name in ((False, "step_and_method_straight_lines"), (True, "step_and_method_poles")):
        runs = {change: functools.partial(unmoved, change, bent) for change in (CHANGES if bent else STEPS_S)}
        found.append(case("circuit", name, runs, tolerance=_COUNT))
    return found
