# SPDX-License-Identifier: Apache-2.0
"""The named suite: its short set, that its table is complete, and that no way of going wrong passes for an answer."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import time
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
import seeded_faults
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis.converter import vfc
from dermis.errors import InputError
from dermis.report import verdict
from scripts import workers
from tb.programs.hard import converter_runs, inputs, networks, runner
from tb.programs.hard.case import Case
from tb.programs.hard.converter_runs import World
from tb.reference import exact

# ---- the suite ----------------------------------------------------------------------------------------------


@pytest.mark.timeout(900)
@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.paper
def test_the_short_set_passes(every: int) -> None:
    """Run an eighth of the short set; the whole set takes 25 s on an idle core once compiled."""
    cases = runner.chosen((), short=True)[::every]
    rows = [row for group in runner.MODULES for row in runner.run(cases, 1, group)]
    assert not [row for row in rows if row["status"] not in ("PASS", "SKIP")]
    assert sum(row["status"] == "PASS" for row in rows) > len(cases)


def test_the_table_of_cases_is_complete() -> None:
    cases = runner.all_cases()
    assert len(cases) >= 60
    for case in cases:
        assert case.name == case.name.lower().replace(" ", "_")
        assert case.group in runner.MODULES
        assert all((case.why, case.expected, case.source, case.tolerance, case.unit)), case.name
        assert case.runs, f"{case.name}: nothing runs it"
        assert not set(case.runs) & set(case.refused), f"{case.name}: an engine both runs and cannot"
        if case.group == "converter":
            assert {"closed", "event", "icarus", "verilator", "cosim"} <= {*case.runs, *case.refused}, (
                case.name
            )


def test_two_cases_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tb.programs.hard.converter.cases", lambda: [case_of(seeded_faults.right)] * 2)
    with pytest.raises(ValueError, match="two hard cases are named seeded"):
        runner.all_cases()


def test_a_word_chooses_by_name_or_group_and_nothing_is_refused() -> None:
    assert [case.name for case in runner.chosen(["tie_on_every"], short=False)] == ["tie_on_every_clock_edge"]
    assert {case.group for case in runner.chosen(["circuit"], short=False)} == {"circuit"}
    with pytest.raises(InputError, match="--only = no_such_case"):
        runner.chosen(["no_such_case"], short=False)


# ---- seeded faults ------------------------------------------------------------------------------------------


_numbers = itertools.count()


@pytest.fixture(autouse=True)
def _seconds_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each test its own sleeping time, which marks the processes that its faults leave."""
    monkeypatch.setenv(seeded_faults.SLEEP, f"1717.{os.getpid()}{next(_numbers):03d}")


def case_of(*runs: object, limit_s: float = 1.0) -> Case:
    """A case whose runs are functions of seeded_faults."""
    return Case(
        name="seeded",
        group="converter",
        why="because it goes wrong on purpose",
        expected="an ERROR or FAIL row",
        source="this test",
        tolerance="none",
        limit=0.0,
        unit="lsb",
        runs={run.__name__: run for run in runs},  # type: ignore[attr-defined]
        limit_s=limit_s,
        refused={"closed": "knows no faults"},
    )


