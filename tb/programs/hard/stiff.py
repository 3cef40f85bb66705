# SPDX-License-Identifier: Apache-2.0
"""Published stiff circuits through the project's own ngspice driver: errors by method, step and
tolerance.

A run drives a deck as the co-simulation does: edges of the digital side, samples at given times,
integration in the steps of lockstep.c. Its error is the largest difference from the reference over
all samples.
"""

from __future__ import annotations

import hashlib
import itertools
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist
from dermis.chip.ngspice import NgspiceHalf
from dermis.files import write_atomic
from dermis.places import ROOT
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import load as load_design
from scripts import workers
from tb.programs.bench.measure import markdown
from tb.programs.hard import stiff_circuits
from tb.programs.hard.case import Case, Measured
from tb.programs.hard.stiff_circuits import CIRCUITS, StiffCircuit

Floats = NDArray[np.float64]

DOCS = "build/stiff.md"

OPTIONS = {
    "exact": netlist.options(pole=False),
    "pole": netlist.options(pole=True),
    "clamp": netlist.options(pole=True, clamp_i0_a=load_design().converter.i0_a),
}
"""The option sets of netlist.py: without truncation control, with it at reltol 1e-4, at 1e-6."""


@dataclass(frozen=True)
class Setting:
    """Integration of ngspice: trap or gear (order 2), longest step in seconds, one of OPTIONS."""

    method: str
    t_max_step_s: float
    options: str = "pole"


@dataclass(frozen=True)
class Solved:
    """States [times, probes] in volt, accepted and rejected steps, processor seconds."""

    states: Floats
    accepted: int
    rejected: int
    seconds: float


def solve(circuit: StiffCircuit, setting: Setting, log: Path) -> Solved:
    """Drive a circuit to its end; after a failure this process cannot run ngspice again.

    Raises
    ------
    SimulatorError
        ngspice gave up.
    """
    half = NgspiceHalf(
        circuit.deck(f"{OPTIONS[setting.options]} method={setting.method} maxord=2"),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=setting.t_max_step_s,
        t_stop_s=circuit.t_stop_s,
        log=log,
        use_ic=True,
    )
    begin = time.process_time()
    found = []
    edges = list(circuit.edges)
    for now in circuit.times_s:
        while edges and edges[0][0] < now * (1.0 - 1e-12):  # an edge at a sample follows it
            at = edges[0][0]
            half.advance(at, [])
            together = [edge for edge in edges if edge[0] == at]
            edges = edges[len(together) :]
            half.advance(at, together)
        found.append(half.advance(min(now, circuit.t_stop_s), []).copy())
    seconds = time.process_time() - begin
    told = half.statistics
    half.close()
    return Solved(np.array(found), told["accepted"], told["rejected"], seconds)


def reference(circuit: StiffCircuit) -> Floats:
    """Return the reference states [times, probes], kept in build/ until stiff_circuits.py
    changes.
    """
    source = Path(stiff_circuits.__file__).read_bytes()
    path = ROOT / "build" / "stiff" / f"{circuit.name}_{hashlib.sha256(source).hexdigest()[:12]}.npy"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npy", delete=False) as scratch:
            np.save(scratch, circuit.reference(1))
        Path(scratch.name).replace(path)
    return np.load(path)


def published_error(circuit: StiffCircuit, states: Floats) -> Floats:
    """Return the difference of the last row of states from the published end values, in volt of the
    probes.
    """
    scale = np.array(circuit.scale or (1.0,) * len(circuit.probes))
    return states[-1] - np.array(circuit.published, dtype=float) / scale


def distance(circuit: StiffCircuit, states: Floats, probes: Sequence[str]) -> float:
    """Return the largest |states - reference| over the samples that have a reference; NaN in the
    states stays NaN.
    """
    columns = [circuit.probes.index(name) for name in probes]
    expected = reference(circuit)[:, columns]
    known = np.isfinite(expected)
    return float(np.max(np.abs(states[:, columns] - expected)[known]))


def measure(circuit: StiffCircuit, setting: Setting, probes: tuple[str, ...]) -> Measured:
    """Solve and compare with the reference."""
    with tempfile.TemporaryDirectory() as work:
        solved = solve(circuit, setting, Path(work) / "ngspice.log")
    note = f"{solved.accepted} steps, {solved.rejected} rejected"
    return Measured(distance(circuit, solved.states, probes), note)


