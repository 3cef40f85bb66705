# SPDX-License-Identifier: Apache-2.0
"""Time erodes nothing: counters, charges and phases after 10^12 clocks, 55 hours, are those of exact arithmetic."""

import dataclasses
import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest

from dermis import plan as planning
from dermis.converter import vfc
from dermis.engines import event
from dermis.records import Drive

Write = Callable[..., Path]

LONG = 10**12
FRAMES = 10**8  # of 10^4 clocks


def test_a_count_of_1e12_clocks_is_that_of_exact_rationals() -> None:
    rng = np.random.default_rng(1)
    # The doubles next to where the count changes, of duties that the exact formula of count_rational covers.
    x = (rng.integers(0, LONG // 2, 400) + 0.5) / LONG
    exact = [vfc.count_rational(Fraction(v), LONG) for v in x]
    assert vfc.count(x, LONG).tolist() == exact
    # A product in doubles is off by up to 3e-5 there, and counts wrong.
    assert sum(math.floor(LONG * v - 0.5) + 1 != e for v, e in zip(x, exact, strict=True)) > 50


@pytest.mark.parametrize("frequency", [1234.5, 1e6 / 3, 2.4999e6, 1e-3])
@pytest.mark.parametrize("t_frame_s", [0.002, 0.032])
def test_a_ripple_after_1e12_clocks_has_the_phase_of_60_digits(frequency: float, t_frame_s: float) -> None:
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
    # A whole number of turns of every decimal frequency.
    late = dataclasses.replace(first, first_frame=10**10)
    assert late.first_frame * first.rows * first.timing.slot_clocks > LONG
    assert (event.run(first).info["x"] == event.run(late).info["x"]).all()
    off = dataclasses.replace(first, first_frame=10**10 + 1)
    assert (event.run(first).info["x"] != event.run(off).info["x"]).any()
