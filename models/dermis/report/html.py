# SPDX-License-Identifier: Apache-2.0
"""Report pages: the verdict tables and runs of a command as one HTML file, with plots that can be
zoomed.

Bokeh draws. Its wheel carries the JavaScript, 1.27 MB for plots alone, which goes into the page, so
a page needs no network. Plotly's has 4.5 MB, and that of Vega-Altair is not in its wheel.
"""

from __future__ import annotations

import csv
import datetime
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.chip import vcd_file
from dermis.converter import vfc
from dermis.decode.force import decode
from dermis.errors import DermisError, InputError, one_line, optional
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.records import Plan
from dermis.report import output, verdict
from dermis.report.verdict import Row

WAVE_POINTS = 3000
"""Points of one analog trace: more than a screen is wide, and 24 kB."""
WAVE_COLUMNS = 4
WORST = 10
RUNS_DRAWN = 8
"""Runs of one page that are drawn; the others are listed."""
CSV_ROWS = 20_000
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#666666"

TEMPLATE, STYLE = Path(__file__).with_name("page.html"), Path(__file__).with_name("page.css")
ORDER = ("ERROR", "FAIL", "SKIP", "PASS")
"""Missed limits come first."""


@dataclass
class Part:
    """One part of a page: heading, line of text with a command, table and plots; see page.html."""

    heading: str
    level: int = 2
    text: str = ""
    code: str = ""
    counts: Sequence[tuple[str, int]] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[Any]] = ()
    numbers: Sequence[int] = ()
    """Places of the columns that hold numbers."""
    plots: Sequence[Any] = ()


def _bokeh(module: str) -> Any:
    return optional(f"bokeh.{module}", "report")


def write(
    path: Path,
    title: str,
    tables: Mapping[str, Sequence[Row]],
    runs: Sequence[Path],
    data: Sequence[Path] = (),
    command: Sequence[str] | None = None,
) -> None:
    """Write a report page.

    Parameters
    ----------
    path : the page, whole or not at all
    title : its heading
    tables : verdict rows by the name of their target
    runs : directories that `dermis run` or the like has filled
    data : csv files of numbers, drawn column by column
    command : the command that repeats it; that of this process by default
    """
    command = ["dermis", *sys.argv[1:]] if command is None else command
    parts = [Part(title, 1, f"{_utc()}. Repeat with:", shlex.join(command))]
    parts += [_verdicts("Verdicts" if len(tables) == 1 else name, rows) for name, rows in tables.items()]
    # Waves of one run are drawn: they are most of a page.
    with_waves = next((directory for directory in runs if (directory / "waves.vcd").is_file()), None)
    for directory in runs[:RUNS_DRAWN]:
        parts += _run(directory, waves=directory == with_waves)
    if runs[RUNS_DRAWN:]:
        parts.append(Part("Further runs", heads=("directory",), rows=[(str(d),) for d in runs[RUNS_DRAWN:]]))
    for file in data:
        parts += _numbers(file)
    parts.append(Part("Versions", heads=("package", "version"), rows=list(output.versions().items())))
    write_atomic(path, _page(title, parts))


def _page(title: str, parts: Sequence[Part]) -> str:
    """Return the HTML of a page; bokeh renders all plots together."""
    markup = optional("markupsafe", "report").Markup
    script, places = "", {}
    if plots := {plot.id: plot for part in parts for plot in part.plots}:
        script, places = _bokeh("embed").components(plots)
        script = _bokeh("resources").Resources(mode="inline", components=["bokeh"]).render() + script
    jinja = optional("jinja2", "report")
    # Every text becomes one line, and is escaped.
    environment = jinja.Environment(
        autoescape=True,
        trim_blocks=True,
        finalize=lambda said: said if isinstance(said, markup) else one_line(str(said), 2000),
    )
    return str(
        environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
            title=title,
            parts=parts,
            places={name: markup(place) for name, place in places.items()},
            script=markup(script),
            style=markup(STYLE.read_text(encoding="utf-8")),
            marks=(*ORDER, "on"),
        )
    )


