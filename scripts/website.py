# SPDX-License-Identifier: Apache-2.0
"""Build the documentation as a site: docs/, and pages of commands, library, design, results."""

from __future__ import annotations

import csv
import inspect
import itertools
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import click
from click.testing import CliRunner

import dermis
from dermis import cli
from dermis.errors import SimulatorError
from dermis.places import BUILD, ROOT
from dermis.processes import children
from dermis.scene import design as designs
from dermis.scene.design import Design
from scripts import generate, markdown, templates
from scripts.demo import demo
from scripts.schematics import command as schematics

SOURCE, SITE = BUILD / "site_source", BUILD / "site"
CONFIG = ROOT / "mkdocs.yml"
LIMIT_S = 300.0

# Rows of the datasheet by section: name of a row, and its meaning. A name without a row means all
# rows that begin with it.
MEASURED: dict[str, dict[str, str]] = {
    "error": {
        "frame.code_error_lsb": "Code error of whole frames, ideal blocks in ngspice",
        "sky130.chain_code_inl_lsb.k80": "Non-linearity of the code, conveyor and mirror in transistors",
        "sky130.chain_gain_error.k80": "Gain error of conveyor and mirror, before calibration",
        "sky130.conveyor_r_x_ohm.k80": "Input resistance of the conveyor",
        "sky130.conveyor_v_offset_v.k80": "Offset of the virtual ground",
        "sky130.mismatch.chain_gain_error.k80": "Gain error by mismatch",
        "sky130.noise_lsb.full": "Code noise at full scale, rms",
        "sky130.noise_lsb.low": "Code noise at the low end, rms",
        "sky130.noise_lsb.packet": "Noise of the packets, rms",
        "sky130.settling_lsb.low_5mhz": "Settling error when the gate opens, at the low end",
        "sky130.settling_lsb.high_5mhz": "Settling error when the gate opens, at full scale",
    },
    "area": {
        "synth.area_um2.sky130.16x16": "Standard cells of the digital core, 130 nm",
        "synth.cells.sky130.16x16": "Number of cells",
        "synth.flops.sky130.16x16": "Flip-flops",
        "synth.highest_mhz.clk.sky130.16x16": "Highest clock of the core, slow corner",
        "synth.highest_mhz.sck.sky130.16x16": "Highest SPI clock, slow corner",
    },
    "power": {
        "sky130.supply_channel_a.conveyor_mirror": "Supply current of a channel",
        "sky130.supply_array_a.conveyor_mirror": "Supply current of sixteen channels with their bias",
        "accuracy_chip.energy_nj": "Energy of a conversion, sensor included",
        "accuracy_chip.energy_per_bit_nj": "Energy per bit of a conversion",
    },
}

# Pins of dermis_top.
PINS = {
    "clk_i": "Clock",
    "rst_ni": "Reset, low active; asserted at once, released on a clock",
    "enable_i": "Scans while high",
    "comp_async_i": "Comparators, one a column; not synchronous to the clock",
    "row_sense_i": "Levels of the row lines, read by the self-test",
    "row_select_o": "Row drivers, at most one of them high",
    "preset_o": "Presets the integrators to minus half a packet",
    "charge_o": "Charge switches, one a column",
    "range_o": "Ratio of the mirror, two bits a column",
    "test_current_o": "Switches the test current on, one a column",
    "frame_start_o": "High for one clock as a frame begins",
    "spi_sck_i": "SPI clock, mode 0",
    "spi_cs_ni": "SPI select, low active",
    "spi_copi_i": "SPI data into the chip",
    "spi_cipo_o": "SPI data out of the chip",
    "spi_cipo_oe_o": "High while spi_cipo_o drives",
    "frame_ready_o": "A new frame is ready",
}


@dataclass(frozen=True)
class Measured:
    """One measured row: its values as text, and the file that it was read from."""

    least: str
    typical: str
    most: str
    unit: str
    status: str
    source: str


