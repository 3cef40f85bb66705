# SPDX-License-Identifier: Apache-2.0
"""Single faults seeded in the netlists of spice/sky130, found by the bench of a block or the closed loop.

The faults are those of drawing and wiring: a device left out, turned round, of the wrong kind or number, pins and
controls exchanged, a line open, two lines joined, a switch that does not switch. They are made by rule from every line
that the channel of Fig. 5a uses, and a part of each kind is drawn with a fixed seed: nobody chooses which.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic, write_between
from dermis.report import progress, verdict
from dermis.scene.design import ROOT
from dermis.scene.extracted import CIRCUIT, Measured
from scripts import workers
from scripts.characterise import runs
from scripts.characterise.benches import SUPPLY_BLOCKS, chain_by_pins_body, chain_lsb
from tb.programs.equivalence import cases, extract, gate
from tb.programs.equivalence.gate import TYPICAL, Case
from tb.programs.equivalence.loop import Slot

FILES = (
    "level_shifter.sp",
    "bias.sp",
    "ota.sp",
    "integrator.sp",
    "comparator.sp",
    "charge_source.sp",
    "conveyor.sp",
    "offset_null.sp",
    "mirror.sp",
    "vfc.sp",
    "channel_conveyor_mirror.sp",
)
"""Blocks of the channel of Fig. 5a."""

UNUSED = {"integrator_direct", "mirror", "level_down"}
"""Which side of an `.if` that channel takes."""

LOOP = Case(codes=(0, 0, 64, 200, 250), clocks=64)
"""The closed loop, for faults that no bench finds."""


@dataclass(frozen=True)
class Fault:
    """One change to one line.

    Attributes
    ----------
    kind : what was done, lower_snake
    file, line : where, from 0 on
    element : its name and subcircuit, for people
    text : what stands there instead, one line or more
    """

    kind: str
    file: str
    line: int
    element: str
    text: str

    @property
    def name(self) -> str:
        """Kind and place."""
        return f"{self.kind}.{self.element}"


@dataclass(frozen=True)
class Element:
    """A line of a netlist: name, nodes, model and parameters."""

    file: str
    line: int
    subckt: str
    name: str
    nodes: tuple[str, ...]
    kind: str
    rest: str

    def text(
        self, nodes: Sequence[str] | None = None, kind: str | None = None, rest: str | None = None
    ) -> str:
        """The line with something else in it."""
        parts = (self.name, *(nodes or self.nodes), kind or self.kind, self.rest if rest is None else rest)
        return " ".join(p for p in parts if p)


def elements(folder: Path = CIRCUIT) -> Iterator[Element]:
    """Every element that the channel uses, in the order of the files."""
    for file in FILES:
        subckt = ""
        for number, line in enumerate((folder / file).read_text(encoding="utf-8").splitlines()):
            words = line.split()
            if not words or line.startswith("*"):
                continue
            if words[0] == ".subckt":
                subckt = words[1]
            elif words[0][0] == "x" and subckt not in UNUSED and not subckt.endswith("_inverted"):
                fixed = [w for w in words[1:] if "=" not in w]
                rest = " ".join(w for w in words[1:] if "=" in w)
                yield Element(file, number, subckt, words[0], tuple(fixed[:-1]), fixed[-1], rest)


def _swapped(nodes: Sequence[str], a: int, b: int) -> list[str]:
    changed = list(nodes)
    changed[a], changed[b] = changed[b], changed[a]
    return changed


def _of(element: Element) -> Iterator[tuple[str, str]]:
    """Kind and text of every fault that a rule makes of an element."""
    e, nodes = element, element.nodes
    if e.kind in ("nmos", "pmos"):
        drain, gate_, source, _ = nodes
        if drain != gate_:
            yield "gate_and_drain_swapped", e.text(_swapped(nodes, 0, 1))
        yield "wrong_polarity", e.text(kind="pmos" if e.kind == "nmos" else "nmos")
        yield "missing_device", f"* {e.name} left out"
        # A gigaohm in place of a cut line: an open node needs some path to have a voltage at all.
        yield "open_drain", f"{e.text([f'{e.name}_cut', *nodes[1:]])}\nr{e.name}_cut {e.name}_cut {drain} 1g"
        if drain != source:
            yield "drain_and_source_joined", f"{e.text()}\nr{e.name}_short {drain} {source} 10"
        # A device more in a cascode, a follower or a pair sets no ratio: no count and no current moves with it.
        if source in ("vdd", "vss") and (ratio := _one_more(e.rest)):
            yield "wrong_ratio", e.text(rest=ratio)
    elif e.kind == "mirror_group" and e.rest:
        yield "wrong_ratio", e.text(rest=re.sub(r"units=\{?([^}]*)\}?$", r"units={(\1)-1}", e.rest))
    elif e.kind in ("switch", "switch_small"):
        yield "missing_switch", f"* {e.name} left out"
        yield "controls_swapped", e.text(_swapped(nodes, 2, 3))
        yield "switch_stuck_on", e.text([*nodes[:2], "vdd", "vss", *nodes[4:]])
        yield "switch_stuck_off", e.text([*nodes[:2], "vss", "vdd", *nodes[4:]])
    elif e.kind in ("level_shifter", "level_shifter_matched"):
        yield "controls_swapped", e.text(_swapped(nodes, 1, 2))
    elif e.kind in ("ota", "comparator", "conveyor", "integrator", "offset_null"):
        yield "inputs_swapped", e.text(_swapped(nodes, 0, 1))


def _one_more(rest: str) -> str:
    """Parameters with one device more than there are; empty where there is one, and no ratio."""
    changed, count = re.subn(r"\bk=(?:\{([^}]*)\}|(\S+))", lambda m: f"k={{({m[1] or m[2]})+1}}", rest)
    return changed if count else ""


def all_faults(folder: Path = CIRCUIT) -> list[Fault]:
    """Every fault that the rules make."""
    return [
        Fault(kind, e.file, e.line, f"{e.subckt}.{e.name}", text)
        for e in elements(folder)
        for kind, text in _of(e)
    ]


def written(fault: Fault, folder: Path) -> Path:
    """A copy of spice/sky130 with the fault in it."""
    place = folder / fault.name.replace(".", "_")
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(CIRCUIT, place)
    path = place / fault.file
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[fault.line] = fault.text
    write_atomic(path, "\n".join(lines) + "\n")
    return place


# ---- benches --------------------------------------------------------------------------------------------------

# Allowed difference from the value without a fault. Both come from the same solver and deck
# and repeat to 1e-6. A value that affects a code may change it by a quarter of a count; others by 2 % (5 %
# for a ratio of small differences), far above convergence errors and below one device in sixteen.
TOLERANCES: Mapping[str, tuple[float, float]] = {  # absolute, relative
    "row_driver.r_ohm": (0.0, 0.02),
    "row_driver.grounded_r_ohm": (0.0, 0.02),
    "column_input.r_ohm": (0.03, 0.0),
    "column_offset.v_v": (30e-6, 0.0),
    "mirror_ratio.ratio_error": (1e-3, 0.0),
    "offset_current.i_a": (12e-9, 0.0),
    "mirror_output.r_out_ohm": (0.0, 0.05),
    "integrator_gain.r_in_ohm": (
        math.inf,
        0.0,
    ),  # of a device that is off; leakage is in offset_current
    "integrator_gain.gain_dc": (0.0, 0.05),
    "integrator_bandwidth.gbw_hz": (0.0, 0.02),
    "charge_packet.packet_error": (1e-3, 0.0),
    "preset_error.v_v": (20e-3, 0.0),
    "comparator_offset.v_v": (20e-3, 0.0),
    "comparator_delay.t_s": (1e-9, 0.0),
}
SUPPLY = 0.01
"""Of a supply current: a unit of 5 uA is 2 % of the largest block's."""

