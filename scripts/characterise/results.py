# SPDX-License-Identifier: Apache-2.0
"""Results of the runs: each quantity over its conditions against models/spec.toml, and the file of values."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from dermis import engines, plan
from dermis.chip import sky130, spice_batch
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.report import verdict
from dermis.scene import scene
from dermis.scene.design import ROOT, Limit
from dermis.scene.schema import read_toml
from scripts.characterise import benches
from scripts.characterise.benches import BENCHES, CODES_A_UNIT, SUMS, Condition
from scripts.characterise.runs import CELSIUS, TYPICAL, Job, Outcome

VALUES = ROOT / "build" / "characterise" / "values.json"
"""All quantities at every condition of the last whole run, SI units, named as in benches.BENCHES:

    {"ngspice": version, "models": {corner: file}, "values": {"tt,27,1": {quantity: value}}, "samples": {"1": {...}}}

The files of models are named after their content; the samples are mismatch at typical. A bench that ended as ERROR
somewhere has no quantities there."""

PREFIX = "sky130"
RECORD = benches.DECKS / "typical.toml"
"""Every quantity at typical, as `dermis extract` last recorded it: a change of a circuit moves one, within its limit or
not."""
MOVED = 0.005
"""Share of its own size, or of the farther end of its limit, by which a quantity may be off its record."""
CLASS = "device_class"
EVERY = (CLASS, "moved")
"""Rows over every bench: transistors that it takes outside their class, and quantities off their record."""


@dataclass
class Series:
    """A quantity over conditions."""

    name: str  # with what it is about before it: "packet_error.sink", "mismatch.packet_error.sink"
    only: str  # what `--only` takes to measure it
    values: dict[str, float] = field(default_factory=dict)  # by place, as `--at` and `--sample` take it
    typical: float | None = None  # the value at typical, if it was measured there
    faults: dict[str, str] = field(default_factory=dict)  # where it was not measured -> why
    told: dict[str, str] = field(default_factory=dict)  # where -> what else there is to say of the value

    @property
    def worst(self) -> str:
        """Where it is closest to its limit or farthest beyond it; without a limit, farthest from typical."""
        if (rule := limit_of(self.name)) is None:
            return max(self.values, key=lambda where: abs(self.values[where] - (self.typical or 0.0)))
        low, high = (
            (-math.inf if rule.min is None else rule.min),
            (math.inf if rule.max is None else rule.max),
        )
        return min(self.values, key=lambda where: min(self.values[where] - low, high - self.values[where]))

    def command(self, where: str) -> str:
        """Return the line that measures this quantity there and nothing else."""
        # A place of a row over every bench has the bench in it.
        return f"dermis characterise {'' if self.only in EVERY else f'--only {PREFIX}.{self.only} '}{where}"

    def row(self) -> verdict.Row:
        """Return its verdict: FAIL where a value misses, else ERROR where one is not there."""
        name, unit, told = f"{PREFIX}.{self.name}", benches.unit(self.only), ""
        if self.faults:
            where, fault = next(iter(self.faults.items()))
            many = f"{len(self.faults)} of {len(self.faults) + len(self.values)}"
            told = f"not measured at {many}: {fault}: `{self.command(where)}`"
        if not self.values:
            return verdict.error(name, told, unit)
        worst = self.worst
        least, most = min(self.values.values()), max(self.values.values())
        note = f"{least:.4g} .. {most:.4g} at {len(self.values)}; `{self.command(worst)}`{self.told.get(worst, '')}"
        row = verdict.measured(name, self.values[worst], unit, f"{told}; {note}" if told else note)
        return row | {"status": "ERROR"} if told and row["status"] == "PASS" else row


def _where(condition: Condition) -> str:
    sample = "" if condition.sample is None else f" --sample {condition.sample}"
    return f"--at {condition.at}{sample}"


def _measured(outcomes: Mapping[Job, Outcome]) -> dict[tuple[str, Condition], tuple[float | None, str]]:
    """Return every quantity of every job, and the sums: the value, or None and the reason."""
    found = {
        (quantity, job.condition): (outcome.values.get(quantity), outcome.fault)
        for job, outcome in outcomes.items()
        if not job.numerics
        for quantity in BENCHES[job.bench].units
    }
    for name, parts in SUMS.items():
        for condition in dict.fromkeys(condition for _, condition in found):
            own = [found[part, condition] for part in parts if (part, condition) in found]
            if len(own) == len(parts):
                values = [abs(value) for value, _ in own if value is not None]
                fault = next((fault for _, fault in own if fault), "")
                found[name, condition] = sum(values) if len(values) == len(parts) else None, fault
    return found


def limit_of(name: str) -> Limit | None:
    """Return the limit of a quantity or of its group, `a.b` of `a.b.sink`, if there is one."""
    try:
        return verdict.limit(f"{PREFIX}.{name}")
    except KeyError:
        return None


def record(outcomes: Mapping[Job, Outcome]) -> None:
    """Write RECORD from the jobs at typical; SimulatorError if one of them has no values."""
    if faults := [f"{job.bench}: {outcome.fault}" for job, outcome in outcomes.items() if outcome.fault]:
        raise SimulatorError(f"not recorded: {faults[0]}")
    values = {name: value for outcome in outcomes.values() for name, value in outcome.values.items()}
    head = "# SPDX-License-Identifier: Apache-2.0\n# Written by dermis extract: the benches at typical.\n"
    write_atomic(RECORD, head + "".join(f'"{name}" = {values[name]:.8g}\n' for name in sorted(values)))


def missed(values: Mapping[str, float]) -> list[str]:
    """Say which quantities at typical miss a limit."""
    rows = ((name, row) for name in values for row in (name, f"typical.{name}") if limit_of(row))
    return [
        f"{name} {values[name]:.4g}"
        for name, row in rows
        if verdict.judge(f"{PREFIX}.{row}", values[name])["status"] != "PASS"
    ]


def moved(values: Mapping[str, float]) -> list[str]:
    """Say which quantities at typical are off their record, or have none."""
    known, found = read_toml(RECORD), []
    for name, value in values.items():
        limit, old = limit_of(name), known.get(name, math.nan)
        ends = (limit.min, limit.max) if limit else ()
        size = max([abs(old), *(abs(end) for end in ends if end is not None)])
        if not abs(value - old) <= MOVED * size:
            found.append(f"{name} {old:.4g} -> {value:.4g}")
    return found


def series(outcomes: Mapping[Job, Outcome]) -> list[Series]:
    """Return every quantity over corners and mismatch, at typical, its drift, and the numerics.

    Corners of resistors and capacitors are among the others, unless there is a limit for them alone.
    Drift is the change over temperature at one corner and supply, after calibration at 27 C. Numerics is
    the number of codes by which a transient moves when it is solved in another way.
    """
    found: dict[str, Series] = {}
    groups: dict[tuple[str, str, float], dict[float, float]] = {}

    def add(name: str, only: str, where: str, value: float | None, fault: str = "") -> None:
        one = found.setdefault(name, Series(name, only))
        if value is None:
            one.faults[where] = fault
        else:
            one.values[where] = value

    for (quantity, condition), (value, fault) in _measured(outcomes).items():
        names = [quantity]
        if condition.sample is not None:
            names = [f"mismatch.{quantity}"]
        elif condition.corner in sky130.PASSIVE_CORNERS and limit_of(f"passives.{quantity}"):
            names = [f"passives.{quantity}"]
        if condition == TYPICAL and limit_of(f"typical.{quantity}"):
            names.append(f"typical.{quantity}")
        for name in names:
            add(name, quantity, _where(condition), value, fault)
        if condition.sample is None and value is not None and limit_of(f"drift.{quantity}"):
            group = groups.setdefault((quantity, condition.corner, condition.supply), {})
            group[condition.celsius] = value
    for (quantity, corner, supply), values in groups.items():
        if set(values) >= set(CELSIUS):
            change = max(values.values()) - min(values.values())
            add(f"drift.{quantity}", quantity, f"--at {corner},*,{supply:g}", change)
    for job, outcome in outcomes.items():
        if outcome.measured is not None and not job.numerics:
            said = {CLASS: sky130.outside_class(outcome.measured.exceeded)}
            said |= {"moved": moved(outcome.values)} if job.condition == TYPICAL and not outcome.fault else {}
            where = f"--only {job.bench} {_where(job.condition)}"
            for name, names in said.items():
                add(name, name, where, len(names))
                found[name].told[where] = ": " + "; ".join(names[:3]) if names else ""
        if job.numerics:
            name = f"numerics_lsb.{job.bench}.{job.numerics}"
            add(name, name, _where(job.condition), *_moved(job, outcome, outcomes))
    for one in found.values():
        typical = found[one.only].values.get(_where(TYPICAL)) if one.only in found else None
        one.typical = one.values.get("--at tt,*,1", typical)
    return list(found.values())


def _moved(job: Job, other: Outcome, outcomes: Mapping[Job, Outcome]) -> tuple[float | None, str]:
    """Return the largest difference in codes of another way to solve, or None and the reason."""
    own = outcomes.get(Job(job.bench, job.condition))
    if own is None or other.fault or own.fault:
        return None, other.fault or ("not run as its bench says" if own is None else own.fault)
    moved = [
        abs(other.values[quantity] - own.values[quantity]) * CODES_A_UNIT[kind]
        for quantity in BENCHES[job.bench].units
        if (kind := quantity.partition(".")[0]) in CODES_A_UNIT
    ]
    return (max(moved), "") if moved else (None, "benches.CODES_A_UNIT knows none of its quantities")


def write_values(outcomes: Mapping[Job, Outcome]) -> None:
    values: dict[str, dict[str, float]] = {}
    drawn: dict[str, dict[str, float]] = {}
    for job, outcome in outcomes.items():
        if job.numerics or outcome.fault:
            continue
        c = job.condition
        place = values.setdefault(c.at, {}) if c.sample is None else drawn.setdefault(str(c.sample), {})
        place.update(outcome.values)
    models = {corner: sky130.models(corner).name for corner in sorted({at.split(",")[0] for at in values})}
    told = {"ngspice": spice_batch.version(), "models": models, "values": values, "samples": drawn}
    write_atomic(VALUES, json.dumps(told, indent=1) + "\n")


def pads_row(pad_ohm: float | None = None) -> verdict.Row:
    """Return the verdict of pads.rows: the lowest code of a pressed 8x8 sheet behind row drivers and row pads."""
    pads = {"r_column_ohm": 0.0} | ({} if pad_ohm is None else {"r_row_ohm": pad_ohm})
    data = {
        "array": {"rows": 8, "cols": 8},
        "stimulus": {"kind": "uniform", "r_ohm": 500.0},
        "effects": {"row_driver": True, "pad": pads},
    }
    made = plan.make(scene.from_data(data, ROOT / "models" / "scenes" / "pads.toml"), "closed")
    return verdict.judge("pads.rows", int(engines.run(made).codes.min()))
