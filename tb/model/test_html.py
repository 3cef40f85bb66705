# SPDX-License-Identifier: Apache-2.0
"""Report pages: what stands in them, that they need no network, and the option --html."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from dermis import engines, plan
from dermis.chip import vcd_file
from dermis.cli import NO_TABLE, cli, with_page
from dermis.errors import InputError
from dermis.report import html, output, verdict

ROWS = [
    verdict.within("some.value_lsb", 0.5, "lsb", None, 1.0, "good"),
    verdict.within("some.<script>", 3.0, "lsb", None, 1.0, "bad & worse"),
    verdict.skip("some.other", "no tool"),
    verdict.report("some.number", 7, "taxels"),
    verdict.within("some.third_lsb", 0.1, "lsb", None, 1.0),
]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of a scene with effects, as `dermis run` leaves it."""
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'title = "A <b>ball</b>"\n[stimulus]\nkind = "indenter"\nshape = "spherical"\nforce_n = 12\n'
        "[effects]\nrow_driver = { r_ohm = 10 }\n"
    )
    made = plan.load(scene, "event")
    output.write(tmp_path / "run", made, engines.run(made), ROWS)
    return tmp_path / "run"


def fetched(page: str) -> list[str]:
    """What a browser would fetch to show a page; scripts and styles inside it are left out."""
    page = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    return re.findall(r"""(?:src|href)=["'](?!data:|#)([^"']+)""", page) + re.findall(
        r"url\((?!data:)[^)]*\)", page
    )


