# SPDX-License-Identifier: Apache-2.0
"""The site is built from the tree as it is: every link leads somewhere, every name and number comes from its source."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

import dermis
from dermis import cli
from dermis.errors import SimulatorError
from dermis.report import verdict
from dermis.scene import design as designs
from dermis.scene.design import ROOT
from scripts import website


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the pages, and a place for the site, of a test's own."""
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for name in ("site_source", "site"):
        config = config.replace(f"build/{name}", str(tmp_path / name))
    config = config.replace("docs/theme", str(ROOT / "docs/theme"))
    (tmp_path / "mkdocs.yml").write_text(config)
    for name, place in (("CONFIG", "mkdocs.yml"), ("SOURCE", "site_source"), ("SITE", "site"), ("BUILD", "")):
        monkeypatch.setattr(website, name, tmp_path / place)
    monkeypatch.setattr(website.demo, "wasm", lambda _: b"")  # where its compiler is installed it takes 40 s
    return tmp_path


def test_the_site_builds_and_loads_nothing_from_elsewhere(place: Path) -> None:
    result = CliRunner().invoke(website.docs_command, standalone_mode=False)
    assert result.exception is None, result.exception
    pages = list((place / "site").rglob("*.html"))
    assert len(pages) > 25
    elsewhere = re.compile(r'src="(?:https?:)?//|rel="stylesheet" href="http')
    assert not [page for page in pages if elsewhere.search(page.read_text(encoding="utf-8"))]
    (file,) = set(re.findall(r'href="(tables/\w+\.csv)"', (place / "site" / "characterise.html").read_text()))
    recorded = (ROOT / "docs" / "characterise.md").read_text().count("\n| mismatch.")
    assert (place / "site" / file).read_text().count("\nmismatch.") == recorded > 10
    datasheet = (place / "site" / "datasheet.html").read_text(encoding="utf-8")
    assert "{{" not in datasheet
    assert "test_current_o" in datasheet


def test_each_broken_link_is_a_warning_and_a_warning_ends_the_build(place: Path) -> None:
    faults = ("[x](nowhere.md)", "[x](index.md#nowhere)", "![x](figures/nowhere.png)")

    def broken() -> None:
        website.write_source()
        with (place / "site_source" / "index.md").open("a") as page:
            page.write("\n" + "\n".join(faults) + "\n")

    with pytest.raises(SimulatorError, match="mkdocs"):
        website.build(broken)
    warnings = re.findall(r".*WARNING.*", (place / "site.log").read_text())
    for word in ("nowhere.md", "#nowhere", "figures/nowhere.png"):
        assert any(word in line for line in warnings)


def test_every_command_and_every_public_name_has_its_entry() -> None:
    commands, library = website.commands_page(), website.api_page()
    assert all(f"\n## {name}\n" in commands for name in cli.elsewhere())
    assert "--engine" in commands
    assert all(f"\n## {name}\n" in library for name in set(dermis.__all__) - {"__version__"})


def test_a_number_of_the_datasheet_is_the_one_that_was_measured(place: Path) -> None:
    name = "synth.area_um2.sky130.16x16"
    recorded = website.measured()[name]
    assert recorded.source == "docs/synthesis.md"
    row = verdict.report(name, 123.5, "um2")
    (place / "synth.json").write_text(json.dumps([row]))
    assert website.measured()[name] == website.Measured("", "123.5", "", "um2", "build/synth.json")
    assert "| 123.5 |" in website.row(website.measured(), name, "Standard cells").replace("  ", " ")


def test_a_pin_without_a_meaning_is_an_error() -> None:
    text = (ROOT / "docs" / "datasheet.md").read_text(encoding="utf-8")
    lost = "\n".join(line for line in text.splitlines() if "charge_o" not in line)
    with pytest.raises(SimulatorError, match="differ from the ports"):
        website.datasheet(lost, designs.load())


def test_no_file_cites_a_page_that_is_not_there() -> None:
    pages = {path.name for path in (ROOT / "docs").glob("*.md")}
    suffixes = set(".c .cpp .inc .json .md .py .rdl .sby .sdc .sh .sp .sv .toml .v".split())
    tops = ("models", "rtl", "spice", "scripts", "tb", "docs")
    files = [path for top in tops for path in (ROOT / top).rglob("*") if path.suffix in suffixes]
    lost = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in [*files, *ROOT.glob("*.md"), ROOT / "Makefile", ROOT / "pyproject.toml"]
        for name in re.findall(r"docs/(\w+\.md)", path.read_text(encoding="utf-8", errors="replace"))
        if name not in pages
    }
    assert not lost


@pytest.mark.paper
def test_the_page_of_the_paper_has_every_figure_and_the_codes_of_the_indenters() -> None:
    text = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    figures = [str(figure) for figure in range(1, 12)]
    assert re.findall(r"^\| (\d+) \|", text, re.M) == figures
    headings = " ".join(re.findall(r"^## Fig\. (.*)", text, re.M))
    assert set(re.findall(r"\d+", headings)) == set(figures)
    for shape in ("flat", "triangular", "cylindrical"):
        (line,) = dermis.simulate(f"{shape}_indenter", engine="closed").codes[0, 8:9]
        half = [str(code) for code in line[:8] if code]
        (row,) = (found for found in text.splitlines() if found.startswith(f"| {shape} |"))
        assert (", ".join(dict.fromkeys(half))) in row


def test_each_block_has_its_own_page_and_stands_there_once(tmp_path: Path) -> None:
    source = tmp_path / "schematics"
    source.mkdir()
    text = (ROOT / "docs" / "schematics.md").read_text(encoding="utf-8")
    sheets = {path.stem for path in (ROOT / "spice" / "schematic").glob("*.sch")}
    for name in sheets:
        (source / f"{name}.svg").write_text('<svg width="100" height="40">')
    (tmp_path / "schematics.md").write_text(text)
    website.schematic_pages(tmp_path)
    assert {path.stem for path in source.glob("*.md")} == sheets
    assert 'width="125" height="50"' in (source / "ota.md").read_text()
    listed = (tmp_path / "schematics.md").read_text()
    assert all(listed.count(f"](schematics/{name}.md)") == 1 for name in sheets)
    (tmp_path / "schematics.md").write_text(text)
    with pytest.raises(SimulatorError, match="there twice"):
        website.schematic_pages(tmp_path)
