# SPDX-License-Identifier: Apache-2.0
"""Numbers stay clean: flags of compiled code are errors, every tolerance says why, time erodes nothing."""

from __future__ import annotations

import subprocess
import sys

import numba
import numpy as np
import pytest

from dermis import float_flags

# --- floating-point flags --------------------------------------------------------------------------------------------


@numba.njit(error_model="numpy")
def quotient(a: float, b: float) -> float:
    """What numpy's errstate does not see."""
    return a / b


@pytest.mark.parametrize(
    ("a", "b", "flag"),
    [(1.0, 0.0, "divide by zero"), (0.0, 0.0, "invalid"), (1e300, 1e-300, "overflow"), (1.0, 3.0, None)],
)
def test_a_seeded_flag_of_a_compiled_loop_is_an_error(a: float, b: float, flag: str | None) -> None:
    quotient(1.0, 2.0)  # compiled before it is watched
    if flag is None:
        with float_flags.watch("quotient"):
            assert quotient(a, b) > 0
        return
    with pytest.raises(FloatingPointError, match=f"{flag} in quotient"), float_flags.watch("quotient"):
        quotient(a, b)


def test_a_flag_from_before_is_not_blamed_on_what_is_watched() -> None:
    quotient(1.0, 0.0)
    with float_flags.watch("nothing"):
        pass


def test_an_error_inside_is_not_hidden_by_its_flag() -> None:
    with pytest.raises(KeyError), float_flags.watch("quotient"):
        quotient(1.0, 0.0)
        raise KeyError


def test_numpy_raises_in_every_test() -> None:
    with pytest.raises(FloatingPointError):
        np.divide(1.0, np.zeros(1))


def test_flags_cost_nothing_where_nobody_asks_for_them() -> None:
    told = "from dermis import float_flags as f; assert f.watch('a') is f.watch('b'); assert not f.wanted()"
    found = subprocess.run([sys.executable, "-c", told], env={}, capture_output=True, text=True, timeout=60)
    assert found.returncode == 0, found.stderr
