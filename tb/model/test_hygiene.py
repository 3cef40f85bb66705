# SPDX-License-Identifier: Apache-2.0
"""Numbers stay clean: numpy raises, and no unbounded source or step reaches ngspice."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dermis.scene.design import ROOT
from scripts.markdown import filled


def test_numpy_raises_in_every_test() -> None:
    with pytest.raises(FloatingPointError):
        np.divide(1.0, np.zeros(1))


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
