# SPDX-License-Identifier: Apache-2.0
"""A short run of every fuzzer, stored findings, and seeded faults; `make fuzz` is the long run."""

from __future__ import annotations

import os
import sys
import types
from pathlib import Path

import pytest
from hypothesis import strategies as st

from dermis import engines, plan
from dermis.chip import spi_protocol as spi
from dermis.errors import InputError
from dermis.scene import scene, schema, stimulus
from scripts import workers
from tb.programs.fuzz import command, oracle, runner
from tb.programs.fuzz.faults import FAULTS
from tb.reference import chip

QUICK = ("short_answer",)
"""Seeded faults of the default run; preparing other targets takes longer."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("name", "inputs"),
    [
        ("scene", 60),
        ("spi", 150),
        pytest.param("frames", 200, marks=pytest.mark.long),
        pytest.param("design", 100, marks=pytest.mark.long),
        pytest.param("command", 100, marks=pytest.mark.long),
        pytest.param("registers", 1000, marks=pytest.mark.long),
    ],
)
def test_a_short_run_finds_nothing(name: str, inputs: int) -> None:
    made = runner.alone(runner.fuzz, name, inputs, 7)
    assert made["found"] == {}
    assert made["inputs"] == inputs
    assert made["taken"]
    assert bool(made.get("refused")) == (name != "registers")


@pytest.mark.timeout(600)
def test_stored_findings_are_cured() -> None:
    files = [path for path in runner.FOUND.iterdir() if not path.name.startswith("registers")]
    assert len(files) > 10
    assert runner.alone(runner.replay, files) == []


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n not in QUICK)) for n in FAULTS]
)
def test_a_seeded_fault_is_seen(name: str) -> None:
    assert runner.alone(runner.fuzz, FAULTS[name].target, command.SEEDED_INPUTS, 0, name)["found"]


def test_a_finding_is_shrunk_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A target whose defect is any input with a "!"; the next run starts with it."""

    def run(data: bytes, place: Path) -> str:
        if b"!" in data:
            raise oracle.Finding("escape", "made.up", repr(data))
        return "taken"

    texts = st.text(alphabet="ab!", max_size=40).map(str.encode)
    target = types.SimpleNamespace(strategy=lambda: texts, prepare=lambda place: None, run=run)
    monkeypatch.setitem(sys.modules, "tb.programs.fuzz.target_made", target)
    monkeypatch.setattr(runner, "WORK", tmp_path)
    monkeypatch.setattr(runner, "FOUND", tmp_path)
    assert runner.fuzz("made", 200, 1)["found"] == {"escape made.up": "escape in made.up: b'!'"}
    [stored] = tmp_path.glob("made_escape_*")
    assert stored.read_bytes() == b"!"
    assert runner.replay([stored]) == [f"{stored.name}: escape in made.up: b'!'"]
    assert runner.fuzz("made", 1, 2, stored=True)["found"]


