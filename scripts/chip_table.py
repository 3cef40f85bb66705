# SPDX-License-Identifier: Apache-2.0
"""`dermis datasheet`: one table for the chip in transistors, from the event engine on its extracted parameters.

Every code has a lowest conductance. Bisection finds the 255 of them in the event engine, for one taxel and for a row of
16 pressed alike. Against the ideal ones they give offset, gain, integral (INL) and differential nonlinearity (DNL), as
IEEE Std 1241 defines them: gain and offset are those of the line through both ends. Decoding gives the same with the
network taken out, calibrated with one taxel. ENOB adds the noise of a code to its error over the range.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import click
import numpy as np

from dermis import engines, plan
from dermis.chip import sky130
from dermis.decode import crosstalk
from dermis.ndarrays import Floats
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.scene import design as design_module
from dermis.scene import scene
from dermis.scene.design import ROOT
from scripts import markdown
from scripts.characterise import benches, runs
from scripts.characterise.benches import BENCHES, Condition
from scripts.judged import finish
from scripts.schematics.command import DEVICES, Subckt, written

LOADS = {"taxel": 1, "row": 16}
"""Columns that are pressed alike in the driven row."""
ROUNDS, AROUND = 18, 24.0
"""Halvings of a bracket of that many codes on either side of an ideal transition: to 0.0002 code."""


def chip(condition: Condition, k: int, cols: int) -> Plan:
    """Return the plan of a row of columns with the extracted parameters of a condition and a ratio."""
    named = {"corner": condition.corner, "temperature_c": condition.celsius}
    data = {
        "array": {"rows": 1, "cols": cols},
        "stimulus": {"kind": "uniform", "code": 0},
        "interface": {"topology": "conveyor_mirror", "k": k},
        "effects": {"extracted": named},
    }
    return plan.make(scene.from_data(data, ROOT / "chip"), "event")


def transitions(made: Plan, k: int) -> Floats:
    """Return the conductance from which on each code 1 .. 255 is read, [codes] in siemens; NaN where none is found."""
    codes = np.arange(1, made.timing.code_max + 1)
    low, high = np.maximum(codes - AROUND, 1e-3) * step_s(k), (codes + AROUND) * step_s(k)
    bracket = low.copy(), high.copy()
    for _ in range(ROUNDS):
        middle = (low + high) / 2.0
        ohm = np.broadcast_to((1.0 / middle)[:, None, None], (codes.size, 1, made.cols))
        read = engines.run(dataclasses.replace(made, resistance_ohm=ohm)).codes[:, 0, 0] >= codes
        low, high = np.where(read, low, middle), np.where(read, middle, high)
    found = (low + high) / 2.0
    return np.where((low > bracket[0]) & (high < bracket[1]), found, math.nan)


def step_s(k: int) -> float:
    """Return the conductance of an ideal step of the code at a ratio, siemens."""
    design = design_module.load()
    return k * design.converter.i0_a / (design.timing.gate_clocks * design.interface.v_bias_v)


def line(at: Floats) -> tuple[float, float]:
    """Return gain and offset in codes of the line through both ends of transitions in ideal steps [codes]."""
    first, last = np.flatnonzero(np.isfinite(at))[[0, -1]]
    gain = (last - first) / (at[last] - at[first])
    return float(gain), float(first + 0.5 - gain * at[first])


def static(at: Floats, noise_lsb: float) -> tuple[float, float, float]:
    """Return INL and DNL in codes and ENOB of transitions in ideal steps [codes], after gain and offset."""
    gain, offset = line(at)
    apart = gain * at + offset - (np.arange(at.size) + 0.5)
    wide, middle = 1.0 + np.diff(apart), (apart[1:] + apart[:-1]) / 2.0
    # A code's error is uniform over its step, around the middle of its ends.
    power = float(np.nanmean(middle**2 + wide**2 / 12.0)) + noise_lsb**2
    bits = math.log2(at.size + 1) - math.log2(math.sqrt(12.0 * power))
    return float(np.nanmax(np.abs(apart))), float(np.nanmax(np.abs(wide - 1.0))), bits


def decoded(made: Plan, k: int, at: Floats, one: Floats) -> Floats:
    """Return where transitions are once decoding has taken the network out, in ideal steps [codes].

    The currents of codes are those that one taxel, whose transitions are `one`, calibrates.
    """
    (gain, offset), ideal = line(one), np.arange(at.size) + 0.5
    steps = (ideal - offset) / gain
    amperes = np.repeat((steps * step_s(k) * made.v_bias_v)[:, None, None], made.cols, axis=2)
    solved = crosstalk.solve(made.network(0), amperes)
    return steps + at - np.where(solved.converged, solved.conductance_s[:, 0, 0], math.nan) / step_s(k)


def noise(condition: Condition, k: int) -> float:
    """Return the rms of a code at full scale: conveyor and mirror, packet, and the null on one of a column's taxels."""
    full_a = benches.chain_full_a(k)
    bodies = {"taxel": benches.noise_body("ix", benches.body("noise_taxel", k=k, i=full_a, r=0.5 / full_a))}
    bodies |= {name: BENCHES[f"noise_{name}"].body for name in ("packet", "null")}
    rms = {name: runs.measured(body, condition) for name, body in bodies.items()}
    lsb = {name: benches.noise(found, name)[f"noise_lsb.{name}"] for name, found in rms.items()}
    return math.hypot(lsb["taxel"], lsb["packet"], lsb["null"] / 16.0)


