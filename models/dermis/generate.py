# SPDX-License-Identifier: Apache-2.0
"""Writes what follows from models/design.toml: Verilog header, SPICE parameters, array, tables in docs.

``check`` compares the files of the tree with what would be written now and shows each difference.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import ArrayLike

from dermis import calculator, scene, verdict
from dermis import design as design_module
from dermis.design import ROOT, Design, exact
from dermis.errors import InputError
from dermis.files import write_atomic

HEADER = "SPDX-License-Identifier: Apache-2.0"
ORIGIN = "Generated from models/design.toml; change it there and run: dermis generate"
DOCS_NUMBERS = "docs/numbers.md"


def verilog_header(design: Design) -> str:
    """Return rtl/dermis_design.vh: the defaults of the top-level parameters as macros."""
    period = 1 / exact(design.converter.f_clk_hz)
    macros = {
        "DERMIS_ROWS": design.array.rows,
        "DERMIS_COLS": design.array.cols,
        "DERMIS_CODE_BITS": design.timing.code_bits,
        "DERMIS_GATE_CLOCKS": design.timing.gate_clocks,
        "DERMIS_SETTLE_CLOCKS": design.timing.settle_clocks,
        "DERMIS_SLOT_CLOCKS": design.timing.slot_clocks,
        "DERMIS_T_CLK_PS": round(period * 10**12),
    }
    width = max(map(len, macros))
    lines = [f"// {HEADER}", f"// Defaults of the top-level parameters. {ORIGIN}"]
    lines += ["`ifndef DERMIS_DESIGN_VH", "`define DERMIS_DESIGN_VH"]
    lines += [f"`define {name:<{width}} {value}" for name, value in macros.items()]
    return "\n".join([*lines, "`endif", ""])


def spice_number(value: float | int) -> str:
    """Return a number as a deck may hold it; only finite numbers get there, never text."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} cannot stand in a deck")
    return repr(int(value)) if isinstance(value, int) else repr(number)


def spice_params(design: Design) -> str:
    """Return spice/design.inc: every numeric value, stored and derived, as ``.param section_key = value``."""
    lines = [f"* {HEADER}", f"* Every design value as a parameter, named section_key. {ORIGIN}"]
    for title, values in (("stored in design.toml", design.stored()), ("derived", design.derived())):
        lines.append(f"* {title}")
        for key, value in values.items():
            name = key.replace(".", "_")
            if isinstance(value, str):
                lines.append(f"* {name}: {value}")
            elif isinstance(value, list):
                stem = name.removesuffix("_options")
                lines += [f".param {stem}_{i} = {spice_number(v)}" for i, v in enumerate(value)]
            else:
                lines.append(f".param {name} = {spice_number(value)}")
    return "\n".join([*lines, ""])


