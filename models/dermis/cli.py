# SPDX-License-Identifier: Apache-2.0
"""The command line: parses, calls, and turns every end into its exit code."""

import contextlib
import errno
import functools
import importlib
import os
import shutil
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from pathlib import Path
from typing import Any

import click

from dermis import __version__
from dermis.errors import DermisError, InputError, SimulatorError, counted, one_line
from dermis.places import BUILD, ROOT
from dermis.processes import children

# Commands of the package that are imported only when they are called, so that each starts quickly.
LATER = {
    "calibrate": ("dermis.report.calibrate", "Fit a calibration to test currents, loads and load cycles."),
    "report": ("dermis.report.html", "Collect the tables and runs of build/ into pages, with an index."),
    "read": ("dermis.report.read", "Read a recording: forces with intervals, of codes or through the chip."),
    "ablate": ("dermis.report.ablate", "Measure the cost of each effect of a scene, in codes and time."),
    "plan": ("dermis.report.plan_table", "Show the effects of a scene, and which of them change codes."),
}
PROGRAMS = ROOT / "scripts" / "commands.toml"
"""Commands of the checkout, which an installed package does not have."""


@functools.cache
def elsewhere() -> dict[str, tuple[str, str]]:
    """Return module and help line of every command that this module does not define."""
    if not PROGRAMS.is_file():
        return LATER
    programs = tomllib.loads(PROGRAMS.read_text(encoding="utf-8"))
    return LATER | {name: (entry["module"], entry["help"]) for name, entry in programs.items()}


NO_TABLE = ("docs", "plan", "report")
"""Commands that write no verdict table."""
FULL_BYTES = 1 << 16
"""A disk with less free space counts as full."""


def with_page(name: str, command: click.Command) -> click.Command:
    """Give a command the option --html, which writes its verdict tables and runs as a page."""
    call = command.callback
    if call is None or any(parameter.name == "html" for parameter in command.params):
        return command
    option = click.Option(
        ["--html"],
        type=click.Path(dir_okay=False, path_type=Path),
        help="Also write a report page to this file.",
    )

    @functools.wraps(call)
    def callback(*args: Any, html: Path | None = None, **options: Any) -> Any:
        if html is None:
            return call(*args, **options)
        from dermis.report import html as pages

        return pages.reporting(name, html, lambda: call(*args, **options))

    command.params.append(option)
    command.callback = callback
    return command


class Commands(click.Group):
    """A group with further commands: `<name>_command` of the modules in `elsewhere`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *elsewhere()])

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in elsewhere():
            command = super().get_command(ctx, name)
        else:
            module = importlib.import_module(elsewhere()[name][0])
            command = getattr(module, f"{name.replace('-', '_')}_command")
        return command if command is None or name in NO_TABLE else with_page(name, command)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands elsewhere without importing them."""
        own = {name: command.get_short_help_str(90) for name, command in self.commands.items()}
        rows = own | {name: text for name, (_, text) in elsewhere().items()}
        with formatter.section("Commands"):
            formatter.write_dl(sorted(rows.items()))


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="dermis")
def cli() -> None:
    """Simulator and tools of a readout chip for resistive artificial skin."""


@cli.command()
@click.argument("scene")
@click.option(
    "--engine",
    help="closed, event, rtl or cosim; default: the scene's, or the cheapest with all its effects.",
)
@click.option("--out", type=click.Path(), help="Directory for results; default build/run/SCENE.")
@click.option(
    "--processes",
    type=click.IntRange(1, 1024),
    default=1,
    show_default=True,
    help="Parallel processes, which share the frames.",
)
@click.option(
    "--simulator",
    type=click.Choice(["icarus", "verilator"]),
    help="Verilog simulator of rtl and cosim; default: verilator for rtl, icarus for cosim.",
)
@click.option(
    "--waves",
    is_flag=True,
    help="Also write waves.vcd, waves.gtkw and transient.png of the first frames, at most 4 (cosim only).",
)
@click.option(
    "--views",
    type=click.Choice(["behavioural", "sky130"]),
    help="SPICE blocks as models or transistors (cosim only; docs/views.md); default: the scene's.",
)
@click.option(
    "--check",
    type=click.IntRange(1),
    metavar="TAXELS",
    help="Also run this number of taxels, in whole frames, in another engine, and compare with it and a straight line.",
)
def run(
    scene: str,
    engine: str | None,
    out: str | None,
    processes: int,
    simulator: str | None,
    waves: bool,
    views: str | None,
    check: int | None,
) -> int:
    """Simulate one scene: a path, or the name of a file in models/scenes."""
    from dermis import engines, plan
    from dermis.engines import batch
    from dermis.processes import cpu_time
    from dermis.report import comparison, figures, output, plan_table, progress, verdict
    from dermis.scene import scene as scenes

    path = scenes.find(scene)
    world = scenes.load(path)
    made = plan.make(scenes.with_views(world, views) if views else world, engine)
    engines.check(made)
    if made.scene.table.effects.auto is not None:
        plan_table.print_plan(made)
    target: str | Path = BUILD / "run" / path.stem if out is None else out
    for option, given, able in (("--simulator", simulator, ("rtl", "cosim")), ("--waves", waves, ("cosim",))):
        if given and made.engine not in able:
            raise InputError("command line", option, made.engine, f"engine {' or '.join(able)}")
    options: dict[str, Any] = {"simulator": simulator} if simulator else {}
    options |= {"record": True} if waves else {}
    with output.place(target) as where:
        start, begin = time.perf_counter(), cpu_time.cpu_used_s()
        with progress.slots(path.stem, made.frames * made.rows) as on_slots:
            result = batch.run(made, on_slots, processes=processes, **options)
        info = result.info
        info["cpu_seconds"] = cpu_time.cpu_used_s() - begin
        info["seconds"] = time.perf_counter() - start
        rows = []
        if check is not None:
            begin = cpu_time.cpu_used_s()
            rows += comparison.first_frames(made, result, path.stem, check)
            info["check_cpu_s"] = cpu_time.cpu_used_s() - begin
        full = int((result.codes >= made.timing.code_max).sum())
        rows.append(verdict.report(f"run.taxels_at_full_scale.{path.stem}", full, "taxels"))
        if "check_cpu_s" in info:
            note = f"processor time; the run itself took {info['cpu_seconds']:.3g} s"
            rows.append(verdict.report(f"run.check_cpu_s.{path.stem}", info["check_cpu_s"], "s", note))

        def draw(directory: Path) -> None:
            fit = comparison.fit_residual(made, result.codes)
            figures.frame_figure(made, result.codes, fit, directory / "frame.png")
            if waves:
                from dermis.report import waves as wave_files

                wave_files.write(directory, made, result)
                figures.transient_figure(made, result, directory / "transient.png")

        # The table first: if it cannot be written, earlier results stay.
        verdict.write_rows("run", rows)
        output.write(where, made, result, rows, draw)
    if "filter" in info:
        plan_table.print_filter(made, info["filter"])
    elif "masked" in info:
        plan_table.print_rows(info["masked"])
    elif made.on and made.engine in ("closed", "event"):
        plan_table.print_answer(made)
    title = one_line(made.scene.table.title) or path.stem
    verdict.print_rows(rows, f"{title} ({made.engine}, {counted(made.frames, 'frame')})")
    click.echo(f"codes, figure, summary and the resolved scene are in {one_line(str(where), 400)}")
    return verdict.exit_code(rows)