def ratio(condition: Condition, k: int) -> dict[str, float]:
    """Return the figures of the converter at a condition and a ratio of the mirror, by name."""
    noise_lsb = noise(condition, k)
    found = {f"chip.noise_lsb.k{k}": noise_lsb}
    one: Floats | None = None
    for load, cols in LOADS.items():
        made = chip(condition, k, cols)
        at = transitions(made, k) / step_s(k)
        one = at if one is None else one
        gain, offset = line(at)
        inl_raw, dnl_raw, enob_raw = static(at, noise_lsb)
        inl, dnl, enob = static(decoded(made, k, at, one), noise_lsb)
        told = {"offset_lsb": offset, "gain_error": gain - 1.0, "inl_raw_lsb": inl_raw}
        told |= {"inl_decoded_lsb": inl, "dnl_lsb": max(dnl_raw, dnl), "enob_raw": enob_raw, "enob": enob}
        found |= {f"chip.{name}.{load}.k{k}": value for name, value in told.items()}
    return found


def whole(condition: Condition) -> dict[str, float]:
    """Return supply rejection, and the power of 16 columns at rest and with a row of 500 ohm, by name."""

    def bench(name: str) -> dict[str, float]:
        return BENCHES[name].values(runs.measured(BENCHES[name].body, condition))

    row_a = 16e-3
    rest_a = bench("supply_conveyor_mirror")["supply_array_a.conveyor_mirror"] - row_a
    rest_mw = 2e3 * benches.SUPPLY_V * rest_a
    return {
        "chip.supply_rejection": bench("supply_rejection")["supply_rejection.vdd"],
        "chip.power_mw.rest": rest_mw,
        "chip.power_mw.row": rest_mw + 1e3 * row_a * (0.5 + benches.SUPPLY_V),  # from vbias to vss
    }


def area_um2(text: Mapping[str, Subckt], name: str, given: Mapping[str, float] | None = None) -> float:
    """Return the drawn area of the devices of a subcircuit: width times length, without what lies between them."""
    values: dict[str, float] = {}
    for key, said in text[name].parameters.items():
        values[key] = (given or {}).get(key, float(eval(said, {}, values)))  # a formula of the netlist
    total = 0.0
    for (*_, device), pairs in text[name].elements.values():
        sizes = {key: float(eval(said, {}, values)) for key, said in pairs.items() if key != "rs_int"}
        if device in text and device not in DEVICES:
            total += area_um2(text, device, sizes)
        elif "diode" in device:
            total += sizes["area"] * 1e-12
        else:
            usual = text[device].parameters if device in text else {}
            sizes = {key: float(said) for key, said in usual.items()} | sizes
            total += sizes["w"] * sizes["l"] * sizes.get("k", sizes.get("m", 1.0))
    return total


