# SPDX-License-Identifier: Apache-2.0
"""The demo in a headless Chromium: a session, and the figures that `dermis demo --check` prints."""

import contextlib
import importlib.util
import shutil
import statistics
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dermis import engines, plan
from dermis.report import verdict
from dermis.scene.design import load as load_design

LIMIT_S = 60
"""Longest wait for a page or a script."""
READY = "!!(window.demo && demo.firstCode)"

# No network: the page needs none, and the browser must not look for updates.
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip


def missing() -> str | None:
    """Return the reason why no browser can be driven here, or None."""
    for package in ("selenium", "axe_playwright_python"):
        if importlib.util.find_spec(package) is None:
            return f"Python package {package.replace('_', '-')} is not installed (make demo installs it)"
    for program in ("chromium", "chromedriver"):
        if shutil.which(program) is None:
            return f"{program} is not installed (make demo ARGS=--check installs it)"
    return None


@contextlib.contextmanager
def session() -> Iterator[Any]:
    """Yield a WebDriver of a new Chromium; its files and processes end with the block."""
    from selenium import webdriver

    with tempfile.TemporaryDirectory(prefix="dermis_browser_") as scratch:
        options = webdriver.ChromeOptions()
        for flag in (*FLAGS, f"--user-data-dir={scratch}/profile", "--window-size=1440,1000"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        options.binary_location = shutil.which("chromium") or ""
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        driver = webdriver.Chrome(options=options, service=service)
        try:
            driver.set_page_load_timeout(LIMIT_S)
            driver.set_script_timeout(LIMIT_S)
            screen(driver, 1440, 1000, False)
            yield driver
        finally:
            driver.quit()


def screen(driver: Any, width: int, height: int, dark: bool) -> None:
    scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def visit(driver: Any, page: Path, fragment: str = "") -> None:
    """Open the page and wait for its first frame."""
    driver.get("about:blank")  # a change of the fragment alone would not load the page
    driver.get(page.resolve().as_uri() + fragment)
    wait(driver, READY)


def wait(driver: Any, condition: str) -> Any:
    """Wait until an expression of JavaScript is true; return its value."""
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(driver, LIMIT_S).until(lambda d: d.execute_script(f"return {condition}"))


def call(driver: Any, name: str, frames: int) -> Any:
    """Return the answer of a function of the page to a number of frames."""
    script = f"const done = arguments[1]; demo.{name}(arguments[0]).then(done)"
    return driver.execute_async_script(script, frames)


def wrong_codes(driver: Any, folder: Path, frames: int = 1) -> int:
    """Return the number of codes that differ between page and engine event for the saved scene."""
    scene = folder / "pressed.toml"
    scene.write_text(driver.execute_script("return demo.toml()"))
    answer = call(driver, "codes", frames)
    made = plan.load(scene, "event")
    codes = np.array(answer["codes"]).reshape(-1, made.rows, made.cols)[: made.frames]
    return int((codes != engines.run(made).codes[:frames]).sum()) + (0 if answer["good"] else codes.size)


def presses(count: int = 20, seed: int = 0) -> list[str]:
    """Return links of random scenes: one to three bodies, and effects in three out of four."""
    draw = np.random.default_rng(seed)
    shapes = ("spherical", "cylindrical", "triangular", "flat", "round")
    # Slider: highest value, step.
    sliders = {
        "row_ohm": (20, 0.1), "column_ohm": (20, 0.1), "lateral": (40, 1), "offset": (5, 0.05),
        "mismatch": (5, 0.1), "noise": (500, 5), "flicker": (2, 0.05),
    }  # fmt: skip
    links = []
    for _ in range(count):
        parts = []
        for _ in range(draw.integers(1, 4)):
            size = draw.integers(2, 25, 2) / 2
            place = draw.uniform(0, 15, 2).round(2)
            angle = draw.integers(0, 19) * 5
            force = draw.integers(1, 151) / 10
            parts.append(f"b={draw.choice(shapes)},{force},{size[0]},{size[1]},{place[0]},{place[1]},{angle}")
        for name, (most, step) in sliders.items():
            if draw.random() < 0.75:
                parts.append(f"{name}={round(draw.integers(1, most / step + 1) * step, 2)}")
        links.append("#" + "&".join([*parts, f"seed={draw.integers(0, 2**32)}"]))
    return links


def speed(driver: Any, clocks: int = 15_000_000) -> float:
    design = load_design()
    frames = max(5, clocks // (design.array.rows * design.timing.slot_clocks))
    call(driver, "bench", frames // 5)  # the browser has compiled everything by then
    return float(call(driver, "bench", frames))


def measure(page: Path) -> list[verdict.Row]:
    """Return the rows of the page in a browser, or one SKIP each with the reason."""
    names = ("demo.wrong_codes", "demo.frames_per_s", "demo.first_code_s")
    if reason := missing():
        return [verdict.skip(name, reason) for name in names]
    links = presses()
    with session() as driver, tempfile.TemporaryDirectory() as scratch:
        opened = []
        for _ in range(3):
            visit(driver, page)
            opened.append(float(driver.execute_script("return demo.firstCode / 1000")))
        rate = speed(driver)
        wrong = ramp_wrong(driver)
        for link in links:
            visit(driver, page, link)
            wrong += wrong_codes(driver, Path(scratch))
    note = f"256 codes against the formula, {len(links)} random presses with effects against engine event"
    return [
        verdict.judge("demo.wrong_codes", wrong, note),
        verdict.judge("demo.frames_per_s", rate, "by the clock, Chromium"),
        verdict.judge("demo.first_code_s", statistics.median(opened), "from opening the file, median of 3"),
    ]


def ramp_wrong(driver: Any) -> int:
    """Return the number of wrong codes where those of the resistances rise by one from taxel to taxel."""
    script = """
      const done = arguments[0], d = DESIGN, unit = d.v_bias_v / (d.k * d.i0_a);
      const meant = (i) => i % (d.code_max + 1);
      const ohm = Float64Array.from({length: d.rows * d.cols}, (_, i) => unit * d.gate_clocks / meant(i));
      (async () => {
        await demo.ask("recording", {frames: {ohm, count: 1}, playing: false});
        const {codes} = await demo.codes();
        await demo.ask("recording", {frames: null, playing: false});
        done(codes.filter((code, i) => code !== meant(i)).length);
      })();"""
    return int(driver.execute_async_script(script))
