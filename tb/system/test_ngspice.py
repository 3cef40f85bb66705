# SPDX-License-Identifier: Apache-2.0
"""ngspice as an analog half on its own: what it refuses, and that it says so; a process a circuit."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

from dermis.scene.design import ROOT

RC = """
    from pathlib import Path
    from dermis.errors import SimulatorError
    from dermis.chip.ngspice import Deck, NgspiceHalf

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


def test_probes_that_are_late_are_looked_at_earlier(tmp_path: Path) -> None:
    """Two delays beside none, samples before time 0, edges before and behind what is looked at, and the record."""
    said = run(
        tmp_path,
        """
        import numpy as np
        def ramp(t):  # of d: up by 1 ns from 1.1 us, down from 1.7 us
            return float(np.interp(t, [1.1e-6, 1.101e-6, 1.7e-6, 1.701e-6], [0.0, 1.0, 1.0, 0.0]))
        late = (3e-7, 0.0, 8.995e-7)
        h = half(["rtwo d two 1", "rthree d three 1"], probes=("d", "two", "three"), t_stop=5e-6, late_s=late)
        print(*h.advance(0.0, []))
        edges = {2: [(1.1e-6, 0, 1.0), (1.7e-6, 0, 0.0)]}
        worst = 0.0
        for n in range(1, 6):
            t = n * 1e-6
            got = h.advance(t, edges.get(n, []))
            worst = max(worst, *(abs(got[p] - ramp(t - late[p])) for p in range(3)))
        print(worst, ramp(2e-6 - 8.995e-7))
        t, shown = h.waveform()
        for at in (1.4003e-6, 1.9e-6, 1.9995e-6):
            print(np.interp(at, t, shown["d"]) , np.interp(at, t, shown["two"]))
        """,
    )
    start, worst, *shown = said.splitlines()
    assert [float(v) for v in start.split()] == [0.0, 0.0, 0.0]
    off, half_way = map(float, worst.split())
    # One of them is looked at half way up the edge: 1e-6 of its nanosecond is rounding of the time.
    assert 0.4 < half_way < 0.6
    assert off < 1e-6
    # Up 0.3 us later than it is, and there still when it is down.
    assert [[round(float(v)) for v in line.split()] for line in shown] == [[0, 1], [1, 0], [1, 0]]


def test_a_probe_later_than_the_last_sample_and_one_that_is_early_are_refused(tmp_path: Path) -> None:
    said = run(
        tmp_path,
        """
        def refused(call):
            try:
                call()
            except ValueError as error:
                print("refused:", error)
        refused(lambda: half(late_s=(-1e-9,)))
        refused(lambda: half(late_s=(1e-9, 0.0)))
        h = half(late_s=(2e-6,))
        h.advance(0.0, [])
        h.advance(1e-6, [])
        refused(lambda: h.advance(2e-6, []))
        """,
    )
    assert said.count("refused:") == 3
    assert "a probe is 2e-06 s late, but the last sample is 1e-06 s ago" in said


def test_edges_outside_the_interval_or_into_a_ramp_are_refused(tmp_path: Path) -> None:
    late = run(tmp_path, "h = half(); h.advance(0.0, []); refused(lambda: h.advance(1e-6, [(2e-6, 0, 1.0)]))")
    assert "outside the interval" in late
    overlap = "[(0.5e-6, 0, 1.0), (0.5003e-6, 0, 0.0)]"
    early = run(tmp_path, f"h = half(); h.advance(0.0, []); refused(lambda: h.advance(1e-6, {overlap}))")
    assert "before the last one of its source has ended" in early


def test_a_source_nobody_drives_and_a_probe_that_is_not_there_are_refused(tmp_path: Path) -> None:
    stray = run(tmp_path, "h = half(['v_x x 0 external', 'r2 x 0 1k']); refused(lambda: h.advance(1e-6, []))")
    assert "v_x" in stray
    probe = run(tmp_path, "h = half(probes=('nowhere',)); refused(lambda: h.advance(1e-6, []))")
    assert "refused" in probe


def test_a_deck_with_an_error_is_refused_with_the_words_of_ngspice(tmp_path: Path) -> None:
    said = run(tmp_path, "refused(lambda: half(['x1 a b nosuchblock']).advance(1e-6, []))")
    assert "refused" in said
    assert "nosuchblock" in said


def test_going_beyond_the_end_is_refused(tmp_path: Path) -> None:
    said = run(tmp_path, "h = half(t_stop=1e-6); h.advance(1e-6, []); refused(lambda: h.advance(2e-6, []))")
    assert "beyond the end" in said


def test_a_circuit_given_up_blocks_the_next_of_its_process(tmp_path: Path) -> None:
    said = run(tmp_path, "h = half(); h.advance(1e-6, []); h.close(); refused(lambda: half())")
    assert "did not come to its end" in said


def test_the_driver_compiles_without_a_warning() -> None:
    source = ROOT / "models" / "dermis" / "chip" / "lockstep.c"
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-O2", "-D_GNU_SOURCE", "-fsyntax-only", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
