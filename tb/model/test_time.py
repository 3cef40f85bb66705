# SPDX-License-Identifier: Apache-2.0
"""Time erodes nothing: counters, charges and phases after 10^12 clocks, 55 hours, are those of exact arithmetic."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest

from dermis import plan as planning
from dermis.chip import netlist
from dermis.converter import noise, vfc, walk
from dermis.converter.walk import Cells, count_cells
from dermis.engines import event
from dermis.records import Drive

Write = Callable[..., Path]

LONG = 10**12
FRAMES = 10**8  # of 10^4 clocks


def cells(x: np.ndarray, **fields: float) -> Cells:
    """Converters that are ideal but for some fields."""
    ideal = {f.name: 0.0 for f in dataclasses.fields(Cells)} | {"w0": -0.5, "packet": 1.0}
    ideal |= {"low": -np.inf, "high": np.inf} | fields
    return Cells(**{name: np.broadcast_to(v, x.shape) for name, v in (ideal | {"x": x}).items()})


def test_a_count_of_1e12_clocks_is_that_of_exact_rationals() -> None:
    rng = np.random.default_rng(1)
    # The doubles next to where the count changes, of duties that the exact formula of count_rational covers.
    x = (rng.integers(0, LONG // 2, 400) + 0.5) / LONG
    exact = [vfc.count_rational(Fraction(v), LONG) for v in x]
    assert vfc.count(x, LONG).tolist() == exact
    # A product in doubles is off by up to 3e-5 there, and counts wrong.
    assert sum(math.floor(LONG * v - 0.5) + 1 != e for v, e in zip(x, exact, strict=True)) > 50


def test_the_formula_in_integers_is_the_one_in_doubles_where_both_hold() -> None:
    rng = np.random.default_rng(2)
    for clocks in (37, 510, vfc.LONGEST_GATE):
        x, w0 = rng.uniform(-0.3, 1.3, 300), rng.uniform(-1.5, 1.5, 300)
        packet = rng.uniform(0.8, 1.2, 300)
        x[:3] = np.inf, -np.inf, 0.0
        found = [vfc._count_of_rationals(clocks, *cell, 0.1) for cell in zip(x, w0, packet, strict=True)]
        assert found == vfc.count(x, clocks, w0=w0, packet=packet, threshold=0.1).tolist()


def exact_end_miss(clocks: int, **fields: float) -> float:
    """How far the charge that the event loop ends with is off what exact arithmetic leaves, packets aside."""
    x = np.array([0.123456789, 1 / 3, 0.1, math.pi / 7, 0.49999, 1e-6, 0.0123])
    packet = Fraction(fields.get("packet", 1.0))
    _, end = count_cells(cells(x, **fields), clocks, 1.0)
    left = [Fraction(-1, 2) + clocks * Fraction(v) - Fraction(w) for v, w in zip(x, end, strict=True)]
    return max(float(abs(w - round(w / packet) * packet)) for w in left)


# The second pair has a range that is never met: another loop.
@pytest.mark.parametrize(
    "fields", [{}, {"packet": 1.0123}, {"low": -100.0}, {"low": -100.0, "packet": 1.0123}]
)
def test_the_event_loop_s_charge_is_as_exact_after_5e6_clocks_as_after_1e5(fields: dict[str, float]) -> None:
    # One rounding of a charge of a packet, whatever the length; without carrying on it is 5.5e-17 a clock, 3e-10 here.
    assert exact_end_miss(100_000, **fields) < 1.2e-16
    assert exact_end_miss(5_000_000, **fields) < 1.2e-16


def test_a_loop_that_drops_what_it_rounds_off_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "LONGEST_GATE", 10**9)
    # A hundred times the tolerance of the test above.
    assert exact_end_miss(1_000_000) > 1e-14


def test_a_leak_of_many_time_constants_forgets_what_rounds_off() -> None:
    """A leaky integrator settles at x / leak, to rounding, after 3e6 clocks and 3e2 time constants."""
    x = np.array([1e-5])
    _, end = count_cells(cells(x, leak=1e-4, rise=1.0, fall=1.0), 3_000_000, 1.0)
    # Four roundings: of exp, of the difference from 1, of the quotient and of the sum.
    assert end[0] == pytest.approx(0.1, rel=5e-16)


@pytest.mark.parametrize("frequency", [1234.5, 1e6 / 3, 2.4999e6, 1e-3])
@pytest.mark.parametrize("t_frame_s", [0.002, 0.032])
def test_the_phase_of_a_ripple_after_1e12_clocks_is_that_of_60_digits(
    frequency: float, t_frame_s: float
) -> None:
    drive = Drive(t_frame_s, 0.01, frequency)
    plain = 0.0
    for frame, clocks in ((FRAMES, 0), (FRAMES + 1, 625 * 15), (FRAMES - 1, 3)):
        with mpmath.workdps(60):
            seconds = frame * mpmath.mpf(repr(t_frame_s)) + mpmath.mpf(clocks) / 5_000_000
            turns = mpmath.mpf(repr(frequency)) * seconds
            exact = turns - mpmath.floor(turns)
            miss = float(abs(drive.turns(frame, clocks, 5e6) - exact))
            plain = max(plain, float(abs(frequency * (frame * t_frame_s + clocks / 5e6) % 1.0 - exact)))
        # one rounding of a number below 1
        assert miss < 1.2e-16
    assert frequency < 1 or plain > 1e-9, "seconds in doubles would do as well"


RIPPLE = """
[array]
rows = 2
cols = 3
[stimulus]
kind = "uniform"
code = [30, 200]
[effects]
supply_ripple = { relative = 0.05, frequency_hz = 12345.0, phase_deg = 10 }
"""


def test_frames_after_1e12_clocks_read_as_the_first_ones(write_scene: Write) -> None:
    first = planning.load(write_scene(RIPPLE), "event")
    late = dataclasses.replace(
        first, first_frame=10**10
    )  # a whole number of turns of every decimal frequency
    assert late.first_frame * first.rows * first.timing.slot_clocks > LONG
    assert (event.run(first).info["x"] == event.run(late).info["x"]).all()
    off = dataclasses.replace(first, first_frame=10**10 + 1)
    assert (event.run(first).info["x"] != event.run(off).info["x"]).any()


def test_a_deck_s_ripple_goes_by_the_frame_time_of_the_recording(write_scene: Write) -> None:
    """Frames of 32 ms: the ripple stands 32 ms, not one read-out, further on in each, as in engine event."""
    plan = planning.load(write_scene(RIPPLE), "cosim")
    slow = dataclasses.replace(plan, drive=dataclasses.replace(plan.drive, t_frame_s=0.0321))
    levels = [1.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    late = plan.timing.break_clocks / plan.timing.f_clk_hz
    for frame in (0, 1):
        line = next(li for li in netlist.frame_deck(slow, frame, levels).lines if li.startswith("vbias "))
        degrees = float(line.rstrip(")").split()[-1])
        expected = (10 / 360 + 12345.0 * (frame * 0.0321 + late)) % 1
        # some hundred turns in doubles, written in degrees with 15 digits
        assert degrees / 360 % 1 == pytest.approx(expected, abs=1e-12)


def test_random_numbers_of_late_frames_are_those_of_their_number() -> None:
    late = noise.cell_keys(3, LONG, (2, 4, 5))
    assert (noise.cell_keys(3, LONG + 1, (1, 4, 5))[0] == late[1]).all()
    assert np.unique(late).size == late.size
