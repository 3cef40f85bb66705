# SPDX-License-Identifier: Apache-2.0
"""Build the documentation as a site: docs/, and pages of commands, library, design, results."""

import csv
import inspect
import itertools
import json
import re
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
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


@dataclass(frozen=True)
class Measured:
    """One measured row: its values as text, and the file that it was read from."""

    least: str
    typical: str
    most: str
    unit: str
    source: str


def measured() -> dict[str, Measured]:
    """Return measured rows by name, from build/*.json, else as commands recorded them in the pages of docs/."""
    found: dict[str, Measured] = {}
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
                found[name] = Measured(*cells, f"docs/{path.name}")
    for path in sorted(BUILD.glob("*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        for row in data if isinstance(data, list) else []:
            if isinstance(row, dict) and isinstance(row.get("value"), int | float):
                value = f"{row['value']:.6g}"
                found[row["name"]] = Measured("", value, "", row["unit"], f"build/{path.name}")
    return found


def row(found: Mapping[str, Measured], name: str, meaning: str) -> str:
    """Return a measured row of the datasheet with its file and command, or the rows below a name."""
    rule = designs.spec().get(name) or designs.spec().get(name.rpartition(".")[0])
    limit = markdown.limits(rule.min, rule.max) if rule else ""
    command = f"`{rule.command if rule else _COMMANDS[name.partition('.')[0]]}`"
    below = {k: r for k, r in found.items() if k == name or k.startswith(f"{name}.")}
    below = {name: below[name]} if name in below else below
    none = Measured("", "not measured here", "", "", "")
    lines = []
    for key, r in itertools.islice((below or {name: none}).items(), 3):
        said = meaning + (f": {key[len(name) + 1 :]}" if key != name else "")
        source = f"`{r.source}`" if r.source else ""
        lines.append(" | ".join((said, r.least, r.typical, r.most, r.unit, limit, source, command)))
    return "\n".join(f"| {line} |" for line in lines)


_COMMANDS = {
    "frame": "make sim",
    "sky130": "make characterise",
    "synth": "make synth TECH=sky130",
    "accuracy_chip": "make accuracy-chip",
}


def datasheet(text: str, design: Design) -> str:
    """Return the datasheet from its page, a template; SimulatorError if its pins are not those of rtl/dermis_top.v."""
    top = (ROOT / "rtl" / "dermis_top.v").read_text(encoding="utf-8")
    found = re.findall(r"^  (input|output) +wire +(?:\[([^\]]+)\] +)?(\w+)", top, re.M)
    ports = {name: f"{way} | {width.replace('-1:0', '') or 1}" for way, width, name in found}
    told: list[str] = []

    def pin(name: str, meaning: str) -> str:
        told.append(name)
        return f"| `{name}` | {ports.get(name)} | {meaning} |"

    table = generate.range_table(design, ROOT)
    page = templates.rendered(text, design=design, row=partial(row, measured()), pin=pin, range=table)
    if sorted(told) != sorted(ports):
        raise SimulatorError("the pins of docs/datasheet.md differ from the ports of rtl/dermis_top.v")
    return page


def timing_diagram(design: Design, path: Path) -> None:
    """Draw one row slot, to the scale of models/design.toml except for its ends."""
    from matplotlib.figure import Figure

    timing, clock = design.timing, design.converter.f_clk_hz
    breaks, settle, slot = timing.break_clocks, timing.settle_clocks, timing.slot_clocks
    shown = max(breaks, 12)  # the break is a clock of hundreds, and is drawn wider
    nets = {
        "row_select_o[n]": (shown, slot),
        "preset_o": (0, settle),
        "gate": (settle, slot),
        "row_select_o[n+1]": (slot + shown, slot + 120),
    }
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    axes = figure.subplots()
    for level, (net, high) in enumerate(reversed(nets.items())):
        low = 1.5 * level
        axes.stairs([low, low + 1, low], [-40.0, *high, slot + 120], baseline=None, color="black")
        axes.text(-50, low + 0.3, net, ha="right", family="monospace")
    marks = {0: "0", shown: f"{breaks}", settle: f"{settle}", slot: f"{slot}"}
    axes.set_xticks(list(marks), list(marks.values()))
    axes.set_xlabel(f"clocks of {1e9 / clock:g} ns from the start of the slot of row n")
    axes.set(yticks=[], xlim=(-40, slot + 120))
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.grid(axis="x", color="0.85")
    figure.savefig(path, metadata={"Date": None})


def commands_page() -> str:
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
        # As it is written, of a function.
        head = re.match(r"def \w+(\(.*?\)) ->", inspect.getsource(thing), re.S)
        names.append((name, thing, head[1] if head else "", members))
    return templates.text("library.md", package=dermis, names=names, cleandoc=inspect.cleandoc)


def demo_page(source: Path) -> None:
    """Add the demo page and show it on the first page, or the reason why it cannot be built."""
    if reason := demo.have_compiler():
        shown = f"The demo is not in this build: {reason}."
    else:
        demo.build(source / "chip.html")
        shown = (
            '<iframe src="chip.html" title="The chip in this page: press the skin" '
            'style="width: 100%; height: 40rem; border: 1px solid #8888; border-radius: 10px"></iframe>'
        )
    for page in (source / "index.md", source / "demo.md"):
        text = markdown.filled(page.read_text(encoding="utf-8"), {"<!-- demo -->": shown}, page.name)
        page.write_text(f"---\nhide: [toc]\n---\n\n{text}", encoding="utf-8")  # more room for the demo


SHEET_SCALE = 1.25
"""Size of a sheet on its page: names of pins are 13 px then."""


def schematic_pages(source: Path) -> None:
    """Give each block of schematics.md its own page, and list them; SimulatorError if a block is there twice."""
    page = source / "schematics.md"
    intro, *sections = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.M)
    listed = [intro.rstrip()]
    for section in sections:
        title, *blocks = re.split(r"^### ", section, flags=re.M)
        listed += [f"## {title.strip()}", "| block | purpose |\n|---|---|"]
        for block in blocks:
            name, text = block.split("\n", 1)
            said, picture, _ = text.partition("[![")
            own = source / "schematics" / f"{name}.md"
            if own.exists() or not picture:
                raise SimulatorError(f"docs/schematics.md: block {name} is there twice, or has no picture")
            drawn = own.with_suffix(".svg").read_text(encoding="utf-8")
            size = re.search(r'width="([\d.]+)" height="([\d.]+)"', drawn)
            assert size is not None
            width, height = (round(SHEET_SCALE * float(number)) for number in size.groups())
            image = f'<img src="{name}.svg" alt="Sheet of {name}" width="{width}" height="{height}">'
            own.write_text(
                f"---\nhide: [toc]\n---\n\n# {name}\n\n{said.strip()}\n\n"
                f"The sheet scrolls here; [alone it fits a window]({name}.svg).\n\n"
                f'<div class="sheet" tabindex="0">{image}</div>\n',
                encoding="utf-8",
            )
            listed[-1] += f"\n| [{name}](schematics/{name}.md) | {' '.join(said.split())} |"
    page.write_text("\n\n".join(listed) + "\n", encoding="utf-8")


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
        tables = [table for part in WRITTEN.findall(text) for table in TABLE.findall(part)]
        # Two lines are the header; a table with two rows more stays.
        long = (table for table in tables if table.count("\n") > SHOWN_ROWS + 4)
        for number, table in enumerate(long, 1):
            head, rule, *rows = table.rstrip("\n").split("\n")
            cells = {row: [cell.strip(" `") for cell in _cells(row)] for row in (head, *rows)}
            file = f"tables/{name}_{number}.csv"
            with (source / file).open("w", encoding="utf-8", newline="") as out:
                csv.writer(out).writerows(cells[row] for row in (head, *rows))
            missed = [row for row in rows if {"FAIL", "ERROR"} & {*cells[row]}]
            shown = [*missed, *(row for row in rows if row not in missed)][:SHOWN_ROWS]
            first = f", the {len(missed)} missed limits first" if missed else ""
            said = f"{len(shown)} of {len(rows)} rows{first}; all are in [{file}]({file})."
            text = text.replace(table, "\n".join([head, rule, *shown, "", said, ""]))
        page.write_text(text, encoding="utf-8")


def _cells(line: str) -> list[str]:
    return re.split(r"(?<!\\)\|", line.strip().strip("|"))


def write_source() -> None:
    """Copy docs/ to SOURCE and add the generated pages and tables."""
    design, source = designs.load(), SOURCE
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(ROOT / "docs", source)
    demo_page(source)
    (source / "commands.md").write_text(commands_page(), encoding="utf-8")
    (source / "library.md").write_text(api_page(), encoding="utf-8")
    schematics.pictures(source / "schematics")
    schematic_pages(source)
    shorten_tables(source)
    timing_diagram(design, source / "figures" / "timing.svg")
    page = source / "datasheet.md"
    page.write_text(datasheet(page.read_text(encoding="utf-8"), design), encoding="utf-8")


def build(write: Callable[[], None] = write_source) -> None:
    """Write the source of the site and build it; SimulatorError if a link is broken, or a page is in no menu."""
    write()
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "-f", CONFIG]
    children.run_logged(command, ROOT, BUILD / "site.log", LIMIT_S, "mkdocs", {"NO_MKDOCS_2_WARNING": "1"})


@click.command("docs")
def docs_command() -> int:
    """Build the documentation as a site in build/site; a broken link is an error."""
    build()
    click.echo(f"the site begins at {SITE / 'index.html'}")
    return 0