def against_published(name: str) -> Measured:
    """Compare our reference with the published end values."""
    circuit = CIRCUITS[name]
    own = [i for i, probe in enumerate(circuit.probes) if not (name == "charge_pump" and probe == "i")]
    return Measured(float(np.max(np.abs(published_error(circuit, reference(circuit))[own]))))


def prepare(cases: Sequence[Case]) -> None:
    """Compute the references of the cases before the timed runs."""
    for name, circuit in CIRCUITS.items():
        if any(case.name.startswith(name) for case in cases):
            reference(circuit)


_PUBLISHED = "end values of the IVP test set, and a solution of our own at tolerances of 1e-12"
_WHY = {
    "transistor_amplifier": "exponential laws and a singular capacitance matrix: an algebraic part of index 1",
    "nand_gate": "charges that depend on voltage, laws with kinks, time constants of 0.2 ps in a span of 80 ns",
    "charge_pump": "a transistor modelled by charge only, its current a derivative: index 2",
    "ring_modulator": "diodes with 2 pF: rates of 3e11/s and ringing at 5 MHz below signals of 1 and 10 kHz",
}


def cases() -> list[Case]:
    """Return the four circuits at two steps each, and the references against the published
    values.
    """

    def at(
        name: str,
        step_s: float,
        limit: float,
        argument: str,
        *,
        what: str = "",
        options: str = "pole",
        methods: tuple[str, ...] = ("trap", "gear"),
        probes: tuple[str, ...] = (),
        short: bool = False,
        refused: dict[str, str] | None = None,
    ) -> Case:
        circuit = CIRCUITS[name]
        probes = probes or circuit.probes
        shown = ", ".join(probes) if len(probes) < 5 else f"{len(probes)} states"
        return Case(
            name=f"{name}_{what or f'{1e9 * step_s:g}ns'.replace('.', '_')}",
            group="stiff",
            why=_WHY[name.removesuffix("_start")],
            expected=f"{shown} at {len(circuit.times_s)} instants",
            source=_PUBLISHED,
            tolerance=argument,
            limit=limit,
            unit="V",
            runs={m: partial(measure, circuit, Setting(m, step_s, options), probes) for m in methods},
            short=short,
            refused=refused or {},
        )

    def published(name: str, limit: float, argument: str, short: bool = False) -> Case:
        return Case(
            name=f"{name}_published",
            group="stiff",
            why=_WHY[name],
            expected="the end values of the IVP test set",
            source="IVP test set, release 2.4: PSIDE at tolerances of 1e-14 and less, GAMD in quadruple precision",
            tolerance=argument,
            limit=limit,
            unit="V",
            runs={"reference": partial(against_published, name)},
            short=short,
        )

    sine = "second order lags a sine of 100 Hz by at most (w h)^2 / 3 a radian (gear; trap a quarter), of 4 V of output"
    gate = "1 % of the 5 V swing at 0.1 ns; a hundredth of it at a tenth of the step (second order)"
    return [
        at("transistor_amplifier", 1e-4, 5e-3, sine, what="100us", short=True),
        at("transistor_amplifier", 1e-5, 5e-5, sine, what="10us", short=True),
        published(
            "transistor_amplifier", 1e-12, "2000 steps of a rounding of 6 V each add up to 2e-12 at worst"
        ),
        at("nand_gate", 1e-10, 0.05, gate, what="100ps", short=True),
        at("nand_gate", 1e-11, 5e-4, gate, what="10ps"),
        published(
            "nand_gate",
            1e-10,
            "some 10 000 steps over kinks, each at a tolerance of 1e-12 of 5 V, in a random walk",
        ),
        at(
            "charge_pump",
            1e-9,
            1e-3,
            "charge is a function of state, so errors do not accumulate; a thousandth of our converter's packet of 1 V",
            what="voltages",
            probes=("q_g", "s", "d"),
            short=True,
        ),
        at(
            "charge_pump",
            1e-10,
            1.5e-3,
            "1 % of the 0.152 mA that flow at the end (1 V is 1 mA)",
            what="current",
            methods=("gear",),
            probes=("i",),
            refused={
                "trap": "on the last edge the trapezoidal current alternates about the right one by 1 to 3 mA at any "
                "step: it does not damp what has index 2"
            },
        ),
        published(
            "charge_pump", 1e-12, "closed forms against 24 digits, rounded to doubles of some 1", short=True
        ),
        at(
            "ring_modulator_start",
            1e-9,
            0.02,
            "1 % of a swing of 2 V; the ringing at 5 MHz has 200 steps a period",
            what="trap",
            options="exact",
            methods=("trap",),
        ),
        at(
            "ring_modulator_start",
            1e-9,
            0.08,
            "four times that of trap, as is the error constant: (w h)^2 / 3 a radian against (w h)^2 / 12",
            what="gear",
            options="exact",
            methods=("gear",),
        ),
        published("ring_modulator", 1e-7, "two tolerances of our own, 1e-12 and 2e-13, differ by 4e-8"),
    ]


