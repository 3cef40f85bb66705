# SPDX-License-Identifier: Apache-2.0
"""Generate Verilog, SDC, SPICE, Python, C and docs from design.toml and dermis_registers.rdl.

``check`` compares the files of the tree with the generated text and shows each difference.
"""

import difflib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import tomlkit

from dermis.chip import hdl, sky130
from dermis.chip.spice_text import array_subckt
from dermis.errors import InputError
from dermis.files import between, write_atomic
from dermis.report import verdict
from dermis.scene import design as design_module
from dermis.scene import scene
from dermis.scene.design import ROOT, Design, exact
from scripts import calculator, effect_tables, first_picture, markdown, register_files, templates
from scripts.judged import finish

FRONT_END = "spice/sky130/dermis_analog_front_end.sp"
ORIGIN = "Generated from models/design.toml; change it there and run: dermis generate"


_MARKS = {"P": "paper", "C": "computed", "S": "source", "": ""}


def design_table(design: Design, root: Path) -> str:
    path = root / "models" / "design.toml"
    why, stored = design_module.reasons(path), []
    tables: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    for key, value in design.stored().items():
        table, name = key.split(".")
        # dermis calc says behind a value that the reason belongs to another one.
        changed = tables[table].item(name).trivia.comment.lstrip("# ") if name in tables[table] else ""
        said = f"{changed}: {why[key].text}" if changed else why[key].text
        stored.append((f"`{key}`", str(value), "changed" if changed else _MARKS[why[key].mark], said))
    derived = ((f"`{key}`", f"{value:.9g}") for key, value in design.derived().items())
    values = markdown.table(("name", "value", "from", "reason"), stored)
    return f"{values}\n\n{markdown.table(('derived', 'value'), derived)}"


def limits_table(_design: Design, root: Path) -> str:
    rows = []
    for name, limit in design_module.load_spec(root / "models" / "spec.toml").items():
        low, high = ("" if v is None else f"{v:.9g}" for v in (limit.min, limit.max))
        gates, conditions = "yes" if limit.gate else "no", limit.conditions
        rows.append((f"`{name}`", low, high, limit.unit, gates, conditions, f"`{limit.command}`"))
    return markdown.table(("limit", "min", "max", "unit", "gates", "conditions", "measured by"), rows)


def range_table(design: Design, _root: Path) -> str:
    rows = calculator.solve(calculator.Targets(), design).range_table()
    return markdown.table(calculator.RANGE_COLUMNS, ([f"{c:.6g}" for c in row] for row in rows), "---:")


# Targets of each kind: the paper's, a larger array, another sensor, more bits, and three that
# cannot be met.
EXAMPLES: tuple[dict[str, Any], ...] = (
    {},
    {"rows": 32, "cols": 32, "frame_rate_hz": 200.0},
    {"r_min_ohm": 1000.0, "k_force_n_ohm": 6000.0, "i_sensor_a": 5e-4},
    {"bits": 10},
    {"f_clk_hz": 4e6, "bits": 9},
    {"frame_s": 1e-4},
    {"topology": "direct", "gain_dc": 1000.0},
)


def examples_table(design: Design, _root: Path) -> str:
    """Return the calculator's answers to `EXAMPLES` for docs/numbers.md."""
    head = "targets, f_clk [Hz], slot = settle + gate, V_b [V], k, i0 [A], C [F], can it be built".split(", ")
    rows = []
    for targets in EXAMPLES:
        answer = calculator.solve(calculator.make_targets(**targets), design)
        v = answer.values()
        options = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in targets.items())
        cells = [f"`dermis calc {options}`".replace(" `", "`"), f"{v['f_clk_hz']:.6g}"]
        cells += [f"{v['slot_clocks']} = {v['settle_clocks']} + {v['gate_clocks']}"]
        cells += [f"{v[name]:.6g}" for name in ("v_bias_v", "k", "i0_a", "c_int_f")]
        missed = [f"{r['name']}: {r['note']}" for r in answer.rows if r["status"] != "PASS"]
        rows.append([*cells, "; ".join(missed) or "yes"])
    return markdown.table(head, rows)


TABLES: dict[str, dict[str, Callable[[Design, Path], str]]] = {
    "docs/numbers.md": {
        "design": design_table,
        "limits": limits_table,
        "range": range_table,
        "examples": examples_table,
    },
    "docs/effects.md": effect_tables.TABLES,
    "docs/registers.md": {"registers": register_files.table},
    "docs/scenes.md": {
        "keys": lambda _design, _root: scene.schema_table(),
        "scenes": lambda _design, _root: scene.scenes_table(),
    },
}