def _build_rows() -> Iterator[tuple[str, Measured]]:
    """Return the rows of build/*.json."""
    for path in sorted(BUILD.glob("*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        for row in data if isinstance(data, list) else []:
            if isinstance(row, dict) and isinstance(row.get("value"), int | float):
                value = f"{row['value']:.6g}"
                yield row["name"], Measured("", value, "", row["unit"], row["status"], f"build/{path.name}")


def _page_rows() -> Iterator[tuple[str, Measured]]:
    """Return the rows of the tables that commands wrote into pages of docs/."""
    for path in sorted((ROOT / "docs").glob("*.md")):
        for table in TABLE.findall(path.read_text(encoding="utf-8")):
            head, _, *lines = ([cell.strip(" `") for cell in _cells(line)] for line in table.splitlines())
            if len(head) < 3 or head[0] not in ("name", "row"):
                continue
            for row in (dict(zip(head, cells, strict=False)) for cells in lines if len(cells) >= len(head)):
                name = row[head[0]]
                name = name if "." in name and "least" not in row else f"sky130.{name}"
                value = next((row[key] for key in ("value", "typical", "result") if key in row), "")
                number, _, unit = value.partition(" ")
                cells = (row.get("least", ""), number, row.get("most", ""), row.get("unit", unit))
                yield name, Measured(*cells, row.get("status", ""), f"docs/{path.name}")


def measured() -> dict[str, Measured]:
    """Return measured rows by name, from build/, else as recorded in docs/."""
    return {**dict(_page_rows()), **dict(_build_rows())}


def rows_table(section: str) -> str:
    """Return the measured rows of a section of the datasheet, each with its file and command."""
    found, limits = measured(), designs.spec()
    rows: list[tuple[str, ...]] = []
    for name, meaning in MEASURED[section].items():
        rule, limit = limits.get(name) or limits.get(name.rpartition(".")[0]), ""
        if rule is not None:
            low, high = ("" if v is None else f"{v:g}" for v in (rule.min, rule.max))
            limit = f"{low} .. {high}".strip()
        command = f"`{rule.command if rule else _COMMANDS[name.partition('.')[0]]}`"
        matches = {
            f"{meaning}: {k[len(name) + 1 :]}": row for k, row in found.items() if k.startswith(f"{name}.")
        }
        matches = {meaning: found[name]} if name in found else matches
        if not matches:
            rows.append((meaning, "", "not measured here", "", "", limit, "", command))
        for said, row in itertools.islice(matches.items(), 3):
            rows.append((said, row.least, row.typical, row.most, row.unit, limit, f"`{row.source}`", command))
    head = ("quantity", "min", "typ", "max", "unit", "limit", "source", "command")
    return markdown.table(head, rows, "---|--:|--:|--:|---|---|---|---")


_COMMANDS = {
    "frame": "make sim",
    "sky130": "make characterise",
    "synth": "make synth TECH=sky130",
    "accuracy_chip": "make accuracy-chip",
}


def pins_table() -> str:
    """Return the pins of the core from the ports of rtl/dermis_top.v; SimulatorError if those are
    not the pins of `PINS`.
    """
    text = (ROOT / "rtl" / "dermis_top.v").read_text(encoding="utf-8")
    ports = re.findall(r"^  (input|output) +wire +(?:\[([^\]]+)\] +)?(\w+)", text, re.M)
    if {name for _, _, name in ports} != set(PINS):
        raise SimulatorError("the pins of scripts/website.py differ from the ports of rtl/dermis_top.v")
    rows = (
        (f"`{name}`", direction, width.replace("-1:0", "") if width else "1", PINS[name])
        for direction, width, name in ports
    )
    return markdown.table(("pin", "direction", "width", "meaning"), rows)


def key_values(design: Design) -> str:
    """Return the values on the first page of the datasheet."""
    clock, timing = design.converter.f_clk_hz, design.timing
    k_ohm = design.interface.v_bias_v / (design.interface.k * design.converter.i0_a)
    rows = [
        ("Array", f"{design.array.rows} x {design.array.cols} taxels, one converter a column"),
        ("Clock", f"{clock / 1e6:g} MHz"),
        ("Frame", f"{timing.frame_s * 1e3:g} ms, {1 / timing.frame_s:g} frames a second"),
        (
            "Row slot",
            f"{timing.slot_clocks} clocks: {timing.settle_clocks} to settle, {timing.gate_clocks} to count",
        ),
        ("Code", f"{timing.code_bits} bits, 0 to {timing.code_max}; floor({timing.gate_clocks} x + 1/2)"),
        ("Duty", f"x = {k_ohm:g} ohm / R with {design.interface.k}:1 in the mirror"),
        ("Full scale", f"{design.sensor.force_max_n:g} N, {design.sensor.r_min_ohm:g} ohm"),
        ("Step", f"{design.sensor.force_max_n / timing.code_max * 1e3:.3g} mN"),
        ("Ranges", ", ".join(f"{k}:1" for k in design.interface.k_options)),
        ("Bias of the driven row", f"{design.interface.v_bias_v:g} V"),
        ("Supply", f"{design.supply.vdd_v - design.supply.vss_v:g} V"),
    ]
    return markdown.table(("", ""), rows)


def timing_diagram(design: Design, path: Path) -> None:
    """Draw one row slot, to the scale of models/design.toml except for its ends."""
    from matplotlib.figure import Figure

    timing, clock = design.timing, design.converter.f_clk_hz
    breaks, settle, slot = timing.break_clocks, timing.settle_clocks, timing.slot_clocks
    # The break is a clock of hundreds: it is drawn wider.
    shown = max(breaks, 12)
    nets = {
        "row_select_o[n]": [(shown, slot)],
        "preset_o": [(0, settle)],
        "gate": [(settle, slot)],
        "row_select_o[n+1]": [(slot + shown, slot + 120)],
    }
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    axes = figure.subplots()
    for level, (net, spans) in enumerate(reversed(nets.items())):
        edges = [-40.0, *(edge for span in spans for edge in span), slot + 120]
        heights = [1.5 * level + n % 2 for n in range(len(edges) - 1)]
        axes.stairs(heights, edges, baseline=None, color="black")
        axes.text(-50, 1.5 * level + 0.3, net, ha="right", family="monospace")
    marks = {0: "0", shown: f"{breaks}", settle: f"{settle}", slot: f"{slot}"}
    axes.set_xticks(list(marks), list(marks.values()))
    axes.set_xlabel(f"clocks of {1e9 / clock:g} ns from the start of the slot of row n")
    axes.set(yticks=[], xlim=(-40, slot + 120))
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.grid(axis="x", color="0.85")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def commands_page() -> str:
    """Return the help of every command."""
    programs, shown = set(cli.elsewhere()) - set(cli.LATER), []
    for name in cli.cli.list_commands(click.Context(cli.cli)):
        said = CliRunner().invoke(cli.cli, [name, "--help"], terminal_width=90, prog_name="dermis").output
        shown.append((name, " (of a checkout)" if name in programs else "", said.rstrip()))
    return templates.text("commands.md", commands=shown)


def api_page() -> str:
    """Return the public names of the package with their docstrings."""
    names = []
    for name in sorted(set(dermis.__all__) - {"__version__"}, key=lambda n: (n[0].isupper(), n)):
        thing = getattr(dermis, name)
        members = [
            (member, "()" if inspect.isfunction(value) else "", value)
            for member, value in (vars(thing).items() if inspect.isclass(thing) else ())
            if isinstance(value, property) or inspect.isfunction(value)
            if not member.startswith("_") and value.__doc__
        ]
        names.append((name, thing, "" if inspect.isclass(thing) else _signature(thing), members))
    return templates.text("library.md", package=dermis, names=names, cleandoc=inspect.cleandoc)


def _signature(function: Callable[..., object]) -> str:
    parameters, lines = inspect.signature(function).parameters.values(), []
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in lines:
            lines.append("*")
        kind = parameter.annotation
        shown = parameter.replace(annotation=parameter.empty)
        equals = f" = {parameter.default!r}" if parameter.default is not parameter.empty else ""
        lines.append(f"{str(shown).partition('=')[0]}: {kind}{equals}")
    return "(\n    " + ",\n    ".join(lines) + ",\n)" if lines else "()"


DEMO_MARK = "<!-- demo -->"


def demo_page(source: Path) -> None:
    """Add the demo page and show it on the first page, or the reason why it cannot be built."""
    if reason := demo.have_compiler():
        shown = f"The demo is not in this build: {reason}."
    else:
        demo.build(source / "chip.html")
        shown = (
            '<iframe src="chip.html" title="The chip in this page: press the skin" '
            'style="width: 100%; height: 46rem; border: 1px solid #8888; border-radius: 10px"></iframe>'
        )
    for name in ("index.md", "demo.md"):
        _fill(source / name, {DEMO_MARK: shown})


def _fill(page: Path, parts: Mapping[str, str]) -> None:
    """Replace marks of a page, each of which must occur once."""
    text = markdown.filled(page.read_text(encoding="utf-8"), parts, page.name)
    page.write_text(text, encoding="utf-8")


SHORTENED = ("benchmarks", "characterise", "equivalence", "synthesis")
"""Pages of results whose long tables are cut on the site; all rows go into a csv file."""
SHOWN_ROWS = 10


WRITTEN = re.compile(r"<!-- begin: .*?<!-- end: ", re.S)
"""Tables that a command wrote into a page; the other tables are part of the text."""
TABLE = re.compile(r"^\|.*\n\|[-:| ]+\|\n(?:\|.*\n)+", re.M)


def shorten_tables(source: Path) -> None:
    """Shorten long tables of the result pages, missed limits first; write all rows to csv."""
    (source / "tables").mkdir()
    for name in SHORTENED:
        page = source / f"{name}.md"
        text = page.read_text(encoding="utf-8")
        long = [
            table[0]
            for part in WRITTEN.findall(text)
            for table in TABLE.finditer(part)
            if table[0].count("\n") > SHOWN_ROWS + 4  # two lines of header; a table with two rows more stays
        ]
        for number, table in enumerate(long, 1):
            text = text.replace(table, _shortened(table, source, f"tables/{name}_{number}.csv"))
        page.write_text(text, encoding="utf-8")


def _shortened(table: str, source: Path, file: str) -> str:
    head, rule, *rows = table.rstrip("\n").split("\n")
    with (source / file).open("w", encoding="utf-8", newline="") as out:
        csv.writer(out).writerows(
            [cell.strip().strip("`") for cell in _cells(line)] for line in (head, *rows)
        )
    missed = [row for row in rows if {"FAIL", "ERROR"} & {cell.strip() for cell in _cells(row)}]
    shown = [*missed, *(row for row in rows if row not in missed)][:SHOWN_ROWS]
    first = f", the {len(missed)} missed limits first" if missed else ""
    said = f"{len(shown)} of {len(rows)} rows{first}; all are in [{file}]({file})."
    return "\n".join([head, rule, *shown, "", said, ""])


def _cells(line: str) -> list[str]:
    return re.split(r"(?<!\\)\|", line.strip().strip("|"))


def write_source(source: Path | None = None) -> None:
    """Copy docs/ and add the generated pages and tables."""
    source = SOURCE if source is None else source
    design = designs.load()
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(ROOT / "docs", source)
    demo_page(source)
    (source / "commands.md").write_text(commands_page(), encoding="utf-8")
    (source / "library.md").write_text(api_page(), encoding="utf-8")
    schematics.pictures(source / "schematics")
    shorten_tables(source)
    timing_diagram(design, source / "figures" / "timing.svg")
    tables = {
        "key values": key_values(design),
        "pins": pins_table(),
        "range": generate.range_table(design, ROOT),
        **{name: rows_table(name) for name in MEASURED},
    }
    marked = {f"<!-- table: {name} -->": table for name, table in tables.items()}
    _fill(source / "datasheet.md", marked)


def build(write: Callable[[], None] = write_source) -> None:
    """Write the source of the site and build it; SimulatorError if a link is broken, or a page is in
    no menu.
    """
    write()
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "-f", CONFIG]
    children.run_logged(command, ROOT, BUILD / "site.log", LIMIT_S, "mkdocs", {"NO_MKDOCS_2_WARNING": "1"})


@click.command("docs")
def docs_command() -> int:
    """Build the documentation as a site in build/site; a broken link is an error."""
    build()
    click.echo(f"the site begins at {SITE / 'index.html'}")
    return 0
