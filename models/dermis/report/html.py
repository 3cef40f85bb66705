# SPDX-License-Identifier: Apache-2.0
"""Report pages: the verdict tables and runs of a command as one HTML file, with plots that can be
zoomed.

Bokeh draws. Its wheel carries the JavaScript, 1.27 MB for plots alone, which goes into the page, so
a page needs no network. Plotly's has 4.5 MB, and that of Vega-Altair is not in its wheel.
"""

from __future__ import annotations

import csv
import datetime
import html
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
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

STYLE = Path(__file__).with_name("page.css")


def available() -> None:
    """Refuse early where the plots cannot be drawn.

    Raises
    ------
    InputError
        bokeh is not installed.
    """
    optional("bokeh", "report")


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
    body = _Body()
    command = ["dermis", *sys.argv[1:]] if command is None else command
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    body.text(
        f"<h1>{_say(title)}</h1><p class='soft'>{now}. Repeat with: <code>{_say(shlex.join(command))}</code></p>"
    )
    for target, rows in tables.items():
        _verdicts(body, target, rows, alone=len(tables) == 1)
    for directory in runs[:RUNS_DRAWN]:
        _run(body, directory, waves=directory == _with_waves(runs))
    if runs[RUNS_DRAWN:]:
        body.text("<h2>Further runs</h2>" + "".join(f"<p>{_say(str(d))}</p>" for d in runs[RUNS_DRAWN:]))
    for file in data:
        _numbers(body, file)
    body.text("<h2>Versions</h2>" + _table(("package", "version"), output.versions().items()))
    write_atomic(path, body.page(title))


class _Body:
    """Parts of a page in their order: text, and plots that bokeh renders together at the end."""

    def __init__(self) -> None:
        self._parts: list[str | int] = []
        self._plots: list[Any] = []

    def text(self, part: str) -> None:
        self._parts.append(part)

    def plots(self, figures: Sequence[Any]) -> None:
        if not figures:
            return
        self._parts.append("<div class='plots'>")
        for figure in figures:
            self._parts.append(len(self._plots))
            self._plots.append(figure)
        self._parts.append("</div>")

    def page(self, title: str) -> str:
        head = ""
        if self._plots:
            resources = optional("bokeh.resources", "report").Resources(mode="inline", components=["bokeh"])
            script, places = optional("bokeh.embed", "report").components(self._plots)
            head = resources.render() + script
        parts = [places[p] if isinstance(p, int) else p for p in self._parts]
        return (
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{_say(title)}</title>'
            '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
            f"<style>{STYLE.read_text()}</style>{head}</head><body><main>{''.join(parts)}</main></body></html>\n"
        )


def _say(text: Any) -> str:
    return html.escape(one_line(str(text), 400))


def _number(value: Any) -> str:
    return "" if value is None else f"{value:.6g}"


def _table(heads: Sequence[str], rows: Any, numbers: Sequence[int] = ()) -> str:
    """Return a table; cells are text, already escaped where they come as `_Markup`."""

    def cell(tag: str, place: int, value: Any) -> str:
        kind = " class='number'" if place in numbers else ""
        return f"<{tag}{kind}>{value if isinstance(value, _Markup) else _say(value)}</{tag}>"

    def line(tag: str, cells: Sequence[Any]) -> str:
        return "<tr>" + "".join(cell(tag, place, value) for place, value in enumerate(cells)) + "</tr>"

    lines = line("th", heads) + "".join(line("td", tuple(row)) for row in rows)
    # A wide table scrolls; the tab stop lets a keyboard scroll it.
    return f"<div class='panel' tabindex='0'><table>{lines}</table></div>"


class _Markup(str):
    """HTML that is not to be escaped again."""


# ---- verdicts ---------------------------------------------------------------------------------------------------


