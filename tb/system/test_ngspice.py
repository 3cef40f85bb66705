# SPDX-License-Identifier: Apache-2.0
"""ngspice as an analog half on its own: what it refuses, and that it says so; a process a circuit."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from dermis.scene.design import ROOT

RC = """
    from pathlib import Path
    from dermis.errors import SimulatorError
    from dermis.lockstep.ngspice import Deck, NgspiceHalf

    def half(lines=(), sources=("v_d",), probes=("out",), t_stop=1e-5, **more):
        deck = Deck(("test", "v_d d 0 external", "r1 d out 1k", "c1 out 0 1n", *lines), sources, (0.0,) * len(sources),
                    (False,) * len(sources), probes, **more)
        return NgspiceHalf(deck, t_edge_s=1e-9, t_max_step_s=1e-7, t_stop_s=t_stop, log=Path("ngspice.log"),
                           record=bool(more))

    def refused(call):
        try:
            call()
        except SimulatorError as error:
            print("refused:", error)
        else:
            print("accepted")
"""


def run(tmp_path: Path, code: str) -> str:
    """Run a few lines after RC in a process of their own; return what they print."""
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(RC) + textwrap.dedent(code))
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_an_rc_charges_as_the_formula_says(tmp_path: Path) -> None:
    said = run(
        tmp_path,
        """
        import math
        h = half(t_stop=4e-6)
        h.advance(0.0, [])
        v = [float(h.advance(t, edges)[0]) for t, edges in ((1e-6, []), (2e-6, [(1e-6, 0, 1.0)]), (4e-6, []))]
        print(v[0], v[1] - (1 - math.exp(-(1e-6 - 0.5e-9) / 1e-6)), v[2] - (1 - math.exp(-(3e-6 - 0.5e-9) / 1e-6)))
        """,
    )
    before, one, three = map(float, said.split())
    # Nothing has happened: vntol. Then an exponential in ngspice's default tolerances, reltol 1e-3 of 1 V,
    # twice.
    assert abs(before) < 1e-9
    assert abs(one) < 2e-3
    assert abs(three) < 2e-3


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (
            "h = half(); h.advance(0.0, []); refused(lambda: h.advance(1e-6, [(2e-6, 0, 1.0)]))",
            "outside the interval",
        ),
        (
            "h = half(); h.advance(0.0, []);"
            " refused(lambda: h.advance(1e-6, [(0.5e-6, 0, 1.0), (0.5003e-6, 0, 0.0)]))",
            "before the last one of its source has ended",
        ),
        ("h = half(['v_x x 0 external', 'r2 x 0 1k']); refused(lambda: h.advance(1e-6, []))", "v_x"),
        ("h = half(probes=('nowhere',)); refused(lambda: h.advance(1e-6, []))", "refused"),
        ("refused(lambda: half(['x1 a b nosuchblock']).advance(1e-6, []))", "nosuchblock"),
        (
            "h = half(t_stop=1e-6); h.advance(1e-6, []); refused(lambda: h.advance(2e-6, []))",
            "beyond the end",
        ),
        # The circuit that was given up stays in its process.
        ("h = half(); h.advance(1e-6, []); h.close(); refused(lambda: half())", "did not come to its end"),
    ],
)
def test_misuse_is_refused_with_the_words_of_ngspice(tmp_path: Path, code: str, said: str) -> None:
    found = run(tmp_path, code)
    assert "refused:" in found
    assert said in found


def test_the_driver_compiles_without_a_warning() -> None:
    sources = [str(path) for path in (ROOT / "models" / "dermis" / "lockstep").glob("*.c")]
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-O2", "-D_GNU_SOURCE", "-fsyntax-only", *sources]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