WORDS = {
    "offset_lsb": ("offset", "lsb"),
    "gain_error": ("gain error", "1"),
    "inl_raw_lsb": ("INL of the codes", "lsb"),
    "inl_decoded_lsb": ("INL, decoded", "lsb"),
    "dnl_lsb": ("DNL", "lsb"),
    "noise_lsb": ("noise at full scale, rms", "lsb"),
    "enob_raw": ("ENOB of the codes", "bit"),
    "enob": ("ENOB, decoded", "bit"),
    "supply_rejection": ("supply rejection", "lsb/mV"),
    "power_mw": ("power of 16 columns", "mW"),
    "area_mm2": ("area of the devices", "mm2"),
}
"""What a figure is called, and its unit."""


def rows_of(values: Mapping[str, Mapping[str, float]]) -> list[verdict.Row]:
    """Return a verdict for each name, of the value closest to its limit; `values` are by name and condition."""
    rows = []
    for name, found in values.items():
        numbers, (_, unit) = list(found.values()), WORDS[name.split(".")[1]]
        worst = min(found, key=lambda at: found[at] if unit == "bit" else -abs(found[at]))
        row = verdict.measured(name, found[worst], unit, f"at {worst}")
        ends = {"least": min(numbers), "typical": numbers[0], "most": max(numbers)}
        rows.append(row | {end: f"{number:.3g}" for end, number in ends.items()})
    return rows


def table(rows: Sequence[verdict.Row]) -> str:
    """Return the rows as the table of docs/datasheet.md: typical, least and most, a column for each ratio."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        _, figure, *load = row["name"].split(".")
        k = load.pop() if load and load[-1][0] == "k" else f"k{sky130.MIRROR_RATIOS[-2]}"
        limit = {"limit": markdown.limits(row["min"], row["max"])}
        line = cells.setdefault((figure, load[0] if load else ""), limit)
        line[k] = f"{row['typical']} ({row['least']} .. {row['most']})"
    lines = []
    for (figure, load), line in sorted(cells.items(), key=lambda item: list(WORDS).index(item[0][0])):
        values = [line.get(f"k{k}", "") for k in sky130.MIRROR_RATIOS]
        lines.append((WORDS[figure][0], load, *values, line["limit"], WORDS[figure][1]))
    head = ("quantity", "pressed", "k = 20", "40", "80", "160", "limit", "unit")
    return markdown.table(head, lines)


@click.command("datasheet")
@click.option("--docs", is_flag=True, help="Write the table of docs/datasheet.md.")
def datasheet_command(docs: bool) -> int:
    """The chip in transistors in one table: offset, gain, INL, DNL, noise, ENOB, supply rejection, power, area."""
    values: dict[str, dict[str, float]] = {}
    with progress.slots("datasheet", len(runs.EXTRACTED), "conditions") as tell:
        for done, at in enumerate(runs.EXTRACTED, 1):
            ratios = sky130.MIRROR_RATIOS if at.corner in ("tt", "ss", "ff") else (80,)
            for found in (*(ratio(at, k) for k in ratios), whole(at)):
                for name, value in found.items():
                    values.setdefault(name, {})[at.at] = value
            tell(done)
    values["chip.area_mm2"] = {runs.TYPICAL.at: 1e-6 * area_um2(written(), "dermis_analog_front_end")}
    rows = rows_of(dict(sorted(values.items())))
    title = "The chip in transistors: a taxel alone (taxel), 16 of a row alike (row)"
    code = finish("datasheet", rows, title)
    if docs:
        markdown.write(ROOT / "docs" / "datasheet.md", "chip", "datasheet", table(rows))
        click.echo("written: docs/datasheet.md")
    return code