def _utc(seconds: float | None = None) -> str:
    """Return a moment in words: seconds since 1970, or now."""
    utc = datetime.UTC
    when = datetime.datetime.now(utc) if seconds is None else datetime.datetime.fromtimestamp(seconds, utc)
    return when.strftime("%Y-%m-%d %H:%M UTC")


def _number(value: Any) -> str:
    return "" if value is None else f"{value:.6g}"


# ---- verdicts ---------------------------------------------------------------------------------------------------


def _counts(rows: Sequence[Row], statuses: Sequence[str] = tuple(verdict.COLOURS)) -> list[tuple[str, int]]:
    return [(status, sum(row["status"] == status for row in rows)) for status in statuses]


def _verdicts(heading: str, rows: Sequence[Row]) -> Part:
    lines = [
        (
            row["name"],
            *(_number(row[key]) for key in ("value", "min", "max")),
            row["unit"],
            row["status"],
            row["note"],
        )
        for row in sorted(rows, key=lambda row: ORDER.index(row["status"]))
    ]
    judged = [(row["name"], share, row["status"]) for row in rows if (share := _share(row)) is not None]
    return Part(
        heading,
        text="" if rows else "no rows",
        counts=[(status, number) for status, number in _counts(rows) if number],
        heads=("name", "value", "min", "max", "unit", "status", "note"),
        rows=lines,
        numbers=(1, 2, 3),
        plots=[_against_limits(judged)] if len(judged) > 2 else [],
    )


def _share(row: Row) -> float | None:
    """Return a value relative to its limit, 1 at the limit and less inside, or None."""
    value, low, high = row["value"], row["min"], row["max"]
    if value is None:
        return None
    if value < 0:
        return float(value / low) if low is not None and low < 0 else None
    if high:
        return float(value / high)
    return float(low / value) if low and value else None


def _against_limits(judged: Sequence[tuple[str, float, str]]) -> Any:
    names, shares, statuses = zip(*reversed(judged), strict=True)
    source = {
        "name": names,
        "share": [max(share, 1e-4) for share in shares],
        "colour": [GREEN if status == "PASS" else RED for status in statuses],
    }
    figure = _figure(
        "Value relative to its limit; the limit is at 1", width=1150, height=120 + 17 * len(names), y_range=names,
        x_axis_type="log", tooltips=[("", "@name"), ("share of the limit", "@share")]
    )  # fmt: skip
    models = _bokeh("models")
    figure.scatter("share", "name", color="colour", size=8, source=models.ColumnDataSource(source))
    line = models.Span(location=1.0, dimension="height", line_color=GREY, line_dash="dashed")
    figure.add_layout(line)
    return figure


def _figure(title: str, x: str = "", y: str = "", **options: Any) -> Any:
    options = {"width": 560, "height": 360, "tools": "pan,box_zoom,wheel_zoom,reset,save,hover", **options}
    figure = _bokeh("plotting").figure(title=title, x_axis_label=x or None, y_axis_label=y or None, **options)
    figure.toolbar.logo = None
    return figure


# ---- a run --------------------------------------------------------------------------------------------------------


def _run(directory: Path, waves: bool) -> Iterator[Part]:
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    engine, scene = summary["engine"], directory / "resolved.toml"
    frames = "1 frame" if summary["frames"] == 1 else f"{summary['frames']} frames"
    size = f"{frames} of {summary['rows']} x {summary['cols']}"
    again = shlex.join(["dermis", "run", str(scene), "--engine", engine])
    heading = summary["title"] or directory.name
    text = f"{size}, engine {engine}, seed {summary['seed']}. Repeat with:"
    codes = np.load(directory / "codes.npy")
    try:
        made = plan.load(scene, engine)
    except DermisError as error:  # a file of the scene is gone: the codes are there all the same
        yield Part(heading, text=text, code=again, plots=[_map("Codes", codes[0].astype(float), "code")])
        yield Part("Worst taxels", 3, f"unknown, because the scene cannot be read any more: {error}")
    else:
        yield Part(heading, text=text, code=again, plots=_maps(made, codes))
        yield _worst(made, codes)
    yield _effects(summary["effects"])
    if waves:
        yield from _waves(directory / "waves.vcd", codes)


