# SPDX-License-Identifier: Apache-2.0
"""The characterisation: kept by content, resumed, judged with four outcomes, and each row with its way back."""

import dataclasses
import json
import shlex
import shutil
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from dermis.chip import spice_batch
from dermis.chip.sky130 import CORNERS, PASSIVE_CORNERS
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design
from dermis.scene.schema import read_toml
from scripts.characterise import benches, command, results, runs
from scripts.characterise.benches import BENCHES, Bench, Condition, deck
from scripts.characterise.command import characterise_command, chosen
from scripts.characterise.runs import Job, Runs, jobs_of


@pytest.fixture(autouse=True)
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place of this test's own for what is kept and written."""
    monkeypatch.setattr(runs, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(runs, "FAILED", tmp_path / "failed")
    monkeypatch.setattr(results, "VALUES", tmp_path / "values.json")
    monkeypatch.setattr(verdict, "BUILD", tmp_path / "build")
    return tmp_path


def called(*arguments: str) -> int:
    """Exit code of the command."""
    options = {"standalone_mode": False, "catch_exceptions": False}
    return CliRunner().invoke(characterise_command, arguments, **options).return_value


# ---- kept by content --------------------------------------------------------------------------------------------


def test_a_key_is_that_of_what_decides_and_of_nothing_else(tmp_path: Path) -> None:
    blocks = tmp_path / "sky130"
    shutil.copytree(benches.sky130.ROOT / "spice" / "sky130", blocks)

    def keys() -> dict[str, str]:
        named = {name: BENCHES[name].body for name in ("reference", "comparator", "chain_k80")}
        return {n: runs.key(runs.resolved(deck(b, Condition(), blocks=blocks))) for n, b in named.items()}

    before, mirror = keys(), blocks / "mirror.sp"
    mirror.write_text("* a comment\n" + mirror.read_text())
    assert keys() == before
    mirror.write_text(mirror.read_text().replace("l=2", "l=2.1"))
    after = keys()
    assert {name for name in before if after[name] != before[name]} == {"chain_k80"}


def test_an_interrupted_run_goes_on_where_it_stopped() -> None:
    jobs = [Job("row_driver_held", Condition(corner)) for corner in ("tt", "ss", "ff")]

    def interrupt(done: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Runs(jobs).run(1, interrupt)
    again = Runs(jobs)
    assert 2 <= len(again.outcomes) < len(jobs) or not again.todo  # one more may have ended meanwhile
    again.run(1, lambda done: None)
    assert set(again.outcomes) == set(jobs)
    assert not Runs(jobs).todo


def test_outcomes_are_in_the_order_of_the_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = [Job("reference", Condition(celsius=celsius)) for celsius in (-40.0, 27.0, 125.0)]
    gave_up = SimpleNamespace(fault="gave up", value=None)
    monkeypatch.setattr(runs.workers, "run", lambda tasks, _: [(n, gave_up) for n in reversed(range(3))])
    made = Runs(jobs)
    made.run(1, lambda done: None)
    assert list(made.outcomes) == jobs


# ---- judged -----------------------------------------------------------------------------------------------------


def judged(values: dict[str, float], name: str = "packet_error.sink", **more: object) -> verdict.Row:
    return results.Series(name, name, values, **more).row()


def test_the_worst_condition_is_the_one_with_the_least_room() -> None:
    # Limits -0.02 and 0.02: the smallest in size is not asked for, the one next to a limit is.
    row = judged({"--at tt,27,1": 0.001, "--at ss,-40,0.9": -0.019, "--at ff,125,1.1": 0.018})
    assert (row["value"], row["status"]) == (-0.019, "PASS")
    assert "`dermis characterise --only sky130.packet_error.sink --at ss,-40,0.9`" in row["note"]
    assert judged({"--at tt,27,1": 0.0, "--at sf,27,1": 0.021, "--at fs,27,1": -0.02})["status"] == "FAIL"
    # A lower limit alone: the least is the worst.
    assert judged({"--at tt,27,1": 90.0, "--at ss,27,1": 71.0}, "amplifier_gain_db")["value"] == 71.0
    # What was not measured is no pass, and hides no miss.
    faults = {"--at ss,-40,0.9": "gave up"}
    rows = [judged(values, faults=faults) for values in ({}, {"--at tt,27,1": 0.0}, {"--at tt,27,1": 0.5})]
    assert [row["status"] for row in rows] == ["ERROR", "ERROR", "FAIL"]
    assert "gave up: `dermis characterise --only sky130.packet_error.sink --at ss,-40,0.9`" in rows[0]["note"]


@pytest.mark.parametrize(
    ("name", "place", "names", "at"),
    [
        ("mismatch.packet_error.sink", "--at tt,27,1 --sample 17", ["vfc_sink"], Condition(sample=17)),
        ("code_inl_lsb.sink", "--at tt,27,1", ["chain_k80", "density_sink"], Condition()),
    ],
)
def test_the_command_of_a_row_measures_that_row_and_nothing_else(
    name: str, place: str, names: list[str], at: Condition
) -> None:
    arguments = shlex.split(results.Series(name, name.removeprefix("mismatch.")).command(place))[2:]
    options = characterise_command.make_context("characterise", arguments).params
    keys = ("at", "sample", "many", "short")
    jobs = jobs_of(chosen(options["only"]), *(options[key] for key in keys))
    assert jobs == [Job(bench, at) for bench in names]


def test_an_operating_point_that_hangs_on_its_tolerance_is_seen(tmp_path: Path) -> None:
    """The current of a row in one step: a drop of 14 mV beside 0.5 V, of which the tolerance may leave 0.5 mV."""
    outcomes = {}
    for way in ("", "tight"):
        job = Job("row_driver_driven", Condition("sf"), way)
        (tmp_path / "row.sp").write_text(job.deck().replace("16m 1m", "16m 16m"))
        outcomes[job] = runs.outcome(job, spice_batch.run(tmp_path / "row.sp"))
    (row,) = (one.row() for one in results.series(outcomes) if one.name.startswith("numerics_lsb."))
    assert row["status"] == "FAIL"


# ---- the command ------------------------------------------------------------------------------------------------


def test_each_end_of_the_command_has_its_exit_code(build: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = BENCHES["row_driver_held"].body

    def run(body: str) -> tuple[int, verdict.Row]:
        bench = dataclasses.replace(BENCHES["row_driver_held"], body=body)
        monkeypatch.setitem(BENCHES, "row_driver_held", bench)
        code = called("--only", "reference", "--only", "row_driver_held", "--at", "tt,27,1", "--jobs", "1")
        rows = json.loads((build / "build" / "characterise_part.json").read_text())
        (row,) = [row for row in rows if row["name"] == "sky130.row_driver_r_ohm.held"]
        others = {other["name"]: other["status"] for other in rows if other != row}
        # What has two ohm more is off its record as well.
        assert others.pop("sky130.moved") == ("FAIL" if row["status"] == "FAIL" else "PASS")
        assert set(others.values()) == {"PASS"}
        return code, row

    code, row = run(held)
    assert (code, row["status"]) == (0, "PASS")
    assert row["value"] > 0.1

    # Two ohm of wire behind the switch.
    far = held.replace("il row 0 0", "rfault row far 2\nil far 0 0").replace("v(row)", "v(far)")
    code, row = run(far)
    assert (code, row["status"]) == (1, "FAIL")
    assert "--only sky130.row_driver_r_ohm.held --at tt,27,1" in row["note"]

    # A node that is 1 V where it is below half a volt, and 0 V elsewhere, has no voltage.
    code, row = run("bnone n 0 v='v(n) > 0.5 ? 0 : 1'\nrn n 0 1k\n" + held)
    assert (code, row["status"]) == (3, "ERROR")
    assert "tried: " in row["note"], row
    assert str(runs.FAILED) in row["note"], "the log stays"


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (("--only", "nothing"), "--only"),
        (("--at", "tt,27"), "--at"),
        (("--short", "--at", "tt,27,1"), "--short"),
        (("--docs", "--only", "reference"), "--docs"),
        (("--sample", "3", "--samples", "5"), "--sample and --samples"),
    ],
)
def test_wrong_arguments_are_named(arguments: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError) as raised:
        called(*arguments)
    assert raised.value.key == key


def test_only_a_whole_run_replaces_what_others_read(build: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "jobs_of", lambda *_: [Job("row_driver_held", Condition())])
    rows, part = (build / "build" / f"{name}.json" for name in ("characterise", "characterise_part"))
    for arguments in (("--at", "tt,27,1"), ("--only", "row_driver_held"), ("--samples", "99"), ("--short",)):
        called(*arguments, "--jobs", "1")
        assert part.exists(), arguments
        assert not rows.exists() | results.VALUES.exists(), arguments
        part.unlink()
    called("--jobs", "1")
    assert rows.exists() & results.VALUES.exists() & (not part.exists())


def test_a_whole_run_is_63_conditions_100_draws_and_the_numerics() -> None:
    jobs = jobs_of(list(BENCHES), (), None, None, short=False)
    places = {job.condition for job in jobs if job.condition.sample is None and not job.numerics}
    assert len(places) == 63 == len(CORNERS) * 3 * 3 + len(PASSIVE_CORNERS) * 3
    drawn = Counter(job.bench for job in jobs if job.condition.sample is not None)
    assert drawn.items() >= dict.fromkeys(("chain_k80", "vfc_sink", "comparator", "reference"), 100).items()
    transients = {name for name, bench in BENCHES.items() if ".tran" in bench.body}
    # What no code is made of is not measured in another way.
    apart = {"esd_clamp", "row_change", "sequencing_10us", "sequencing_10ms", "reference_step", "front_end"}
    apart |= {name for name in BENCHES if name.startswith("channel_")}
    points = {job.bench for job in jobs if job.numerics == "tight"}
    assert points > {"reference", "chain_k80", "row_driver_held"}
    assert {job.bench for job in jobs if job.numerics} - points == transients - apart


def test_a_transient_that_hangs_on_its_step_is_seen() -> None:
    """Quantities that move by a hundredth of a packet, 2.55 codes, when they are solved in another way."""
    own = dict.fromkeys(BENCHES["vfc_sink"].units, 0.0)
    outcomes = {
        Job("vfc_sink", Condition()): runs.Outcome(own),
        Job("vfc_sink", Condition(), "gear"): runs.Outcome(own | {"packet_error.sink": 0.01}),
    }
    (row,) = (one.row() for one in results.series(outcomes) if one.name.startswith("numerics_lsb."))
    assert (row["value"], row["status"]) == (pytest.approx(2.55), "FAIL")
    assert "--only sky130.numerics_lsb.vfc_sink.gear --at tt,27,1`" in row["note"]
    assert chosen(["sky130.numerics_lsb.vfc_sink.gear"]) == ["vfc_sink"]
    again = jobs_of(["vfc_sink"], ["tt,27,1"], None, None, short=False, ways=["gear"])
    assert again == list(outcomes)


def test_a_sum_is_of_sizes_and_lacks_what_a_part_lacks() -> None:
    def at(place: Condition, bend: float, fault: str = "") -> dict[Job, runs.Outcome]:
        chain = runs.Outcome(dict.fromkeys(BENCHES["chain_k80"].units, 0.2))
        density = {} if fault else dict.fromkeys(BENCHES["density_sink"].units, bend)
        return {Job("chain_k80", place): chain, Job("density_sink", place): runs.Outcome(density, fault)}

    outcomes = at(Condition(), -0.4) | at(Condition("ss"), 0.1) | at(Condition("ff"), 0.0, "gave up")
    found = {one.name: one for one in results.series(outcomes)}
    whole = found["code_inl_lsb.sink"]
    assert whole.values == {"--at tt,27,1": pytest.approx(0.6), "--at ss,27,1": pytest.approx(0.3)}
    assert whole.faults == {"--at ff,27,1": "gave up"}
    assert found["typical.code_inl_lsb.sink"].row()["status"] == "FAIL"


def test_what_moves_off_its_record_is_seen_though_it_is_within_its_limit() -> None:
    known = read_toml(results.RECORD)
    assert known.keys() == {name for bench in BENCHES.values() for name in bench.units}, "run: dermis extract"
    assert results.moved(known) == []
    # Half a percent of the limit, 0.02, is 1e-4.
    name = "packet_error.sink"
    assert results.moved({name: known[name] + 0.9e-4}) == []
    assert [said.split()[0] for said in results.moved({name: known[name] - 1.1e-4})] == [name]
    assert results.moved({"no_such_quantity": 1.0})
    right = runs.Outcome({name: known[name]}, "", runs.Measured({}))
    wrong = dataclasses.replace(right, values={name: known[name] + 0.01})
    for outcome, count in ((right, 0), (wrong, 1)):
        found = results.series({Job("vfc_sink", Condition()): outcome})
        (row,) = [one.row() for one in found if one.name == "moved"]
        assert (row["value"], row["status"] == "PASS") == (count, count == 0), row


def test_a_transistor_outside_its_class_is_a_row_with_its_name() -> None:
    switch, core = "m.x.xm.msky130_fd_pr__pfet_g5v0d10v5 Vgd", "m.y.xm.msky130_fd_pr__nfet_01v8 Vgs"
    cases = {
        "edge": ({switch: (4.2, 2e-9), core: (1.97, 1e-9)}, 0),
        "stands": ({switch: (3.8, 1e-6)}, 1),
        "beyond": ({switch: (5.6, 1e-9), core: (2.2, 1e-9)}, 2),
        "at rest": ({core: (3.3, float("inf"))}, 1),
    }
    for name, (exceeded, count) in cases.items():
        outcome = runs.Outcome({}, "", runs.Measured({}, exceeded=exceeded))
        found = results.series({Job("comparator", Condition("ss")): outcome})
        (row,) = (one.row() for one in found if one.name == results.CLASS)
        assert row["value"] == count, name
        assert all(device in row["note"] for device in exceeded) == (count > 0), row["note"]
        assert "--only comparator --at ss,27,1" in row["note"]
    assert set(chosen(["sky130.device_class"])) == set(BENCHES)


# ---- benches ----------------------------------------------------------------------------------------------------


def test_a_quantity_that_does_not_follow_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench("", lambda found: {"q": found["missing"]}, {"q": "V"})
    nan = dataclasses.replace(bench, values=lambda found: {"q": float("nan")})
    for one, said in ((bench, "missing"), (nan, "not a number: q")):
        monkeypatch.setitem(BENCHES, "b", one)
        done = runs.outcome(Job("b", Condition()), runs.Measured({}))
        assert said in done.fault
        assert not done.values


def test_benches_measure_the_design() -> None:
    """What their texts and formulas write as numbers is what models/design.toml says."""
    d = design.load()
    assert d.supply.vdd_v == -d.supply.vss_v == benches.SUPPLY_V
    assert (d.interface.v_bias_v, d.converter.i0_a, d.converter.c_int_f) == (0.5, 25e-6, 5e-12)
    assert (d.timing.gate_clocks, 2**d.timing.code_bits - 1) == (510, 255)
    assert 1.0 / d.converter.f_clk_hz == 200e-9
    assert {f"chain_k{k}" for k in d.interface.k_options} <= set(BENCHES)
    # x = 1/2 at the least resistance, with the k that its benches have.
    assert benches.chain_full_a(d.interface.k) * d.sensor.r_min_ohm == pytest.approx(0.5)
    assert d.array.c_column_f == 400e-12
    assert d.array.rows == 16


def test_table_and_figures_are_made_of_what_there_is(build: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A condition, three draws and a fault: each row, and pictures that leave out what is not there."""
    from scripts.characterise import docs

    monkeypatch.setattr(docs, "DOCS", build / "page.md")
    monkeypatch.setattr(docs, "FIGURES", build)
    begin = "<!-- begin: table (written by dermis characterise --docs) -->"
    docs.DOCS.write_text(f"before\n{begin}\nold\n<!-- end: table -->\nafter\n")
    made, units = Runs([]), BENCHES["vfc_sink"].units
    for n, value in ((None, 0.001), (1, 0.004), (2, -0.03), (3, 0.08)):
        made.outcomes[Job("vfc_sink", Condition(sample=n))] = runs.Outcome(dict.fromkeys(units, value))
    found = {f"out{n}": 12.5e-6 * share for n, share in enumerate(benches.SHARES)}
    found |= {f"x{n}": 0.0 for n in range(len(benches.SHARES))}
    chain = Job("chain_k80", Condition())
    made.outcomes[chain] = runs.outcome(chain, runs.Measured(found))
    made.outcomes[Job("r_x", Condition())] = runs.Outcome({}, "gave up")
    docs.write(results.series(made.outcomes), made)
    text = docs.DOCS.read_text()
    row = "| mismatch.packet_error.sink | -0.03 | 0.001 | 0.08 | -0.05 .. 0.05 | 1 | FAIL "
    assert f"{row}| `--at tt,27,1 --sample 3` |" in text
    assert "| r_x_ohm.f100 |  |  |  |  | ohm | ERROR |  |" in text
    assert len(list(build.glob("characterise_*.png"))) == len(docs.DRAWN)