# A tenth of a packet: an output that is stuck, or does not hold, is off by volts, and a level by its whole swing.
HELD_V = 0.1
"""Of a preset level or a comparator's output that should be at rest."""


NULL_CLAMP = """\
xline ibias vdd vss bias_line
vpreset logic_preset 0 1
xdut 0 y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
iy 0 y 0
.dc iy -1u 1u 1u
.meas dc held_down find v(y) at=-1u
.meas dc held_up find v(y) at=1u
"""
"""Where the two diodes of the offset null hold its output while nothing else does, as at power-up."""


def at_rest(bench: str, found: Mapping[str, float], should: Mapping[str, float]) -> str:
    """The first supply current or level of a bench that is not as it should be, in words; empty where all are."""
    for name, value in found.items():
        want = should[name]
        if "supply" in (bench, name) and abs(value - want) > SUPPLY * abs(want):
            return f"{name} takes {-value * 1e6:.1f} uA for {-want * 1e6:.1f}"
        if ("held" in name or "comp" in name) and abs(value - want) > HELD_V:
            return f"{name} {value:.3f} V for {want:.3f}"
    return ""


def moved(have: Sequence[Measured], want: Sequence[Measured]) -> str:
    """The first parameter that is not as it should be, in words."""
    for one, other in zip(have, want, strict=True):
        name = f"{one.effect}.{one.parameter}"
        absolute, relative = TOLERANCES[name]
        if not abs(one.value - other.value) <= absolute + relative * abs(other.value):
            return f"{name} {one.value:.4g} for {other.value:.4g}"
    return ""


