# SPDX-License-Identifier: Apache-2.0
"""The named suite: its short set, that its table is complete, and that no way of going wrong passes for an answer."""

import dataclasses
import itertools
import os
from pathlib import Path

import numpy as np
import pytest
import seeded_faults

from dermis.errors import InputError
from dermis.report import verdict
from scripts import workers
from tb.programs.hard import converter, networks, runner
from tb.programs.hard.case import Case
from tb.programs.hard.converter import World
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


def test_a_word_chooses_by_name_or_group_and_nothing_is_refused() -> None:
    assert [case.name for case in runner.chosen(["tie_on_every"], short=False)] == ["tie_on_every_clock_edge"]
    assert {case.group for case in runner.chosen(["array"], short=False)} == {"array"}
    with pytest.raises(InputError, match="--only = no_such_case"):
        runner.chosen(["no_such_case"], short=False)


# ---- seeded faults ------------------------------------------------------------------------------------------


_numbers = itertools.count()


@pytest.fixture(autouse=True)
def _seconds_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each test its own sleeping time, which marks the processes that its faults leave."""
    monkeypatch.setenv(seeded_faults.SLEEP, f"1717.{os.getpid()}{next(_numbers):03d}")


def case_of(*names: str, limit_s: float = 1.0) -> Case:
    """A case whose runs are functions of seeded_faults."""
    runs = {name: getattr(seeded_faults, name) for name in names}
    return Case("seeded", "converter", runs, limit_s=limit_s, refused={"closed": "knows no faults"})


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
    quick = case_of(*(name for name in expected if name not in endless), limit_s=60.0)
    slow = case_of(*endless)
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
    rows = runner.run([case_of("too_slow")], 1, "converter")
    assert rows[0]["status"] == "PASS"


def test_what_the_consumer_leaves_early_is_ended() -> None:
    tasks = map(workers.Task, (seeded_faults.right, seeded_faults.hang_with_child))
    quick = workers.run(tasks, 2)
    assert next(quick)[1].value == seeded_faults.right()
    quick.close()
    assert not left_over()


# ---- the exact references -----------------------------------------------------------------------------------


def test_a_margin_opens_the_interval_only_beside_a_level() -> None:
    beside = exact.cell_of(100.5 / 510, {}, {})
    assert exact.interval(beside, 510, margin=1e-9) == (100, 101)
    assert exact.interval(exact.cell_of(100 / 510, {}, {}), 510, margin=1e-9) == (100, 100)


def test_cases_see_an_engine_that_is_off_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World((0.1, 0.2, 100 / 510))
    assert converter.codes("event", world).error == 0.0
    right = converter.ENGINES["event"]
    monkeypatch.setitem(converter.ENGINES, "event", lambda w: right(w) + np.array([0, 0, 1] + [0] * 5))
    found = converter.codes("event", world)
    assert found.error == 1.0
    assert "101, exactly 100" in found.note


def test_cases_see_a_current_that_is_wrong_in_its_tenth_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    right = networks.column_currents
    monkeypatch.setattr(networks, "column_currents", lambda network: right(network) * (1 + 1e-10))
    # 0.01: the last digits of a double.
    assert networks.currents("one_open").error == pytest.approx(1e-10, rel=0.01)