def array_subckt(
    rows: int,
    cols: int,
    resistance_ohm: ArrayLike | None = None,
    lateral_ohm: ArrayLike | str | None = None,
    name: str = "array",
    design: Design | None = None,
    *,
    lateral_column_ohm: float | None = None,
    trace_row_ohm: float = 0.0,
    trace_column_ohm: float = 0.0,
    taxel_f: float = 0.0,
    slope_s_per_s: ArrayLike | None = None,
) -> str:
    """Write the taxel array as a subckt with the pins r0 r1 ... c0 c1 ...

    A taxel is a resistor ``rtaxel_r3c4`` between its row and its column; its inner electrode is the column
    line. A lateral resistor ``rlat_r3c4`` stands between the inner electrodes of (3, 4) and (3, 5).

    With trace resistance the taxel (3, 4) joins the nodes ``u_r3c4`` of its row line and ``v_r3c4`` of its column
    line, its inner electrode. Row line 3 runs pin, ``rtrace_row_r3c0``, u_r3c0, ``rtrace_row_r3c1``, u_r3c1 ...;
    column line 4 runs v_r0c4, ``rtrace_col_r0c4``, v_r1c4 ... last row, its rtrace_col, pin. Only then has a lateral
    resistor along a column (``rlat_col_r3c4``, to row 4) two ends, and is written.

    Parameters
    ----------
    rows, cols
        Size of the array.
    resistance_ohm
        Scalar or [rows, cols] in ohm; inf leaves the element out, what is below array.r_floor_ohm of the
        design becomes that. None makes each taxel a parameter ``r_r3c4_ohm``, r_max_ohm by default.
    lateral_ohm
        Scalar or [rows, cols - 1] in ohm (inf and 0 as above), None to leave the lateral resistors out,
        "parameter" to make them all ``{r_lateral_ohm}``, a parameter of the subckt.
    name
        Name of the subckt.
    design
        Where the defaults come from; models/design.toml when None.
    lateral_column_ohm
        Lateral resistors along a column, in ohm; None to leave them out.
    trace_row_ohm, trace_column_ohm
        Of a row and of a column line a taxel pitch, in ohm; 0 writes no element and makes the line one node.
    taxel_f
        Capacitance across every taxel in farad, ``ctaxel_r3c4``; 0 writes none.
    slope_s_per_s
        [rows, cols] in siemens a second: how fast conductances change. A taxel that does is a source
        ``btaxel_r3c4`` and no resistor; its resistance is that at time 0.

    Raises
    ------
    InputError
        Wrong shape, NaN, negative or non-numeric values.
    """
    if rows < 1 or cols < 1:
        raise InputError("array", "rows, cols", f"{rows}, {cols}", "at least 1 each")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise InputError("array", "name", repr(name), "a lower_snake word")
    design = design or design_module.load()
    floor = design.array.r_floor_ohm
    params: list[str] = []
    elements: list[str] = []

    def row_node(r: int, c: int) -> str:
        return f"u_r{r}c{c}" if trace_row_ohm else f"r{r}"

    def inner(r: int, c: int) -> str:
        return f"v_r{r}c{c}" if trace_column_ohm else f"c{c}"

    cells = [(r, c) for r in range(rows) for c in range(cols)]
    if resistance_ohm is None:
        default = spice_number(design.sensor.r_max_ohm)
        params += [f"r_r{r}c{c}_ohm={default}" for r, c in cells]
        elements += [f"rtaxel_r{r}c{c} {row_node(r, c)} {inner(r, c)} {{r_r{r}c{c}_ohm}}" for r, c in cells]
    else:
        slope = np.zeros((rows, cols)) if slope_s_per_s is None else np.asarray(slope_s_per_s, dtype=float)
        if slope.shape != (rows, cols) or not np.isfinite(slope).all():
            raise InputError(
                "array", "slope_s_per_s", f"shape {slope.shape}", f"finite, shape {(rows, cols)}"
            )
        for (r, c), ohm in _resistances("resistance_ohm", resistance_ohm, (rows, cols)):
            ends = f"{row_node(r, c)} {inner(r, c)}"
            if slope[r, c]:
                start, rate = spice_number(1.0 / max(ohm, floor)), spice_number(float(slope[r, c]))
                across = ends.replace(" ", ",")
                elements.append(f"btaxel_r{r}c{c} {ends} i = v({across})*({start} + ({rate})*time)")
            elif math.isfinite(ohm):
                elements.append(f"rtaxel_r{r}c{c} {ends} {spice_number(max(ohm, floor))}")
    if taxel_f:
        elements += [
            f"ctaxel_r{r}c{c} {row_node(r, c)} {inner(r, c)} {spice_number(float(taxel_f))}" for r, c in cells
        ]

    if isinstance(lateral_ohm, str):
        if lateral_ohm != "parameter":
            raise InputError("array", "lateral_ohm", repr(lateral_ohm), 'a number, None or "parameter"')
        params.append(f"r_lateral_ohm={spice_number(design.array.r_lateral_ohm)}")
        for r in range(rows):
            elements += [
                f"rlat_r{r}c{c} {inner(r, c)} {inner(r, c + 1)} {{r_lateral_ohm}}" for c in range(cols - 1)
            ]
    elif lateral_ohm is not None:
        for (r, c), ohm in _resistances("lateral_ohm", lateral_ohm, (rows, cols - 1)):
            if math.isfinite(ohm):
                elements.append(
                    f"rlat_r{r}c{c} {inner(r, c)} {inner(r, c + 1)} {spice_number(max(ohm, floor))}"
                )
    if trace_column_ohm and lateral_column_ohm is not None:
        for (r, c), ohm in _resistances("lateral_column_ohm", lateral_column_ohm, (rows - 1, cols)):
            if math.isfinite(ohm):
                elements.append(
                    f"rlat_col_r{r}c{c} {inner(r, c)} {inner(r + 1, c)} {spice_number(max(ohm, floor))}"
                )
    if trace_row_ohm:
        segment = spice_number(float(trace_row_ohm))
        for r, c in cells:
            before = row_node(r, c - 1) if c else f"r{r}"
            elements.append(f"rtrace_row_r{r}c{c} {before} {row_node(r, c)} {segment}")
    if trace_column_ohm:
        segment = spice_number(float(trace_column_ohm))
        for r, c in cells:
            behind = inner(r + 1, c) if r + 1 < rows else f"c{c}"
            elements.append(f"rtrace_col_r{r}c{c} {inner(r, c)} {behind} {segment}")

    head = [f".subckt {name}"]
    head += _folded([f"r{r}" for r in range(rows)] + [f"c{c}" for c in range(cols)], 16)
    if params:
        head += _folded([f"params: {params[0]}", *params[1:]], 4)
    return "\n".join([*head, *elements, f".ends {name}", ""])