BENCH_LIMIT_S = 90.0
"""Time limit of a bench with a fault: twenty times its time without on an idle core."""


@dataclass(frozen=True)
class Found:
    """Outcome of a fault.

    Attributes
    ----------
    by : the bench that noticed it, or "closed loop"
    said : what that found, in words
    caught : None where it is not known, for something else went wrong
    """

    by: str
    said: str
    caught: bool | None


def _of_the_circuit(what: str) -> bool | None:
    """Return True if an error of ngspice is due to the circuit: no solution on any rung, or a missing measurement.

    A limit that was reached, a process that was lost: of those the circuit may be innocent.
    """
    said = ("; tried: ", "did not measure", "SimulatorError: ngspice at ")
    return True if any(words in what for words in said) else None


def bodies() -> dict[str, str]:
    """The decks that a fault goes through, cheap ones first.

    Besides those of extraction: the current of each block, the mirror by its pins with no group and with every group of
    devices on, and the column with an offset that the null has to take away, as mismatch gives it.
    """
    column = extract.column_body(LOOP.topology, LOOP.k).replace("xconveyor y x", "xconveyor y_off x")
    return {
        "supply": SUPPLY_BLOCKS,
        "pins_k20": chain_by_pins_body(20),
        "pins_k160": chain_by_pins_body(160),
        **extract.bodies(LOOP.topology, LOOP.k),
        "column_with_offset": f"voffset y_off y 3m\n{column}",
        "column_of_channel": extract.column_of_channel_body(LOOP.topology, LOOP.k),
        "null_clamp": NULL_CLAMP,
    }


def _parameters(name: str, found: Mapping[str, float]) -> list[Measured]:
    if name in ("supply", "null_clamp"):
        return []
    if name.startswith("pins"):
        gain = chain_lsb(found)[-1] - chain_lsb(found)[0]
        return [Measured("mirror_ratio", "ratio_error", gain / 255.0 - 1.0, name)]
    return extract.parameters(
        name.removesuffix("_with_offset").removesuffix("_of_channel"), found, LOOP.topology, LOOP.k
    )


def bench(fault: Fault, folder: Path) -> Found:
    """Return the findings of the benches of a block; benches without the fault reuse the results of the sound run."""
    blocks = written(fault, folder)
    for name, body in bodies().items():
        should = runs.measured(body, TYPICAL)
        try:
            found = runs.measured(body, TYPICAL, BENCH_LIMIT_S, blocks=blocks)
        except SimulatorError as error:
            return Found(name, error.what[:200], _of_the_circuit(error.what))
        wrong = at_rest(name, found, should)
        if wrong := wrong or moved(_parameters(name, found), _parameters(name, should)):
            return Found(name, wrong, True)
    return Found("bench", "nothing", False)


def loop(slots: list[Slot] | str) -> Found:
    """Return the finding of the closed loop."""
    if isinstance(slots, str):
        return Found("closed loop", slots[:100], _of_the_circuit(slots))
    try:
        worst = gate.compare(LOOP, slots)["worst"]
    except ValueError as error:
        return Found("closed loop", str(error), True)
    limit = verdict.limit("equivalence.counts_apart").max
    return Found("closed loop", f"{worst:.2f} counts apart", limit is not None and worst > limit)