def _verdicts(body: _Body, target: str, rows: Sequence[Row], alone: bool) -> None:
    counts = {status: sum(row["status"] == status for row in rows) for status in verdict.COLOURS}
    said = ", ".join(f"<span class='{s}'>{n} {s}</span>" for s, n in counts.items() if n)
    body.text(f"<h2>{'Verdicts' if alone else _say(target)}</h2><p>{said or 'no rows'}</p>")
    # Missed limits come first.
    order = {"ERROR": 0, "FAIL": 1, "SKIP": 2, "PASS": 3}
    lines = [
        (
            row["name"],
            _number(row["value"]),
            _number(row["min"]),
            _number(row["max"]),
            row["unit"],
            _Markup(f"<span class='{row['status']}'>{row['status']}</span>"),
            row["note"],
        )
        for row in sorted(rows, key=lambda row: order[row["status"]])
    ]
    body.text(_table(("name", "value", "min", "max", "unit", "status", "note"), lines, numbers=(1, 2, 3)))
    judged = [(row["name"], _share(row), row["status"]) for row in rows]
    judged = [(name, share, status) for name, share, status in judged if share is not None]
    if len(judged) > 2:
        body.plots([_against_limits(judged)])


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
    names = [name for name, _, _ in judged][::-1]
    source = {
        "name": names,
        "share": [max(share, 1e-4) for _, share, _ in judged][::-1],
        "colour": [GREEN if status == "PASS" else RED for _, _, status in judged][::-1],
    }
    figure = _figure(
        "Value relative to its limit; the limit is at 1", width=1150, height=120 + 17 * len(names), y_range=names,
        x_axis_type="log", tooltips=[("", "@name"), ("share of the limit", "@share")],
    )  # fmt: skip
    columns = optional("bokeh.models", "report").ColumnDataSource(source)
    figure.scatter("share", "name", color="colour", size=8, source=columns)
    _line_at(figure, "height", 1.0)
    return figure


def _figure(title: str, **options: Any) -> Any:
    options = {"width": 560, "height": 360, "tools": "pan,box_zoom,wheel_zoom,reset,save,hover", **options}
    figure = optional("bokeh.plotting", "report").figure(title=title, **options)
    figure.toolbar.logo = None
    return figure


def _line_at(figure: Any, dimension: str, place: float) -> None:
    span = optional("bokeh.models", "report").Span
    figure.add_layout(span(location=place, dimension=dimension, line_color=GREY, line_dash="dashed"))


# ---- a run --------------------------------------------------------------------------------------------------------


def _with_waves(runs: Sequence[Path]) -> Path | None:
    """Return the first run with waves: those of one run are drawn, for they are most of a page."""
    return next((directory for directory in runs if (directory / "waves.vcd").is_file()), None)


def _run(body: _Body, directory: Path, waves: bool) -> None:
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    body.text(f"<h2>{_say(summary['title'] or directory.name)}</h2>")
    scene = directory / "resolved.toml"
    again = shlex.join(["dermis", "run", str(scene), "--engine", summary["engine"]])
    frames = "1 frame" if summary["frames"] == 1 else f"{summary['frames']} frames"
    body.text(
        f"<p class='soft'>{frames} of {summary['rows']} x {summary['cols']}, engine "
        f"{_say(summary['engine'])}, seed {summary['seed']}. Repeat with: <code>{_say(again)}</code></p>"
    )
    codes = np.load(directory / "codes.npy")
    try:
        made = plan.load(scene, summary["engine"])
    except DermisError as error:  # a file of the scene is gone: the codes are there all the same
        body.text(f"<p class='SKIP'>The scene cannot be read any more: {_say(error)}</p>")
        body.plots([_map("Codes", codes[0].astype(float), "code")])
    else:
        body.plots(_maps(made, codes))
        body.text("<h3>Worst taxels</h3>" + _worst(made, codes))
    body.text("<h3>Effects</h3>" + _effects(summary["effects"]))
    if waves:
        _waves(body, directory / "waves.vcd", codes)


def _strongest(codes: NDArray[Any]) -> int:
    return int(np.argmax(codes.reshape(codes.shape[0], -1).sum(axis=1, dtype=float)))


