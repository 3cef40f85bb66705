# SPDX-License-Identifier: Apache-2.0
"""Circuits that need a rung of the ladder (docs/ladder.md), or have no answer, and their exact values."""

from collections.abc import Sequence
from pathlib import Path

import mpmath
import numpy as np

from dermis.lockstep import ladder
from dermis.lockstep.ngspice import Deck, NgspiceHalf
from dermis.ndarrays import Floats

# Tolerances of the decks without a pole (netlist.py): Newton's method ends a step beyond them.
TIGHT = ".options reltol=1e-6 abstol=1e-13 vntol=1e-9"


def half_of(
    lines: Sequence[str], probe: str, step_s: float, t_stop_s: float, **how: ladder.Level
) -> NgspiceHalf:
    """Return a circuit without sources of the digital side."""
    deck, log = Deck(("circuit", *lines), (), (), (), (probe,)), Path("/dev/null")
    return NgspiceHalf(deck, t_edge_s=1e-9, t_max_step_s=step_s, t_stop_s=t_stop_s, log=log, **how)


def lockstep(lines: Sequence[str], probe: str, times: Sequence[float]) -> tuple[Floats, ladder.Climb]:
    """Return samples of a node of a circuit at times (the last one ends the transient), and its rungs."""

    def attempt(level: ladder.Level) -> Floats:
        half = half_of(lines, probe, min(1e-7, times[-1] / 10), times[-1], level=level)
        half.advance(0.0, [])
        found = [half.advance(time, [])[0] for time in times]
        half.close()
        return np.array(found)

    way = ladder.Climb("hard circuit", report=lambda line: None)
    return ladder.climb(attempt, way), way


_DIODE = "bx b 0 i = 1e-14*(exp(v(b)/0.02) - 1)"
_LOCKED = "bo o 0 v = (v(a) > 0.5 && v(a) < 29.5) ? (v(n) > 0.5 ? 0 : 1) : 0.2"
NEEDS = {
    "gmin_stepping": ("v1 a 0 1", "r1 a b 1k", "bx b 0 i = 1e-3*tanh(1e6*(v(b) - 0.5)) + 1e-12*exp(40*v(b))"),
    "source_stepping": ("v1 a 0 30", "r1 a b 10", _DIODE, TIGHT),
    "ramp": ("v1 a 0 30", "r1 a b 10", _DIODE, _LOCKED, "r2 o n 1k", "c2 n 0 1n", TIGHT),
}
"""By rung, a circuit with one operating point, at node b, that no lower rung finds: a saturating
element of 1 A/uV; an exponential of 20 mV from 0 V on; the same with a loop that has no state at a
fraction of the supply, where source stepping stops."""


LEAP = (
    "vleap high 0 1",
    "rleap high leap 1meg",
    "bleap leap 0 i = time > 60u ? 1e-6*tanh(200*(v(leap) - 0.5)) : 0",
)
"""A saturating law that begins at 60 us at a node without charge: no steps lead from 1 V to its end."""


def leap_v() -> float:
    """Return v(leap) after the leap: 1 - v = tanh(200 (v - 1/2))."""
    return float(mpmath.findroot(lambda v: 1 - v - mpmath.tanh(200 * (v - 0.5)), (0.5026, 0.5028)))


def needed_operating_point(rung: str) -> mpmath.mpf:
    """Return v(b) of a circuit of NEEDS in thirty digits."""
    with mpmath.workdps(30):
        if rung == "gmin_stepping":
            # With v = 1/2 + d: 1/2 - d = tanh(1e6 d) + 1e-9 exp(20 + 40 d), solved for that of tanh.
            def law(d: mpmath.mpf) -> mpmath.mpf:
                return d - mpmath.atanh(0.5 - d - mpmath.exp(20 + 40 * d) / 10**9) / 10**6

            return 0.5 + mpmath.findroot(law, (1e-8, 2e-8))

        def kirchhoff(v: mpmath.mpf) -> mpmath.mpf:
            return (30 - v) / 10 - mpmath.mpf("1e-14") * (mpmath.exp(v / mpmath.mpf("0.02")) - 1)

        return mpmath.findroot(kirchhoff, mpmath.mpf("0.66"))


FLOATING = ("v1 a 0 1", "c1 a b 1p", "c2 b 0 3p", "r1 a 0 1k")
RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = v(c) > 0.5 ? 0 : 1")
LATE_RELAY = ("v1 a 0 1", "r1 a 0 1k", "bx c 0 v = time > 1.5e-6 ? (v(c) > 0.5 ? 0 : 1) : 0.2")