# ---- all of them ---------------------------------------------------------------------------------------------


def judged(faults: Sequence[Fault], jobs: int, fresh: bool = False) -> list[Found]:
    """Put faults to the benches, and those that no bench notices to the closed loop."""
    folder = cases.WORK / "faults"
    found: dict[int, Found] = {}
    with progress.slots("faults", len(faults), "faults at the benches") as tell:
        tasks = (workers.Task(bench, (fault, folder), 12 * BENCH_LIMIT_S) for fault in faults)
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs), 1):
            found[number] = Found("bench", outcome.fault, None) if outcome.fault else outcome.value
            tell(done)
    left = [n for n in range(len(faults)) if found[n].caught is False]
    with progress.slots("faults", len(left), "faults in the closed loop") as tell:
        shown = cases.shown([(LOOP, written(faults[n], folder)) for n in left], jobs, tell, fresh)
    found |= {n: loop(slots) for n, slots in zip(left, shown, strict=True)}
    return [found[n] for n in range(len(faults))]


def table(faults: Sequence[Fault], found: Sequence[Found]) -> str:
    """Faults by kind, then each that nothing notices, for docs/equivalence.md."""
    lines = [
        "| fault | seeded | a bench | the closed loop | nothing | not measured |",
        "|---|--:|--:|--:|--:|--:|",
    ]

    def row(label: str, own: Sequence[Found]) -> str:
        at = [
            sum(f.caught is True and (f.by == "closed loop") == looped for f in own)
            for looped in (False, True)
        ]
        rest = [sum(f.caught is state for f in own) for state in (False, None)]
        return f"| {label} | {len(own)} | " + " | ".join(map(str, at + rest)) + " |"

    for kind in dict.fromkeys(f.kind for f in faults):
        own = [f for fault, f in zip(faults, found, strict=True) if fault.kind == kind]
        lines.append(row(kind.replace("_", " "), own))
    lines.append(row("all", found))
    unseen = [(fault, f) for fault, f in zip(faults, found, strict=True) if not f.caught]
    if unseen:
        lines += ["", "Not noticed:", ""]
        lines += [f"- `{fault.name}`, `{fault.text.splitlines()[-1]}`: {f.said}" for fault, f in unseen]
    return "\n".join(lines)


def rows_of(faults: Sequence[Fault], found: Sequence[Found]) -> list[verdict.Row]:
    """A row a fault (PASS caught, SKIP not noticed by anything, ERROR not known), and the share of those known."""
    rows = []
    for fault, f in zip(faults, found, strict=True):
        name, said = f"equivalence.fault.{fault.name}", f"{f.by}: {f.said}"
        if f.caught is None:
            rows.append(verdict.error(name, said, "caught"))
        elif f.caught:
            rows.append(verdict.report(name, 1, "caught", said))
        else:
            rows.append(verdict.skip(name, f"not noticed; {said}", "caught"))
    known = [f.caught for f in found if f.caught is not None]
    share = sum(known) / len(known) if known else None
    note = f"{len(known)} of {len(faults)} measured, of {len(all_faults())} that the rules make"
    return [*rows, verdict.judge("equivalence.faults_caught", share, note)]


def command(only: Sequence[str], jobs: int, fresh: bool, docs: bool) -> int:
    """`dermis equivalence --faults`: rows in build/equivalence_faults.json."""
    every = all_faults()
    faults = [f for f in every if not only or any(w in f.name for w in only)]
    if not faults:
        kinds = ", ".join(dict.fromkeys(f.kind for f in every))
        raise InputError("command line", "--only", " ".join(only), f"a block, a device, or one of {kinds}")
    found = judged(faults, jobs, fresh)
    rows = rows_of(faults, found)
    verdict.write_rows("equivalence_faults", rows)
    verdict.print_rows(rows, "seeded faults")
    if docs:
        marks = ("begin: faults (written by dermis equivalence --faults --docs)", "end: faults")
        write_between(
            ROOT / "docs" / "equivalence.md", *(f"<!-- {m} -->" for m in marks), table(faults, found)
        )
    return verdict.exit_code(rows)
