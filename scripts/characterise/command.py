# SPDX-License-Identifier: Apache-2.0
"""`dermis characterise`: the transistor blocks over corners and mismatch, against their limits."""

from __future__ import annotations

from collections.abc import Sequence

import click
from rich import box
from rich.console import Console
from rich.table import Table

from dermis.engines import batch
from dermis.errors import InputError
from dermis.report import verdict
from dermis.report.progress import slots
from scripts.characterise import results
from scripts.characterise.benches import BENCHES, SUMS, Condition
from scripts.characterise.results import Series
from scripts.characterise.run_all import (
    EXTREMES,
    GUESS_S,
    NUMERICS,
    TYPICAL,
    Job,
    Runs,
    conditions,
    is_transient,
    passives,
    samples,
)

SAMPLES = 100
_SHORT_SAMPLES = 2


def chosen(only: Sequence[str]) -> list[str]:
    """Return the benches of `--only`: names of benches, or of quantities with or without `sky130.`.

    Raises
    ------
    InputError
        There is none of a name.
    """
    if not only:
        return list(BENCHES)
    names: list[str] = []
    for word in only:
        wanted = [quantity_of(word)]
        wanted += [part for name, parts in SUMS.items() if _covers(wanted[0], name) for part in parts]
        found = [
            name
            for name, bench in BENCHES.items()
            if name in (word, _solved_otherwise(wanted[0]))
            or any(_covers(quantity, q) for quantity in wanted for q in bench.units)
        ]
        if not found:
            quantities = sorted({q.partition(".")[0] for b in BENCHES.values() for q in (*b.units, *SUMS)})
            raise InputError(
                "command line", "--only", word, f"{' '.join(BENCHES)}; or {' '.join(quantities)}"
            )
        names += found
    return list(dict.fromkeys(names))


def _covers(name: str, quantity: str) -> bool:
    """Return True if a name is that of a quantity or of its group: `a.b` of `a.b.sink`."""
    return f"{quantity}.".startswith(f"{name}.")


def _solved_otherwise(quantity: str) -> str:
    """The bench of a row such as numerics_lsb.vfc_sink.gear, or nothing."""
    return quantity.split(".")[1] if quantity.startswith("numerics_lsb.") else ""


def quantity_of(word: str) -> str:
    """The quantity that a row of the table is about."""
    word = word.removeprefix(f"{results.PREFIX}.")
    for kind in ("mismatch.", "typical.", "drift.", "passives."):
        word = word.removeprefix(kind)
    return word


def jobs_of(
    names: Sequence[str],
    at: str | None,
    sample: int | None,
    many: int | None,
    short: bool,
    ways: Sequence[str] = (),
) -> list[Job]:
    """All runs that the options ask for: corners, mismatch, and for the transients other ways to solve them.

    Of a condition by itself only the `ways` that are asked for.
    """
    drawable = [name for name in names if BENCHES[name].samples]
    if at is not None or sample is not None:
        places = [TYPICAL] if at is None else conditions(at)
        if sample is not None:
            places = [drawn for place in places for drawn in samples(sample, sample, place)]
        jobs = [Job(name, place, way) for name in names for place in places for way in ("", *ways)]
        return jobs + [Job(name, drawn) for drawn in samples(1, many or 0, places[0]) for name in drawable]
    places = list(EXTREMES) if short else [*conditions(), *passives()]
    last = (_SHORT_SAMPLES if short else SAMPLES) if many is None else many
    jobs = [Job(name, place) for place in places for name in names]
    jobs += [Job(name, drawn) for drawn in samples(1, last) for name in drawable]
    jobs += [
        Job(name, place, way)
        for way in NUMERICS
        if way
        for place in EXTREMES
        for name in names
        if is_transient(BENCHES[name])
    ]
    return jobs


