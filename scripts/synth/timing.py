# SPDX-License-Identifier: Apache-2.0
"""Static timing of a mapped netlist with OpenSTA: slacks at the design's clocks, highest clocks.

Before layout every net has an estimated capacitance per sink, a wire load model in a copy of the
Liberty; wires have no resistance and clocks no skew.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from dermis.errors import SimulatorError
from dermis.processes.children import run_logged
from scripts import templates
from scripts.judged import tool
from scripts.synth.cells import SYNTH, Technology
from scripts.synth.map import TOP

SDC = SYNTH / "dermis.sdc"
STA_LIMIT_S = 300.0
CLOCKS = ("clk", "sck")
ASYNC, GATING = "async_default", "clock_gating_default"
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

    kind: str
    start: str
    end: str
    slack_ns: float
    cells: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.start} to {self.end}, {len(self.cells)} cells"


def parse(report: str) -> dict[tuple[str, str], Path_]:
    """Return the worst path of each (group, "max" or "min") in a report of OpenSTA."""
    found: dict[tuple[str, str], Path_] = {}
    for match in _PATH.finditer(report):
        slack, key = float(match["slack"]), (match["group"].strip("*"), match["kind"])
        if key in found and found[key].slack_ns <= slack:
            continue
        data = match["body"].split("data arrival time")[0]
        # A flop shows its clock pin and its output.
        steps = re.findall(r"[\^v] (\S+)/\w+ \((\w+)\)", data)
        cells = tuple(cell for i, (name, cell) in enumerate(steps) if i == 0 or name != steps[i - 1][0])
        found[key] = Path_(match["kind"], match["start"], match["end"], slack, cells)
    return found


def liberty_with_wires(technology: Technology, corner: str, directory: Path) -> Path:
    """Write a copy of the Liberty of a corner with the wire capacitance; return its path."""
    text = technology.liberty(corner).read_text(encoding="utf-8", errors="replace")
    head = re.search(r"^\s*library\s*\([^)]*\)\s*\{", text, re.MULTILINE)
    unit = re.search(r"capacitive_load_unit\s*\(\s*([\d.]+)\s*,\s*\"?(\w+)\"?\s*\)", text)
    if head is None or unit is None:
        raise SimulatorError("no library or no capacitance unit in the Liberty", technology.liberty(corner))
    in_ff = float(unit.group(1)) * {"pf": 1e3, "ff": 1.0}[unit.group(2).lower()]
    first, further = technology.wire_ff, technology.wire_ff_per_sink
    model = [
        f'  wire_load ("stated") {{\n    capacitance : {1 / in_ff:.9g};\n    resistance : 0;\n    area : 0;',
        f"    slope : {further:g};",
        *(f"    fanout_length ({n}, {first + further * (n - 1):g});" for n in (1, 2, 4, 8, 16)),
        "  }",
    ]
    path = directory / f"{corner}.lib"
    path.write_text("\n".join([text[: head.end()], *model, text[head.end() :]]))
    return path


# Pins without a clock or a constraint, by the start of their names, and the reason.
UNTIMED = {
    "frame_ready_o": "an interrupt pin, synchronized by its receiver",
    "u_reset_sync.u_first.": "constant data",
    "u_spi.begun_q": "constant data",
}


def _checks(what: str) -> str:
    return f"report_checks -format full_clock_expanded -digits 4 -path_delay {what}"


@dataclass(frozen=True)
class Timing:
    """A netlist at a corner; every run of OpenSTA leaves its script and log in `directory`.

    With `black_boxes` a module may be missing, and paths end there. All methods raise
    SimulatorError if OpenSTA fails, warns, or leaves out a path.
    """

    technology: Technology
    corner: str
    netlist: Path
    directory: Path
    sdc: Path = SDC
    black_boxes: bool = False

    def _pathless(self, where: str, name: str) -> SimulatorError:
        return SimulatorError(f"OpenSTA reported no path {where}", self.directory / f"{name}.log")

    def _run(self, name: str, periods: Mapping[str, float], reports: Sequence[str], *settings: str) -> str:
        """Return the reports of OpenSTA, then "setup check" and the list of pins without timing."""
        self.directory.mkdir(parents=True, exist_ok=True)
        script, log = (self.directory / f"{name}.{end}" for end in ("tcl", "log"))
        early, late = self.technology.derates(self.corner)
        # OpenSTA takes no path with a space, which the root may have.
        near = partial(os.path.relpath, start=self.directory)
        known = {"early_derate": early, "late_derate": late, "driving_cell": self.technology.driver}
        text = templates.text(
            "sta.tcl",
            liberty=near(liberty_with_wires(self.technology, self.corner, self.directory)),
            netlist=near(self.netlist),
            top=TOP,
            periods=periods,
            settings=known | dict.fromkeys(settings, 1),
            sdc=near(self.sdc),
            reports=reports,
        )
        script.write_text(text)
        log.unlink(missing_ok=True)
        command = [tool("sta", "opensta"), "-no_init", "-no_splash", "-exit", script.name]
        run_logged(command, self.directory, log, STA_LIMIT_S, "OpenSTA")
        said = log.read_text(errors="replace")
        # `untimed` judges the warnings of check_setup.
        for complaint in _COMPLAINT.findall(said.split("setup check")[0]):
            if not (self.black_boxes and "black box" in complaint):
                raise SimulatorError(f"OpenSTA: {complaint.strip()}", log)
        if "setup check" not in said or "sta ended" not in said:
            raise SimulatorError("OpenSTA reported no path for its end", log)
        return said

    def worst(self, periods: Mapping[str, float]) -> dict[tuple[str, str], Path_]:
        """Return the worst setup ("max") and hold ("min") path of each clock, of ASYNC and of GATING; periods in ns."""
        name = f"sta_{self.corner}"
        paths = parse(self._run(name, periods, [_checks("max"), _checks("min")], "cut_crossings"))
        if missing := [f"{k} {clock}" for clock in CLOCKS for k in ("max", "min") if (clock, k) not in paths]:
            raise self._pathless(f"for {', '.join(missing)}", name)
        return paths

    def crossings(self, periods: Mapping[str, float]) -> dict[str, Path_]:
        """Return the longest path into each clock from the other, against its bound in the SDC."""
        name = f"sta_{self.corner}_crossings"
        reports = [
            f'puts "to {receiver}"\n'
            + _checks(f"max -from [get_clocks {sender}] -to [get_clocks {receiver}]")
            for sender, receiver in (CLOCKS, CLOCKS[::-1])
        ]
        said = self._run(name, periods, reports)
        found: dict[str, Path_] = {}
        for receiver in CLOCKS:
            _, _, rest = said.partition(f"to {receiver}\n")
            paths = [path for path in parse(rest.split("\nto ")[0]).values() if path.kind == "max"]
            if len(paths) != 1:
                raise self._pathless(f"into {receiver}", name)
            found[receiver] = paths[0]
        return found

    def skew_ns(self, ports: str, periods: Mapping[str, float]) -> tuple[float, float]:
        """Return the largest difference of one edge between output ports, and that of rise and fall of a port."""
        check = f"report_checks -to [get_ports {ports}] -group_count 1000 -format end -digits 4 -path_delay"
        reports = [f"{check} max_rise", 'puts "falling"', f"{check} max_fall"]
        said = self._run(f"sta_{self.corner}_skew", periods, reports, "cut_crossings")
        rise, fall = (
            {port: float(delay) for port, delay in re.findall(r"^(\S+) \(output\) +\S+ +(\S+)", part, re.M)}
            for part in said.split("setup check")[0].split("falling\n", 1)
        )
        if not rise or rise.keys() != fall.keys():
            raise SimulatorError(f"OpenSTA reported no path to {ports}", self.directory)
        skew = max(max(found.values()) - min(found.values()) for found in (rise, fall))
        return skew, max(abs(rise[port] - fall[port]) for port in rise)

    def to_safe_ns(self, periods: Mapping[str, float]) -> float:
        """Return the delay from the enable pin through the clear of a flop to the last of the outputs."""
        reports = ["set sta_preset_clear_arcs_enabled 1", _checks("max -from [get_ports enable_i]")]
        name = f"sta_{self.corner}_to_safe"
        said = self._run(name, periods, reports, "cut_crossings", "to_safe")
        if not (found := re.search(r"^ *([\d.]+) +data arrival time", said, re.M)):
            raise self._pathless("from enable_i", name)
        return float(found[1])

    def untimed(self) -> list[str]:
        """Return loops, and pins without timing that UNTIMED does not name, of the last `worst`."""
        log = self.directory / f"sta_{self.corner}.log"
        _, check, listed = log.read_text(errors="replace").partition("setup check")
        if not check or "sta ended" not in listed:
            raise SimulatorError("OpenSTA did not check the constraints", log)
        if "loop" in listed:
            return ["a combinational loop"]
        pins = [line.strip() for line in listed.splitlines() if line.startswith(" ")]
        return [pin for pin in pins if not pin.startswith(tuple(UNTIMED))]

    def highest(self, periods: Mapping[str, float]) -> dict[str, tuple[float, Path_]]:
        """Search the shortest period of each clock in ns, starting at `periods`; with its critical path."""
        periods, found = dict(periods), dict[str, tuple[float, Path_]]()
        for _ in range(_STEPS):
            paths = self.worst(periods)
            for clock in {*CLOCKS} - found.keys():
                period, path = periods[clock], paths[clock, "max"]
                if 0 <= path.slack_ns <= _CLOSE * period:
                    found[clock] = period, path
                else:
                    # Exact for a path of one period, half way for half a period; the margin lets the search end.
                    periods[clock] = max(period * (1 + _CLOSE / 10) - path.slack_ns, period / 64)
            if len(found) == len(CLOCKS):
                return {clock: found[clock] for clock in CLOCKS}
        raise SimulatorError(f"the highest clock was not found in {_STEPS} runs of OpenSTA", self.directory)
