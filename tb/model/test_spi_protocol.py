# SPDX-License-Identifier: Apache-2.0
"""Claims about the host's side of the SPI protocol."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_plans import refused

from dermis.chip import spi_protocol as spi
from dermis.chip.register_map import REGISTERS


def answering(answer: bytes) -> Callable[[bytes], bytes]:
    """An exchange that gives nothing during the command, then `answer`, then zeros."""
    left = bytearray(answer)
    commanded = False

    def exchange(data: bytes) -> bytes:
        nonlocal commanded
        if not commanded:
            commanded = True
            return bytes(len(data))
        got = bytes(left[: len(data)])
        del left[: len(data)]
        return got + bytes(len(data) - len(got))

    return exchange


def test_the_crcs_are_those_of_the_catalogue() -> None:
    assert spi.crc8(b"123456789") == 0xF4
    assert spi.crc16(b"123456789") == 0x29B1
    assert spi.crc16(b"123456789" + bytes((0x29, 0xB1))) == 0


@pytest.mark.parametrize("waits", [0, 1, 7])
def test_an_answer_is_found_behind_any_number_of_wait_bytes(waits: int) -> None:
    assert spi.run(spi.write_register(4, 115), answering(bytes(waits) + b"\x5a")) == waits
    good = b"\xa5\x12\x34" + bytes((spi.crc8((3, 9, 0x12, 0x34)),))
    assert spi.run(spi.read_register(9), answering(bytes(waits) + good)) == 0x1234


TOKENS = {
    0xE0: spi.UnknownCommand, 0xE1: spi.BadCommandCrc, 0xE2: spi.Busy, 0xE3: spi.NoSuchRegister, 0xFF: spi.BadToken,
    0xA5: spi.BadToken, 0x3C: spi.BadToken,
}  # fmt: skip


@pytest.mark.parametrize(("token", "error"), TOKENS.items())
def test_each_refusal_is_an_error_of_its_own(token: int, error: type[spi.SpiError]) -> None:
    with pytest.raises(error):
        spi.run(spi.write_register(4, 1), answering(bytes((0, token))))


@pytest.mark.parametrize(("early", "error"), [(0xA5, spi.UnknownCommand), (0x5A, spi.BadToken)])
def test_a_byte_during_the_command_is_no_answer_to_it(early: int, error: type[spi.SpiError]) -> None:
    with pytest.raises(error, match="during the command"):
        spi.run(spi.write_register(4, 1), lambda data: bytes(len(data) - 1) + bytes((early,)))


def test_a_damaged_answer_is_no_value() -> None:
    with pytest.raises(spi.BadAnswerCrc):
        spi.run(spi.read_register(9), answering(b"\xa5\x12\x34\x00"))
    # The right bytes of another register: the address is under the CRC.
    with pytest.raises(spi.BadAnswerCrc):
        spi.run(spi.read_register(8), answering(b"\xa5\x12\x34" + bytes((spi.crc8((3, 9, 0x12, 0x34)),))))


@st.composite
def frames(draw: st.DrawFn) -> spi.Frame:
    cols, code_bits = draw(st.integers(1, 20)), draw(st.integers(1, 16))
    slot = st.sampled_from([*range(128), *spi.SPECIAL_SLOTS])
    slots = draw(st.lists(slot, min_size=1, max_size=6, unique=True))
    seed = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return spi.Frame(
        number=draw(st.integers(0, 65535)),
        cols=cols,
        code_bits=code_bits,
        gate_clocks=draw(st.integers(0, 65535)),
        slots=tuple(sorted(slots, key=lambda s: (s not in spi.SPECIAL_SLOTS, s))),
        codes=seed.integers(0, 2**code_bits, (len(slots), cols)).astype(np.uint16),
        overflow=seed.random((len(slots), cols)) < 0.3,
        test=draw(st.booleans()),
        pedestal_mode=draw(st.integers(0, 2)),
        dark=draw(st.booleans()),
        fault=draw(st.booleans()),
    )


@given(frames())
def test_a_packed_frame_is_read_as_it_was(frame: spi.Frame) -> None:
    data = spi.pack_frame(frame)
    assert len(data) == spi.frame_bytes(len(frame.slots), frame.cols, frame.code_bits)
    got = spi.run(spi.read_frame(), answering(b"\x00\x3c" + len(data).to_bytes(2, "big") + data))
    for field in dataclasses.fields(spi.Frame):
        assert np.array_equal(getattr(got, field.name), getattr(frame, field.name)), field.name
    # Zeros keep a CRC of 0, and the chip sends them behind an answer: the length was corrupted.
    for more in range(1, 5):
        with pytest.raises(spi.FrameError):
            spi.parse_frame(data + bytes(more * spi.slot_bytes(frame.cols, frame.code_bits)))


@given(frames(), st.data())
def test_no_burst_of_errors_up_to_16_bits_passes(frame: spi.Frame, data: st.DataObject) -> None:
    packed = int.from_bytes(raw := spi.pack_frame(frame), "big")
    burst = data.draw(st.integers(1, 0xFFFF))
    place = data.draw(st.integers(0, 8 * len(raw) - burst.bit_length()))
    with pytest.raises(spi.BadFrameCrc):
        spi.parse_frame((packed ^ burst << place).to_bytes(len(raw), "big"))


def sealed(body: bytes) -> bytes:
    return body + spi.crc16(body).to_bytes(2, "big")


def test_what_is_no_frame_is_refused_by_kind() -> None:
    header = bytes((1, 0, 0, 1, 2, 8, 1, 0xFE))
    slot = bytes((3, 10, 20, 0))
    assert spi.parse_frame(sealed(header + slot)).slot(3).tolist() == [10, 20]
    with pytest.raises(spi.EmptyFrame):
        spi.parse_frame(b"")
    for length in ((header + slot)[:-1], header, header + slot + b"\x04", b"\x01"):
        with pytest.raises(spi.BadFrameLength):
            spi.parse_frame(sealed(length))
    wrong = [
        b"\x02" + header[1:] + slot,  # another format
        bytes((1, 0x20)) + header[2:] + slot,  # a flag there is not
        header[:4] + b"\x00" + header[5:] + slot,  # no columns
        header[:5] + b"\x11" + header[6:] + slot,  # 17 bits
        header + bytes((0x80, 10, 20, 0)),  # a slot there is not
        header + slot + slot,  # a row twice
        header + slot + bytes((2, 10, 20, 0)),  # rows out of order
        header + slot + bytes((spi.SLOT_DARK, 10, 20, 0)),  # a special slot after a row
        header
        + bytes((spi.SLOT_FULL_EVEN, 10, 20, 0, spi.SLOT_DARK, 10, 20, 0)),  # special slots out of order
        header + bytes((3, 10, 20, 4)),  # overflow of a third column
        header[:5] + b"\x04" + header[6:] + slot,  # codes above 4 bits
    ]
    for body in wrong:
        with pytest.raises(spi.BadFrameFormat):
            spi.parse_frame(sealed(body))
    with pytest.raises(KeyError):
        spi.parse_frame(sealed(header + slot)).slot(4)


# ---- rows of interest


def looked_at(policy: spi.RowsOfInterest, touched: set[int]) -> set[int]:
    """Return the rows of the next frame, after one with a code of 8 in the touched rows that it has."""
    slots = np.flatnonzero(policy.mask)
    codes = np.zeros((slots.size, 3), np.uint8)
    codes[np.isin(slots, list(touched)), 1] = 8
    return set(np.flatnonzero(policy.next(slots, codes)).tolist())


def test_touched_rows_and_their_neighbours_are_looked_at_and_all_in_every_nth_frame() -> None:
    policy = spi.RowsOfInterest(16, every=4)
    every = set(range(16))
    # Row 11 is touched in frame 1, which does not have it, and seen after the whole frame.
    found = [looked_at(policy, touched) for touched in ({0, 5}, {0, 5, 11}, {5, 11}, {5, 11}, {5, 11}, set())]
    assert found[:3] == [{0, 1, 4, 5, 6}, {0, 1, 4, 5, 6}, {4, 5, 6}]
    assert found[3:5] == [every, {4, 5, 6, 10, 11, 12}]
    assert found[5] == {r for r in every if (r + 6) % 3 == 0}


@pytest.mark.parametrize("late", [1, 2, 3])
@pytest.mark.parametrize("every", [8, 15, 16])
def test_a_touch_once_seen_is_not_lost_however_late_a_mask_acts(late: int, every: int) -> None:
    policy = spi.RowsOfInterest(16, every=every)
    masks, seen, missed = [policy.mask] * late, False, 0
    for frame in range(240):
        slots = np.flatnonzero(masks[frame])
        codes = np.where((slots == 0) | ((slots == 10) & (frame >= 40)), 50, 0)[:, None]
        masks.append(policy.next(slots, codes))
        seen |= frame >= 40 and 10 in slots
        missed += seen and 10 not in slots
    assert seen
    assert missed < late


def test_codes_below_the_threshold_and_slots_that_are_no_rows_do_not_count() -> None:
    policy = spi.RowsOfInterest(4, threshold=8)
    frame = np.array([[7, 7], [255, 255], [0, 8]])
    assert policy.next((0, spi.SLOT_DARK, 3), frame).tolist() == [False, False, True, True]
    newtons = spi.RowsOfInterest(4, threshold=0.5)
    assert newtons.next((0, 1, 2, 3), [[0.6], [0.4], [0.0], [0.0]]).tolist() == [True, True, False, False]


@pytest.mark.parametrize("rows", [1, 16, 20, 128])
def test_the_words_are_those_of_the_register(rows: int) -> None:
    assert spi.RowsOfInterest(rows).words == REGISTERS["ROW_MASK"].words(rows, 16, 8)


@given(st.integers(1, 128), st.integers(0, 130), st.integers(1, 20), st.integers(0, 99))
def test_no_mask_is_empty_and_no_row_waits_longer_than_the_whole_frame(
    rows: int, neighbours: int, every: int, seed: int
) -> None:
    rng, policy = np.random.default_rng(seed), spi.RowsOfInterest(rows, 8, neighbours, every)
    left = np.zeros(rows, int)
    for _ in range(3 * every):
        slots = np.flatnonzero(policy.mask)
        left = np.where(policy.mask, 0, left + 1)
        policy.next(slots, (rng.random((slots.size, 2)) < 0.1 / rows) * 9)
        assert policy.mask.any()
        assert left.max() < every
        words = policy.words
        assert [words[r // 16] >> r % 16 & 1 for r in range(rows)] == policy.mask.tolist()
        assert len(words) == (rows + 15) // 16
        assert sum(word.bit_count() for word in words) == policy.mask.sum()


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: spi.RowsOfInterest(0), "rows = 0: a whole number 1..128"),
        (lambda: spi.RowsOfInterest(200), "rows = 200: a whole number 1..128"),
        (lambda: spi.RowsOfInterest(True), "rows = True: a whole number 1..128"),
        (lambda: spi.RowsOfInterest(2, math.nan), "threshold = nan: a number"),
        (lambda: spi.RowsOfInterest(2).next((-1,), [[9]]), "slots = [-1]: rows below 2"),
        (lambda: spi.RowsOfInterest(2).next((0.9,), [[9]]), "slots = [0.9]: rows below 2"),
        (lambda: spi.RowsOfInterest(2).next((2,), [[9]]), "slots = [2]: rows below 2"),
        (lambda: spi.RowsOfInterest(16, neighbours=-1), "neighbours = -1: a whole number 0.."),
        (lambda: spi.RowsOfInterest(16, every=0.5), "every = 0.5: a whole number 1.."),
        (lambda: spi.RowsOfInterest(2).next((0, 1), [1, 2]), "codes = shape (2,): [2, cols]"),
        (lambda: spi.RowsOfInterest(2).next((0,), [[1], [2]]), "codes = shape (2, 1): [1, cols]"),
    ],
)
def test_what_rows_of_interest_cannot_take_is_one_line(call: Callable[[], object], said: str) -> None:
    assert said in str(refused(call))


def test_no_bit_of_an_opcode_makes_a_write_of_a_read() -> None:
    """The byte that follows a read is not the CRC that a write to the same register would need."""
    registers = [r for r in REGISTERS.values() if r.writable]
    writable = {r.address + n for r in registers for n in range(len(r.words(128, 128, 16)))}
    (fill,) = spi.FILL
    assert not [a for a in writable if spi.crc8((spi.OP_WRITE, a, fill, fill)) == fill]
    assert [a for a in writable if spi.crc8((spi.OP_WRITE, a, 0, 0)) == 0]
