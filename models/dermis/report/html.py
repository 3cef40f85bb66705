# SPDX-License-Identifier: Apache-2.0
"""Report pages: verdict tables, figures and runs of a command as one HTML file without JavaScript."""

import base64
import io
import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray
from PIL import Image

from dermis import plan
from dermis.converter import vfc
from dermis.decode.force import decode
from dermis.errors import DermisError, InputError, one_line, optional
from dermis.files import check_place, write_atomic
from dermis.places import BUILD
from dermis.records import Plan
from dermis.report import figures, output, verdict
from dermis.report.verdict import Row

WORST = 10
RUNS_DRAWN = 8
"""Runs of one page that are drawn; the others are listed."""

TEMPLATE, STYLE = Path(__file__).with_name("page.html"), Path(__file__).with_name("page.css")
ORDER = ("ERROR", "FAIL", "SKIP", "PASS")
"""Missed limits come first."""


def write(
    path: Path,
    title: str,
    tables: Mapping[str, Sequence[Row]],
    runs: Sequence[Path],
    images: Sequence[Path] = (),
    command: Sequence[str] | None = None,
    maps: Sequence[tuple[str, NDArray[Any], str]] = (),
) -> None:
    """Write a report page, whole or not at all.

    Parameters
    ----------
    tables : verdict rows by the name of their target
    runs : directories that `dermis run` or the like has filled
    images : figures of the command, PNG; the first is on the first screen, else that of the first run
    command : the command that repeats it; that of this process by default
    maps : words, values [rows, cols] and unit of pictures with a value at each place
    """
    command = ["dermis", *sys.argv[1:]] if command is None else command
    picture = _picture(runs, images)
    ordered = {n: sorted(rows, key=lambda row: ORDER.index(row["status"])) for n, rows in tables.items()}
    page = _page(
        title=title,
        picture=picture,
        worst=_worst_row([row for rows in tables.values() for row in rows]),
        text=f"{_utc(time.time())}. Repeat with:",
        command=shlex.join(command),
        tables=ordered,
        runs=[_run(directory) for directory in runs[:RUNS_DRAWN]],
        more=runs[RUNS_DRAWN:],
        maps=[_map(*found) for found in maps],
        images=[image for image in images if image != picture],
        versions=output.versions(),
    )
    write_atomic(path, page)


def _page(**said: Any) -> str:
    markup = optional("markupsafe", "report").Markup
    # Every text becomes one line, and is escaped.
    environment = optional("jinja2", "report").Environment(
        autoescape=True,
        trim_blocks=True,
        finalize=lambda said: said if isinstance(said, markup) else one_line(str(said), 2000),
    )
    page = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        png=lambda path: markup(base64.b64encode(path.read_bytes()).decode()),
        thumbnail=lambda path: markup(base64.b64encode(_thumbnail(path)).decode()),
        words=verdict.in_words,
        style=markup(STYLE.read_text(encoding="utf-8")),
        marks=(*ORDER, "on"),
        counts=_counts,
        **said,
    )
    return str(page)


def _picture(runs: Sequence[Path], images: Sequence[Path]) -> Path | None:
    """Return the figure that stands for a page: the first of the command, or that of its first run."""
    found = [*images, *(path for run in runs[:1] if (path := run / "frame.png").is_file())]
    return found[0] if found else None


def _thumbnail(path: Path) -> bytes:
    """Return a figure as PNG of at most 240 x 150 pixels."""
    out = io.BytesIO()
    with Image.open(path) as image:
        image.thumbnail((240, 150))
        image.save(out, "png", optimize=True)
    return out.getvalue()


def _worst_row(rows: Sequence[Row]) -> Row | None:
    """Return the row to look at first: one that missed, else the one nearest to its limit, or None.

    A limit of 0 that is met has no distance; such rows come last.
    """

    def used(row: Row) -> float:
        if row["status"] != "PASS":
            return {"ERROR": 3.0, "FAIL": 2.0}[row["status"]]
        value, low, high = row["value"], row["min"], row["max"]
        shares = [value / high] if high is not None and high > 0 else []
        shares += [low / value] if low is not None and low > 0 else []
        return max(shares, default=-1.0)

    met = [row for row in rows if row["status"] == "PASS" and (row["min"], row["max"]) != (None, None)]
    return max((*(row for row in rows if row["status"] in ("ERROR", "FAIL")), *met), key=used, default=None)


def _utc(seconds: float) -> str:
    """Return a moment, in seconds since 1970, in words."""
    return time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(seconds))


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    return {status: sum(row["status"] == status for row in rows) for status in verdict.COLOURS}


def _run(directory: Path) -> dict[str, Any]:
    """Return what page.html shows of a run."""
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    engine, scene = summary["engine"], directory / "resolved.toml"
    codes = np.load(directory / "codes.npy")
    found = {
        "summary": summary,
        "name": summary["title"] or directory.name,
        "command": shlex.join(["dermis", "run", str(scene), "--engine", engine]),
        "images": [path for name in ("frame.png", "transient.png") if (path := directory / name).is_file()],
    }
    try:
        made = plan.load(scene, engine)
    except DermisError as error:  # a file of the scene is gone: the codes are there all the same
        return found | {"maps": [_map("Codes", codes[0].astype(float), "code")], "unread": error}
    off = codes.astype(int) - vfc.code(made.duty_ideal(), made.timing.gate_clocks, made.timing.code_max)
    heads, worst = _worst(made, codes, off)
    return found | {"maps": _maps(made, codes, off), "heads": heads, "worst": worst}


