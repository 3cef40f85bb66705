# SPDX-License-Identifier: Apache-2.0
"""ngspice as an analog half on its own: what it refuses, and that it says so; a process a circuit."""

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from dermis.lockstep import ngspice
from dermis.scene.design import ROOT

RC = """
    import math
    from pathlib import Path
    from dermis.errors import DermisError
    from dermis.lockstep.ngspice import Deck, NgspiceHalf

    def half(lines=(), sources=("v_d",), probes=("out",), t_stop=1e-5, **more):
        deck = Deck(("test", "v_d d 0 external", "r1 d out 1k", "c1 out 0 1n", *lines), sources, (0.0,) * len(sources),
                    (False,) * len(sources), probes, **more)
        return NgspiceHalf(deck, t_edge_s=1e-9, t_max_step_s=1e-7, t_stop_s=t_stop, log=Path("ngspice.log"),
                           record=bool(more))

    def refused(call):
        try:
            call()
        except DermisError as error:
            print("refused:", error.exit_code, error)
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


AT_0 = "h = half(); h.advance(0.0, []); "
TO_1U = "h = half(); h.advance(1e-6, []); "


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (AT_0 + "refused(lambda: h.advance(1e-6, [(2e-6, 0, 1.0)]))", "outside the interval"),
        (AT_0 + "refused(lambda: h.advance(1e-6, [(1e-7, 1, 1.0)]))", "or is of no source"),
        (AT_0 + "refused(lambda: h.advance(1e-6, [(math.nan, 0, 1.0)]))", "outside the interval"),
        (AT_0 + "refused(lambda: h.advance(1e-6, [(1e-7, 0, math.inf)]))", "source v_d is inf"),
        (AT_0 + "refused(lambda: h.advance(1e-6, [(1e-7, 0, 1.0)] * 4097))", "more than 4096 edges"),
        (
            AT_0 + "refused(lambda: h.advance(1e-6, [(0.5e-6, 0, 1.0), (0.5003e-6, 0, 0.0)]))",
            "before the last one of its source has ended",
        ),
        ("h = half(['v_x x 0 external', 'r2 x 0 1k']); refused(lambda: h.advance(1e-6, []))", "v_x"),
        ("refused(lambda: half(['x1 a b nosuchblock']).advance(1e-6, []))", "nosuchblock"),
        ("h = half(t_stop=1e-6); h.advance(1e-6, []); refused(lambda: h.advance(2e-6, []))", "beyond the end"),
        (TO_1U + "refused(lambda: half())", "did not come to its end"),
        # A process has another circuit after one that was given up or refused.
        (
            TO_1U + "h.close(); refused(lambda: half(['x1 a b none'])); "
            "refused(lambda: half(probes=('nowhere',)).advance(1e-6, [])); print('refused:', half().advance(1e-6, []))",
            "refused: [0",
        ),
    ],
)  # fmt: skip
def test_misuse_is_refused_with_the_words_of_ngspice(tmp_path: Path, code: str, said: str) -> None:
    found = run(tmp_path, code)
    assert "refused:" in found
    assert said in found


TIMES = "t_edge_s=1e-9, t_max_step_s=1e-7, t_stop_s=1e-5, log=Path('ngspice.log')"
EMPTY = f"NgspiceHalf(Deck(('title', '.options reltol=1e-6'), (), (), (), ('out',)), {TIMES})"
FAULTS = {
    "a source that is not external": ("half(['v_e e 0 1'], ('v_d', 'v_e'))", "source = v_e: an external source"),
    "a source that is not there": ("half((), ('v_d', 'v_e'))", "source = v_e: an external source"),
    "one of two probes": ("half(probes=('out', 'nowhere'))", "probe = nowhere: a node of the circuit"),
    "the only probe": ("half(probes=('nowhere',))", "probe = nowhere: a node of the circuit"),
    "a value": ("half(['v_e e 0', '* c', '+ dc=0 external'])", "line 5 = v_e e 0 dc=0 external: name node"),
    "a value without dc": ("half(['V_E e GND 0 External ; x'])", "line 5 = V_E e GND 0 External: name"),
    "a value in a file": ("half(['.include \"part.inc\"'])", "part.inc: line 2 = v_e e 0 0 external"),
    "sources in parallel": ("half(['r2 a 0 1', 'v2 gnd d 0'])", "line 6 = v2 gnd d 0: no voltage source in parallel"),
    "a current source": ("half(['i_e e 0 external'])", "line 5 = i_e e 0 external: an external"),
    "no element": (EMPTY, "elements = 0: at least one, after the line of the title"),
    "a subcircuit without end": ("half(['.subckt a b', 'r1 b 0 1'])", "line 5 = .subckt a b: .ends or .endif after"),
    "a subcircuit twice": (
        f"half({['.subckt p a', 'r1 a 0 1', '.ends', '.subckt p a', 'r1 a 0 2', '.ends']})",
        ".subckt = p: one subcircuit of a name",
    ),
    "an option misspelt": ("half(['.options temp=27 reltoll=1'])", "ngspice has no option reltoll; is it reltol?"),
    "a command": ("half(['.control', 'quit', '.endc'])", "line 5 = .control: no .control block"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_netlist_is_wrong_input_named_with_its_line(tmp_path: Path, fault: str) -> None:
    (tmp_path / "part.inc").write_text("* a part\nv_e e 0 0 external\n")
    code, said = FAULTS[fault]
    (found,) = run(tmp_path, f"refused(lambda: {code}.advance(0.0, []))").splitlines()
    assert found.startswith("refused: 2 part.inc: " if "part.inc" in said else "refused: 2 netlist: ")
    assert said in found


def test_sources_that_are_not_in_parallel_are_taken(tmp_path: Path) -> None:
    """Across other nodes, in a subcircuit, in a comment, in the title."""
    lines = ["v2 e d 0", "r2 e 0 1k", ".subckt b d", "v3 d 0 1", "v4 d 0 1", ".ends", "* v5 d 0 1"]
    assert "accepted" in run(tmp_path, f"refused(lambda: half({lines}).advance(0.0, []))")


def test_what_ngspice_ignores_is_warned_of(tmp_path: Path) -> None:
    """An option of any other name may be meant for another program."""
    lines = [".options reltol=1e-4 method=gear post=2 brand", ".model m d(is=1f foo=3)", "d1 d 0 m"]
    code = f"import warnings\nwith warnings.catch_warnings(record=True) as said: half({lines})\nprint(*said)"
    assert "unrecognized parameter (foo) - ignored" in run(tmp_path, code)


def test_a_change_of_tools_makes_another_driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ngspice, "BUILD", tmp_path)
    wrapper = tmp_path / "compiler"
    wrapper.write_text('#!/bin/sh\nexec cc "$@"\n')
    wrapper.chmod(0o755)
    own = shutil.copy(ngspice._loaded_ngspice()[0], tmp_path / "libngspice.so.0")
    found = [ngspice.library(), ngspice.library()]
    for change in (
        lambda other: other.setenv("CC", str(wrapper)),
        lambda other: other.setattr(ngspice, "FLAGS", ("-g", *ngspice.FLAGS)),
        lambda other: other.setattr(ngspice, "_loaded_ngspice", lambda: [Path(own)]),
    ):
        with monkeypatch.context() as other:
            change(other)
            found.append(ngspice.library())
    assert found[0] == found[1]
    assert len(set(found)) == 4


def test_the_ngspice_of_the_key_is_the_one_that_is_loaded(tmp_path: Path) -> None:
    own = shutil.copy(ngspice._loaded_ngspice()[0], tmp_path / "libngspice.so.0")
    code = "from dermis.lockstep import ngspice; print(ngspice._loaded_ngspice()[0])"
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}
    command = [sys.executable, "-c", code]
    said = subprocess.check_output(command, text=True, timeout=60, env=environment)
    assert said.strip() == str(own)


def test_the_driver_compiles_without_a_warning() -> None:
    sources = [str(path) for path in (ROOT / "models" / "dermis" / "lockstep").glob("*.c")]
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-O2", "-D_GNU_SOURCE", "-fsyntax-only", *sources]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