def test_faults_and_deaths_fail_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that dies is a finding with its last input; a seeded fault that nothing met is missed."""
    monkeypatch.setattr(command, "WORK", tmp_path)
    monkeypatch.setattr(runner, "FOUND", tmp_path)
    [dies], tally = command.tasks_of(("spi",), 10, 3, False, False), command.Tally()
    (tmp_path / "spi.30000.last").write_bytes(b"deadly")
    tally.add(dies, workers.Outcome(fault="crashed: SIGSEGV"))
    [stored] = tmp_path.glob("spi_crash_*")
    assert stored.read_bytes() == b"deadly"
    for fault in ("a", "b"):
        task = workers.Task(runner.fuzz, ("spi", 10, 3, fault, False))
        tally.add(task, workers.Outcome({"inputs": 10, "found": {"x": "y"} if fault == "a" else {}}))
    rows = {row["name"]: (row["value"], row["status"]) for row in tally.rows()}
    assert rows["fuzz.findings.spi"] == (1, "FAIL")
    assert rows["fuzz.seeded_faults_missed"] == (1, "FAIL")


def test_the_inputs_of_a_run_are_split_into_rounds() -> None:
    tasks = command.tasks_of(runner.NAMES, None, 0, True, True)
    assert sum(task.arguments[1] for task in tasks if not task.arguments[3]) >= 100_000
    assert max(task.arguments[1] for task in tasks if not task.arguments[3]) == command.ROUND
    assert {task.arguments[3] for task in tasks} == {"", *FAULTS}


def test_a_large_sheet_is_refused_without_solving_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """To name engines took over 100 s of processor time at 255 x 40; small sheets are still asked by value."""
    made = plan.make(scene.load(runner.FOUND / "scene_time_settling"))
    asked: list[str] = []
    monkeypatch.setattr(engines, "refuses", lambda plan, engine: asked.append(engine))
    with pytest.raises(InputError, match=r"engine event where its values allow it$"):
        engines.check(made)
    assert asked == []
    monkeypatch.setattr(engines, "_ASKED_CELLS", made.rows * made.cols)
    with pytest.raises(InputError, match=r"engine event$"):
        engines.check(made)
    assert asked == ["event"]


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ("a" + ".a" * 40 + " = 1\n", "line 1", "keys of fewer than 32 parts"),
        ("\n\n[" + " . ".join("x" * 40) + "]\n", "line 3", "keys of fewer than 32 parts"),
        ('title = "v' + ".1" * 20 + '"\n"" = 1\n', "scene", "unknown key"),
        ("x = " + "[" * 900 + "]" * 900 + "\n", None, ""),
    ],
)
def test_keys_that_no_scene_has_are_one_line(tmp_path: Path, text: str, key: str | None, said: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        scene.load(path)
    assert key is None or caught.value.key == key
    assert said in caught.value.allowed
    assert str(caught.value).isprintable()
    assert ": : " not in str(caught.value)


def test_a_file_takes_no_more_memory_than_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.csv"
    path.write_text("1,2\n")
    asked: list[int] = []
    real = os.stat(path).st_size

    class Counting:
        def __init__(self, file: Path, mode: str) -> None:
            self._stream = file.open(mode)

        def __enter__(self) -> Counting:
            return self

        def __exit__(self, *_: object) -> None:
            self._stream.close()

        def read(self, count: int) -> bytes:
            asked.append(count)
            return self._stream.read(count)

    monkeypatch.setattr(schema, "open", Counting, raising=False)
    assert schema.read_bytes(path, stimulus.FILE_BYTES_MAX) == b"1,2\n"
    assert asked == [real + 1]


def test_a_file_that_says_it_is_empty_is_not_read() -> None:
    """/proc/kmsg is a regular file of 0 bytes whose reading waits for the kernel to speak."""
    assert schema.read_bytes(Path("/proc/kmsg"), 1 << 20) == b""


@pytest.mark.parametrize("answer", [b"", b"\x00\x00", b"\xa5\xa5\xa5"])
def test_a_driver_that_gives_back_another_number_of_bytes_is_told(answer: bytes) -> None:
    with pytest.raises(spi.BadExchange, match=f"{len(answer)} bytes came back for"):
        spi.run(spi.read_register(3), lambda sent: answer)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: spi.write_command(256, 0), "address"),
        (lambda: spi.write_command(-1, 0), "address"),
        (lambda: spi.write_command(0, 1 << 16), "value"),
        (lambda: spi.read_command(1 << 40), "address"),
    ],
)
def test_a_command_of_numbers_that_do_not_fit_is_refused(call: object, name: str) -> None:
    with pytest.raises(InputError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.key == name


@pytest.mark.paper
def test_the_reference_model_follows_the_document() -> None:
    """The examples of docs/spi.md: SETTLE = 115 is written, GATE reads 510, an unknown command is E0 and counts."""
    write = bytes((chip.LOW,)) + b"".join(bytes((0, b)) for b in (*spi.write_command(4, 115), 0, 0))
    read = bytes((chip.HIGH, chip.LOW)) + b"".join(bytes((0, b)) for b in (3, 5, 0, 0, 0, 0, 0))
    wrong = bytes((chip.HIGH, chip.LOW, 0, 0x77, 0, 0))
    crc = spi.crc8((3, 5, 1, 0xFE))
    said = chip.answer(write + read + wrong)
    assert said == bytes((*[0] * 6, 0x5A, *[0] * 3, 0xA5, 1, 0xFE, crc, 0, 0xE0, 0, 1, 0, 0))


def test_what_an_oracle_lets_through(tmp_path: Path) -> None:
    """Each oracle alone, with a call that it must see and one that it must not."""

    def inside(path: Path) -> bool:
        return tmp_path in path.parents

    assert oracle.judge(lambda: (tmp_path / "x").write_text("x"), inside) == "taken"
    seen = {}
    calls = {
        "write": lambda: (tmp_path.parent / "beside").write_text("x"),
        "process": lambda: os.system("true"),
        "escape": lambda: {}["x"],
        "exit": lambda: (_ for _ in ()).throw(SystemExit(3)),
        "line": lambda: (_ for _ in ()).throw(InputError("file", "key", 1, "")),
    }
    for kind, call in calls.items():
        with pytest.raises(oracle.Finding) as found:
            oracle.judge(call, inside)
        seen[kind] = found.value.kind
    assert seen == {kind: kind for kind in calls}
    with pytest.raises(InputError) as caught:
        schema.read_toml(Path("/no/such/dermis/fuzz/file.toml"))
    assert oracle.place_of(caught.value) == "scene.schema.read_bytes"
    assert oracle.place_of(ValueError()) == "the package"
    assert not (tmp_path.parent / "beside").exists()
    with pytest.raises(oracle.Finding, match="time"):
        oracle.judge(_work, inside, cpu_s=0.05)
    with pytest.raises(oracle.Finding, match="caught"):
        oracle.judge(_swallows, inside)


def _work() -> None:
    while True:
        pass


def _swallows() -> None:
    try:
        os.mkdir("/no_such_place_of_a_fuzzer")
    except BaseException:  # what an oracle raises may be caught; it must be told all the same
        return