def _resistances(key: str, values: ArrayLike, shape: tuple[int, int]) -> list[tuple[tuple[int, int], float]]:
    try:
        table = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError("array", key, "(not numeric)", "numbers in ohm") from None
    if table.ndim == 0:
        table = np.broadcast_to(table, shape)
    if table.shape != shape:
        raise InputError("array", key, f"shape {table.shape}", f"shape {shape}")
    bad = np.argwhere(~(table >= 0))
    if len(bad):
        r, c = map(int, bad[0])
        value = repr(float(table[r, c]))
        raise InputError("array", f"{key}[{r}, {c}]", value, "0 ohm or more, inf for an open taxel")
    return [((r, c), float(table[r, c])) for r in range(shape[0]) for c in range(shape[1])]


def _folded(words: list[str], per_line: int) -> list[str]:
    return ["+ " + " ".join(words[i : i + per_line]) for i in range(0, len(words), per_line)]


def array_file(design: Design) -> str:
    """Return spice/array/array.sp: `array` without, `array_lateral` with lateral resistors, as parameters."""
    rows, cols = design.array.rows, design.array.cols
    text = [
        f"* {HEADER}",
        f"* The {rows} x {cols} taxel array, each taxel r_r<row>c<col>_ohm. {ORIGIN}",
        "* Take `array` to leave the lateral resistors out, `array_lateral` to have them (r_lateral_ohm).",
        array_subckt(rows, cols, design=design)
        + array_subckt(rows, cols, lateral_ohm="parameter", name="array_lateral", design=design),
    ]
    return "\n".join(text)


_MARKS = {"P": "paper", "C": "computed", "S": "source", "": ""}


def _cell(text: object) -> str:
    return str(text).replace("|", "/")


def design_table(design: Design, root: Path) -> str:
    """Return the table of stored and derived design values for docs/numbers.md."""
    why = design_module.reasons(root / "models" / "design.toml")
    lines = ["| value | | from | reason |", "|---|---|---|---|"]
    for key, value in design.stored().items():
        mark, text = why[key].mark, why[key].text
        lines.append(f"| `{key}` | {_cell(value)} | {_MARKS[mark]} | {_cell(text)} |")
    lines += ["", "| derived | |", "|---|---|"]
    lines += [f"| `{key}` | {value:.9g} |" for key, value in design.derived().items()]
    return "\n".join(lines)


def limits_table(_design: Design, root: Path) -> str:
    """Return the table of limits for docs/numbers.md."""
    head = ("limit", "min", "max", "unit", "gates", "conditions", "measured by")
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, limit in design_module.load_spec(root / "models" / "spec.toml").items():
        low, high = ("" if v is None else f"{v:.9g}" for v in (limit.min, limit.max))
        gates = "yes" if limit.gate else "no"
        cells = (f"`{name}`", low, high, limit.unit, gates, _cell(limit.conditions), f"`{limit.command}`")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def range_table(design: Design, _root: Path) -> str:
    """Return the calculator's answer to the default wish, R against code, for docs/numbers.md."""
    answer = calculator.solve(calculator.Wish(), design)
    lines = [
        "| " + " | ".join(calculator.RANGE_COLUMNS) + " |",
        "|---:" * len(calculator.RANGE_COLUMNS) + "|",
    ]
    lines += ["| " + " | ".join(f"{cell:.6g}" for cell in row) + " |" for row in answer.range_table()]
    return "\n".join(lines)


# One wish of each kind: the paper's, a larger array, another sensor, more bits, and three that cannot be met.
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
    head = (
        "wish",
        "f_clk [Hz]",
        "slot = settle + gate",
        "V_b [V]",
        "k",
        "i0 [A]",
        "C [F]",
        "can it be built",
    )
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for wishes in EXAMPLES:
        answer = calculator.solve(calculator.make_wish(**wishes), design)
        v = answer.values()
        options = " ".join(f"--{name.replace('_', '-')} {_cell(value)}" for name, value in wishes.items())
        cells = [f"`dermis calc {options}`".replace(" `", "`"), f"{v['f_clk_hz']:.6g}"]
        cells += [f"{v['slot_clocks']} = {v['settle_clocks']} + {v['gate_clocks']}"]
        cells += [f"{v[name]:.6g}" for name in ("v_bias_v", "k", "i0_a", "c_int_f")]
        missed = [f"{r['name']}: {r['note']}" for r in answer.rows if r["status"] != "PASS"]
        lines.append("| " + " | ".join([*cells, _cell("; ".join(missed)) or "yes"]) + " |")
    return "\n".join(lines)


