# SPDX-License-Identifier: Apache-2.0
"""A short run of every fuzzer, stored findings, and seeded faults; `make fuzz` is the long run."""

import contextlib
import io
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dermis import engines, plan
from dermis.chip import spi_protocol as spi
from dermis.errors import DermisError, InputError
from dermis.scene import scene, schema
from scripts import workers
from tb.programs.fuzz import command, oracle


def alone(function: Callable[..., Any], *arguments: Any) -> Any:
    """Run one call in a process of its own."""
    command.WORK.mkdir(parents=True, exist_ok=True)
    [(_, outcome)] = workers.run([workers.Task(function, arguments, 550.0)], 1, fresh=True)
    assert not outcome.fault
    return outcome.value


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("name", "inputs"), [("scene", 60), pytest.param("frames", 200, marks=pytest.mark.long)]
)
def test_a_short_run_finds_nothing(name: str, inputs: int) -> None:
    made = alone(command.fuzz, name, inputs, 7)
    assert made["found"] == {}
    assert made["inputs"] == inputs
    assert made["taken"]
    assert made["refused"]


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", command.INPUTS)
def test_stored_findings_are_cured(name: str) -> None:
    assert list(command.FOUND.glob(f"{name}_*"))
    assert alone(command.replay, name)["found"] == {}


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n != "title_in_deck")) for n in command.FAULTS]
)
def test_a_seeded_fault_is_seen(name: str) -> None:
    assert alone(command.fuzz, command.FAULTS[name][0], command.SEEDED_INPUTS, 0, name)["found"]


def test_a_finding_is_shrunk_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A target whose defect is any input with a "!"; the next run starts with it."""

    def run(data: bytes, place: Path) -> str:
        if b"!" in data:
            raise oracle.Finding("escape", "made.up", repr(data))
        return "taken"

    texts = st.text(alphabet="ab!", max_size=40).map(str.encode)
    target = types.SimpleNamespace(strategy=lambda: texts, prepare=lambda place: None, run=run)
    monkeypatch.setitem(sys.modules, "tb.programs.fuzz.target_made", target)
    monkeypatch.setattr(command, "WORK", tmp_path)
    monkeypatch.setattr(command, "FOUND", tmp_path)
    assert command.fuzz("made", 200, 1)["found"] == {"escape made.up": "escape in made.up: b'!'"}
    [stored] = tmp_path.glob("made_escape_*")
    assert stored.read_bytes() == b"!"
    assert command.replay("made")["found"] == {stored.name: "escape in made.up: b'!'"}


def test_faults_and_deaths_fail_a_run() -> None:
    """A process that dies is a finding; a seeded fault that nothing met is missed."""
    tasks = [workers.Task(command.fuzz, ("scene", 10, 3, fault)) for fault in ("", "a", "b")]
    seen = [{"inputs": 10, "found": {"x": "y"} if fault else {}} for fault in (0, 1, 0)]
    outcomes = [workers.Outcome(fault="crashed: SIGSEGV"), *map(workers.Outcome, seen[1:])]
    rows = {row["name"]: (row["value"], row["status"]) for row in command.rows_of(tasks, outcomes)}
    assert rows["fuzz.findings.scene"] == (1, "FAIL")
    assert rows["fuzz.seeded_faults_missed"] == (1, "FAIL")


def test_a_large_sheet_is_refused_without_solving_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """To name engines took over 100 s of processor time at 255 x 40; small sheets are still asked by value."""
    made = plan.make(scene.load(command.FOUND / "scene_time_settling"))
    asked: list[str] = []
    monkeypatch.setattr(engines, "refuses", lambda plan, engine: asked.append(engine))
    with pytest.raises(InputError, match=r"engine event where its values allow it$"):
        engines.check(made)
    assert asked == []
    monkeypatch.setattr(engines, "_ASKED_CELLS", made.rows * made.cols)
    with pytest.raises(InputError, match=r"engine event$"):
        engines.check(made)
    assert asked == ["event"]


@pytest.mark.parametrize("out", [b"out_\xff", b"n" * 300])
def test_an_odd_name_of_out_is_written_or_refused_in_one_line(out: bytes, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dermis", "run", "single_touch", "--out", out]
    done = subprocess.run(command, capture_output=True, timeout=120, check=False, cwd=tmp_path)
    assert done.returncode == (2 if len(out) > 255 else 0), done.stderr
    said = [line for line in done.stderr.decode().splitlines() if not line.startswith("compiling once")]
    assert len(said) == (done.returncode == 2)
    assert "".join(said).isprintable()


def test_a_file_that_says_it_is_empty_is_not_read() -> None:
    """/proc/kmsg is a regular file of 0 bytes whose reading waits for the kernel to speak."""
    assert schema.read_bytes(Path("/proc/kmsg"), 1 << 20, ("made", "file", "made")) == b""


READ_OR_WRITE = (spi.read_frame, lambda: spi.read_register(3), lambda: spi.write_register(4, 115))


@given(st.binary(max_size=60), st.sampled_from(READ_OR_WRITE))
def test_any_answer_of_a_chip_is_read_or_refused_by_kind(answer: bytes, transaction: Any) -> None:
    left = io.BytesIO(answer)
    with contextlib.suppress(DermisError):  # whatever else it raises fails
        spi.run(transaction(), lambda sent: left.read(len(sent)).ljust(len(sent), b"\0"))


@pytest.mark.parametrize("answer", [b"", b"\x00\x00", b"\xa5\xa5\xa5"])
def test_a_driver_that_gives_back_another_number_of_bytes_is_told(answer: bytes) -> None:
    with pytest.raises(spi.BadExchange, match=f"{len(answer)} bytes came back for"):
        spi.run(spi.read_register(3), lambda sent: answer)


@pytest.mark.parametrize(
    ("command", "numbers", "key"),
    [
        (spi.write_command, (256, 0), "address"),
        (spi.write_command, (-1, 0), "address"),
        (spi.write_command, (0, 1 << 16), "value"),
        (spi.read_command, (1 << 40,), "address"),
    ],
)
def test_a_number_that_does_not_fit_a_command_is_refused(command: Any, numbers: Any, key: str) -> None:
    with pytest.raises(InputError) as caught:
        command(*numbers)
    assert caught.value.key == key


def test_what_an_oracle_lets_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each oracle alone, with a call that it must see and one that it must not."""
    monkeypatch.chdir(tmp_path)
    assert oracle.judge(lambda: None) == "taken"
    calls = {
        "write": lambda: Path("left").write_text("x"),
        "escape": lambda: {}["x"],
        "exit": lambda: sys.exit(3),
        "line": lambda: (_ for _ in ()).throw(InputError("file", "key", 1, "")),
        "time": _work,
    }
    for kind, call in calls.items():
        with pytest.raises(oracle.Finding) as found:
            oracle.judge(call, cpu_s=0.05)
        assert found.value.kind == kind
    with pytest.raises(InputError) as caught:
        schema.read_toml(Path("/no/such/dermis/fuzz/file.toml"))
    assert oracle.place_of(caught.value) == "scene.schema.read_bytes"
    assert oracle.place_of(ValueError()) == "the package"


def _work() -> None:
    while True:
        pass