def _maps(made: Plan, codes: NDArray[Any], off: NDArray[Any]) -> list[Any]:
    """Draw codes, forces and errors of the strongest frame."""
    frame, which = figures.strongest(codes)
    read, off = decode(made, codes[frame]).force_n, off[frame].astype(float)
    read = np.where(np.isfinite(read), read, np.nan)
    maps = [_map(f"Code{which}", codes[frame].astype(float), ""), _map(f"Force read{which}", read, "N")]
    if not off.any():  # a map of one colour would say less
        return maps
    most = float(np.abs(off).max())
    return [*maps, _map(f"Code less the ideal code{which}", off, "LSB", "RdBu", (-most, most))]


def _map(
    title: str,
    values: NDArray[Any],
    label: str,
    palette: str = "viridis",
    limits: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return what page.html shows of a map: a colour and words for each taxel."""
    finite = values[np.isfinite(values)]
    low, high = limits or (0.0, float(finite.max()) if finite.size else 1.0)
    colours = colormaps[palette]((values - low) / (high - low if high > low else 1.0))
    cells: list[list[tuple[str, str]]] = [[] for _ in values]
    for (r, c), v in np.ndenumerate(values):
        said = "no value" if np.isnan(v) else f"{v:.4g} {label}".rstrip()
        cells[r].append((to_hex(colours[r, c]), f"row {r}, column {c}: {said}"))
    return {"title": f"{title}, {low:.3g} to {high:.3g} {label}".rstrip(), "cells": cells}


def _worst(made: Plan, codes: NDArray[Any], off: NDArray[Any]) -> tuple[list[str], list[list[Any]]]:
    """Return the heads and lines of a table of the codes that are farthest from those of an ideal read-out."""
    columns = {"code": codes, "ideal code": codes - off, "resistance / ohm": made.resistance_ohm}
    columns |= {"force / N": made.force_n, "difference / LSB": off}
    worst = np.argsort(-np.abs(off).ravel(), kind="stable")[: WORST * off.any()]
    places = zip(*np.unravel_index(worst, off.shape), strict=True)
    lines = [[*map(int, place), *(values[place].item() for values in columns.values())] for place in places]
    return ["frame", "row", "column", *columns], lines


def reporting(name: str, path: Path, call: Callable[[], Any]) -> Any:
    """Call a command and write the page of the tables and runs that it leaves; return what it returns.

    Raises InputError before the command runs if jinja2 is missing, or the page cannot be written.
    """
    optional("jinja2", "report")
    check_place(path, "--html")
    if path.is_file() and not path.read_bytes()[:15].lower().startswith((b"<!doctype html", b"<html")):
        raise InputError("command line", "--html", str(path), "a new file, or an earlier page to replace")
    tables, runs, maps = len(verdict.WRITTEN), len(output.WRITTEN), len(output.MAPS)
    start = time.time()
    code = call()
    if path.is_dir():
        raise InputError("command line", "--html", str(path), "another name than that of --out")
    written = dict(verdict.WRITTEN[tables:])
    done = list(dict.fromkeys(output.WRITTEN[runs:]))
    # Figures of an earlier call are not this one's.
    images = [i for target in written for i in _images(target) if not done or i.stat().st_mtime >= start]
    write(path, f"dermis {name}", written, done, images, maps=output.MAPS[maps:])
    return code


def _images(target: str) -> list[Path]:
    """Return the figures that a command leaves in build/."""
    return [*BUILD.glob(f"{target}.png"), *sorted((BUILD / target).glob("*.png"))]


@click.command("report")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Directory; default build/report."
)
def report_command(out: Path | None) -> int:
    """Collect the tables and runs of build/ into pages, with an index of their verdicts."""
    optional("jinja2", "report")
    out = BUILD / "report" if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    lines = []
    for table in sorted(BUILD.glob("*.json")):
        name, rows = table.stem, _rows(table)
        if not rows:
            continue
        runs = sorted(path.parent for path in (BUILD / name).glob("*/summary.json"))
        images = _images(name)
        write(out / f"{name}.html", name, {name: rows}, runs, images, ["dermis", name])
        counts = _counts(rows)
        worst = next((status for status in ("ERROR", "FAIL") if counts[status]), "PASS")
        link, when = {"href": f"{name}.html", "text": name}, _utc(table.stat().st_mtime)
        lines.append((_picture(runs, images) or "", link, worst, *counts.values(), when))
    if not lines:
        allowed = "verdict tables; run a target first, such as `make sim`"
        raise InputError("build", "*.json", "nothing", allowed)
    lines.sort(key=lambda line: ORDER.index(line[2]))
    heads = ("picture", "target", "result", *verdict.COLOURS, "measured")
    text = "Every verdict table of this checkout; those that missed come first."
    page = _page(title="dermis: report", text=text, heads=heads, index=lines, tables={})
    write_atomic(out / "index.html", page)
    click.echo(f"{len(lines)} pages, listed in {out / 'index.html'}")
    return 0


def _rows(path: Path) -> list[Row]:
    """Return the verdict rows of a file, none where it holds something else."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return []
    good = isinstance(rows, list) and all(isinstance(r, dict) and r.keys() >= set(verdict.KEYS) for r in rows)
    return rows if good else []
