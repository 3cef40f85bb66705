# SPDX-License-Identifier: Apache-2.0
"""The demo page in a real browser: its codes against the package, its controls, its files, its looks."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scripts.demo import browser, demo

REASON = browser.missing() or demo.have_compiler()
pytestmark = [pytest.mark.long, pytest.mark.skipif(bool(REASON), reason=str(REASON))]

SLIDERS = ("row_ohm", "column_ohm", "lateral", "offset", "mismatch", "noise", "flicker")


@pytest.fixture(scope="module")
def page() -> Path:
    return demo.build()


@pytest.fixture(scope="module")
def driver(page: Path) -> Iterator[Any]:
    with browser.session() as opened:
        yield opened


@pytest.fixture
def fresh(driver: Any, page: Path) -> Iterator[Any]:
    """The page as it opens; no test may leave an error on the console."""
    browser.visit(driver, page)
    yield driver
    assert driver.get_log("browser") == []


def by_id(driver: Any, name: str) -> Any:
    return driver.find_element("id", name)


def slide(driver: Any, name: str, value: float) -> None:
    script = "const s = document.getElementById(arguments[0]); s.value = arguments[1];"
    driver.execute_script(script + "s.dispatchEvent(new Event('input'))", name, value)


def wait(driver: Any, condition: str) -> Any:
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(driver, 20).until(lambda d: d.execute_script(f"return {condition}"))


def drop(driver: Any, path: Path, unit: str = "newtons") -> None:
    slide(driver, "unit", 0)
    driver.execute_script("document.getElementById('unit').value = arguments[0]", unit)
    by_id(driver, "file").send_keys(str(path))


def test_page_is_one_small_file_that_asks_nothing_of_a_network(page: Path) -> None:
    text = page.read_text()
    assert len(text.encode()) <= 300_000
    assert not re.findall(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//|@import|url\(""", text)


def test_every_code_is_read_as_itself(fresh: Any) -> None:
    assert browser.ramp_wrong(fresh) == 0


def test_saved_scenes_have_the_codes_of_engine_event(fresh: Any, page: Path, tmp_path: Path) -> None:
    for link in browser.presses(4, seed=3):
        browser.visit(fresh, page, link)
        assert browser.wrong_codes(fresh, tmp_path) == 0, link


def test_a_wrong_model_would_be_seen(fresh: Any, tmp_path: Path) -> None:
    """The comparison fails where the page and the scene differ."""
    slide(fresh, "row_ohm", 10)
    fresh.execute_script(
        "const right = demo.toml; demo.toml = () => right().replace('r_ohm = 10', 'r_ohm = 9')"
    )
    assert browser.wrong_codes(fresh, tmp_path) > 0


def test_every_slider_moves_codes_and_stands_in_scene_and_link(fresh: Any, tmp_path: Path) -> None:
    script = "const done = arguments[0]; demo.codes().then((a) => done(a.codes))"
    slide(fresh, "force", 14)
    for name in SLIDERS:
        if name == "lateral":  # carries a current only between columns at different voltages
            slide(fresh, "column_ohm", 20)
        before = fresh.execute_async_script(script)
        slide(fresh, name, {"flicker": 2, "noise": 500, "lateral": 30}.get(name, 5))
        assert fresh.execute_async_script(script) != before, name
        assert name in fresh.execute_script("return location.hash")
        assert browser.wrong_codes(fresh, tmp_path) == 0, name


def test_correction_puts_droop_back(fresh: Any) -> None:
    slide(fresh, "force", 12)
    slide(fresh, "row_ohm", 10)
    slide(fresh, "column_ohm", 5)
    slide(fresh, "lateral", 30)
    slide(fresh, "offset", 1)
    slide(fresh, "mismatch", 3)
    error = "Number.parseFloat(document.getElementById('error').textContent)"
    wait(fresh, f"{error} > 0.5")
    by_id(fresh, "corrected").click()
    assert wait(fresh, f"{error} < 0.3")


