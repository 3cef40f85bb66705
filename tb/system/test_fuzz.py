# SPDX-License-Identifier: Apache-2.0
"""A short run of every fuzzer, stored findings, and seeded faults; `make fuzz` is the long run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from dermis import engines, plan
from dermis.chip import spi_protocol as spi
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import scene, schema, stimulus
from scripts import workers
from scripts.checkpoint import Checkpoint
from tb.programs.fuzz import command, oracle, session, target
from tb.programs.fuzz.faults import FAULTS
from tb.reference import chip

QUICK = ("short_answer",)
"""Seeded faults of the default run; preparing other targets takes longer."""


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
def test_a_short_run_finds_nothing(tmp_path: Path, name: str, inputs: int) -> None:
    piece = command.alone(session.fuzz, name, inputs, 7, str(tmp_path / "last"))
    assert piece["found"] == []
    counts = piece["counts"]
    assert counts["inputs"] == inputs
    assert counts["taken"]
    assert bool(counts.get("refused")) == (name != "registers")


def test_stored_findings_are_cured() -> None:
    files = [str(path) for path in command.FOUND.iterdir() if not path.name.startswith("registers")]
    assert len(files) > 10
    assert command.alone(session.replay, files) == []


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n not in QUICK)) for n in FAULTS]
)
def test_a_seeded_fault_is_seen(name: str) -> None:
    seen = command.alone(session.seeded, name, command.SEEDED_INPUTS, 0)
    assert seen["kind"] in FAULTS[name].kinds, seen


def test_the_place_of_a_finding_has_no_directory_and_no_line_number() -> None:
    with pytest.raises(InputError) as caught:
        schema.read_toml(Path("/no/such/dermis/fuzz/file.toml"))
    assert oracle.place_of(caught.value) == "scene.schema.read_bytes"
    assert oracle.place_of(ValueError()) == "the package"


class _Made:
    """A target whose defect is any input with a "!"."""

    @staticmethod
    def load(name: str) -> target.Target:
        from hypothesis import strategies as st

        def run(data: bytes, place: Path) -> str:
            if b"!" in data:
                raise oracle.Finding("escape", "made.up", repr(data))
            return "taken"

        texts = st.text(alphabet="ab!", max_size=40).map(str.encode)
        return target.Target(lambda: texts, lambda place: None, run, ())


def test_a_finding_is_shrunk_and_the_round_runs_all_its_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session.target, "load", _Made.load)
    monkeypatch.setattr(oracle, "limit_memory", lambda *_: None)
    piece = session.fuzz("made", 200, 1, str(tmp_path / "last"))
    assert [one["data"] for one in piece["found"]] == ["!"]
    assert piece["counts"]["inputs"] == 200
    again = session.fuzz("made", 200, 1, str(tmp_path / "last"))
    assert again["found"] == piece["found"]
    assert again["counts"]["taken"] == piece["counts"]["taken"]


def _workers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **fails: str) -> list[str]:
    """Replace the worker processes; return the list of names that they are asked for."""
    monkeypatch.setattr(command, "WORK", tmp_path)
    monkeypatch.setattr(command, "FOUND", tmp_path / "found")
    monkeypatch.setattr(verdict, "write_rows", lambda target, rows: None)
    asked: list[str] = []

    def run(tasks: Any, count: int, fresh: bool = False) -> Any:
        for number, task in enumerate(tasks):
            asked.append(task.function.__name__)
            fault = fails.get(task.arguments[0], "") if task.function is session.fuzz else ""
            value: Any = [3, 4]
            if task.function is session.fuzz:
                Path(task.arguments[3]).write_bytes(b"deadly")
                value = {"counts": {"inputs": task.arguments[1], "taken": 1, "seconds": 1}, "found": []}
            yield number, workers.Outcome(None if fault else value, fault)

    monkeypatch.setattr(workers, "run", run)
    return asked


def _run(*words: str) -> tuple[int, str]:
    told = CliRunner().invoke(command.fuzz_command, words, standalone_mode=False)
    return told.return_value, told.output


def test_a_run_continues_and_other_code_starts_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = _workers(monkeypatch, tmp_path)
    words = ("--only", "spi", "--inputs", "4001", "--no-faults")
    code, said = _run(*words)
    assert (code, asked.count("fuzz")) == (0, 3)
    assert "every input ran before" not in said
    assert "every input ran before" in _run(*words)[1]
    assert asked.count("fuzz") == 3
    monkeypatch.setattr(command, "stamp", lambda *folders: "another")
    _run(*words)
    assert asked.count("fuzz") == 6


def test_a_process_that_dies_leaves_its_last_input_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _workers(monkeypatch, tmp_path, spi="crashed: SIGSEGV")
    code, said = _run("--only", "spi", "--inputs", "10", "--no-faults")
    assert code == 1
    assert "crash of spi.0.10" in " ".join(said.split())
    assert [path.read_bytes() for path in (tmp_path / "found").iterdir()] == [b"deadly"]
    wanted, pieces = {"spi": 10}, Checkpoint(tmp_path / "none", "").pieces
    rows = {r["name"]: r["status"] for r in command.rows_of(wanted, pieces, {"spi.1.10": "hangs"}, {})}
    assert (rows["fuzz.ends.spi"], rows["fuzz.inputs.spi"]) == ("ERROR", "FAIL")


def test_an_unseen_fault_fails() -> None:
    seen = {"a": {"kind": "line", "inputs": 1}, "b": {"kind": "", "inputs": 9}}
    row = command.rows_of({}, {}, {}, seen)[-1]
    assert (row["name"], row["value"], row["status"]) == ("fuzz.seeded_faults_missed", 1, "FAIL")


@pytest.mark.parametrize("part", [["--only", "spi"], ["--inputs", "5"], ["--no-faults"]])
def test_tables_of_a_part_are_not_written(part: list[str]) -> None:
    told = CliRunner().invoke(command.fuzz_command, ["--docs", *part])
    assert isinstance(told.exception, InputError)
    assert str(told.exception).startswith("command line: --docs = with --only")


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
    inside = oracle.inside(tmp_path)
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
    assert not (tmp_path.parent / "beside").exists()
    with pytest.raises(oracle.Finding, match="time"):
        oracle.judge(
            _work,
            inside,
            cpu_s=0.05,
        )
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
