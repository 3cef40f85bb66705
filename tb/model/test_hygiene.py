# SPDX-License-Identifier: Apache-2.0
"""Numbers stay clean: numpy raises, no unbounded source or step reaches ngspice, every tolerance has a reason."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tolerances

from dermis.scene.design import ROOT
from scripts.markdown import filled


def test_numpy_raises_in_every_test() -> None:
    with pytest.raises(FloatingPointError):
        np.divide(1.0, np.zeros(1))


def test_no_tolerance_and_no_swallowed_exception_is_without_a_reason() -> None:
    assert "".join(f"{finding}\n" for finding in tolerances.findings(tolerances.files())) == ""


# Text, and how many findings it must make: the tolerances in it are the seeded faults.
PYTHON = {
    "assert got == pytest.approx(want, rel=1e-9)": 1,
    "assert got == pytest.approx(want, rel=1e-9)  # nine digits are printed": 0,
    "# nine digits are printed\n\nassert got == pytest.approx(want, rel=1e-9)": 1,
    "# nine digits\nassert a == approx(b, rel=1e-9)\nassert c == approx(d, rel=1e-9)": 0,
    "# nine digits\nassert a == approx(b, rel=1e-9)\nx = 1\nassert c == approx(d, rel=1e-9)": 1,
    "assert got == pytest.approx(want, rel=1e-9), 'nine digits are printed'": 0,
    "assert 0.02 > abs(a - b)": 1,
    "assert abs(a - b) > 3": 0,
    "assert a < 1e-9 * b": 1,
    "assert np.allclose(a, b)": 1,
    "NEAR = 0.5\nassert abs(a - b) < NEAR": 1,
    "NEAR = 0.5  # half a count\nassert abs(a - b) < NEAR": 0,
    "try:\n    f()\nexcept ValueError:\n    pass": 1,
    "try:\n    f()\nexcept ValueError:\n    pass  # it was gone already": 0,
    "try:\n    f()\nexcept:\n    g()": 1,
    "try:\n    f()\nexcept Exception:\n    g()\n    raise": 0,
    "with suppress(OSError):  # noqa: SIM105\n    f()": 1,
}


@pytest.mark.parametrize("text", PYTHON)
def test_a_seeded_fault_is_listed(text: str) -> None:
    assert len(tolerances.in_python("seeded.py", text + "\n")) == PYTHON[text]


LOCKSTEP = """
import sys
from pathlib import Path
from dermis.lockstep import ngspice
from dermis.errors import SimulatorError
from dermis.lockstep.ngspice import Deck, NgspiceHalf

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
if sys.argv[1].endswith("seeded.c"):
    library.unlink()
"""


# Text of lockstep.c, a fault in its place, and the message that it must lead to.
FAULTS = {
    "none": ("", "", "fine"),
    "source": ("return s->to;", "return s->to / (s->t_edge - s->t_edge);", "source v_d is "),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_seeded_division_by_zero_in_the_lock_step_is_an_error(tmp_path: Path, fault: str) -> None:
    path = ROOT / "models/dermis/lockstep/lockstep.c"
    right, wrong, message = FAULTS[fault]
    if fault != "none":
        text = filled(path.read_text(encoding="utf-8"), {right: wrong}, path.name)
        path = tmp_path / "seeded.c"
        path.write_text(text)
    found = subprocess.run(
        [sys.executable, "-c", LOCKSTEP, str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert found.returncode == 0, found.stderr
    assert message in found.stdout
