# SPDX-License-Identifier: Apache-2.0
"""Settings and fixtures of all tests: numpy raises on invalid operations; scenes and pressure frames."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from dermis.scene import design

PAPER = {
    "array.rows": 16,
    "array.cols": 16,
    "sensor.force_max_n": 15.0,
    "sensor.r_min_ohm": 500.0,
    "interface.v_bias_v": 0.5,
    "interface.k": 80,
    "converter.i0_a": 25e-6,
    "converter.c_int_f": 5e-12,
    "converter.f_clk_hz": 5e6,
    "timing.frame_s": 2e-3,
    "timing.gate_clocks": 510,
    "timing.code_bits": 8,
}
"""Design values that the numbers of tests with the mark `paper` belong to."""


def pytest_configure() -> None:
    """Let children of tests take Ctrl-C where the tests run in the background: a shell ignores SIGINT for them."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.set_threshold(100_000, 20)  # by default it takes a tenth of the time of numba's compiler


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests of the paper's values where models/design.toml holds another design."""
    stored = design.load().stored()
    if unlike := [f"{key} = {stored[key]!r}" for key, value in PAPER.items() if stored[key] != value]:
        for item in items:
            if item.get_closest_marker("paper"):
                item.add_marker(pytest.mark.skip(reason=f"values of the paper; here {unlike[0]}"))
    gc.freeze()  # modules and tests live until the end: nothing to look at again and again


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Let a loaded worker end: execnet sends it SIGINT if it takes 5 s after its last test (`_terminate_execution`)."""
    if hasattr(session.config, "workerinput"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.fixture(autouse=True)
def _strict_numbers() -> Iterator[None]:
    """Every invalid, overflowing or zero-dividing operation of numpy that is not meant raises."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield


@pytest.fixture
def write_scene(tmp_path: Path) -> Callable[..., Path]:
    """Write a scene file and the files beside it; returns its path."""

    def write(text: str, **files: str | bytes) -> Path:
        for name, content in files.items():
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / name.replace("__", ".")).write_bytes(data)
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def gait_csv(tmp_path: Path) -> Path:
    """205 real pressure frames where they are at hand, else two made ones of the same kind."""
    data = Path(os.environ.get("DERMIS_DATA", design.ROOT.parent / "shared" / "data"))
    if (real := data / "fscan_gait_16x16.csv").is_file():
        return real
    made = tmp_path / "frames_made.csv"
    frames = [[(7 * i + 3 * f) % 256 for i in range(256)] for f in range(2)]
    made.write_text("".join(",".join(map(str, frame)) + "\n" for frame in frames))
    return made
