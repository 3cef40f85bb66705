# SPDX-License-Identifier: Apache-2.0
"""A short run of every fuzzer, what they once found, and faults that they must see; `make fuzz` is the long run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from dermis import engines, plan
from dermis.chip import spi_protocol as spi
from dermis.engines import batch
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import scene, schema, stimulus
from tb.programs.fuzz import command, grammar, oracle, target, worker
from tb.programs.fuzz.faults import FAULTS
from tb.programs.fuzz.target import NAMES
from tb.reference import chip

QUICK = ("title_in_deck", "room_for_the_limit", "short_answer")
"""Faults that some of the first inputs meet; `make test LONG=1` and `make fuzz` take all."""


def test_a_short_run_of_every_parser_finds_nothing() -> None:
    inputs = {"scene": 100, "frames": 100, "spi": 400, "design": 30}
    told = command.short(inputs)
    assert {name: row.get("finding", "") for name, row in told.items()} == dict.fromkeys(inputs, "")
    assert all(sum(row.values()) == inputs[name] for name, row in told.items())
    assert all(row["refused"] for row in told.values())
    assert told["scene"]["taken"] > 10


def test_what_was_found_once_is_found_no_more() -> None:
    files = [path for path in command.FOUND.iterdir() if not path.name.startswith("registers")]
    assert len(files) > 10
    assert {path.name.split("_")[0] for path in files} <= set(NAMES)
    assert command.replay(files) == []


def test_seeded_faults_are_seen() -> None:
    told = command.seeded(list(QUICK))
    assert [name for name in QUICK if not told[name]["kind"]] == []


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_every_seeded_fault_is_seen() -> None:
    told = command.seeded(list(FAULTS))
    assert [name for name in FAULTS if not told[name]["kind"]] == []
    assert len(FAULTS) >= 10


@pytest.mark.long
def test_the_register_port_answers_as_its_model() -> None:
    assert command.short({"registers": 2000})["registers"] == {"taken": 2000, "refused": 0}


def test_the_place_of_a_finding_hangs_on_no_directory() -> None:
    """Neither where the clone lies nor a line number: by module and function."""
    with pytest.raises(InputError) as caught:
        schema.read_toml(Path("/no/such/dermis/fuzz/file.toml"))
    assert oracle.place_of(caught.value) == "scene.schema.read_bytes"
    assert oracle.place_of(ValueError()) == "the package"


def test_a_finding_is_made_small() -> None:
    wanted = b"needle"
    hay = b"line one\nsome needle in it\nline three\n" * 3
    assert worker.smaller(hay, lambda data: wanted in data, lambda: False) == wanted


def test_mutations_are_the_same_for_one_seed() -> None:
    import random

    one = target.load("scene")
    data = one.seeds()[0]
    assert [one.mutate(data, random.Random(n)) for n in range(50)] == [
        one.mutate(data, random.Random(n)) for n in range(50)
    ]
    assert len({one.mutate(data, random.Random(n)) for n in range(50)}) > 40
    assert max(len(one.mutate(data, random.Random(n))) for n in range(200)) <= grammar.SIZE_MAX


@pytest.mark.skipif(bool(command.missing()), reason=command.missing() or "never")
def test_the_state_of_a_run_is_taken_up_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "WORK", tmp_path / "work")
    monkeypatch.setattr(command, "FOUND", tmp_path / "found")
    monkeypatch.setattr(command, "ROUND", 30)
    counted: list[int] = []
    half = command.run_target("spi", 30, 0, counted.append)
    whole = command.run_target("spi", half.inputs + 1, 0, counted.append)
    assert half.inputs >= 30
    assert whole.inputs > half.inputs
    assert (whole.rounds, whole.crashes, whole.findings) == (2, 0, [])
    assert command._progress(command._kept("spi", 0)) == whole
    assert command._progress(command._kept("spi", 1)) == command.Progress()


def _with_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None, inputs: int, left: bytes = b""
) -> list[dict[str, int]]:
    """Put an end of our choice in the place of a worker's; what the workers were asked for."""
    monkeypatch.setattr(command, "WORK", tmp_path / "work")
    monkeypatch.setattr(command, "FOUND", tmp_path / "found")
    (tmp_path / "found").mkdir(exist_ok=True)
    asked: list[dict[str, int]] = []

    def ends(log: Path, limit_s: float, **more: Any) -> int | None:
        asked.append(more)
        log.write_text("the last words")
        if inputs:
            (log.parent / "counts").write_bytes(worker.COUNTS.pack(inputs, inputs, 0))
        if left:
            (log.parent / "found" / "crash-1").write_bytes(left)
        return code

    monkeypatch.setattr(command, "_worker", ends)
    return asked