def test_page_of_a_run_says_what_happened_and_asks_nothing_of_a_network(run: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    html.write(page, "dermis run", {"run": ROWS}, [run], command=["dermis", "run", "a scene.toml"])
    text = page.read_text()
    assert len(text) < 2_000_000
    assert fetched(text) == []
    assert not re.search(r"<script[^>]+src=", text)
    assert "dermis run &#39;a scene.toml&#39;" in text
    assert "A &lt;b&gt;ball&lt;/b&gt;" in text
    assert "some.&lt;script&gt;" in text
    assert "bad &amp; worse" in text
    assert "row_driver" in text
    assert "sensor_spread." in text, "the list of effects that are off is whole"
    body = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert body.index("some.&lt;script&gt;") < body.index("some.value_lsb")  # what missed comes first


def test_worst_taxels_are_those_farthest_from_the_ideal_code(run: Path) -> None:
    made = plan.load(run / "resolved.toml", "event")
    codes = np.load(run / "codes.npy")
    off = np.abs(codes.astype(int) - engines.run(plan.load(run / "resolved.toml", "event")).codes)
    assert off.max() == 0
    ideal = np.floor(made.timing.gate_clocks * np.minimum(made.duty_ideal(), 0.5) + 0.5)
    assert abs(int(html._worst(made, codes).rows[0][-1])) == int(np.abs(codes - ideal).max()) > 0


def test_numbers_of_a_csv_file_are_drawn(tmp_path: Path) -> None:
    data = tmp_path / "curve.csv"
    data.write_text("r_ohm,view,code\n" + "".join(f"{r},{v},{r / 2}\n" for r in (1, 2, 3, 900) for v in "ab"))
    page = tmp_path / "page.html"
    html.write(page, "sweep", {}, [], [data])
    assert "code against r_ohm" in page.read_text()
    data.write_text("a,b\n")
    html.write(page, "sweep", {}, [], [data])
    assert "against" not in page.read_text()


def test_a_vcd_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    vcd = pytest.importorskip("vcd")
    with (tmp_path / "a.vcd").open("w") as file, vcd.VCDWriter(file, timescale="10 ns", date="") as writer:
        word = writer.register_var("chip", "word", "wire", size=4, init=0)
        bit = writer.register_var("chip", "bit", "wire", size=1, init=0)
        real = writer.register_var("analog", "v", "real", init=0.0)
        for time, net, value in ((1, word, 5), (2, bit, 1), (3, real, -0.25), (4, word, 9)):
            writer.change(net, time, value)
    read = vcd_file.read(tmp_path / "a.vcd")
    assert read["chip.word"][1].tolist() == [0, 5, 9]
    assert read["chip.word"][0] == pytest.approx([0, 1e-8, 4e-8])
    assert read["chip.bit"][1].tolist() == [0, 1]
    assert read["analog.v"][1].tolist() == [0.0, -0.25]


def test_option_html_writes_tables_and_runs_of_a_command(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = CliRunner().invoke(
        cli,
        ["run", "single_touch", "--out", str(tmp_path / "out"), "--html", str(page)],
        standalone_mode=False,
    )
    assert done.exception is None
    text = page.read_text()
    assert "run.taxels_at_full_scale.single_touch" in text
    assert "Worst taxels" in text


@pytest.mark.parametrize("numbers", [False, True])
def test_option_html_of_a_command_with_a_table(
    numbers: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command's own option around a body that leaves rows, and numbers as `accuracy` does."""
    monkeypatch.setattr(html, "BUILD", tmp_path)
    monkeypatch.setattr(verdict, "BUILD", tmp_path)

    def body(**_: object) -> int:
        (tmp_path / "accuracy").mkdir()
        if numbers:
            lines = "".join(f"event,{10**n},{1 / (n + 1)}\n" for n in range(5))
            (tmp_path / "accuracy" / "numbers.csv").write_text(f"method,seconds,error_lsb\n{lines}")
        verdict.write_rows("accuracy", ROWS)
        return 1

    command = cli.get_command(click.Context(cli), "accuracy")
    assert command is not None
    params = [parameter for parameter in command.params if parameter.name != "html"]
    again = with_page("accuracy", click.Command("accuracy", params=params, callback=body))
    page = tmp_path / "page.html"
    done = CliRunner().invoke(again, ["--html", str(page)], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 1)
    text = page.read_text()
    assert fetched(text) == []
    assert all(
        word in text
        for word in ("<h1>dermis accuracy</h1>", "some.&lt;script&gt;", "Value relative to its limit")
    )
    for word in ("numbers.csv", "error_lsb against seconds", "error / LSB"):
        assert (word in text) == numbers


def test_every_command_with_a_table_takes_html() -> None:
    context = click.Context(cli)
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        taken = any(parameter.name == "html" for parameter in command.params)
        assert taken == (name not in NO_TABLE), name


def test_a_value_below_zero_is_drawn_against_its_own_limit() -> None:
    low = verdict.within("some.gain", -0.04, "1", -0.05, 0.1)
    assert html._share(low) == pytest.approx(0.8)
    assert html._share({**low, "min": None}) is None
    assert html._share({**low, "value": 0.05}) == pytest.approx(0.5)


def test_option_html_is_refused_before_the_command_runs(tmp_path: Path) -> None:
    page = tmp_path / "none" / "page.html"
    done = CliRunner().invoke(
        cli,
        ["run", "single_touch", "--out", str(tmp_path / "out"), "--html", str(page)],
        standalone_mode=False,
    )
    assert isinstance(done.exception, InputError)
    assert "--html" in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_report_collects_every_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html, "BUILD", tmp_path)
    with pytest.raises(InputError, match="verdict tables"):
        html.report_command.callback(out=None)
    (tmp_path / "some.json").write_text(json.dumps(ROWS))
    (tmp_path / "good.json").write_text(json.dumps(ROWS[:1]))
    (tmp_path / "other.json").write_text('{"not": "rows"}')
    (tmp_path / "broken.json").write_text("{")
    assert html.report_command.callback(out=None) == 0
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"index.html", "some.html", "good.html"}
    index = (tmp_path / "report" / "index.html").read_text()
    assert index.index("some.html") < index.index("good.html")  # what missed comes first
