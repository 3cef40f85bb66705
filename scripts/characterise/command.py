# SPDX-License-Identifier: Apache-2.0
"""`dermis characterise`: the transistor blocks over corners and mismatch, against their limits."""

from collections.abc import Sequence

import click

from dermis.errors import InputError
from dermis.report.progress import slots
from scripts.characterise import results
from scripts.characterise.benches import BENCHES, SUMS
from scripts.characterise.results import CLASS
from scripts.characterise.runs import NUMERICS, SAMPLES, Runs, jobs_of
from scripts.judged import SHOW, finish

_NUMERICS = "numerics_lsb."


def chosen(only: Sequence[str]) -> list[str]:
    """Return the benches of `--only`: names of benches, or of quantities with or without `sky130.`."""
    known: dict[str, list[str]] = {}
    for name, bench in BENCHES.items():
        for quantity in (*bench.units, *results.EVERY, *(f"{_NUMERICS}{name}.{way}" for way in NUMERICS)):
            known.setdefault(quantity, []).append(name)
    known |= {whole: [name for part in parts for name in known[part]] for whole, parts in SUMS.items()}
    names: list[str] = []
    for word in only:
        wanted = quantity_of(word)
        found = [word] if word in BENCHES else []
        found += [name for quantity, own in known.items() if _covers(wanted, quantity) for name in own]
        if not found:
            groups = sorted({quantity.partition(".")[0] for quantity in known})
            raise InputError("command line", "--only", word, f"{' '.join(BENCHES)}; or {' '.join(groups)}")
        names += found
    return list(dict.fromkeys(names)) if only else list(BENCHES)


def _covers(name: str, quantity: str) -> bool:
    """Return True if a name is that of a quantity or of its group: `a.b` of `a.b.sink`."""
    return f"{quantity}.".startswith(f"{name}.")


def quantity_of(word: str) -> str:
    """Return the quantity that a row of the table is about."""
    for kind in (f"{results.PREFIX}.", "mismatch.", "typical.", "drift.", "passives."):
        word = word.removeprefix(kind)
    return word


@click.command("characterise", context_settings=SHOW)
@click.option("--only", multiple=True, metavar="NAME", help="A bench or row (repeatable).")
@click.option(
    "--at", multiple=True, metavar="CORNER,C,SUPPLY", help="A condition, ss,-40,0.9; * for all (repeatable)."
)
@click.option("--sample", type=click.IntRange(1, 10**6), help="One draw of the mismatch, at --at or typical.")
@click.option("--samples", "many", type=click.IntRange(0, 10**6), help=f"Draws of the mismatch; {SAMPLES}.")
@click.option("--jobs", default=2, type=click.IntRange(1, 256), help="Processes at a time.")
@click.option("--fresh", is_flag=True, help="Measure again what is kept in build/characterise.")
@click.option("--short", is_flag=True, help="Three conditions and two draws.")
@click.option("--docs", is_flag=True, help="Write table and figures of docs/characterise.md.")
def characterise_command(
    only: tuple[str, ...],
    at: tuple[str, ...],
    sample: int | None,
    many: int | None,
    jobs: int,
    fresh: bool,
    short: bool,
    docs: bool,
) -> int:
    """The transistor blocks over corners, temperatures, supplies and mismatch, against their limits."""
    part = bool(only or at) or sample is not None
    whole = not part and not short and (many is None or many >= SAMPLES)
    if docs and not whole:
        raise InputError("command line", "--docs", "a part", f"all benches and at least {SAMPLES} samples")
    if short and (at or sample is not None):
        raise InputError("command line", "--short", "with a condition", "one of the two")
    if sample is not None and many is not None:
        raise InputError("command line", "--sample and --samples", sample, "one of the two")
    names = chosen(only)
    wanted = [quantity_of(word) for word in only if word not in BENCHES]
    asked = {word.rpartition(".")[2] for word in wanted if word.startswith(_NUMERICS)}
    every = jobs_of(names, at, sample, many, short, [way for way in NUMERICS if way in asked])
    runs = Runs(every, fresh=fresh)
    kept = len(runs.outcomes)
    click.echo(f"{len(names)} benches, {len(every)} runs, {kept} of them kept", err=True)
    with slots("characterise", kept + len(runs.todo), "runs") as on_done:
        runs.run(jobs, on_done)
    found = results.series(runs.outcomes)
    if wanted and len(wanted) == len(only):
        found = [one for one in found if one.only == CLASS or any(_covers(w, one.only) for w in wanted)]
    rows = [one.row() for one in found]
    if whole:
        results.write_values(runs.outcomes)
        rows.append(results.pads_row())
    places = {job.condition for job in every if not job.numerics}
    drawn = sum(place.sample is not None for place in places)
    title = f"SKY130 blocks at {len(places) - drawn} conditions and {drawn} draws of the mismatch"
    title += "; a note has the command that measures the worst condition again"
    # A partial run does not change the results of the last whole run.
    code = finish("characterise" if whole else "characterise_part", rows, title)
    if docs:
        from scripts.characterise import docs as pages

        pages.write(found, runs)
        click.echo("written: docs/characterise.md")
    return 3 if any(one.faults for one in found) else code
