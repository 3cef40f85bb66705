# SPDX-License-Identifier: Apache-2.0
"""A short run of every fuzzer, what they once found, and faults that they must see; `make fuzz` is the long run."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from dermis import scene, schema, stimulus
from dermis import spi_protocol as spi
from dermis.errors import InputError
from dermis.fuzz import command, grammar, oracle, register_model, target, worker
from dermis.fuzz.faults import FAULTS
from dermis.fuzz.target import NAMES

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
    assert oracle.place_of(caught.value) == "schema.read_bytes"
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


def test_the_state_of_a_run_is_taken_up_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "WORK", tmp_path)
    monkeypatch.setattr(command, "ROUND", 30)
    counted: list[int] = []
    half = command.run_target("spi", 30, 0, counted.append)
    whole = command.run_target("spi", half.inputs + 1, 0, counted.append)
    assert half.inputs >= 30
    assert whole.inputs > half.inputs
    assert (whole.rounds, whole.crashes, whole.findings) == (2, 0, [])
    assert json.loads((tmp_path / "spi" / "state.json").read_text())["progress"]["inputs"] == whole.inputs
    assert command._load("spi", 1) == command.Progress()


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
    write = bytes((register_model.LOW,)) + b"".join(bytes((0, b)) for b in (*spi.write_command(4, 115), 0, 0))
    read = bytes((register_model.HIGH, register_model.LOW)) + b"".join(
        bytes((0, b)) for b in (3, 5, 0, 0, 0, 0, 0)
    )
    wrong = bytes((register_model.HIGH, register_model.LOW, 0, 0x77, 0, 0))
    crc = spi.crc8((3, 5, 1, 0xFE))
    said = register_model.answer(write + read + wrong)
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
