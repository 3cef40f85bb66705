# SPDX-License-Identifier: Apache-2.0
"""What became slower or less exact since the blessed run is named, and nothing else is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from dermis.errors import InputError
from dermis.report import verdict
from tb.programs.bench import bench, history

MACHINE = "some processor, 2 cores"


def _run(**changed: Any) -> list[verdict.Row]:
    """A run with something of every kind; `changed` puts other values in place, in the order of `NAMES`."""
    values: dict[str, Any] = {
        "cosim.edge_error_v.step_1u": 1e-12,
        "cosim.count_error.step_1u": 0,
        "accuracy.order": 1.95,
        "cosim.speed_ratio.xspice": [2.6, 2.7, 2.8],
        "event.certificate_time_ratio": [1.4, 1.5, 1.6],
        "closed.frames_per_s": [900.0, 1000.0, 1100.0],
        "cosim.frame_s": [2.0, 2.1, 2.2],
        "peer.xspice.clocks_per_s": [1e4, 1.1e4],
        "machine.busy_cores": 0.0,
    } | changed
    return [
        verdict.median(name, value, "1") if isinstance(value, list) else verdict.report(name, value, "1")
        for name, value in values.items()
    ]


def _blessed() -> dict[str, Any]:
    return history.record(_run(), MACHINE, "0123", {})


def _worse(**changed: Any) -> dict[str, list[str]]:
    """Names by kind of what a run with these changes is told to have lost."""
    found: dict[str, list[str]] = {}
    for change in history.changes(_run(**changed), _blessed()):
        found.setdefault(change.kind, []).append(change.name)
    return found


def test_the_same_run_again_has_lost_nothing() -> None:
    assert _worse() == {}


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        ("cosim.edge_error_v.step_1u", 3e-9, "error"),
        ("cosim.count_error.step_1u", 1, "error"),  # from exact to not
        ("accuracy.order", 1.0, "error"),
        ("cosim.speed_ratio.xspice", [1.2, 1.3, 1.4], "ratio"),
        ("event.certificate_time_ratio", [3.0, 3.1, 3.2], "ratio"),
        ("closed.frames_per_s", [400.0, 500.0, 600.0], "absolute"),
        ("cosim.frame_s", [4.0, 4.1, 4.2], "absolute"),
    ],
)
def test_a_seeded_loss_is_named_and_nothing_else_is(name: str, value: Any, kind: str) -> None:
    assert _worse(**{name: value}) == {kind: [name]}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cosim.edge_error_v.step_1u", 1e-14),  # more exact
        ("accuracy.order", 1.99),
        ("cosim.speed_ratio.xspice", [5.0, 5.1, 5.2]),  # faster
        ("event.certificate_time_ratio", [1.0, 1.1, 1.1]),
        ("closed.frames_per_s", [4e3, 5e3, 6e3]),
        ("cosim.frame_s", [1.0, 1.1, 1.2]),
        ("cosim.speed_ratio.xspice", [1.5, 2.3, 2.7]),  # slower in the middle, but the runs overlap
        ("cosim.speed_ratio.xspice", [2.55, 2.56, 2.57]),  # apart from all, and by 5 %
        ("cosim.edge_error_v.step_1u", 1.5e-12),  # rounding elsewhere
        ("peer.xspice.clocks_per_s", [1.0, 1.1]),  # not ours
        ("machine.busy_cores", 2.0),
    ],
)
def test_what_is_better_or_no_change_or_not_ours_is_not_named(name: str, value: Any) -> None:
    assert _worse(**{name: value}) == {}


def test_errors_stand_before_ratios_and_those_before_times() -> None:
    rows = _run(
        **{
            "closed.frames_per_s": [1.0],
            "event.certificate_time_ratio": [9.0],
            "cosim.speed_ratio.xspice": [0.1],
            "cosim.edge_error_v.step_1u": 1e-6,
        }
    )
    assert [change.name for change in history.changes(rows, _blessed())] == [
        "cosim.edge_error_v.step_1u",
        "cosim.speed_ratio.xspice",
        "event.certificate_time_ratio",
        "closed.frames_per_s",
    ]


def test_the_words_name_row_factor_and_both_machines() -> None:
    rows = _run(**{"cosim.edge_error_v.step_1u": 3e-9, "closed.frames_per_s": [500.0]})
    said = "\n".join(history.report(rows, "another processor", _blessed(), whole=True))
    assert "less exact: \n    cosim.edge_error_v.step_1u: 1e-12 -> 3e-09 1 (3e+03 times worse)" in said
    assert "slower, by ratios that were measured in pairs: nothing" in said
    assert "closed.frames_per_s: 1000 -> 500 1 (2 times worse)" in said
    assert MACHINE in said
    assert "another processor" in said
    assert "not measured now" not in said
    lost = "\n".join(history.report(rows[1:], MACHINE, _blessed(), whole=True))
    assert "not measured now: cosim.edge_error_v.step_1u" in lost
    assert "Another machine" not in lost


def test_a_loss_informs_and_fails_nothing() -> None:
    rows = history.summary(_run(**{"cosim.edge_error_v.step_1u": 3e-9}), _blessed())
    assert [(row["name"], row["value"]) for row in rows] == [
        ("blessed.less_exact", 1),
        ("blessed.slower_by_ratio", 0),
        ("blessed.slower", 0),
    ]
    assert "cosim.edge_error_v.step_1u" in rows[0]["note"]
    assert verdict.exit_code(rows) == 0
    assert {row["status"] for row in history.summary(_run(), None)} == {"SKIP"}


def test_every_row_that_the_benchmark_promises_has_a_meaning() -> None:
    for section in bench.SECTIONS:
        for name in section.names:
            history.meaning(name)
    with pytest.raises(KeyError, match="MEANINGS"):
        history.meaning("nonsense.rows")


def test_a_run_is_kept_blessed_and_read_back(tmp_path: Path) -> None:
    rows, path = _run(), tmp_path / "blessed.json"
    run = history.record(rows, MACHINE, "0123", {"quick": False})
    places = [history.keep(run, tmp_path / "history") for _ in range(2)]
    assert places[0] != places[1]
    assert [kept["rows"] for kept in history.history(tmp_path / "history")] == [run["rows"]] * 2
    assert history.blessed(path) is None
    history.bless(run, rows, path)
    assert history.blessed(path) == run
    assert history.changes(rows, history.blessed(path)) == []
    with pytest.raises(InputError, match="without FAIL or ERROR"):
        history.bless(run, [*rows, verdict.error("cosim.frame_s", "it broke")], path)


@pytest.mark.parametrize("text", ["{", "[]", '{"rows": {"cosim.frame_s": {"value": "fast"}}}'])
def test_a_blessed_file_that_is_broken_is_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "blessed.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"blessed\.json"):
        history.blessed(path)


def test_the_command_keeps_compares_and_blesses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A section that becomes less exact between two runs is named by the second, whose exit code is still 0."""
    value = [1e-12]

    def make(m: bench.Measurements) -> Any:
        yield verdict.judge("cosim.edge_error_v.step_1u", value[0])

    section = bench.Section(("cosim.edge_error_v.step_1u",), make, 5)
    monkeypatch.setattr(bench, "SECTIONS", (section,))
    monkeypatch.setattr(bench, "ROOT", tmp_path)
    monkeypatch.setattr(verdict, "BUILD", tmp_path / "build")
    monkeypatch.setattr(history, "ROOT", tmp_path)
    monkeypatch.setattr(history, "HISTORY", tmp_path / "history")
    monkeypatch.setattr(history, "BLESSED", tmp_path / "blessed.json")
    (tmp_path / "history").mkdir()

    def run(*words: str) -> str:
        done = CliRunner().invoke(bench.bench_command, list(words), standalone_mode=False)
        assert done.return_value == 0, done.output
        return done.output

    assert "no blessed result" in run("--bless")
    assert "1 rows compared" in run()
    value[0] = 1e-9  # a thousand times worse, and still within its limit
    assert "cosim.edge_error_v.step_1u: 1e-12 -> 1e-09" in run()
    assert len(list((tmp_path / "history").glob("*.json"))) == 3
    assert json.loads((tmp_path / "blessed.json").read_text())["rows"]
    assert "1e-12" in run("--history")
    refused = CliRunner().invoke(bench.bench_command, ["--bless", "--quick"])
    assert isinstance(refused.exception, InputError)
