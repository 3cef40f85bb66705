# SPDX-License-Identifier: Apache-2.0
"""Results of the runs: each quantity over its conditions against models/spec.toml, and the file of values."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dermis import engines, plan
from dermis.chip import sky130, spice_batch
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from dermis.scene.design import ROOT, Limit, spec
from scripts.characterise.benches import BENCHES, CODES_A_UNIT, SUMS, Condition
from scripts.characterise.run_all import CELSIUS, TYPICAL, Job, Outcome

VALUES = ROOT / "build" / "characterise" / "values.json"
"""All quantities at every condition of the last whole run, SI units, named as in benches.BENCHES:

    {"ngspice": version, "models": {corner: file}, "values": {"tt,27,1": {quantity: value}}, "samples": {"1": {...}}}

The files of models are named after their content; the samples are mismatch at typical. A bench that ended as ERROR
somewhere has no quantities there."""

PREFIX = "sky130"


@dataclass
class Series:
    """A quantity over conditions.

    Attributes
    ----------
    name : of the quantity, with what it is about before it: "packet_error.sink", "mismatch.packet_error.sink"
    only : what `--only` takes to measure it
    unit : SI
    values : by where it was measured, as `--at` and `--sample` take it
    typical : the value at typical, if it was measured there
    faults : where it was not measured -> why
    """

    name: str
    only: str
    unit: str
    values: dict[str, float] = field(default_factory=dict)
    typical: float | None = None
    faults: dict[str, str] = field(default_factory=dict)

    @property
    def limit(self) -> Limit | None:
        """Its limit, if models/spec.toml has one."""
        try:
            return verdict.limit(f"{PREFIX}.{self.name}")
        except KeyError:
            return None

    @property
    def worst(self) -> str:
        """Where it is closest to its limit or farthest beyond it; without a limit, farthest from typical."""
        rule, middle = self.limit, self.typical or 0.0

        def room(where: str) -> float:
            value = self.values[where]
            if rule is None:
                return -abs(value - middle)
            sides = [value - rule.min] if rule.min is not None else []
            return min([*sides, rule.max - value] if rule.max is not None else sides)

        return min(self.values, key=room)

    def command(self, where: str) -> str:
        """The line that measures this quantity there and nothing else."""
        return f"dermis characterise --only {PREFIX}.{self.only} {where}"

    def row(self) -> Row:
        """Its verdict: FAIL where a value misses, else ERROR where one is not there."""
        name = f"{PREFIX}.{self.name}"
        missing = next(iter(self.faults.items()), None)
        told = ""
        if missing is not None:
            many = len(self.faults)
            told = f"not measured at {many} of {many + len(self.values)}: {missing[1]}: `{self.command(missing[0])}`"
        if not self.values:
            return verdict.error(name, told, self.unit)
        worst = self.worst
        least, most = min(self.values.values()), max(self.values.values())
        note = f"{least:.4g} .. {most:.4g} at {len(self.values)}; `{self.command(worst)}`"
        if told:
            note = f"{told}; {note}"
        row = verdict.measured(name, self.values[worst], self.unit, note)
        return row | {"status": "ERROR"} if told and row["status"] == "PASS" else row


def _where(condition: Condition) -> str:
    sample = "" if condition.sample is None else f" --sample {condition.sample}"
    return f"--at {condition.at}{sample}"


@dataclass(frozen=True)
class _One:
    """A quantity at a condition: its value, or why there is none."""

    quantity: str
    unit: str
    condition: Condition
    value: float | None
    fault: str = ""


def _each(outcomes: Mapping[Job, Outcome]) -> Iterator[_One]:
    """Return every quantity of every solved job, and their sums."""
    there: dict[tuple[str, Condition], _One] = {}
    for job, outcome in outcomes.items():
        if not job.numerics:
            for quantity, unit in BENCHES[job.bench].units.items():
                one = _One(quantity, unit, job.condition, outcome.values.get(quantity), outcome.fault)
                there[quantity, job.condition] = one
                yield one
    for name, parts in SUMS.items():
        for condition in dict.fromkeys(condition for _, condition in there):
            found = [there[part, condition] for part in parts if (part, condition) in there]
            if len(found) == len(parts):
                values = [abs(one.value) for one in found if one.value is not None]
                total = sum(values) if len(values) == len(parts) else None
                fault = next((one.fault for one in found if one.fault), "")
                yield _One(name, found[0].unit, condition, total, fault)


def series(outcomes: Mapping[Job, Outcome]) -> list[Series]:
    """Return every quantity over corners, at typical if limited there, over mismatch, and its drift.

    Corners of resistors and capacitors are among the others, unless there is a limit for them alone.
    """
    found: dict[str, Series] = {}
    for it in _each(outcomes):
        names = [it.quantity]
        if it.condition.sample is not None:
            names = [f"mismatch.{it.quantity}"]
        elif it.condition.corner in sky130.PASSIVE_CORNERS and _has_limit(f"{PREFIX}.passives.{it.quantity}"):
            names = [f"passives.{it.quantity}"]
        if it.condition == TYPICAL and _has_limit(f"{PREFIX}.typical.{it.quantity}"):
            names.append(f"typical.{it.quantity}")
        for name in names:
            one = found.setdefault(name, Series(name, it.quantity, it.unit))
            if it.value is None:
                one.faults[_where(it.condition)] = it.fault
            else:
                one.values[_where(it.condition)] = it.value
    for one in [*found.values()]:
        typical = found.get(one.only)
        one.typical = None if typical is None else typical.values.get(_where(TYPICAL))
    return [*found.values(), *_drifts(outcomes)]


def _has_limit(name: str) -> bool:
    """Return True if models/spec.toml limits this quantity or its group, such as `a.b` of `a.b.sink`."""
    return name in spec() or name.rpartition(".")[0] in spec()


def _drifts(outcomes: Mapping[Job, Outcome]) -> Iterator[Series]:
    """Return the change of a quantity over temperature at one corner and supply, after calibration at 27 C."""
    groups: dict[tuple[str, str, str], dict[float, float]] = {}
    units: dict[str, str] = {}
    for it in _each(outcomes):
        c = it.condition
        if c.sample is None and it.value is not None and _has_limit(f"{PREFIX}.drift.{it.quantity}"):
            groups.setdefault((it.quantity, c.corner, f"{c.supply:g}"), {})[c.celsius] = it.value
            units[it.quantity] = it.unit
    whole = {at: values for at, values in groups.items() if set(values) >= set(CELSIUS)}
    for quantity, own in itertools.groupby(sorted(whole), key=lambda at: at[0]):
        one = Series(f"drift.{quantity}", quantity, units[quantity])
        for at in own:
            spread = whole[at].values()
            one.values[f"--at {at[1]},*,{at[2]}"] = max(spread) - min(spread)
        one.typical = one.values.get("--at tt,*,1")
        yield one


def numerics(outcomes: Mapping[Job, Outcome]) -> list[Series]:
    """By how many codes the transients move when they are solved in another way, bench by bench."""
    found: dict[str, Series] = {}
    for job, other in outcomes.items():
        if not job.numerics:
            continue
        name = f"numerics_lsb.{job.bench}.{job.numerics}"
        one = found.setdefault(name, Series(name, name, "lsb"))
        own = outcomes.get(Job(job.bench, job.condition))
        fault = other.fault or ("" if own is None else own.fault)
        if fault or own is None:
            one.faults[_where(job.condition)] = fault or "not run as its bench says"
            continue
        moved = [
            abs(other.values[q] - own.values[q]) * codes
            for q in BENCHES[job.bench].units
            if (codes := CODES_A_UNIT.get(q.partition(".")[0])) is not None
        ]
        if not moved:
            one.faults[_where(job.condition)] = "benches.CODES_A_UNIT knows none of its quantities"
            continue
        one.values[_where(job.condition)] = max(moved)
    return list(found.values())


def write_values(outcomes: Mapping[Job, Outcome]) -> None:
    """Write VALUES, whole or not at all."""
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


def load(path: Path | None = None) -> dict[Condition, dict[str, float]]:
    """All quantities of the last whole run, by condition; those with a sample are mismatch at typical.

    Raises
    ------
    InputError
        The run does not exist.
    """
    path = path or VALUES
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        found = {_condition(at): dict(values) for at, values in told["values"].items()}
        for sample, values in told["samples"].items():
            found[Condition(sample=int(sample))] = dict(values)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(path, "file", "missing or not whole", "what `make characterise` writes") from None
    return found


def _condition(at: str) -> Condition:
    corner, celsius, supply = at.split(",")
    return Condition(corner, float(celsius), float(supply))


def pads_row(pad_ohm: float | None = None) -> Row:
    """Return the verdict of pads.rows: the lowest code of a pressed 8x8 sheet behind row drivers and row pads."""
    pads = {"r_column_ohm": 0.0} | ({} if pad_ohm is None else {"r_row_ohm": pad_ohm})
    data = {
        "array": {"rows": 8, "cols": 8},
        "stimulus": {"kind": "uniform", "r_ohm": 500.0},
        "effects": {"row_driver": True, "pad": pads},
    }
    made = plan.make(scene.from_data(data, ROOT / "models" / "scenes" / "pads.toml"), "closed")
    return verdict.judge("pads.rows", int(engines.run(made).codes.min()))


def exit_code(all_series: Iterable[Series], rows: Sequence[Row]) -> int:
    """3 where something was not measured, else 1 where a limit is missed, else 0."""
    return 3 if any(one.faults for one in all_series) else verdict.exit_code(rows)