def left_over() -> list[str]:
    """Command lines of processes that sleep as long as a seeded fault's."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            command = (place / "cmdline").read_bytes().split(b"\0")
        except OSError:  # it ended meanwhile
            continue
        if command[:2] == [b"sleep", seeded_faults.long_s().encode()]:
            found.append(place.name)
    return found


def test_every_way_of_going_wrong_is_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = {
        "right": ("PASS", "as it should be"),
        "off_by_one": ("FAIL", "one too few"),
        "hang": ("ERROR", "hangs: ended after 1 s"),
        "hang_with_child": ("ERROR", f"left processes behind: sleep {seeded_faults.long_s()}"),
        "deaf": ("ERROR", "hangs: ended after 1 s"),
        "too_slow": ("ERROR", " 1 s"),  # ended at its limit, or found beyond it, as the pool looks
        "crash": ("ERROR", "crashed: its process ended with signal SIGSEGV"),
        "leave": ("ERROR", "raised SystemExit: 0"),
        "fail": ("ERROR", "raised ValueError: nobody expects this"),
        "simulator": ("ERROR", "SimulatorError: ngspice stopped at 3 us, node v_int (log: ngspice.log)"),
        "not_a_number": ("ERROR", "not a number: nan"),
        "nothing": ("ERROR", "returned a NoneType, not a measurement"),
        "orphan": ("ERROR", f"sleep {seeded_faults.long_s()}"),
        "forked": ("ERROR", "left processes behind"),
    }
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))  # the limits as they stand
    # Those that never end have a second; on a starved machine the others may need more.
    endless = ("hang", "hang_with_child", "deaf", "too_slow")
    quick = case_of(*(getattr(seeded_faults, name) for name in expected if name not in endless), limit_s=60.0)
    slow = case_of(*(getattr(seeded_faults, name) for name in endless))
    rows = runner.run([quick, dataclasses.replace(slow, name="slow")], 2, "converter")
    found = {row["name"].rsplit(".", 1)[1]: row for row in rows}
    skipped = found.pop("closed")  # one row for both cases
    assert (skipped["status"], skipped["note"]) == ("SKIP", "2 cases: knows no faults")
    assert set(found) == set(expected)
    for name, (status, said) in expected.items():
        assert found[name]["status"] == status, found[name]
        assert said in found[name]["note"], found[name]
    assert found["off_by_one"]["value"] == 1
    assert verdict.exit_code(rows) == 1
    assert not left_over()


def test_a_busy_machine_gives_a_run_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    cores = os.cpu_count() or 1
    monkeypatch.setattr(os, "getloadavg", lambda: (20.0 * cores, 0.0, 0.0))
    rows = runner.run([case_of(seeded_faults.too_slow)], 1, "converter")
    assert rows[0]["status"] == "PASS"


def test_the_seconds_of_a_run_are_its_own() -> None:
    begin = time.monotonic()
    ends = list(workers.run([workers.Task(time.sleep, (0.2,), 30.0) for _ in range(3)], 3))
    assert sorted(number for number, _ in ends) == [0, 1, 2]
    for _, outcome in ends:
        assert outcome.fault == ""
        assert 0.2 <= outcome.seconds <= time.monotonic() - begin


@pytest.mark.parametrize("fresh", [False, True])
def test_a_fresh_process_for_each_task_where_that_is_asked_for(fresh: bool) -> None:
    ends = list(workers.run([workers.Task(os.getpid)] * 3, 1, fresh=fresh))
    assert len({outcome.value for _, outcome in ends}) == (3 if fresh else 1)


def test_what_the_consumer_leaves_early_is_ended() -> None:
    quick = workers.run(
        iter([workers.Task(seeded_faults.right), workers.Task(seeded_faults.hang_with_child)]), 2
    )
    assert next(quick)[1].value == seeded_faults.right()
    quick.close()
    assert not left_over()


# ---- table and command --------------------------------------------------------------------------------------


def test_the_table_says_each_error() -> None:
    case = dataclasses.replace(case_of(seeded_faults.right, seeded_faults.off_by_one), why="a | b")
    rows = [
        runner.row_of(case, "right", workers.Outcome(seeded_faults.right(), "", 0.5)),
        runner.row_of(case, "off_by_one", workers.Outcome(seeded_faults.off_by_one(), "", 0.125)),
        runner.row_of(case, "hang", workers.Outcome(fault="hangs: ended after 1 s", seconds=1.0)),
        verdict.skip("converter.closed", "1 case: knows no faults"),
    ]
    text = runner.table([case], rows)
    assert "1 cases, 3 runs: 1 PASS, 1 FAIL, 1 ERROR, 1 SKIP" in text
    assert r"| converter | `seeded` | a \| b |" in text
    assert "right 0 PASS; off_by_one 1 FAIL; hang ERROR" in text
    json.dumps(rows, allow_nan=False)


# ---- the exact references -----------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None)
@given(
    x=st.fractions(-1, 2, max_denominator=999),
    clocks=st.integers(1, 80),
    w0=st.fractions(-1, 1, max_denominator=99),
    packet=st.fractions(Fraction(1, 9), 2, max_denominator=99),
    level=st.fractions(-1, 1, max_denominator=99),
)
def test_the_integer_count_is_the_walk_in_rationals(
    x: Fraction, clocks: int, w0: Fraction, packet: Fraction, level: Fraction
) -> None:
    assert exact.count(x, clocks, w0, packet, level) == vfc.count_exact(x, clocks, w0, packet, level)


@pytest.mark.parametrize("keep", [Fraction(1, 2), Fraction(99, 100), Fraction(999, 1000)])
def test_every_plateau_up_to_q_12_has_the_width_of_the_contracted_rotation(keep: Fraction) -> None:
    places = [place for q in range(2, 13) for place in exact.locked(q)]
    assert len(places) == 23
    edges = sorted((*exact.plateau(p, q, keep), p, q) for p, q in places)
    for low, high, _, q in edges:
        assert keep * (high - low) == exact.plateau_width(q, keep)
    for (_, high, p, q), (low, _, p_next, q_next) in itertools.pairwise(edges):
        assert high < low
        assert Fraction(p, q) < Fraction(p_next, q_next)


@settings(max_examples=100, deadline=None)
@given(x=st.fractions(0, Fraction(1, 2), max_denominator=999), clocks=st.integers(1, 500))
def test_the_count_of_many_clocks_is_the_walk_where_it_can_be_walked(x: Fraction, clocks: int) -> None:
    ones = exact.count(x, clocks, Fraction(-1, 2), Fraction(1), Fraction(0))
    assert exact.count_and_rest(x, clocks) == (ones, Fraction(-1, 2) + clocks * x - ones)


def test_plateau_one_half_is_where_it_was_published() -> None:
    low, high = (float(Fraction(99, 100) * edge) for edge in exact.plateau(1, 2, Fraction(99, 100)))
    assert round(low, 6) == 0.497487
    assert round(high, 6) == 0.502513


def test_the_leaky_recursion_is_the_walk_in_fifty_digits() -> None:
    effects = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 4e4}}
    for x in (0.1, 1 / 3, 0.497, 0.503, 0.75):
        cell = exact.cell_of(x, effects, {})
        with mpmath.workdps(exact.DIGITS):
            keep = mpmath.exp(-mpmath.mpf(cell["leak"].numerator) / cell["leak"].denominator)
            ones = sum(exact.leaky_bits(mpmath.mpf(x), keep, 200, mpmath.mpf(-0.5)))
        assert exact.interval(cell, 200) == (ones, ones)


def test_a_margin_opens_the_interval_only_beside_a_level() -> None:
    beside = exact.cell_of(100.5 / 510, {}, {})
    assert exact.interval(beside, 510, margin=1e-9) == (100, 101)
    assert exact.interval(exact.cell_of(100 / 510, {}, {}), 510, margin=1e-9) == (100, 100)


def test_cases_see_an_engine_that_is_off_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World((0.1, 0.2, 100 / 510))
    assert converter_runs.codes("event", world).error == 0.0
    right = converter_runs.ENGINES["event"]
    monkeypatch.setitem(converter_runs.ENGINES, "event", lambda w: right(w) + np.array([0, 0, 1] + [0] * 5))
    found = converter_runs.codes("event", world)
    assert found.error == 1.0
    assert "101, exactly 100" in found.note


def test_many_clocks_see_one_lost_packet_and_a_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    right = converter_runs.loop
    right_error = converter_runs.many_clocks("event", 10**5, [0.1, 0.3]).error
    assert right_error <= 2.0**-52, "the last two sums' half ulps: the limit of the case"
    for count, drift in ((1, 0.0), (0, 1e-9)):

        def wrong(*given: object, count: int = count, drift: float = drift) -> object:
            found, rest = right(*given)  # type: ignore[arg-type]
            return found + count, rest + drift

        monkeypatch.setattr(converter_runs, "loop", wrong)
        assert converter_runs.many_clocks("event", 10**5, [0.1, 0.3]).error >= 0.9 * max(count, drift)


def test_a_scene_that_is_accepted_or_names_another_key_is_no_refusal() -> None:
    assert inputs.effect("comparator_delay", "t_s", 1.0, 1e-9).error == 1.0
    late = {"effects": {"comparator_delay": {"t_s": 1.0}}}
    assert inputs.refused(lambda: inputs.planned(late), "effects.comparator_delay.t_s").error == 0.0
    assert inputs.refused(lambda: inputs.planned(late), "effects.lateral").error == 1.0


def test_a_network_that_is_accepted_or_refused_elsewhere_is_a_miss() -> None:
    assert networks.no_answer(networks.SHORT, "closed", "row 1, column 1").error == 1.0
    assert networks.no_answer(networks.TABLE["one_open"].network(), "solver", "row 1").note == "solved"
    assert networks.refused_value("r_column_ohm", 1.0).note == "accepted"


def test_cases_see_a_current_that_is_wrong_in_its_tenth_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    right = networks.column_currents
    monkeypatch.setattr(networks, "column_currents", lambda network: right(network) * (1 + 1e-10))
    assert networks.currents("one_open").error == pytest.approx(
        1e-10, rel=0.01
    )  # the last digits of a double