# Hand-written files with the clock period in ns in them, and its pattern.
PERIODS = {
    "rtl/synth/dermis.sdc": r"(?<=set clk_period )[\d.e+-]+",
    "rtl/harden/config.json": r'(?<="CLOCK_PERIOD": )[\d.e+-]+',
}


def generate_all(root: Path = ROOT) -> dict[str, str]:
    """Return every generated file as ``{path from the root: text}``.

    Only the tables of a page and the clock period of a constraint file are generated; the rest of
    these is kept.
    """
    design = design_module.load(file := root / "models" / "design.toml")
    rows, cols, timing = design.array.rows, design.array.cols, design.timing
    clocks = timing.gate_clocks, timing.settle_clocks, timing.break_clocks
    for key, value, allowed in hdl.chip_limits(rows, cols, timing.code_bits, *clocks):
        raise InputError(file, key, value, allowed)
    period_ns = float(10**9 / exact(design.converter.f_clk_hz))
    lateral = array_subckt(rows, cols, lateral_ohm="parameter", name="array_lateral", design=design)
    files = templates.filled(
        ("rtl/dermis_design.vh", "spice/design.inc", "spice/array/array.sp", FRONT_END),
        origin=ORIGIN,
        design=design,
        period_ps=round(10**12 / exact(design.converter.f_clk_hz)),
        array=array_subckt(rows, cols, design=design) + lateral,
        front_end=sky130.front_end(rows, cols),
    )
    files |= register_files.files(design, root)
    for path in (*PERIODS, *TABLES):
        text = _read(root / path)
        if text is None:
            raise InputError(path, "file", "missing", "a file with its generated parts")
        for name, make in TABLES.get(path, {}).items():
            begin, end = f"<!-- begin: {name} (written by dermis generate) -->", f"<!-- end: {name} -->"
            text = between(text, begin, end, make(design, root), path, f"table {name}")
        if pattern := PERIODS.get(path):
            text, places = re.subn(pattern, repr(period_ns), text)
            if places != 1:
                raise InputError(path, "clock period", f"{places} places", f"one that matches {pattern}")
        files[path] = text
    # Last: it compiles the Verilog, and a scene that does not fit the design is named above.
    files[first_picture.PATH] = first_picture.svg(design)
    return files


def write(root: Path = ROOT) -> list[str]:
    changed = {path: text for path, text in generate_all(root).items() if _read(root / path) != text}
    for path, text in changed.items():
        write_atomic(root / path, text)
    return list(changed)


def _read(path: Path) -> str | None:
    return path.read_bytes().decode("utf-8", "replace") if path.exists() else None


def drift(root: Path = ROOT, lines: int = 12) -> dict[str, str]:
    """Return ``{path: first differing lines}`` of the generated files, empty if up to date."""
    found: dict[str, str] = {}
    for path, text in generate_all(root).items():
        have = _read(root / path)
        if have is None or have == text:
            found[path] = "missing" if have is None else ""
            continue
        names = (f"{path} (in the tree)", f"{path} (from models/design.toml)")
        diff = list(difflib.unified_diff(have.splitlines(), text.splitlines(), *names, lineterm="", n=0))
        more = [f"... {len(diff) - lines} more lines"] if len(diff) > lines else []
        found[path] = "\n".join(diff[:lines] + more) or "line ends differ"
    return found


def check(root: Path = ROOT) -> list[verdict.Row]:
    """Return one verdict row per generated file: 0 if up to date, else 1 with the difference."""
    rows = []
    for path, said in drift(root).items():
        name, note = f"generate.drift_files.{re.sub(r'[/.]', '_', path)}", f"{path}: {said}" if said else path
        rows.append(verdict.judge(name, int(bool(said)), note))
    return rows


@click.command("generate")
@click.option("--check", "only_check", is_flag=True, help="Write nothing; fail if a file is out of date.")
def generate_command(only_check: bool) -> int:
    """Write Verilog header, clock periods, SPICE parameters, netlists, registers, tables in docs."""
    if only_check:
        return finish("gen-check", check(), "Generated files")
    changed = [f"written: {path}" for path in write()]
    click.echo("\n".join(changed) or "everything is up to date")
    return 0