def test_a_state_of_other_code_counts_for_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = _with_worker(tmp_path, monkeypatch, 0, 10)
    command.run_target("spi", 10, 0, int)
    command.run_target("spi", 10, 0, int)
    assert len(asked) == 1
    monkeypatch.setattr(batch, "fingerprint", lambda: "another")
    assert command.run_target("spi", 10, 0, int).inputs == 10
    assert len(asked) == 2


@pytest.mark.parametrize(("code", "said"), [(None, "was ended at 900 s"), (-9, "ended with exit code -9")])
def test_a_worker_that_dies_and_leaves_no_input_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None, said: str
) -> None:
    _with_worker(tmp_path, monkeypatch, code, 4)
    done = command.run_target("spi", 8, 0, int)
    rows = command.rows_of({"spi": done}, {"spi": 8}, {})
    row = next(row for row in rows if row["name"] == "fuzz.ends.spi")
    assert row["status"] == "ERROR"
    assert f"2 of 2 processes, the first: round 1 {said} after 4 inputs" in row["note"]
    assert verdict.exit_code(rows) == 1


def test_a_worker_that_dies_on_an_input_leaves_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _with_worker(tmp_path, monkeypatch, -11, 8, b"deadly")
    done = command.run_target("spi", 8, 0, int)
    assert (done.died, len(done.findings)) == ([], 1)
    assert [path.read_bytes() for path in (tmp_path / "found").iterdir()] == [b"deadly"]


def test_a_target_short_of_its_inputs_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = _with_worker(tmp_path, monkeypatch, 1, 1, b"deadly")
    done = command.run_target("spi", 1000, 0, int)
    assert len(asked) == command.RESTARTS + 1
    row = command.rows_of({"spi": done}, {"spi": 1000}, {})[0]
    assert (row["name"], row["value"], row["status"]) == ("fuzz.inputs.spi", len(asked), "FAIL")
    assert command.rows_of({"spi": done}, {"spi": len(asked)}, {})[0]["status"] == "PASS"


@pytest.mark.parametrize("part", [["--only", "spi"], ["--inputs", "5"], ["--no-faults"]])
def test_tables_of_a_part_are_not_written(part: list[str]) -> None:
    told = CliRunner().invoke(command.fuzz_command, ["--docs", *part])
    assert isinstance(told.exception, InputError)
    assert str(told.exception).startswith("command line: --docs = with --only")


def test_without_atheris_the_command_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command.importlib.util, "find_spec", lambda name: None)
    told = CliRunner().invoke(command.fuzz_command, [])
    assert isinstance(told.exception, InputError)
    assert "atheris is not installed" in str(told.exception)


def test_a_run_with_nothing_left_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = _with_worker(tmp_path, monkeypatch, 0, 3)
    monkeypatch.setattr(command, "cover", lambda name, done: None)
    monkeypatch.setattr(command, "missing", lambda: "")
    monkeypatch.setattr(verdict, "write_rows", lambda target, rows: None)
    arguments = ["--only", "spi", "--inputs", "3", "--no-faults"]
    first, second = (CliRunner().invoke(command.fuzz_command, arguments) for _ in range(2))
    assert "every input was run before on this code" not in first.output
    assert "every input was run before on this code" in second.output
    assert len(asked) == 1


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
def test_keys_that_no_scene_has_are_one_line(place: Path, text: str, key: str | None, said: str) -> None:
    path = place / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        scene.load(path)
    assert key is None or caught.value.key == key
    assert said in caught.value.allowed
    assert str(caught.value).isprintable()
    assert ": : " not in str(caught.value)


def test_a_file_takes_no_more_memory_than_it_has(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = place / "x.csv"
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


def test_the_reference_model_follows_the_document() -> None:
    """The examples of docs/spi.md: SETTLE = 115 is written, GATE reads 510, an unknown command is E0 and counts."""
    write = bytes((chip.LOW,)) + b"".join(bytes((0, b)) for b in (*spi.write_command(4, 115), 0, 0))
    read = bytes((chip.HIGH, chip.LOW)) + b"".join(bytes((0, b)) for b in (3, 5, 0, 0, 0, 0, 0))
    wrong = bytes((chip.HIGH, chip.LOW, 0, 0x77, 0, 0))
    crc = spi.crc8((3, 5, 1, 0xFE))
    said = chip.answer(write + read + wrong)
    assert said == bytes((*[0] * 6, 0x5A, *[0] * 3, 0xA5, 1, 0xFE, crc, 0, 0xE0, 0, 1, 0, 0))


def test_what_an_oracle_lets_through(place: Path) -> None:
    """Each oracle alone, with a call that it must see and one that it must not."""
    inside = oracle.inside(place)
    assert oracle.judge(lambda: (place / "x").write_text("x"), inside) == "taken"
    seen = {}
    calls = {
        "write": lambda: (place.parent / "beside").write_text("x"),
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
    assert not (place.parent / "beside").exists()
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
