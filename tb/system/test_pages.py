# SPDX-License-Identifier: Apache-2.0
"""Report pages and the site in a real browser: accessible, in light and dark, without an error on the console."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_demo import complaints

from dermis.files import locked
from dermis.places import BUILD, ROOT
from dermis.processes import children
from scripts import website
from scripts.demo import browser, demo

REASON, COMPILER = browser.missing(), demo.have_compiler()
pytestmark = [pytest.mark.long, pytest.mark.skipif(bool(REASON), reason=str(REASON))]
SIZES = ((1280, 800), (800, 1000), (390, 844))

CUT = """
  // Text and controls that leave the window sideways, or the nearest ancestor that clips or has a border, except where
  // a reader can scroll to them.
  const found = [], edge = (style) => style.borderRightStyle !== "none" && parseFloat(style.borderRightWidth) > 0;
  const judge = (name, box, from) => {
    if (box.width < 2 || box.height < 2) return;
    for (let at = from; at; at = at.parentElement) {
      const style = getComputedStyle(at), outer = at.getBoundingClientRect();
      if (outer.width < 2 || style.position === "fixed") return;
      if (style.visibility === "hidden" || style.clipPath !== "none") return;
      if (style.display === "inline" || style.display === "contents") continue;
      if (/auto|scroll/.test(style.overflowX) && at.tabIndex >= 0 && at !== document.documentElement) return;
      const clips = style.overflowX !== "visible" || edge(style) || at === document.documentElement;
      if (clips && (box.right > outer.right + 1 || box.left < outer.left - 1))
        return found.push(`${name} in ${at.tagName}.${at.className}`);
    }
  };
  // Drawers that are shut lie beside the window.
  const shut = [...document.querySelectorAll("body *")].filter((e) => getComputedStyle(e).position === "fixed"
    && (e.getBoundingClientRect().right <= 0 || e.getBoundingClientRect().left >= innerWidth));
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_ELEMENT | NodeFilter.SHOW_TEXT);
  const range = document.createRange();
  for (let node; (node = walk.nextNode());) {
    if (shut.some((drawer) => drawer.contains(node))) continue;
    if (node.nodeType === 3 && node.textContent.trim() && !/SCRIPT|STYLE|OPTION/.test(node.parentElement.tagName)) {
      range.selectNodeContents(node);
      for (const box of range.getClientRects()) judge(node.textContent.trim().slice(0, 40), box, node.parentElement);
    } else if (/INPUT|SELECT|BUTTON|CANVAS|IMG|IFRAME/.test(node.tagName))
      judge(`${node.tagName} ${node.id}`, node.getBoundingClientRect(), node.parentElement);
  }
  const wide = document.documentElement.scrollWidth - innerWidth;
  return wide > 0 ? [`the page scrolls sideways by ${wide} px`, ...found] : found;"""


def cut(driver: Any, page: Path | None = None) -> list[str]:
    """Return what is wider than its place on the open page, or on `page`."""
    if page is not None:
        driver.get(page.as_uri())
    return driver.execute_script(CUT)


# Code in the site is smaller than its text, as the theme has it.
SITE_PX = 10


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with browser.session() as opened:
        yield opened


def errors(driver: Any) -> list[Any]:
    return [line for line in driver.get_log("browser") if line["level"] == "SEVERE"]


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("scene", [["two_fingers"], ["triangular_indenter", "--engine", "rtl"]])
def test_a_report_page_is_accessible(driver: Any, tmp_path: Path, scene: list[str], dark: bool) -> None:
    page = tmp_path / "page.html"
    command = [sys.executable, "-m", "dermis", "run", *scene, "--out", tmp_path / "run", "--html", page]
    children.run_logged(command, ROOT, tmp_path / "log", 120, "dermis run")
    drawn = "return document.querySelectorAll('.maps figure').length"
    for width, height in SIZES:
        browser.screen(driver, width, height, dark)
        driver.get(page.as_uri())
        driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert cut(driver) == [], width
        assert driver.execute_script(drawn) > 0
        assert errors(driver) == []
        assert complaints(driver, minimum_px=10) == [], width


@pytest.fixture(scope="module")
def site(testrun_uid: str) -> Path:
    """Build it once for all workers of a run."""
    with locked(BUILD / "site_tests.lock"):
        built = BUILD / "site_tests.run"
        if not built.exists() or built.read_text() != testrun_uid:
            website.build()
            built.write_text(testrun_uid)
    return BUILD / "site"


@pytest.mark.skipif(bool(COMPILER), reason=str(COMPILER))
def test_the_first_page_of_the_site_runs_the_chip(driver: Any, site: Path) -> None:
    browser.screen(driver, 1440, 1000, False)
    driver.get((site / "index.html").as_uri())
    driver.switch_to.frame(driver.find_element("tag name", "iframe"))
    browser.wait(driver, browser.READY)
    assert driver.execute_script("return demo.state().latest.good")
    driver.switch_to.default_content()
    assert errors(driver) == []
    assert complaints(driver, SITE_PX) == []


@pytest.mark.timeout(900)
def test_no_page_of_the_site_scrolls_sideways_or_cuts_text(driver: Any, site: Path) -> None:
    found = []
    for width, height in SIZES:
        browser.screen(driver, width, height, False)
        for page in sorted(site.rglob("*.html")):
            if page.name not in ("chip.html", "404.html"):  # the first is the demo
                found += [(page.stem, width, said) for said in (*cut(driver, page), *errors(driver))]
    assert found == []


@pytest.mark.skipif(bool(COMPILER), reason=str(COMPILER))
@pytest.mark.parametrize("fragment", ["", "#b=flat,15,9,5,7,8,30&row_ohm=10&noise=200&corrected=1"])
def test_the_demo_neither_scrolls_sideways_nor_cuts_text(driver: Any, fragment: str) -> None:
    page = demo.build()
    for width, height in SIZES:
        browser.screen(driver, width, height, False)
        browser.visit(driver, page, fragment)
        driver.execute_script("document.getElementById('player').hidden = false")
        assert cut(driver) == [], width


FAULTS = {
    "scroll": "<p style='white-space: nowrap'>{}</p>",
    "clip": "<div style='width: 9em; overflow: hidden'><p style='width: 40em'>{}</p></div>",
    "card": "<div style='width: 90px; border: 1px solid'><select style='width: 99px'></select></div>",
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_what_is_cut_is_found(driver: Any, tmp_path: Path, fault: str) -> None:
    page = tmp_path / "page.html"
    browser.screen(driver, 390, 844, False)
    whole = "<!doctype html><meta name='viewport' content='width=device-width'><p>whole</p>"
    page.write_text(whole)
    assert cut(driver, page) == []
    page.write_text(whole + fault.format("a line that is longer than a phone is wide, and more " * 2))
    assert cut(driver, page) != []


def test_a_keyboard_alone_reaches_what_scrolls_and_every_link(driver: Any, site: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    browser.screen(driver, 390, 844, False)
    driver.get((site / "datasheet.html").as_uri())
    wanted = """const all = "article a[href], article .md-typeset__scrollwrap, article pre > code";
      const wide = (e) => e.href || e.scrollWidth > e.clientWidth;
      return [...document.querySelectorAll(all)].filter((e) => e.checkVisibility() && wide(e))"""
    left = {e.id for e in driver.execute_script(wanted)}
    assert left
    for _ in range(400):
        ActionChains(driver).send_keys(Keys.TAB).perform()
        left.discard(driver.switch_to.active_element.id)
        if not left:
            return
    assert not left


@pytest.mark.timeout(900)
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_every_page_of_the_site_is_accessible(driver: Any, site: Path, dark: bool) -> None:
    found = []
    for page in sorted(site.rglob("*.html")):
        if page.name in ("chip.html", "404.html"):
            continue
        narrow = page.stem in ("index", "datasheet", "schematics", "ota")
        for width, height in SIZES if narrow else SIZES[:1]:
            browser.screen(driver, width, height, dark)
            driver.get(page.as_uri())
            shown = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
            assert (shown != "rgb(255, 255, 255)") == dark
            found += [(page.stem, width, said) for said in complaints(driver, SITE_PX)]
    assert found == []
