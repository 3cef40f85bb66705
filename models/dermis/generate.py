# SPDX-License-Identifier: Apache-2.0
"""Writes what follows from models/design.toml: the Verilog header, the SPICE parameters, the array netlist, tables in docs/.

``check`` compares the files of the tree with what would be written now and shows each difference.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import ArrayLike

from dermis import design as design_module
from dermis.design import ROOT, Design, exact
from dermis.errors import InputError

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
                lines += [f".param {name.removesuffix('_options')}_{i} = {spice_number(v)}" for i, v in enumerate(value)]
            else:
                lines.append(f".param {name} = {spice_number(value)}")
    return "\n".join([*lines, ""])


def array_subckt(
    rows: int,
    cols: int,
    resistance_ohm: ArrayLike | None = None,
    lateral_ohm: ArrayLike | str | None = None,
    name: str = "array",
) -> str:
    """Write the taxel array as a subckt with the pins r0 r1 ... c0 c1 ...

    A taxel is a resistor ``rtaxel_r3c4`` between its row and its column; its inner electrode is the column line.
    A lateral resistor ``rlat_r3c4`` stands between the inner electrodes of (3, 4) and (3, 5). Those along a column
    would have both ends on one line (there is no trace resistance here) and are not written.

    Parameters
    ----------
    rows, cols
        Size of the array.
    resistance_ohm
        [rows, cols] in ohm; inf leaves the element out, 0 becomes array.r_floor_ohm of design.toml. None makes each
        taxel a parameter ``r_r3c4_ohm`` of the subckt, r_max_ohm by default.
    lateral_ohm
        Scalar or [rows, cols - 1] in ohm (inf and 0 as above), None to leave the lateral resistors out, "parameter" to
        make them all ``{r_lateral_ohm}``, a parameter of the subckt.
    name
        Name of the subckt.

    Raises
    ------
    InputError
        Wrong shape, NaN, negative or non-numeric values.
    """
    if rows < 1 or cols < 1:
        raise InputError("array", "rows, cols", f"{rows}, {cols}", "at least 1 each")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise InputError("array", "name", repr(name), "a lower_snake word")
    design = design_module.load()
    floor = design.array.r_floor_ohm
    params: list[str] = []
    elements: list[str] = []

    if resistance_ohm is None:
        default = spice_number(design.sensor.r_max_ohm)
        for r in range(rows):
            params += [f"r_r{r}c{c}_ohm={default}" for c in range(cols)]
            elements += [f"rtaxel_r{r}c{c} r{r} c{c} {{r_r{r}c{c}_ohm}}" for c in range(cols)]
    else:
        for (r, c), ohm in _resistances("resistance_ohm", resistance_ohm, (rows, cols)):
            if math.isfinite(ohm):
                elements.append(f"rtaxel_r{r}c{c} r{r} c{c} {spice_number(max(ohm, floor))}")

    if isinstance(lateral_ohm, str):
        if lateral_ohm != "parameter":
            raise InputError("array", "lateral_ohm", repr(lateral_ohm), 'a number, None or "parameter"')
        params.append(f"r_lateral_ohm={spice_number(design.array.r_lateral_ohm)}")
        elements += [f"rlat_r{r}c{c} c{c} c{c + 1} {{r_lateral_ohm}}" for r in range(rows) for c in range(cols - 1)]
    elif lateral_ohm is not None:
        for (r, c), ohm in _resistances("lateral_ohm", lateral_ohm, (rows, cols - 1)):
            if math.isfinite(ohm):
                elements.append(f"rlat_r{r}c{c} c{c} c{c + 1} {spice_number(max(ohm, floor))}")

    head = [f".subckt {name}"]
    head += _folded([f"r{r}" for r in range(rows)] + [f"c{c}" for c in range(cols)], 16)
    if params:
        head += _folded([f"params: {params[0]}", *params[1:]], 4)
    return "\n".join([*head, *elements, f".ends {name}", ""])


def _resistances(key: str, values: ArrayLike, shape: tuple[int, int]) -> list[tuple[tuple[int, int], float]]:
    try:
        table = np.broadcast_to(np.asarray(values, dtype=float), shape) if np.ndim(values) == 0 else np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError("array", key, "(not numeric)", "numbers in ohm") from None
    if table.shape != shape:
        raise InputError("array", key, f"shape {table.shape}", f"shape {shape}")
    bad = np.argwhere(~(table >= 0))
    if len(bad):
        r, c = map(int, bad[0])
        raise InputError("array", f"{key}[{r}, {c}]", repr(float(table[r, c])), "0 ohm or more, inf for an open taxel")
    return [((r, c), float(table[r, c])) for r in range(shape[0]) for c in range(shape[1])]


def _folded(words: list[str], per_line: int) -> list[str]:
    return ["+ " + " ".join(words[i : i + per_line]) for i in range(0, len(words), per_line)]


def array_file(design: Design) -> str:
    """Return spice/array/array.sp: `array` without and `array_lateral` with lateral resistors, all values parameters."""
    rows, cols = design.array.rows, design.array.cols
    text = [f"* {HEADER}", f"* The {rows} x {cols} taxel array, each taxel r_r<row>c<col>_ohm. {ORIGIN}"]
    text += ["* Take `array` to leave the lateral resistors out, `array_lateral` to have them (r_lateral_ohm)."]
    plain = array_subckt(rows, cols)
    return "\n".join([*text, plain + array_subckt(rows, cols, lateral_ohm="parameter", name="array_lateral")])


_MARKS = {"P": "paper", "C": "computed", "S": "source", "": ""}


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else repr(value)


def design_table(design: Design) -> str:
    """Return the table of stored and derived design values for docs/numbers.md."""
    why = design_module.reasons()
    lines = ["| value | | from | reason |", "|---|---|---|---|"]
    for key, value in design.stored().items():
        reason = why[key]
        lines.append(f"| `{key}` | {_plain(value)} | {_MARKS[reason.mark]} | {reason.text.replace('|', '/')} |")
    lines += ["", "| derived | |", "|---|---|"]
    lines += [f"| `{key}` | {value:.9g} |" for key, value in design.derived().items()]
    return "\n".join(lines)


def limits_table(_design: Design) -> str:
    """Return the table of limits for docs/numbers.md."""
    lines = ["| limit | min | max | unit | gates | conditions | measured by |", "|---|---|---|---|---|---|---|"]
    for name, limit in design_module.spec().items():
        low, high = ("" if v is None else f"{v:.9g}" for v in (limit.min, limit.max))
        gates = "yes" if limit.gate else "no"
        text = limit.conditions.replace("|", "/")
        lines.append(f"| `{name}` | {low} | {high} | {limit.unit} | {gates} | {text} | `{limit.command}` |")
    return "\n".join(lines)


def sizing_table(_design: Design) -> str:
    """Return the calculator's answer to the default wish, R against code, for docs/numbers.md."""
    from dermis import calculator

    return calculator.range_table_markdown(calculator.solve(calculator.Wish()))


