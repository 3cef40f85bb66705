# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis coverage`: what is not reached is missed, an exclusion needs its point, runs are added up."""

import json
from pathlib import Path

import pytest

from dermis.chip.sources import TOP, rtl_sources
from dermis.report import verdict
from scripts import coverage

SIZES = dict(coverage.SIZES)
MODULES = [path.stem for path in rtl_sources()]


def point(module: str, what: str, line: int, count: int, page: str = "v_toggle") -> str:
    keys = {"page": f"{page}/{module}", "f": f"x/rtl/{module}.v", "l": line, "n": 3, "o": what, "h": "top.u"}
    return "C '" + "".join(f"\x01{k}\x02{v}" for k, v in keys.items()) + f"' {count}\n"


def left(place: Path, name: str, points: list[str], top: str = TOP, parameters: dict = SIZES) -> None:
    place.mkdir(exist_ok=True)
    (place / f"run_{name}.dat").write_text("# SystemC::Coverage-3\n" + "".join(points))
    (place / f"run_{name}.json").write_text(json.dumps({"top": top, "parameters": parameters}))


def shares(place: Path, *listed: coverage.Exclusion) -> dict[str, dict]:
    return {row["name"]: row for row in coverage.rows(coverage.add_up(place, listed), MODULES)}


NEVER = coverage.Exclusion("toggle", "dermis_spi", r"cs_ni:1->0", reason="a test of the tests")


def test_a_bit_that_never_moves_is_missed_and_named(tmp_path: Path) -> None:
    # A trap has the name of the module it stands for, and lies elsewhere: it does not count.
    trap = point("dermis_spi", "cs_ni:1->0", 12, 1).replace("x/rtl/", "x/traps/")
    fell = point("dermis_spi", "cs_ni:1->0", 12, 0)
    left(tmp_path, "a", [point("dermis_spi", "cs_ni:0->1", 12, 4), fell, trap])
    row = shares(tmp_path)["coverage.toggle.dermis_spi"]
    assert (row["value"], row["status"]) == (50.0, "FAIL")
    missed = coverage.uncovered(coverage.add_up(tmp_path, []))
    assert len(missed) == 1
    assert missed[0].startswith("dermis_spi.v:12: toggle [cs_ni:1->0]")


def test_runs_of_any_size_and_any_module_are_added_to_the_points_of_the_top(tmp_path: Path) -> None:
    left(tmp_path, "a", [point("dermis_spi", "cs_ni:0->1", 12, 4), point("dermis_spi", "cs_ni:1->0", 12, 0)])
    left(tmp_path, "b", [point("dermis_spi", "cs_ni:1->0", 12, 1)], top="dermis_spi", parameters={})
    # A bit that only a larger core has is not asked for.
    left(tmp_path, "c", [point("dermis_top", "row_select_o[63]:0->1", 20, 0)], parameters={"ROWS": 64})
    rows = shares(tmp_path)
    assert rows["coverage.toggle.dermis_spi"]["value"] == 100.0
    assert "not in a run" in rows["coverage.toggle.dermis_top"]["note"]


def test_an_exclusion_takes_its_points_out_and_is_stale_once_they_are_reached(tmp_path: Path) -> None:
    kept = point("dermis_spi", "cs_ni:0->1", 12, 4)
    left(tmp_path / "a", "a", [kept, point("dermis_spi", "cs_ni:1->0", 12, 0)])
    rows = shares(tmp_path / "a", NEVER)
    assert rows["coverage.toggle.dermis_spi"]["value"] == 100.0
    assert "1 excluded" in rows["coverage.toggle.dermis_spi"]["note"]
    assert rows["coverage.stale_exclusions"]["status"] == "PASS"
    left(tmp_path / "b", "a", [kept, point("dermis_spi", "cs_ni:1->0", 12, 2)])
    stale = shares(tmp_path / "b", NEVER)["coverage.stale_exclusions"]
    assert (stale["value"], stale["status"]) == (1, "FAIL")
    assert "cs_ni" in stale["note"]


def test_a_module_that_no_run_of_the_top_holds_is_an_error_and_no_pass(tmp_path: Path) -> None:
    left(tmp_path, "a", [point("dermis_spi", "cs_ni:1->0", 12, 1)])
    rows = shares(tmp_path)
    assert rows["coverage.toggle.dermis_sync_latch"]["status"] == "ERROR"
    assert rows["coverage.line.dermis_sync_latch"]["status"] == "SKIP"
    left(tmp_path, "a", [point("dermis_spi", "cs_ni:1->0", 12, 1)], top="dermis_spi", parameters={})
    rows = shares(tmp_path)
    assert rows["coverage.toggle.all"]["status"] == "ERROR"
    assert verdict.exit_code(list(rows.values())) == 1


def test_a_list_with_another_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / coverage.EXCLUSIONS
    path.parent.mkdir(parents=True)
    path.write_text('[[exclusion]]\nrule = "line"\nmodule = "m"\nmatch = "x"\nreason = "r"\nline = "3"\n')
    with pytest.raises(TypeError, match="line"):
        coverage.exclusions(tmp_path)