def main() -> None:
    """Run the command line and exit: 0 done, 1 check missed, 2 wrong input, 3 simulator failed."""
    # Matrices are small: a second thread of OpenBLAS takes ten times the time. numpy reads this.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Place of YoWASP's compiled Yosys, made by set-up; the default is the home directory.
    os.environ.setdefault("YOWASP_CACHE_DIR", str(Path(sys.prefix) / "share" / "yowasp"))
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    with children.ending():
        code = _run()
    # After a Ctrl-C inside exec of a string (as in a dataclass), Python ends by SIGINT, not with the
    # exit code, even if the exception was caught. Another exec clears this.
    exec("")
    try:
        sys.stdout.flush()
    except OSError as error:
        # Python would try to write again at its end, with a traceback.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        if not isinstance(error, BrokenPipeError):
            _say(f"standard output: {error.strerror}")
            code = 3
    sys.exit(code)


def _run() -> int:
    """Run the command; return its exit code, with a line on standard error from 2 on."""
    try:
        code = cli(standalone_mode=False)
        return code if isinstance(code, int) else 0
    except DermisError as error:
        _say(str(error) + _without_room(error))
        return error.exit_code
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.ClickException as error:
        _say(f"command line: {one_line(error.format_message(), 400)} (see --help)")
        return 2
    except (KeyboardInterrupt, click.Abort):
        _say("interrupted")
        return 130
    except children.Terminated as error:
        _say("terminated")
        return int(error.code)
    except SystemExit as error:  # from a command
        return error.code if isinstance(error.code, int) else 1 if error.code else 0
    except BrokenPipeError:
        return 1
    except MemoryError as error:
        said = one_line(str(error))
        _say(f"out of memory{f' ({said})' if said else ''}: use fewer frames or fewer processes")
        return 3
    except OSError as error:
        if error.errno is None:
            return _defect(error)
        where = error.filename or "a file or a process of this run"
        hint = next((hint for numbers, hint in _HINTS.items() if error.errno in numbers), "")
        _say(f"{where}: {error.strerror}{hint}{_traceback()}")
        return 3
    except Exception as error:  # any other exception is a defect
        return _defect(error)


_HINTS = {
    (errno.ENOSPC, errno.EDQUOT): ": free some space, or name another disk by --out or TMPDIR",
    (errno.EFBIG,): ": above the file size that ulimit -f or the file system allows",
    (errno.EACCES, errno.EPERM, errno.EROFS): ": give this user access, or use another place",
    (errno.EMFILE, errno.ENFILE): ": more open files than ulimit -n allows",
    (errno.EAGAIN, errno.ENOMEM): ": above the processes or memory that this user may have",
}
"""Remedies for errors of the system."""


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # standard error itself is closed, or full
        click.echo(line, err=True)


def _without_room(error: DermisError) -> str:
    """Return a note if a disk is full: a simulator that fails for this reason does not say so."""
    places = {BUILD, Path(tempfile.gettempdir())}
    if isinstance(error, SimulatorError):
        for place in places:
            with contextlib.suppress(OSError):  # the place does not exist
                if shutil.disk_usage(place).free < FULL_BYTES:
                    return f"; no room is left in {place}"
    return ""


def _traceback() -> str:
    """Write the traceback of the current exception to a log; return a note with its path."""
    log = BUILD / "internal_error.log"
    try:
        log.parent.mkdir(exist_ok=True)
        log.write_text(traceback.format_exc())
    except OSError:  # the error itself may be a full disk
        return ""
    return f" (log: {log})"


def _defect(error: Exception) -> int:
    _say(f"dermis has a defect: {type(error).__name__}: {one_line(str(error))}{_traceback()}")
    return 3