# ---- errors by method, step and options --------------------------------------------------------------------------

STEPS_S = {
    "transistor_amplifier": (1e-3, 1e-4, 1e-5),
    "nand_gate": (1e-9, 1e-10, 1e-11),
    "charge_pump": (1e-8, 1e-9, 1e-10),
    "ring_modulator": (1e-6, 1e-7, 1e-8),
    "ring_modulator_start": (1e-8, 3e-9, 1e-9),
}


def settings() -> Iterator[tuple[str, Setting]]:
    """Yield every circuit with every method, step and option set; the slowest are left out."""
    for name, steps in STEPS_S.items():
        for options, method, step in itertools.product(OPTIONS, ("trap", "gear"), steps):
            # Below 100 ns without truncation control: minutes each, without new information.
            if not (name == "ring_modulator" and options == "exact" and step < 1e-7):
                yield name, Setting(method, step, options)


def row(name: str, setting: Setting) -> tuple[float, str]:
    """Return the largest error over all samples in volt, and a note with the end, steps and
    seconds.
    """
    circuit = CIRCUITS[name]
    with tempfile.TemporaryDirectory() as work:
        solved = solve(circuit, setting, Path(work) / "ngspice.log")
    end = float(np.max(np.abs(solved.states[-1] - reference(circuit)[-1])))
    note = (
        f"at the end {end:.2g} V; {solved.accepted} steps, {solved.rejected} rejected, {solved.seconds:.2g} s"
    )
    return distance(circuit, solved.states, circuit.probes), note


def sweep(jobs: int = 2) -> list[Row]:
    """Return a row for each circuit and setting; an aborted run is an ERROR row with ngspice's
    message.
    """
    chosen = list(settings())
    tasks = [workers.Task(row, each, 120.0) for each in chosen]
    rows: list[Row] = [{}] * len(tasks)
    with progress.slots("stiff", len(tasks), "runs") as tell:
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs), 1):
            name, setting = chosen[number]
            key = f"stiff.{name}.{setting.options}.{setting.method}.{setting.t_max_step_s:g}"
            if outcome.fault:
                rows[number] = verdict.error(key, outcome.fault, "V")
            else:
                rows[number] = verdict.report(key, outcome.value[0], "V", outcome.value[1])
            tell(done)
    return rows


def published_rows() -> Iterator[Row]:
    """Yield the difference of each of our references from the published end values."""
    for name, circuit in CIRCUITS.items():
        if any(value is not None for value in circuit.published):
            note = "our reference against the published end values"
            yield verdict.report(f"stiff.{name}.published", against_published(name).error, "V", note)


@click.command("stiff")
@click.option("--docs", is_flag=True, help=f"Also write {DOCS}.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Parallel runs.")
def stiff_command(docs: bool, jobs: int) -> int:
    """Measure errors of published stiff circuits by method, step and option set; rows in
    build/stiff.json.
    """
    for circuit in CIRCUITS.values():
        reference(circuit)
    rows = [*sweep(jobs), *published_rows()]
    verdict.write_rows("stiff", rows)
    verdict.print_rows(rows, "Stiff circuits: largest error over all samples")
    if docs:
        write_atomic(ROOT / DOCS, markdown(rows, ["stiff"]) + "\n")
        click.echo(f"written: {DOCS}")
    # Some settings are expected to fail; `dermis hard --only stiff` judges.
    return 0