def _ideal(made: Plan) -> NDArray[np.int64]:
    """Return codes of an ideal read-out, [frames, rows, cols]."""
    return vfc.code(made.duty_ideal(), made.timing.gate_clocks, made.timing.code_max)


def _maps(made: Plan, codes: NDArray[Any]) -> list[Any]:
    """Draw codes, forces and errors of the strongest frame, and code against force of all."""
    frame = int(np.argmax(codes.reshape(codes.shape[0], -1).sum(axis=1, dtype=float)))
    which = f", frame {frame} of {made.frames}" if made.frames > 1 else ""
    read = decode(made, codes[frame]).force_n
    off = codes[frame].astype(float) - _ideal(made)[frame]
    most = max(1.0, float(np.abs(off).max()))
    plots = [
        _map(f"Code{which}", codes[frame].astype(float), "code"),
        _map(f"Force read{which}", np.where(np.isfinite(read), read, np.nan), "force / N"),
        _map(f"Code less the ideal code{which}", off, "LSB", "RdBu11", (-most, most)),
    ]
    if made.force_n is not None:
        force = made.force_n.ravel()
        keep = np.isfinite(force) & (force <= 1.2 * float(made.force_of_duty(np.full(made.cols, 0.5)).max()))
        step = max(1, int(keep.sum()) // 5000)
        curve = _figure(
            "Code against force", "force on the taxel / N", "code", width=480, height=400,
            tooltips=[("force", "$x N"), ("code", "$y")]
        )  # fmt: skip
        across, up = (values[keep][::step].astype(np.float32) for values in (force, codes.ravel()))
        curve.scatter(across, up, size=4, color=BLUE)
        plots.append(curve)
    return plots


def _map(
    title: str,
    values: NDArray[Any],
    label: str,
    palette: str = "Viridis256",
    limits: tuple[float, float] | None = None,
) -> Any:
    rows, cols = values.shape
    models = _bokeh("models")
    finite = values[np.isfinite(values)]
    low, high = limits or (0.0, float(finite.max()) if finite.size else 1.0)
    figure = _figure(
        title, "column", "row", width=480, height=400, x_range=(-0.5, cols - 0.5), y_range=(rows - 0.5, -0.5),
        tooltips=[("row, column", "$y{0}, $x{0}"), (label, "@image")]
    )  # fmt: skip
    mapper = models.LinearColorMapper(palette=palette, low=low, high=high if high > low else low + 1)
    # From the first row down: the axis runs the other way.
    figure.image([values.astype(np.float32)], x=-0.5, y=-0.5, dw=cols, dh=rows, color_mapper=mapper)
    figure.add_layout(models.ColorBar(color_mapper=mapper), "right")
    figure.grid.visible = False
    return figure


def _worst(made: Plan, codes: NDArray[Any]) -> Part:
    """Return the table of the codes that are farthest from those of an ideal read-out."""
    ideal = _ideal(made)
    off = codes.astype(int) - ideal
    if not off.any():
        return Part("Worst taxels", 3, f"None: each of {off.size} codes is that of an ideal read-out.")
    lines = []
    for flat in np.argsort(-np.abs(off).ravel(), kind="stable")[:WORST]:
        at = tuple(int(i) for i in np.unravel_index(flat, off.shape))
        force = "" if made.force_n is None else _number(float(made.force_n[at]))
        ohm = _number(float(made.resistance_ohm[at]))
        lines.append((*at, force, ohm, int(codes[at]), int(ideal[at]), f"{off[at]:+d}"))
    heads = (
        "frame",
        "row",
        "column",
        "force / N",
        "resistance / ohm",
        "code",
        "ideal code",
        "difference / LSB",
    )
    return Part("Worst taxels", 3, heads=heads, rows=lines, numbers=range(8))


def _effects(states: Sequence[Mapping[str, Any]]) -> Part:
    unnamed = [state["name"] for state in states if not state["on"] and state["reason"] == "not named"]
    lines = []
    for state in sorted(states, key=lambda state: not state["on"]):
        if state["name"] not in unnamed:
            bound = state.get("bound_lsb")
            on = "on" if state["on"] else "off"
            lines.append((state["name"], on, state["reason"], "" if bound is None else f"{bound:.3g}"))
    rest = f"Off, because the scene does not name them: {', '.join(unnamed)}." if unnamed else ""
    return Part(
        "Effects", 3, rest, heads=("effect", "state", "reason", "bound / LSB"), rows=lines, numbers=(3,)
    )


# ---- waves --------------------------------------------------------------------------------------------------------


def _waves(path: Path, codes: NDArray[Any]) -> Iterator[Part]:
    """Draw integrators, comparators and charge pulses in the slot of the strongest row."""
    file = vcd_file.read(path)
    if "chip.row_select" not in file:
        return
    frame = codes[0].astype(int)
    row = int(np.argmax(frame.sum(axis=1)))
    time, words = file["chip.row_select"]
    at = next((i for i, word in enumerate(words) if int(word) == 1 << row), 0)
    begin, end = float(time[at]), float(time[at + 1] if at + 1 < time.size else time[-1])
    plots: list[Any] = []
    for column in sorted(np.argsort(-frame[row], kind="stable")[:WAVE_COLUMNS].tolist()):
        shared = {"x_range": plots[0].x_range} if plots else {}
        title = f"Column {column}, code {frame[row, column]}"
        figure = _figure(title, "time in the slot / us", "V", width=1150, height=225, **shared)
        time_us, volts = _cut(file[f"analog.v_int{column}"], begin, end, WAVE_POINTS)
        figure.line(time_us, volts.astype(np.float32), color=BLUE, legend_label="integrator / V")
        for net, place, colour in (("comparator", -3.0, GREY), ("charge", -4.4, ORANGE)):
            time_us, words = _cut(file[f"chip.{net}"], begin, end, 1 << 30)
            bits = np.array([int(word) >> column & 1 for word in words], dtype=np.float32)
            kept = np.concatenate([[True], bits[1:] != bits[:-1]])
            figure.step(time_us[kept], place + bits[kept], mode="after", color=colour, legend_label=net)
        figure.legend.orientation, figure.legend.label_text_font_size = "horizontal", "11px"
        plots.append(figure)
    text = "Zoom with the wheel or a box; all share one time axis. The whole run is for GTKWave in"
    yield Part(f"Waves of row {row}", 3, text, str(path), plots=plots)


def _cut(
    wave: tuple[NDArray[np.float64], NDArray[Any]], begin: float, end: float, most: int
) -> tuple[NDArray[np.float32], NDArray[Any]]:
    """Return at most `most` points of a wave between two times, as us from the first."""
    time, values = wave
    first, last = np.searchsorted(time, [begin, end])
    first = max(0, first - 1)  # the value at the beginning
    step = max(1, math.ceil((last - first) / most))
    time_us = (np.maximum(time[first:last:step], begin) - begin) * 1e6
    return time_us.astype(np.float32), values[first:last:step]


# ---- numbers ------------------------------------------------------------------------------------------------------


def _numbers(path: Path) -> Iterator[Part]:
    """Draw the columns of a csv file against its first one, where all are numbers."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.reader(file) if line and not line[0].startswith("#")][: CSV_ROWS + 1]
    lines = [line for line in lines if len(line) == len(lines[0])]
    if len(lines) < 3:
        return
    head, *rows = lines
    columns = [_floats([row[i] for row in rows]) for i in range(len(head))]
    different = [0 if column is None else np.unique(column).size for column in columns]
    drawn = [i for i, number in enumerate(different) if number > 2]
    if not drawn:
        return
    kinds = [i for i, column in enumerate(columns) if column is None]
    groups = [tuple(row[i] for i in kinds) for row in rows]
    yield Part(path.name, plots=[_curves(head, columns, drawn[0], y, groups) for y in drawn[1:13]])


def _curves(
    head: Sequence[str], columns: Sequence[Any], x: int, y: int, groups: Sequence[tuple[str, ...]]
) -> Any:
    spread = columns[x][columns[x] > 0]
    log = bool(spread.size == columns[x].size and spread.max() > 100 * spread.min())
    figure = _figure(
        f"{head[y]} against {head[x]}", _with_unit(head[x]), _with_unit(head[y]),
        x_axis_type="log" if log else "linear", tooltips=[(head[x], "$x"), (head[y], "$y")]
    )  # fmt: skip
    paints = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9", GREY)
    names = sorted(set(groups))[:14]
    for n, group in enumerate(names):
        own = np.array([g == group for g in groups]) & np.isfinite(columns[y])
        order = np.argsort(columns[x][own], kind="stable")
        across, up = (columns[i][own][order].astype(np.float32) for i in (x, y))
        label = {"legend_label": ", ".join(group)} if any(group) and len(names) > 1 else {}
        figure.line(across, up, color=paints[n % len(paints)], **label)
        figure.scatter(across, up, color=paints[n % len(paints)], size=4, **label)
    if figure.legend:
        figure.legend.click_policy, figure.legend.label_text_font_size = "hide", "11px"
    return figure


def _with_unit(name: str) -> str:
    """Return a quantity and its unit from a column name: `r_ohm` is `r / ohm`."""
    units = {unit.lower(): unit for unit in ("A", "F", "Hz", "J", "LSB", "N", "nJ", "ohm", "s", "V")}
    quantity, _, unit = name.rpartition("_")
    return f"{quantity.replace('_', ' ')} / {units[unit]}" if quantity and unit in units else name


def _floats(cells: Sequence[str]) -> NDArray[np.float64] | None:
    try:
        return np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError:
        return None


# ---- commands -----------------------------------------------------------------------------------------------------


def reporting(name: str, path: Path, call: Callable[[], Any]) -> Any:
    """Call a command and write the page of the tables and runs that it leaves; return what it
    returns.

    Raises
    ------
    InputError
        bokeh is missing, or the page cannot be written; known before the command runs.
    """
    optional("bokeh", "report")
    if path.is_dir() or not path.parent.is_dir():
        raise InputError("command line", "--html", str(path), "a file in a directory that is there")
    tables, runs = len(verdict.WRITTEN), len(output.WRITTEN)
    code = call()
    written = dict(verdict.WRITTEN[tables:])
    done = list(dict.fromkeys(output.WRITTEN[runs:]))
    # run and sim leave codes; the other commands leave tables of their own.
    folders = [] if done else [BUILD / target for target in written]
    data = [file for folder in folders for file in sorted(folder.glob("*.csv"))]
    write(path, f"dermis {name}", written, done, data)
    return code


@click.command("report")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Directory; default build/report."
)
def report_command(out: Path | None) -> int:
    """Collect the tables and runs of build/ into pages, with an index of their verdicts."""
    optional("bokeh", "report")
    out = BUILD / "report" if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    lines = []
    for table in sorted(BUILD.glob("*.json")):
        name, rows = table.stem, _rows(table)
        if not rows:
            continue
        runs = sorted(path.parent for path in (BUILD / name).glob("*/summary.json"))
        data = [] if runs else sorted((BUILD / name).glob("*.csv"))
        write(out / f"{name}.html", name, {name: rows}, runs, data, ["dermis", name])
        counts = dict(_counts(rows))
        worst = next((status for status in ("ERROR", "FAIL") if counts[status]), "PASS")
        link = {"href": f"{name}.html", "text": name}
        lines.append((link, worst, *counts.values(), _utc(table.stat().st_mtime)))
    if not lines:
        raise InputError(
            "build", "*.json", "nothing", "verdict tables; run a target first, such as `make sim`"
        )
    lines.sort(key=lambda line: ORDER.index(line[1]))
    heads = ("target", "", *verdict.COLOURS, "measured")
    text = "Every verdict table of this checkout; those that missed come first."
    index = Part("dermis", 1, text, heads=heads, rows=lines, numbers=(2, 3, 4, 5))
    write_atomic(out / "index.html", _page("dermis: report", [index]))
    click.echo(f"{len(lines)} pages, listed in {out / 'index.html'}")
    return 0


def _rows(path: Path) -> list[Row]:
    """Return the verdict rows of a file, none where it holds something else."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return []
    keys = {"name", "value", "unit", "min", "max", "status", "note"}
    good = isinstance(rows, list) and all(isinstance(row, dict) and keys <= row.keys() for row in rows)
    return rows if good else []
