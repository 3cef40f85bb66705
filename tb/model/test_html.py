# SPDX-License-Identifier: Apache-2.0
"""Report pages: what stands in them, that they need no network, and the option --html."""

import base64
import io
import json
import re
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from PIL import Image

from dermis import engines, plan
from dermis.cli import NO_TABLE, cli
from dermis.errors import InputError
from dermis.report import figures, html, output, verdict

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
    out = tmp_path / "run"
    output.write(out, made, engines.run(made), ROWS, lambda to: figures.save(Figure(), to / "frame.png"))
    return out


def fetched(page: str) -> list[str]:
    """What a browser would fetch to show a page; scripts and styles inside it are left out."""
    page = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    found = re.findall(r"""(?:src|href)=["'](?!data:|#)([^"']+)""", page)
    return found + re.findall(r"url\((?!data:)[^)]*\)", page)


def test_page_of_a_run_says_what_happened_and_asks_nothing_of_a_network(run: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    html.write(page, "dermis run", {"run": ROWS}, [run], command=["dermis", "run", "a scene.toml"])
    text = page.read_text()
    assert len(text) < 2_000_000
    assert fetched(text) == []
    assert not re.search(r"<script[^>]+src=", text)
    # The last word ends the list of effects that are off.
    for words in (
        "dermis run &#39;a scene.toml&#39;",
        "A &lt;b&gt;ball&lt;/b&gt;",
        "some.&lt;script&gt;",
        "bad &amp; worse",
        "row_driver",
        "sensor_spread.",
    ):
        assert words in text
    body = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert body.index("some.&lt;script&gt;") < body.index("some.value_lsb")  # what missed comes first
    # First screen: verdicts, the worst row, one picture that is not shown again.
    lead = text[text.index('<div class="lead">') : text.index("<h2>Verdicts")]
    assert ">1 FAIL<" in lead
    assert "some.&lt;script&gt;" in lead
    assert "3 lsb (at most 1)" in lead
    assert text.count(base64.b64encode((run / "frame.png").read_bytes()).decode()) == 1
    assert lead.count("<img") == 1


def test_a_page_has_rows_figures_maps_of_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (html, verdict):
        monkeypatch.setattr(module, "BUILD", tmp_path)
    monkeypatch.setattr(verdict, "WRITTEN", [])
    monkeypatch.setattr(output, "MAPS", [("an earlier map", np.ones((2, 2)), "N")])

    def command() -> int:
        figures.save(Figure(), tmp_path / "accuracy" / "ways.png")
        verdict.write_rows("accuracy", ROWS)
        output.MAPS.append(("frame 7", np.array([[0.5, np.nan, 2.0]]), "N"))
        return 1

    assert html.reporting("accuracy", tmp_path / "page.html", command) == 1
    text = (tmp_path / "page.html").read_text()
    assert fetched(text) == []
    assert "<h1>dermis accuracy</h1>" in text
    image = base64.b64encode((tmp_path / "accuracy" / "ways.png").read_bytes()).decode()
    lead = text[text.index('<div class="lead">') : text.index("<h2>Verdicts")]
    for words in (
        "some.&lt;script&gt;",
        f'src="data:image/png;base64,{image}"',
        "frame 7, 0 to 2 N",
        'title="row 0, column 1: no value"',
        'title="row 0, column 2: 2 N"',
    ):
        assert words in lead
    assert "an earlier map" not in text


def test_the_row_nearest_to_its_limit_is_the_first_to_look_at() -> None:
    near = verdict.within("near", 0.9, "", None, 1.0)
    low = verdict.within("low", 100.0, "", 95.0, None)
    exact = verdict.within("exact", 0, "", 0, 0)
    assert html._worst_row([exact, ROWS[0], near, *ROWS[2:4]]) is near
    assert html._worst_row([exact, near, low]) is low
    assert html._worst_row([low, ROWS[1]]) is ROWS[1]
    assert html._worst_row([verdict.error("bad", "no value"), ROWS[1]])["name"] == "bad"
    assert html._worst_row([exact]) is exact
    assert html._worst_row(ROWS[2:4]) is None


def called(*arguments: str | Path) -> BaseException | None:
    """Call the command line in this process; return its exception."""
    return CliRunner().invoke(cli, [str(word) for word in arguments], standalone_mode=False).exception


@pytest.mark.parametrize(
    ("scene", "said", "maps"),
    [("single_touch", "Worst taxels", 3), ("direct_readout", "Code less the ideal code: all equal.", 2)],
)
def test_option_html_writes_tables_and_runs(tmp_path: Path, scene: str, said: str, maps: int) -> None:
    page = tmp_path / "page.html"
    assert called("run", scene, "--out", tmp_path / "out", "--html", page) is None
    text = page.read_text()
    assert f"run.taxels_at_full_scale.{scene}" in text
    assert said in text
    assert text.count("<figure>") == maps


def test_every_command_with_a_table_takes_html() -> None:
    context = click.Context(cli)
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        taken = any(parameter.name == "html" for parameter in command.params)
        assert taken == (name not in NO_TABLE), name


def test_option_html_is_refused_before_the_command_runs(tmp_path: Path) -> None:
    for page in (tmp_path / "none" / "page.html", "/proc/page.html"):
        error = called("run", "single_touch", "--out", tmp_path / "out", "--html", page)
        assert isinstance(error, InputError)
        assert "--html" in str(error)
        assert not (tmp_path / "out").exists()


def test_report_collects_every_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html, "BUILD", tmp_path)
    with pytest.raises(InputError, match="verdict tables"):
        html.report_command.callback(out=None)
    (tmp_path / "some.json").write_text(json.dumps(ROWS))
    (tmp_path / "good.json").write_text(json.dumps(ROWS[:1]))
    figures.save(Figure(), tmp_path / "good.png")
    (tmp_path / "other.json").write_text('{"not": "rows"}')
    (tmp_path / "broken.json").write_text("{")
    assert html.report_command.callback(out=None) == 0
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"index.html", "some.html", "good.html"}
    index = (tmp_path / "report" / "index.html").read_text()
    assert index.index("some.html") < index.index("good.html")  # what missed comes first
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', index)
    with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
        assert max(image.size) <= 240