def _ideal(made: Plan) -> NDArray[np.int64]:
    """Return codes of an ideal read-out, [frames, rows, cols]."""
    return vfc.code(made.duty_ideal(), made.timing.gate_clocks, made.timing.code_max)


def _maps(made: Plan, codes: NDArray[Any]) -> list[Any]:
    frame = _strongest(codes)
    which = f", frame {frame} of {made.frames}" if made.frames > 1 else ""
    read = decode(made, codes[frame]).force_n
    off = codes[frame].astype(float) - _ideal(made)[frame]
    plots = [_map(f"Code{which}", codes[frame].astype(float), "code")]
    plots.append(_map(f"Force read{which}", np.where(np.isfinite(read), read, np.nan), "force / N"))
    most = max(1.0, float(np.abs(off).max()))
    plots.append(_map(f"Code less the ideal code{which}", off, "LSB", "RdBu11", (-most, most)))
    if made.force_n is not None:
        force, flat = made.force_n.ravel(), codes.ravel()
        keep = np.isfinite(force) & (force <= 1.2 * float(made.force_of_duty(np.full(made.cols, 0.5)).max()))
        step = max(1, int(keep.sum()) // 5000)
        curve = _figure(
            "Code against force", width=480, height=400, tooltips=[("force", "$x N"), ("code", "$y")]
        )
        curve.scatter(
            force[keep][::step].astype(np.float32), flat[keep][::step].astype(np.float32), size=4, color=BLUE
        )
        curve.xaxis.axis_label, curve.yaxis.axis_label = "force on the taxel / N", "code"
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
    models = optional("bokeh.models", "report")
    finite = values[np.isfinite(values)]
    low, high = limits or (0.0, float(finite.max()) if finite.size else 1.0)
    figure = _figure(
        title, width=480, height=400, x_range=(-0.5, cols - 0.5), y_range=(rows - 0.5, -0.5),
        tooltips=[("row, column", "$y{0}, $x{0}"), (label, "@image")],
    )  # fmt: skip
    mapper = models.LinearColorMapper(palette=palette, low=low, high=high if high > low else low + 1)
    # From the first row down: the axis runs the other way.
    figure.image([values.astype(np.float32)], x=-0.5, y=-0.5, dw=cols, dh=rows, color_mapper=mapper)
    figure.add_layout(models.ColorBar(color_mapper=mapper), "right")
    figure.grid.visible = False
    figure.xaxis.axis_label, figure.yaxis.axis_label = "column", "row"
    return figure


def _worst(made: Plan, codes: NDArray[Any]) -> str:
    ideal = _ideal(made)
    off = codes.astype(int) - ideal
    if not off.any():
        return f"<p>None: each of {off.size} codes is that of an ideal read-out.</p>"
    order = np.argsort(-np.abs(off).ravel(), kind="stable")[:WORST]
    lines = []
    for flat in order:
        f, r, c = (int(i) for i in np.unravel_index(flat, off.shape))
        force = "" if made.force_n is None else _number(float(made.force_n[f, r, c]))
        ohm = _number(float(made.resistance_ohm[f, r, c]))
        lines.append((f, r, c, force, ohm, int(codes[f, r, c]), int(ideal[f, r, c]), f"{off[f, r, c]:+d}"))
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
    return _table(heads, lines, numbers=range(8))


def _effects(states: Sequence[Mapping[str, Any]]) -> str:
    unnamed = [state["name"] for state in states if not state["on"] and state["reason"] == "not named"]
    lines = []
    for state in sorted(states, key=lambda state: not state["on"]):
        if state["name"] in unnamed:
            continue
        bound = state.get("bound_lsb")
        said = _Markup("<span class='PASS'>on</span>") if state["on"] else "off"
        lines.append((state["name"], said, state["reason"], "" if bound is None else f"{bound:.3g}"))
    rest = (
        f"<p class='soft'>Off, because the scene does not name them: {html.escape(', '.join(unnamed))}.</p>"
        if unnamed
        else ""
    )
    return (_table(("effect", "state", "reason", "bound / LSB"), lines, numbers=(3,)) if lines else "") + rest


# ---- waves --------------------------------------------------------------------------------------------------------


def _waves(body: _Body, path: Path, codes: NDArray[Any]) -> None:
    """Draw the slot of the strongest row: its columns' integrators, comparators and charge
    pulses.
    """
    file = vcd_file.read(path)
    rows = file.get("chip.row_select")
    if rows is None:
        return
    frame = codes[0].astype(int)
    row = int(np.argmax(frame.sum(axis=1)))
    begin, end = _slot(rows, row)
    columns = sorted(np.argsort(-frame[row], kind="stable")[:WAVE_COLUMNS].tolist())
    body.text(
        f"<h3>Waves of row {row}</h3><p class='soft'>Zoom with the wheel or a box; all share one time axis. "
        f"The whole run is in <code>{_say(path)}</code>, for GTKWave.</p>"
    )
    plots: list[Any] = []
    for column in columns:
        shared = {"x_range": plots[0].x_range} if plots else {}
        figure = _figure(f"Column {column}, code {frame[row, column]}", width=1150, height=210, **shared)
        time, volts = _cut(file[f"analog.v_int{column}"], begin, end, WAVE_POINTS)
        figure.line(_us(time, begin), volts.astype(np.float32), color=BLUE, legend_label="integrator / V")
        for net, place, colour in (("chip.comparator", -3.0, GREY), ("chip.charge", -4.4, ORANGE)):
            time, words = _cut(file[net], begin, end, 1 << 30)
            bits = np.array([int(word) >> column & 1 for word in words], dtype=np.float32)
            kept = np.concatenate([[True], bits[1:] != bits[:-1]])
            name = net.removeprefix("chip.")
            figure.step(
                _us(time[kept], begin), place + bits[kept], mode="after", color=colour, legend_label=name
            )
        figure.yaxis.axis_label = "V"
        figure.legend.orientation, figure.legend.label_text_font_size = "horizontal", "11px"
        plots.append(figure)
    plots[-1].xaxis.axis_label = "time in the slot / us"
    body.plots(plots)


def _us(time_s: NDArray[np.float64], begin: float) -> NDArray[np.float32]:
    return ((time_s - begin) * 1e6).astype(np.float32)


def _slot(rows: tuple[NDArray[np.float64], NDArray[Any]], row: int) -> tuple[float, float]:
    time, words = rows
    at = next((i for i, word in enumerate(words) if int(word) == 1 << row), 0)
    return float(time[at]), float(time[at + 1] if at + 1 < time.size else time[-1])


def _cut(
    wave: tuple[NDArray[np.float64], NDArray[Any]], begin: float, end: float, most: int
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    time, values = wave
    first, last = np.searchsorted(time, [begin, end])
    first = max(0, first - 1)  # what holds at the beginning
    step = max(1, math.ceil((last - first) / most))
    return np.maximum(time[first:last:step], begin), values[first:last:step]


# ---- numbers ------------------------------------------------------------------------------------------------------


def _numbers(body: _Body, path: Path) -> None:
    """Draw the columns of a csv file against its first one, where all are numbers."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = list(_lines(csv.reader(file)))
    if len(lines) < 3:
        return
    head, *rows = lines
    columns = [_floats([row[i] for row in rows]) for i in range(len(head))]
    kinds = [i for i, column in enumerate(columns) if column is None]
    x = next(
        (i for i, column in enumerate(columns) if column is not None and np.unique(column).size > 2), None
    )
    if x is None:
        return
    body.text(f"<h2>{_say(path.name)}</h2>")
    groups = [tuple(row[i] for i in kinds) for row in rows]
    plots = []
    for y, column in enumerate(columns):
        if y == x or column is None or np.unique(column).size < 3:
            continue
        plots.append(_curves(head, columns, x, y, groups))
    body.plots(plots[:12])


def _curves(
    head: Sequence[str], columns: Sequence[Any], x: int, y: int, groups: Sequence[tuple[str, ...]]
) -> Any:
    spread = columns[x][columns[x] > 0]
    log = bool(spread.size == columns[x].size and spread.max() > 100 * spread.min())
    figure = _figure(
        f"{head[y]} against {head[x]}", x_axis_type="log" if log else "linear",
        tooltips=[(head[x], "$x"), (head[y], "$y")],
    )  # fmt: skip
    figure.xaxis.axis_label, figure.yaxis.axis_label = _with_unit(head[x]), _with_unit(head[y])
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


_UNITS = {
    "a": "A",
    "f": "F",
    "hz": "Hz",
    "j": "J",
    "lsb": "LSB",
    "n": "N",
    "nj": "nJ",
    "ohm": "ohm",
    "s": "s",
    "v": "V",
}


def _with_unit(name: str) -> str:
    """Return a quantity and its unit from a column name: `r_ohm` is `r / ohm`."""
    quantity, _, unit = name.rpartition("_")
    return f"{quantity.replace('_', ' ')} / {_UNITS[unit]}" if quantity and unit in _UNITS else name


def _lines(reader: Iterator[list[str]]) -> Iterator[list[str]]:
    width = None
    for n, line in enumerate(reader):
        if n > CSV_ROWS:
            return
        if line and not line[0].startswith("#"):
            width = width or len(line)
            if len(line) == width:
                yield line


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
    available()
    if path.is_dir() or not path.parent.is_dir():
        raise InputError("command line", "--html", str(path), "a file in a directory that is there")
    tables, runs = len(verdict.WRITTEN), len(output.WRITTEN)
    code = call()
    written = dict(verdict.WRITTEN[tables:])
    done = sorted(set(output.WRITTEN[runs:]), key=output.WRITTEN.index)
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
    """Collect the tables and runs of build/ into pages, with an index of what passed and what did
    not.
    """
    available()
    out = BUILD / "report" if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    found = []
    for table in sorted(BUILD.glob("*.json")):
        rows = _rows(table)
        if rows:
            runs = sorted(path.parent for path in (BUILD / table.stem).glob("*/summary.json"))
            data = [] if runs else sorted((BUILD / table.stem).glob("*.csv"))
            write(
                out / f"{table.stem}.html", table.stem, {table.stem: rows}, runs, data, ["dermis", table.stem]
            )
            found.append((table, rows))
    if not found:
        raise InputError(
            "build", "*.json", "nothing", "verdict tables; run a target first, such as `make sim`"
        )
    write_atomic(out / "index.html", _index(found))
    click.echo(f"{len(found)} pages, listed in {out / 'index.html'}")
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


def _index(found: Sequence[tuple[Path, Sequence[Row]]]) -> str:
    body = _Body()
    body.text(
        "<h1>dermis</h1><p class='soft'>Every verdict table of this checkout; those that missed come first.</p><br>"
    )
    lines = []
    for path, rows in found:
        counts = [
            sum(row["status"] == status for row in rows) for status in ("PASS", "FAIL", "ERROR", "SKIP")
        ]
        when = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC).strftime(
            "%Y-%m-%d %H:%M UTC"
        )
        name = _Markup(f"<a href='{html.escape(path.stem)}.html'>{html.escape(path.stem)}</a>")
        worst = "ERROR" if counts[2] else "FAIL" if counts[1] else "PASS"
        lines.append((worst, (name, _Markup(f"<span class='{worst}'>{worst}</span>"), *counts, when)))
    lines.sort(key=lambda line: line[0])
    heads = ("target", "", "PASS", "FAIL", "ERROR", "SKIP", "measured")
    body.text(_table(heads, [line for _, line in lines], numbers=(2, 3, 4, 5)))
    return body.page("dermis: report")