def test_pointer_presses_where_it_is(fresh: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    sheet = by_id(fresh, "sheet")
    cell = sheet.size["width"] / 16
    ActionChains(fresh).move_to_element_with_offset(sheet, -5.5 * cell, 4.5 * cell).click().perform()
    wait(fresh, "demo.toml().includes('center_col = 2')")
    text = fresh.execute_script("return demo.toml()")
    row, col = (float(re.search(rf"center_{axis} = ([\d.]+)", text)[1]) for axis in ("row", "col"))
    # A press snaps to a tenth of a taxel.
    assert (row, col) == pytest.approx((12, 2), abs=0.1)
    wait(fresh, "demo.state().latest.codes[12 * 16 + 2] > 100")


def test_two_fingers_press_two_places(fresh: Any) -> None:
    box = fresh.execute_script(
        "const s = document.getElementById('sheet'); s.scrollIntoView(); return s.getBoundingClientRect()"
    )
    cell = box["width"] / 16
    places = [(2, 3), (12, 13)]  # row, column
    points = [
        {"x": box["x"] + (col + 0.5) * cell, "y": box["y"] + (row + 0.5) * cell, "id": finger}
        for finger, (row, col) in enumerate(places)
    ]
    by_id(fresh, "keep").click()  # a lifted finger then ends its press
    fresh.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": points})
    codes = "demo.state().latest.codes"
    wait(fresh, " && ".join(f"{codes}[{row * 16 + col}] > 50" for row, col in places))
    fresh.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": points[1:]})
    (row, col), (lifted_row, lifted_col) = places
    wait(fresh, f"{codes}[{row * 16 + col}] > 50 && {codes}[{lifted_row * 16 + lifted_col}] === 0")
    fresh.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait(fresh, f"{codes}.every((code) => code === 0)")


def test_keyboard_alone_is_enough(fresh: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    seen = set()
    for _ in range(70):
        ActionChains(fresh).send_keys(Keys.TAB).perform()
        seen.add(
            fresh.execute_script("const e = document.activeElement; return e.id || e.name || e.dataset.step")
        )
    assert {
        "sheet",
        "shape",
        "force",
        "keep",
        "corrected",
        "mode",
        "shown",
        "clock",
        "link",
        "toml",
        "file",
        *SLIDERS,
    } <= seen
    by_id(fresh, "sheet").send_keys(Keys.ENTER)
    wait(fresh, "demo.state().latest.codes.every((code) => code === 0)")
    by_id(fresh, "sheet").send_keys(Keys.ENTER, Keys.ARROW_UP, Keys.ARROW_UP, "+")
    wait(fresh, "demo.toml().includes('center_row = 5') && demo.toml().includes('force_n = 9.5')")
    wait(fresh, "demo.state().latest.codes[5 * 16 + 8] > 100")


def test_steps_and_speeds(fresh: Any) -> None:
    clocks = "return demo.state().clocks"
    press = "document.querySelector('[data-step=' + arguments[0] + ']').click()"
    fresh.execute_script(press, "clock")
    wait(fresh, "document.getElementById('rate').textContent === 'paused'")
    for step, length in (("clock", 1), ("row", 625)):
        before = fresh.execute_script(clocks)
        fresh.execute_script(press, step)
        wait(fresh, f"demo.state().clocks === {before + length}")
    frame = fresh.execute_script("return demo.state().latest.number")
    fresh.execute_script(press, "frame")
    wait(fresh, f"demo.state().latest.number === {frame + 1}")
    before = fresh.execute_script(clocks)
    fresh.execute_script("document.querySelector('input[value=slow]').click()")
    assert wait(fresh, f"demo.state().clocks > {before + 20}")
    fresh.execute_script("document.querySelector('input[value=fast]').click()")
    assert wait(fresh, "demo.state().rate > 50")


def test_recordings_of_csv_and_npy_are_played(fresh: Any, tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    codes = draw.integers(0, 256, (3, 16, 16))
    np.savetxt(tmp_path / "codes.csv", codes.reshape(3, -1), fmt="%d", delimiter=",")
    np.save(tmp_path / "newtons.npy", draw.uniform(0, 14, (3, 16, 16)).astype(np.float32))
    drop(fresh, tmp_path / "codes.csv", "codes")
    wait(fresh, "demo.toml().includes('codes.csv')")
    assert browser.wrong_codes(fresh, tmp_path, 3) == 0
    answer = fresh.execute_async_script("const done = arguments[0]; demo.codes(3).then((a) => done(a.codes))")
    assert (np.array(answer).reshape(3, 16, 16) == codes).all()
    by_id(fresh, "close").click()
    drop(fresh, tmp_path / "newtons.npy")
    wait(fresh, "demo.toml().includes('newtons.npy')")
    slide(fresh, "row_ohm", 3)
    assert browser.wrong_codes(fresh, tmp_path, 3) == 0
    by_id(fresh, "close").click()
    wait(fresh, "demo.state().frame === -1")


def test_a_dropped_recording_is_played(fresh: Any) -> None:
    fresh.execute_script(
        """
        const files = new DataTransfer();
        files.items.add(new File([Array(256).fill(7).join() + "\\n"], "dropped.csv"));
        const drop = {dataTransfer: files, bubbles: true, cancelable: true};
        document.getElementById("unit").value = "codes";
        for (const kind of ["dragover", "drop"]) document.body.dispatchEvent(new DragEvent(kind, drop));"""
    )
    wait(fresh, "demo.toml().includes('dropped.csv')")
    wait(fresh, "demo.state().latest.codes.every((code) => code === 7)")


BAD_FILES = {
    "short.csv": (b"1,2,3\n", "line 1 has 3 values"),
    "words.csv": (b",".join([b"1"] * 15 + [b"one"]), '"one" is not a number'),
    "half.csv": (b",".join([b"1"] * 16) + b"\n", "no whole frames"),
    "minus.csv": (b",".join([b"-1"] * 256), "row 0, column 0 is -1"),
    "noise.npy": (bytes(range(200)), "not what numpy.save writes"),
    "picture.png": (b"\x89PNG", "a csv or npy file is wanted"),
}


def test_bad_files_are_refused_in_one_line(fresh: Any, tmp_path: Path) -> None:
    for name, (content, said) in BAD_FILES.items():
        (tmp_path / name).write_bytes(content)
        drop(fresh, tmp_path / name)
        wait(fresh, f"document.getElementById('alert').textContent.includes('{name}')")
        text = by_id(fresh, "alert").text
        assert said in text
        assert "\n" not in text
        assert not by_id(fresh, "player").is_displayed()


def test_a_bad_link_is_refused_and_leaves_the_page_alive(fresh: Any, page: Path) -> None:
    browser.visit(fresh, page, "#b=cube,1,2&row_ohm=x")
    assert "no scene" in by_id(fresh, "alert").text
    assert fresh.execute_script("return demo.state().latest.good")


def test_spi_bytes_are_shown_with_their_crc(fresh: Any) -> None:
    text = by_id(fresh, "bytes").text
    shown = [int(byte, 16) for byte in re.findall(r"\b[0-9A-F]{2}\b", re.sub(r"[a-z,:-]+\S*", " ", text))]
    assert shown[:3] == [0xA5, 0x01, 0x3A]
    assert re.fullmatch(r"frame \d+: CRC [0-9A-F]{4} is right", by_id(fresh, "verdict").text)


def test_every_screen_is_legible(fresh: Any, page: Path) -> None:
    try:
        for width, height, dark in ((390, 844, False), (820, 1180, True), (1440, 1000, True)):
            browser.screen(fresh, width, height, dark)
            browser.visit(fresh, page)
            assert fresh.execute_script("return document.documentElement.scrollWidth") <= width
            assert browser.complaints(fresh) == []
    finally:
        browser.screen(fresh, 1440, 1000, False)


def test_the_accessibility_checker_detects_faults(fresh: Any) -> None:
    fresh.execute_script(
        "document.querySelector('h2').style.color = '#ddd'; document.querySelector('label[for=force]').remove()"
    )
    assert {text.split(":")[0] for text in browser.complaints(fresh)} == {"color-contrast", "label"}


def test_twenty_presses_and_speed(page: Path) -> None:
    rows = {row["name"]: row for row in browser.measure(page)}
    assert rows["demo.wrong_codes"]["value"] == 0
    assert all(row["status"] in ("PASS", "SKIP") for row in rows.values()), json.dumps(rows, indent=1)
