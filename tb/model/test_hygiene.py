# SPDX-License-Identifier: Apache-2.0
"""Numbers stay clean: flags of compiled code are errors, every tolerance says why, time erodes nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
import tolerances

from dermis.array import float_flags
from dermis.scene.design import ROOT

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
    def fails() -> None:
        with float_flags.watch("quotient"):
            quotient(1.0, 0.0)
            raise KeyError

    with pytest.raises(KeyError):
        fails()


def test_numpy_raises_in_every_test() -> None:
    with pytest.raises(FloatingPointError):
        np.divide(1.0, np.zeros(1))


def test_flags_cost_nothing_where_nobody_asks_for_them() -> None:
    told = "from dermis.array import float_flags as f; assert f.watch('a') is f.watch('b'); assert not f.wanted()"
    found = subprocess.run([sys.executable, "-c", told], env={}, capture_output=True, text=True, timeout=60)
    assert found.returncode == 0, found.stderr


# --- tolerances ------------------------------------------------------------------------------------------------------


def test_no_tolerance_and_no_swallowed_exception_is_without_a_reason() -> None:
    assert "".join(f"{finding}\n" for finding in tolerances.findings(tolerances.files())) == ""


# Text, and how many findings it must make: the tolerances in it are the seeded faults. So in the two tables below.
PYTHON = {
    "assert got == pytest.approx(want, rel=1e-9)": 1,
    "assert got == pytest.approx(want, rel=1e-9)  # nine digits are printed": 0,
    "# nine digits are printed\nassert got == pytest.approx(want, rel=1e-9)": 0,
    "# nine digits are printed\n\nassert got == pytest.approx(want, rel=1e-9)": 1,
    "# nine digits\nassert a == approx(b, rel=1e-9)\nassert c == approx(d, rel=1e-9)": 0,
    "# nine digits\nassert a == approx(b, rel=1e-9)\nx = 1\nassert c == approx(d, rel=1e-9)": 1,
    "assert got == pytest.approx(want, rel=1e-9), 'nine digits are printed'": 0,
    "assert got == pytest.approx(want, rel=1e-9), f'{got}'": 1,
    "assert abs(a - b) < 0.02": 1,
    "assert np.abs(a - b).max() <= 1": 1,
    "assert 0.02 > abs(a - b)": 1,
    "assert abs(a - b) > 3": 0,
    "assert abs(a) < 1e300": 0,
    "assert a < 1e-9 * b": 1,
    "assert a < 5": 0,
    "assert np.allclose(a, b)": 1,
    "assert got == pytest.approx(want)": 0,
    "root = brentq(f, 0, 1, xtol=1e-12)": 1,
    "NEAR = 0.5\nassert abs(a - b) < NEAR": 1,
    "NEAR = 0.5  # half a count\nassert abs(a - b) < NEAR": 0,
    "x = solve(\n    f,\n    rtol=1e-9,  # the peer's own\n)": 0,
    "OPTIONS = {'reltol': 1e-6}": 1,
    "line = '.options reltol=1e-6'": 1,
    "x = 1e-9 * y": 0,
    "try:\n    f()\nexcept ValueError:\n    pass": 1,
    "try:\n    f()\nexcept ValueError:\n    pass  # it was gone already": 0,
    "try:\n    f()\nexcept ValueError:\n    g()": 0,
    "try:\n    f()\nexcept:\n    g()": 1,
    "try:\n    f()\nexcept Exception:\n    g()": 1,
    "try:\n    f()\nexcept Exception:\n    g()\n    raise": 0,
    "with suppress(OSError):\n    f()": 1,
    "with suppress(OSError):  # it was gone already\n    f()": 0,
    "with suppress(OSError):  # noqa: SIM105\n    f()": 1,
}


@pytest.mark.parametrize("text", PYTHON)
def test_a_seeded_fault_in_python_is_listed(text: str) -> None:
    assert len(tolerances.in_python("seeded.py", text + "\n")) == PYTHON[text]


C = {
    "if (fabs(a - b) < 1e-12)": 1,
    "if (fabs(a - b) < 1e-12) /* a dozen roundings */": 0,
    "/* a dozen\n   roundings */\nif (fabs(a - b) < 1e-12)": 0,
    "/* a dozen roundings */\nx = 1;\nif (fabs(a - b) < 1e-12)": 1,
    "// a dozen roundings\nif (a < 1.0e-12)": 0,
    "x = 1e-12 * y;": 0,
    'puts("< 1e-12");': 0,
    "/* if (a < 1e-12) */": 0,
}


@pytest.mark.parametrize("text", C)
def test_a_seeded_fault_in_c_or_systemverilog_is_listed(text: str) -> None:
    assert len(tolerances.in_c("seeded.c", text + "\n")) == C[text]


# Seeded faults, as above.
SPICE = {
    ".options reltol=1e-6": 1,
    "* options: tight, for a straight line\n.options reltol=1e-6": 0,
    "* options\n.options reltol=1e-6": 1,
    ".options reltol = 1e-6 ; tight, for a straight line": 0,
    ".options method=gear": 0,
}


@pytest.mark.parametrize("text", SPICE)
def test_a_seeded_fault_in_a_deck_is_listed(text: str) -> None:
    assert len(tolerances.in_spice("seeded.sp", text + "\n")) == SPICE[text]


LOCKSTEP = """
import sys
from pathlib import Path
from dermis.chip import ngspice
from dermis.errors import SimulatorError
from dermis.chip.ngspice import Deck, NgspiceHalf

ngspice.SOURCE = Path(sys.argv[1])
library = ngspice.library()
deck = Deck(("test", "v_d d 0 external", "r1 d out 1k", "c1 out 0 1n"), ("v_d",), (0.0,), (False,), ("out",))
half = NgspiceHalf(deck, t_edge_s=1e-9, t_max_step_s=1e-7, t_stop_s=1e-5, log=Path("ngspice.log"))
try:
    half.advance(0.0, [])
    half.advance(2e-6, [(1e-6, 0, 1.0)])
    print("fine")
except SimulatorError as error:
    print(error)
if sys.argv[1] == "seeded.c":
    library.unlink()
"""


@pytest.mark.parametrize("seeded", [False, True])
def test_a_seeded_divide_in_the_lock_step_is_an_error(tmp_path: Path, seeded: bool) -> None:
    source = (ROOT / "models/dermis/chip/lockstep.c").read_text(encoding="utf-8")
    right = "if (t <= s->t)"
    assert source.count(right) == 1
    # it changes no value: infinity is positive
    wrong = "if (t <= s->t && 1.0 / (s->from - s->from) > 0.0)"
    (tmp_path / "seeded.c").write_text(source.replace(right, wrong))
    path = "seeded.c" if seeded else str(ROOT / "models/dermis/chip/lockstep.c")
    found = subprocess.run(
        [sys.executable, "-c", LOCKSTEP, path], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert found.returncode == 0, found.stderr
    if seeded:
        assert "floating-point exception in on_source of lockstep.c" in found.stdout
    else:
        assert found.stdout == "fine\n"