TABLES: dict[str, dict[str, Callable[[Design], str]]] = {
    DOCS_NUMBERS: {"design": design_table, "limits": limits_table, "range": sizing_table},
}


def _with_tables(path: str, text: str, design: Design) -> str:
    for name, make in TABLES[path].items():
        begin, end = f"<!-- begin: {name} (generated by dermis generate) -->", f"<!-- end: {name} -->"
        head, found_begin, rest = text.partition(begin)
        _, found_end, tail = rest.partition(end)
        if not (found_begin and found_end):
            raise InputError(path, f"table {name}", "(absent)", f"the lines {begin} and {end}")
        text = f"{head}{begin}\n{make(design)}\n{end}{tail}"
    return text


def generate_all(root: Path = ROOT) -> dict[str, str]:
    """Return every generated file as ``{path from the root: text}``; files with tables keep the rest of their text."""
    design = design_module.load(None if root == ROOT else root / "models" / "design.toml")
    files = {
        "rtl/dermis_design.vh": verilog_header(design),
        "spice/design.inc": spice_params(design),
        "spice/array/array.sp": array_file(design),
    }
    for path in TABLES:
        if (root / path).exists():
            files[path] = _with_tables(path, (root / path).read_text(encoding="utf-8"), design)
    return files


def write_atomic(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write(root: Path = ROOT) -> list[str]:
    """Write the generated files that differ; return their paths."""
    changed = [path for path, text in generate_all(root).items() if _read(root / path) != text]
    files = generate_all(root)
    for path in changed:
        write_atomic(root / path, files[path])
    return changed


def _read(path: Path) -> str | None:
    return path.read_bytes().decode("utf-8", "replace") if path.exists() else None


def drift(root: Path = ROOT, lines: int = 12) -> dict[str, str]:
    """Return ``{path: first lines of the difference}`` of every generated file that is not as it would be written."""
    found: dict[str, str] = {}
    for path, text in generate_all(root).items():
        have = _read(root / path)
        if have is None:
            found[path] = "missing"
        elif have != text:
            pair = (have.splitlines(), text.splitlines(), f"{path} (in the tree)", f"{path} (from models/design.toml)")
            diff = list(difflib.unified_diff(*pair, lineterm="", n=0))
            more = [f"... {len(diff) - lines} more lines"] if len(diff) > lines else []
            found[path] = "\n".join(diff[:lines] + more) or "line ends differ"
    return found


def check(root: Path = ROOT) -> list[dict[str, Any]]:
    """Return one verdict row a generated file: 0 where the tree has it as it would be written, else 1 and a difference."""
    from dermis import verdict

    drifted = drift(root)
    return [
        verdict.judge(f"generate.drift_files.{path.rpartition('/')[2].replace('.', '_')}", int(path in drifted),
                      f"{path}: {drifted[path]}" if path in drifted else path)
        for path in generate_all(root)
    ]


@click.command("generate")
@click.option("--check", "only_check", is_flag=True, help="Write nothing; fail on each file that is not up to date.")
def generate_command(only_check: bool) -> int:
    """Write the Verilog header, the SPICE parameters, the array netlist and the tables in docs from design.toml."""
    from dermis import verdict

    if not only_check:
        changed = write()
        for path in changed:
            click.echo(f"written: {path}")
        click.echo("" if changed else "everything is up to date", nl=not changed)
        return 0
    rows = check()
    verdict.write_rows("gen-check", rows)
    verdict.print_rows(rows, "generated files")
    for text in drift().values():
        click.echo(text)
    code = verdict.exit_code(rows)
    if code:
        raise click.exceptions.Exit(code)
    return code
