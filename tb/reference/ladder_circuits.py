# SPDX-License-Identifier: Apache-2.0
"""Circuits that need a rung of the ladder (docs/ladder.md), or have no answer, and their exact values."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import NDArray

from dermis.chip import ladder
from dermis.chip.analog import Edge
from dermis.chip.ngspice import Deck, NgspiceHalf

# Tolerances of the decks without a pole (netlist.py): Newton's method ends a step beyond them.
TIGHT = ".options reltol=1e-6 abstol=1e-13 vntol=1e-9"


def lockstep(
    lines: Sequence[str], probe: str, times: Sequence[float]
) -> tuple[NDArray[np.float64], ladder.Climb]:
    """Return samples of a node of a circuit at times (the last one ends the transient), and its rungs."""
    deck = Deck(("a hard circuit", *lines), (), (), (), (probe,))

    def attempt(level: ladder.Level) -> NDArray[np.float64]:
        half = NgspiceHalf(
            deck,
            t_edge_s=1e-9,
            t_max_step_s=min(1e-7, times[-1] / 10),
            t_stop_s=times[-1],
            log=folder / "ngspice.log",
            level=level,
        )
        half.advance(0.0, [])
        found = [half.advance(time, [])[0] for time in times]
        half.close()
        return np.array(found)

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        way = ladder.Climb("hard circuit", report=lambda line: None)
        return ladder.climb(attempt, way), way


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
    with tempfile.TemporaryDirectory() as folder:
        half = NgspiceHalf(
            deck,
            t_edge_s=1e-9,
            t_max_step_s=T_CLK_S,
            t_stop_s=(GATE + SETTLE) * T_CLK_S,
            log=Path(folder) / "ngspice.log",
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


ABORTING = (1, 2, 3, 5, 6, 7, 11, 12, 13)
"""Sizes of 0 to 13 at which plain ngspice aborts a step."""

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


# ---- circuits without an answer ----------------------------------------------------------------------------------

FLOATING = ("v1 a 0 1", "c1 a b 1p", "c2 b 0 3p", "r1 a 0 1k")
LOOP = ("v1 a 0 1", "v2 a 0 2", "r1 a 0 1k")
RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = v(c) > 0.5 ? 0 : 1")
LATE_RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = time > 1.5e-6 ? (v(c) > 0.5 ? 0 : 1) : 0.2")