def effect_table(which: str, design: Design) -> str:
    """One of the tables of dermis.effect_tables, which needs the decks, and they this module."""
    from dermis import effect_tables

    return getattr(effect_tables, which)(design)


TABLES: dict[str, dict[str, Callable[[Design, Path], str]]] = {
    "docs/numbers.md": {
        "design": design_table,
        "limits": limits_table,
        "range": range_table,
        "examples": examples_table,
    },
    "docs/effects.md": {
        "meanings": lambda design, _root: effect_table("meanings", design),
        "places": lambda design, _root: effect_table("places", design),
        "bounds": lambda design, _root: effect_table("bounds", design),
    },
    "docs/scenes.md": {
        "keys": lambda _design, _root: scene.schema_table(),
        "scenes": lambda _design, _root: scene.scenes_table(),
    },
}


def _with_tables(path: str, text: str, design: Design, root: Path) -> str:
    for name, make in TABLES[path].items():
        begin, end = f"<!-- begin: {name} (written by dermis generate) -->", f"<!-- end: {name} -->"
        if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
            raise InputError(
                path, f"table {name}", "(its markers)", f"once each, in this order: {begin} {end}"
            )
        head, rest = text.split(begin)
        tail = rest.split(end)[1]
        text = f"{head}{begin}\n{make(design, root)}\n{end}{tail}"
    return text


def generate_all(root: Path = ROOT) -> dict[str, str]:
    """Return every generated file as ``{path from the root: text}``; in docs only the tables change."""
    design = design_module.load(root / "models" / "design.toml")
    files = {
        "rtl/dermis_design.vh": verilog_header(design),
        "spice/design.inc": spice_params(design),
        "spice/array/array.sp": array_file(design),
    }
    for path in TABLES:
        text = _read(root / path)
        if text is None:
            raise InputError(path, "file", "(absent)", "a file with the marks of its generated tables")
        files[path] = _with_tables(path, text, design, root)
    return files


def write(root: Path = ROOT) -> list[str]:
    """Write the generated files that differ; return their paths."""
    changed = {path: text for path, text in generate_all(root).items() if _read(root / path) != text}
    for path, text in changed.items():
        write_atomic(root / path, text)
    return list(changed)


def _read(path: Path) -> str | None:
    return path.read_bytes().decode("utf-8", "replace") if path.exists() else None


def drift(root: Path = ROOT, lines: int = 12) -> dict[str, str]:
    """Return ``{path: its first differing lines}`` of the files that are not as they would be written."""
    found: dict[str, str] = {}
    for path, text in generate_all(root).items():
        have = _read(root / path)
        if have is None:
            found[path] = "missing"
        elif have != text:
            names = (f"{path} (in the tree)", f"{path} (from models/design.toml)")
            diff = list(difflib.unified_diff(have.splitlines(), text.splitlines(), *names, lineterm="", n=0))
            more = [f"... {len(diff) - lines} more lines"] if len(diff) > lines else []
            found[path] = "\n".join(diff[:lines] + more) or "line ends differ"
    return found


def check(root: Path = ROOT) -> list[verdict.Row]:
    """Return one verdict row a generated file: 0 as it would be written, 1 (and the difference) if not."""
    drifted = drift(root)
    rows = []
    for path in generate_all(root):
        name = "generate.drift_files." + path.replace("/", "_").replace(".", "_")
        note = f"{path}: {drifted[path]}" if path in drifted else path
        rows.append(verdict.judge(name, int(path in drifted), note))
    return rows


@click.command("generate")
@click.option(
    "--check", "only_check", is_flag=True, help="Write nothing; fail on each file that has drifted."
)
def generate_command(only_check: bool) -> None:
    """Write the Verilog header, the SPICE parameters, the array netlist and the tables in docs."""
    if only_check:
        rows = check()
        verdict.write_rows("gen-check", rows)
        verdict.print_rows(rows, "Generated files")
        if code := verdict.exit_code(rows):
            raise click.exceptions.Exit(code)
        return
    changed = write()
    for path in changed:
        click.echo(f"written: {path}")
    if not changed:
        click.echo("everything is up to date")
