# SPDX-License-Identifier: Apache-2.0
"""Report pages and the site in a real browser: accessible, in light and dark, without an error on the console."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_demo import complaints

from dermis.places import BUILD, ROOT
from dermis.processes import children
from scripts import website
from scripts.demo import browser, demo

REASON, COMPILER = browser.missing(), demo.have_compiler()
pytestmark = [pytest.mark.long, pytest.mark.skipif(bool(REASON), reason=str(REASON))]
SIZES = ((1280, 800), (800, 1000), (390, 844))
SIDEWAYS = "return document.documentElement.scrollWidth - innerWidth"

# Code in the site is smaller than its text, as the theme has it.
SITE_PX = 10


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with browser.session() as opened:
        yield opened


def errors(driver: Any) -> list[Any]:
    return [line for line in driver.get_log("browser") if line["level"] == "SEVERE"]


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(
    "command", [["run", "two_fingers"], ["run", "triangular_indenter", "--engine", "rtl"]]
)
def test_a_report_page_is_accessible(driver: Any, tmp_path: Path, command: list[str], dark: bool) -> None:
    page = tmp_path / "page.html"
    children.run_logged(
        [sys.executable, "-m", "dermis", *command, "--out", tmp_path / "run", "--html", page],
        ROOT, tmp_path / "log", 120, "dermis run",
    )  # fmt: skip
    drawn = "return document.querySelectorAll('.maps figure').length"
    for width, height in SIZES:
        browser.screen(driver, width, height, dark)
        driver.get(page.as_uri())
        driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert driver.execute_script(SIDEWAYS) <= 0, width
        assert driver.execute_script(drawn) > 0
        assert errors(driver) == []
        assert complaints(driver, minimum_px=10) == [], width


@pytest.fixture(scope="module")
def site() -> Path:
    website.build()
    return BUILD / "site"


@pytest.mark.skipif(bool(COMPILER), reason=str(COMPILER))
def test_the_first_page_of_the_site_runs_the_chip(driver: Any, site: Path) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    browser.screen(driver, 1440, 1000, False)
    driver.get((site / "index.html").as_uri())
    driver.switch_to.frame(driver.find_element("tag name", "iframe"))
    WebDriverWait(driver, browser.LIMIT_S).until(
        lambda d: d.execute_script("return !!(window.demo && demo.firstCode)")
    )
    assert driver.execute_script("return demo.state().latest.good")
    driver.switch_to.default_content()
    assert errors(driver) == []
    assert complaints(driver, SITE_PX) == []


def test_no_page_of_the_site_scrolls_sideways_or_has_an_error_on_the_console(driver: Any, site: Path) -> None:
    for width, height in SIZES:
        browser.screen(driver, width, height, False)
        for page in sorted(site.rglob("*.html")):
            if page.name not in ("chip.html", "404.html"):  # the first has tests of its own
                driver.get(page.as_uri())
                assert errors(driver) == [], page.name
                assert driver.execute_script(SIDEWAYS) <= 0, (page.name, width)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("name", ["index", "datasheet", "paper", "schematics", "schematics/ota"])
def test_a_page_of_the_site_is_accessible(driver: Any, site: Path, name: str, dark: bool) -> None:
    for width, height in SIZES:
        browser.screen(driver, width, height, dark)
        driver.get((site / f"{name}.html").as_uri())
        shown = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (shown != "rgb(255, 255, 255)") == dark
        assert complaints(driver, SITE_PX) == [], width
