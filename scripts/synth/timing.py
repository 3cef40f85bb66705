# SPDX-License-Identifier: Apache-2.0
"""Static timing of a mapped netlist with OpenSTA: worst slacks at the clocks of the design, and the
highest clocks.

Before layout every net has an estimated capacitance per sink, a wire load model in a copy of the
Liberty; wires have no resistance and clocks no skew.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dermis.errors import SimulatorError
from dermis.processes.children import run_logged
from dermis.scene.design import ROOT
from scripts.synth.cells import SYNTH, Technology
from scripts.synth.map import TOP, tool

SDC = SYNTH / "dermis.sdc"
STA_LIMIT_S = 300.0
CLOCKS = ("clk", "sck")
# End of the search for the highest clock: slack as a part of the period.
_CLOSE = 1e-3
_STEPS = 25

_PATH = re.compile(
    r"^Startpoint: (?P<start>\S+).*?^Endpoint: (?P<end>\S+).*?^Path Group: (?P<group>\S+)\s*?$"
    r".*?^Path Type: (?P<kind>\w+)\s*?$(?P<body>.*?)^\s*(?P<slack>-?[\d.]+)\s+slack \((?:MET|VIOLATED)\)",
    re.MULTILINE | re.DOTALL,
)
_COMPLAINT = re.compile(r"^(?:Warning|Error).*$", re.MULTILINE)


@dataclass(frozen=True)
class Path_:
    """The worst path of a group: start, end, slack in ns and cells."""

    group: str
    kind: str
    start: str
    end: str
    slack_ns: float
    cells: tuple[str, ...]


def parse(report: str) -> dict[tuple[str, str], Path_]:
    """Return the worst path of each (group, "max" or "min") in a report of OpenSTA."""
    found: dict[tuple[str, str], Path_] = {}
    for match in _PATH.finditer(report):
        group = match["group"].strip("*")
        slack = float(match["slack"])
        key = (group, match["kind"])
        if key in found and found[key].slack_ns <= slack:
            continue
        data = match["body"].split("data arrival time")[0]
        # A flop shows its clock pin and its output.
        steps = re.findall(r"[\^v] (\S+)/\w+ \((\w+)\)", data)
        cells = tuple(cell for i, (name, cell) in enumerate(steps) if i == 0 or name != steps[i - 1][0])
        found[key] = Path_(group, match["kind"], match["start"], match["end"], slack, cells)
    return found


def _liberty(technology: Technology, corner: str, directory: Path) -> Path:
    """Write a copy of the Liberty of a corner with the wire capacitance; return its path."""
    text = technology.liberty(corner).read_text(encoding="utf-8", errors="replace")
    head = re.search(r"^\s*library\s*\([^)]*\)\s*\{", text, re.MULTILINE)
    unit = re.search(r"capacitive_load_unit\s*\(\s*([\d.]+)\s*,\s*\"?(\w+)\"?\s*\)", text)
    if head is None or unit is None:
        raise SimulatorError("no library or no capacitance unit in the Liberty", technology.liberty(corner))
    in_ff = float(unit.group(1)) * {"pf": 1e3, "ff": 1.0}[unit.group(2).lower()]
    points = (1, 2, 4, 8, 16)
    lengths = [technology.wire_ff + technology.wire_ff_per_sink * (n - 1) for n in points]
    model = "\n".join(
        [
            '  wire_load ("stated") {',
            f"    capacitance : {1 / in_ff:.9g};",
            "    resistance : 0;",
            "    area : 0;",
            f"    slope : {technology.wire_ff_per_sink:g};",
            *(f"    fanout_length ({n}, {length:g});" for n, length in zip(points, lengths, strict=True)),
            "  }",
        ]
    )
    path = directory / f"{corner}.lib"
    path.write_text(f"{text[: head.end()]}\n{model}\n{text[head.end() :]}")
    return path


def analyse(
    technology: Technology,
    corner: str,
    netlist: Path,
    directory: Path,
    *,
    clk_ns: float,
    sck_ns: float,
    sdc: Path = SDC,
    wires: bool = True,
    top: str = TOP,
    black_boxes: bool = False,
    limit_s: float = STA_LIMIT_S,
) -> dict[tuple[str, str], Path_]:
    """Return the worst setup ("max") and hold ("min") path of both clocks; slacks in ns.

    With `black_boxes` a module may be missing, and paths end there.

    Raises
    ------
    SimulatorError
        OpenSTA failed, warned, or reported no path for one of them.
    """
    log = directory / f"sta_{corner}.log"
    reports = [
        f"report_checks -path_delay {kind} -path_group {clock} -format full_clock_expanded -digits 4"
        for kind in ("max", "min")
        for clock in CLOCKS
    ]
    constraints = ["set cut_crossings 1", f"source {sdc}"]
    periods = {"clk": clk_ns, "sck": sck_ns}
    said = _run(
        technology, corner, netlist, directory, log, periods, constraints, reports, wires, top, limit_s
    )
    # `unargued` judges the warnings of check_setup.
    complaints = [
        c for c in _COMPLAINT.findall(said.split("setup check")[0]) if not (black_boxes and "black box" in c)
    ]
    if complaints:
        raise SimulatorError(f"OpenSTA: {complaints[0].strip()}", log)
    paths = parse(said)
    missing = [f"{kind} {clock}" for clock in CLOCKS for kind in ("max", "min") if (clock, kind) not in paths]
    if missing or "sta ended" not in said:
        raise SimulatorError(f"OpenSTA reported no path for {', '.join(missing) or 'its end'}", log)
    return paths


def crossings(
    technology: Technology,
    corner: str,
    netlist: Path,
    directory: Path,
    *,
    clk_ns: float,
    sck_ns: float,
    sdc: Path = SDC,
    limit_s: float = STA_LIMIT_S,
) -> dict[str, Path_]:
    """Return the longest path into each clock from the other, against the bound of the constraint
    file.

    Raises
    ------
    SimulatorError
        OpenSTA failed, warned, or reported no path for one of them.
    """
    log = directory / f"sta_{corner}_crossings.log"
    reports = [
        f'puts "to {receiver}"\nreport_checks -path_delay max -from [get_clocks {sender}] -to [get_clocks {receiver}] '
        "-format full_clock_expanded -digits 4"
        for sender, receiver in (CLOCKS, CLOCKS[::-1])
    ]
    periods = {"clk": clk_ns, "sck": sck_ns}
    said = _run(
        technology, corner, netlist, directory, log, periods, [f"source {sdc}"], reports, True, TOP, limit_s
    )
    complaints = _COMPLAINT.findall(said.split("setup check")[0])
    if complaints:
        raise SimulatorError(f"OpenSTA: {complaints[0].strip()}", log)
    found: dict[str, Path_] = {}
    for receiver in CLOCKS:
        _, mark, rest = said.partition(f"to {receiver}\n")
        paths = [path for path in parse(rest.split("\nto ")[0]).values() if path.kind == "max"]
        if not mark or len(paths) != 1 or "sta ended" not in said:
            raise SimulatorError(f"OpenSTA reported no path into {receiver}", log)
        found[receiver] = paths[0]
    return found


def _run(
    technology: Technology,
    corner: str,
    netlist: Path,
    directory: Path,
    log: Path,
    periods: Mapping[str, float],
    constraints: Sequence[str],
    reports: Sequence[str],
    wires: bool,
    top: str,
    limit_s: float,
) -> str:
    """Run OpenSTA; return its output."""
    directory.mkdir(parents=True, exist_ok=True)
    liberty = _liberty(technology, corner, directory)
    early, late = technology.derates(corner)
    script = log.with_suffix(".tcl")
    script.write_text(
        "\n".join(
            [
                f"read_liberty {liberty}",
                f"read_verilog {netlist}",
                f"link_design {top}",
                *(f"set {clock}_period {period!r}" for clock, period in periods.items()),
                *constraints,
                *(["set_wire_load_model -name stated"] if wires else []),
                f"set_timing_derate -early {early}",
                f"set_timing_derate -late {late}",
                *reports,
                'puts "setup check"',
                "check_setup -verbose -no_clock -unconstrained_endpoints -loops",
                'puts "sta ended"',
                "",
            ]
        )
    )
    log.unlink(missing_ok=True)
    run_logged(
        [tool("sta", "opensta"), "-no_init", "-no_splash", "-exit", str(script)],
        ROOT,
        log,
        limit_s,
        "OpenSTA",
    )
    return log.read_text(errors="replace")


# Pins without a clock or a constraint, by the start of their names, and the reason.
UNTIMED = {
    "frame_ready_o": "an interrupt pin, synchronized by its receiver",
    "u_enable_sync.u_first.": "the flop that samples the enable pin",
    "u_reset_sync.u_first.": "constant data",
    "u_spi.begun_q": "clocked by the falling edge of CS, constant data, used eight SCK edges later",
}


def unargued(technology: Technology, corner: str, directory: Path) -> list[str]:
    """Return loops and pins without a clock or a constraint in the latest `analyse` that UNTIMED
    does not name.

    Raises
    ------
    SimulatorError
        OpenSTA did not reach its check.
    """
    log = directory / f"sta_{corner}.log"
    said = log.read_text(errors="replace")
    if "setup check" not in said or "sta ended" not in said:
        raise SimulatorError("OpenSTA did not check the constraints", log)
    listed = said.split("setup check")[1].split("sta ended")[0]
    if "loop" in listed:
        return ["a combinational loop"]
    pins = [line.strip() for line in listed.splitlines() if line.startswith(" ")]
    return [pin for pin in pins if not pin.startswith(tuple(UNTIMED))]


@dataclass(frozen=True)
class Highest:
    """Shortest period of a clock without a setup violation, and its critical path."""

    period_ns: float
    path: Path_

    @property
    def mhz(self) -> float:
        return 1e3 / self.period_ns


class _Search:
    """Search of a period by the chord between a pass and a violation, or the line through two
    passes.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.found: Highest | None = None
        self._miss: tuple[float, float] | None = None
        self._hits: list[tuple[float, float]] = []

    def take(self, path: Path_) -> None:
        """Take the worst path at `period`; set the next period, or `found`."""
        if self.found:
            return
        here = (self.period, path.slack_ns)
        if path.slack_ns < 0:
            self._miss = max(self._miss or here, here)
            if not self._hits:
                self.period = 2.0 * (self.period - path.slack_ns)
                return
        else:
            self._hits = [*self._hits[-1:], here]
        high, slack = self._hits[-1]
        if path.slack_ns >= 0 and slack <= _CLOSE * high:
            self.found = Highest(high, path)
            return
        low, short = self._miss or (self._hits[0] if len(self._hits) == 2 else (0.0, 0.0))
        if not low:
            self.period = 0.7 * high
            return
        # 1e-4 above the chord, so that on a straight line the search ends with a pass.
        self.period = max((high - slack * (high - low) / (slack - short)) * (1 + 1e-4), high / 64)


def highest(
    technology: Technology,
    corner: str,
    netlist: Path,
    directory: Path,
    *,
    clk_ns: float,
    sck_ns: float,
    top: str = TOP,
    sdc: Path = SDC,
    black_boxes: bool = False,
    limit_s: float = STA_LIMIT_S,
) -> dict[str, Highest]:
    """Search the shortest periods of both clocks. Slack is concave and rises with the period, so
    chords converge.

    Raises
    ------
    SimulatorError
        OpenSTA failed, or the search did not converge.
    """
    searches = {"clk": _Search(clk_ns), "sck": _Search(sck_ns)}
    for _ in range(_STEPS):
        paths = analyse(
            technology,
            corner,
            netlist,
            directory,
            clk_ns=searches["clk"].period,
            sck_ns=searches["sck"].period,
            sdc=sdc,
            top=top,
            black_boxes=black_boxes,
            limit_s=limit_s,
        )
        for clock, search in searches.items():
            search.take(paths[clock, "max"])
        if all(search.found for search in searches.values()):
            return {clock: search.found for clock, search in searches.items() if search.found}
    raise SimulatorError(f"the highest clock was not found in {_STEPS} runs of OpenSTA", directory)