def print_table(found: Sequence[Series], rows: Sequence[verdict.Row], title: str) -> None:
    """Print min, typ and max with the limits, the worst condition, and the command to rerun it."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=170)
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("sky130.", "least", "typical", "most", "min", "max", "unit", "status", "at worst"):
        number = heading in ("least", "typical", "most", "min", "max")
        table.add_column(heading, justify="right" if number else "left", no_wrap=number)
    for one, row in zip(found, rows, strict=True):
        least, most = (f(one.values.values(), default=None) for f in (min, max))
        numbers = [
            "" if v is None else f"{v:.4g}" for v in (least, one.typical, most, row["min"], row["max"])
        ]
        colour = verdict.COLOURS[row["status"]]
        where = one.worst if one.values else ""
        table.add_row(one.name, *numbers, row["unit"], f"[{colour}]{row['status']}[/]", where)
    console.print(table)
    for row in [*(row for row in rows if row["status"] == "FAIL"), *verdict.aims_missed(rows)]:
        console.print(f"{row['status']} {row['name']}: {row['note']}", highlight=False, markup=False)
    for fault, names in _faults(found).items():
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        console.print(f"ERROR {', '.join(names[:3])}{more}: {fault}", highlight=False, markup=False)
    counts = ", ".join(f"{sum(r['status'] == s for r in rows)} {s}" for s in verdict.COLOURS)
    console.print(
        f"{counts}; repeat a row: dermis characterise --only NAME with the options under `at worst`"
    )


def _faults(found: Sequence[Series]) -> dict[str, list[str]]:
    """Why something was not measured, with one line that shows it, and the rows that miss it."""
    rows: dict[str, list[str]] = {}
    shown: dict[str, str] = {}
    for one in found:
        for where, fault in one.faults.items():
            rows.setdefault(fault, []).append(one.name)
            shown.setdefault(fault, one.command(where))
    return {f"{fault}: `{shown[fault]}`": list(dict.fromkeys(names)) for fault, names in rows.items()}


@click.command("characterise")
@click.option(
    "--only", multiple=True, metavar="NAME", help="A bench, or a row: sky130.packet_error. Repeatable."
)
@click.option("--at", metavar="CORNER,C,SUPPLY", help="One condition, ss,-40,0.9; * stands for all of them.")
@click.option("--sample", type=click.IntRange(1, 10**6), help="One draw of the mismatch, at --at or typical.")
@click.option("--samples", "many", type=click.IntRange(0, 10**6), help=f"Draws of the mismatch; {SAMPLES}.")
@click.option(
    "--jobs", default=2, show_default=True, type=click.IntRange(1, 256), help="Processes at a time."
)
@click.option("--scheduler", metavar="ADDRESS", help="Spread over a Dask cluster: tcp://host:8786.")
@click.option("--fresh", is_flag=True, help="Measure again what is kept in build/characterise.")
@click.option("--short", is_flag=True, help="Three conditions and two draws.")
@click.option("--docs", is_flag=True, help="Write table and figures of docs/characterise.md.")
def characterise_command(
    only: tuple[str, ...],
    at: str | None,
    sample: int | None,
    many: int | None,
    jobs: int,
    scheduler: str | None,
    fresh: bool,
    short: bool,
    docs: bool,
) -> int:
    """The transistor blocks over corners, temperatures, supplies and mismatch, against their limits."""
    part = bool(only) or at is not None or sample is not None
    whole = not part and not short and (many is None or many >= SAMPLES)
    if docs and not whole:
        raise InputError("command line", "--docs", "a part", f"all benches and at least {SAMPLES} samples")
    if short and (at is not None or sample is not None):
        raise InputError("command line", "--short", "with a condition", "one of the two")
    if sample is not None and many is not None:
        raise InputError("command line", "--sample and --samples", sample, "one of the two")
    names = chosen(only)
    if scheduler is not None:
        # Refused before the decks run, and also if all results are stored.
        with batch.cluster(scheduler):
            pass
    asked = [quantity_of(word) for word in only if _solved_otherwise(quantity_of(word))]
    ways = [way for way in NUMERICS if way and any(word.endswith(f".{way}") for word in asked)]
    every = jobs_of(names, at, sample, many, short, ways)
    runs = Runs(every, fresh=fresh)
    kept = len(runs.outcomes)
    click.echo(
        f"{len(names)} benches, {len(every)} runs, {kept} of them kept; the others take about "
        f"{runs.seconds() / 60:.1f} minutes of ngspice, as the kept ones took or {GUESS_S:g} s each",
        err=True,
    )
    with slots("characterise", kept + len(runs.todo), "runs") as on_done:
        runs.run(jobs, scheduler, on_done)
    wanted = [quantity_of(word) for word in only if word not in BENCHES]
    found = [*results.series(runs.outcomes), *results.numerics(runs.outcomes)]
    if wanted and len(wanted) == len(only):
        found = [one for one in found if any(_covers(w, one.only) for w in wanted)]
    rows = [one.row() for one in found]
    # A partial run does not change the results of the last whole run.
    if whole:
        results.write_values(runs.outcomes)
    pads = [results.pads_row()] if whole else []
    verdict.write_rows("characterise" if whole else "characterise_part", [*rows, *pads])
    print_table(found, rows, _title(every))
    if pads:
        verdict.print_rows(pads)
    if docs:
        from scripts.characterise import docs as pages

        pages.write(found, rows, runs)
        click.echo("written: docs/characterise.md")
    return results.exit_code(found, [*rows, *pads])


def _title(every: Sequence[Job]) -> str:
    places: dict[Condition, None] = dict.fromkeys(job.condition for job in every if not job.numerics)
    drawn = sum(place.sample is not None for place in places)
    return f"SKY130 blocks at {len(places) - drawn} conditions and {drawn} draws of the mismatch"
