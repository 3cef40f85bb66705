# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_top through its pins; test_top.py has their claims."""

import random
from itertools import pairwise
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import RisingEdge, Timer, ValueChange
from cocotb.utils import get_sim_time
from rtl_bench import report, scenario
from spi_client import Pins
from top_bench import CLOCK_PS, Chip, Levels, RegisterModel, reset_values

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi

CONTINUOUS, SHOT, TEST = rm.CONTROL_CONTINUOUS_MASK, rm.CONTROL_SHOT_MASK, rm.CONTROL_TEST_MASK
DARK, PER_COLUMN = rm.CONTROL_DARK_MASK, rm.CONTROL_RANGE_PER_COLUMN_MASK
READY, FAULT, TEST_DONE = rm.STATUS_FRAME_READY_MASK, rm.STATUS_FAULT_MASK, rm.STATUS_TEST_DONE_MASK
TEST_CUT = rm.STATUS_TEST_CUT_MASK


def pedestal_mode(mode: int) -> int:
    """CONTROL bits of a pedestal mode."""
    return mode << rm.CONTROL_PEDESTAL_MODE_SHIFT


def own_pattern(frame: int, row: int) -> int:
    """Levels that tell frames and rows apart."""
    return (frame * 0x9E3779B1 ^ (row + 1) * 0x85EBCA6B) >> 7


async def start(
    dut: Any, levels: Levels = own_pattern, ratio: int = 1, enable: bool = True
) -> tuple[dict[str, Any], Chip, Pins]:
    """Power up; return the scenario, the chip, with charge balance if there is an x, and a host with SCK at
    `ratio` times clk.
    """
    s = scenario()
    chip = Chip(dut, s["parameters"], levels, s.get("x"))
    host = Pins(dut, chip.clock_ps // ratio)
    await chip.reset(enable)
    return s, chip, host


async def wait_ready(chip: Chip, limit_clocks: float) -> None:
    """Wait for a new frame."""
    for _ in range(int(limit_clocks / 2)):
        if int(chip.dut.frame_ready_o.value):
            return
        await chip.clocks(2)
    raise AssertionError(f"no frame within {limit_clocks} clocks")


def same(frame: bytes, expected: spi.Frame) -> None:
    """A burst is, byte by byte, the frame it must be."""
    wanted = spi.pack_frame(expected)
    assert frame == wanted, f"got  {frame.hex(' ')}\nwant {wanted.hex(' ')}"


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def client(dut: Any) -> None:
    """Identity, every register and frames of charge-balance columns."""
    s, chip, host = await start(dut, enable=False)
    p, gate, host.period_ps = s["parameters"], s["gate"], round(1e12 / s["sck_hz"])
    for address, value in (
        (rm.ID, 0xDE01),
        (rm.GEOMETRY, p["ROWS"] << 8 | p["COLS"]),
        (rm.FORMAT, 1 << 9 | p.get("SYNC_LATCH", 0) << 8 | chip.code_bits),
    ):
        assert await host.read(address) == value
    await host.write(rm.GATE, gate)
    await host.write(rm.SETTLE, 6)
    dut.enable_i.value = 1
    for number in range(1, s["frames"] + 1):
        await wait_ready(chip, 2 * p["ROWS"] * (gate + 6) + 200)
        data = await host.frame_bytes()
        same(data, chip.expected(number, gate))
        frame = spi.parse_frame(data)
    report({"codes": frame.codes.tolist(), "overflow": frame.overflow.tolist()})


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def configuration(dut: Any) -> None:
    """Settle, gate, mask, dark slot, pedestals, range, single shot: times measured, codes exact."""
    s, chip, host = await start(dut)
    rows, cols = chip.rows, chip.cols
    gate, settle = (s["parameters"][name] for name in ("GATE_CLOCKS", "SETTLE_CLOCKS"))

    async def frame_clocks() -> float:
        """Return the clocks from frame to frame, of the second frame from now."""
        await chip.starts(2)
        begun = get_sim_time("ps")
        await RisingEdge(dut.frame_start_o)
        return (get_sim_time("ps") - begun) / chip.clock_ps

    async def frame(**expected: Any) -> None:
        """Check the next frame that begins after now."""
        number = chip.frame + 1
        while True:
            await wait_ready(chip, 4000)
            data = await host.frame_bytes()
            if (got := spi.parse_frame(data).number) >= number:
                same(data, chip.expected(got, **expected))
                return

    two, pedestals = {"gate": 50, "row_mask": 0b0101}, [3 * c for c in range(cols)]
    # Break and two clocks are the shortest settle; a gate of 600 passes full scale.
    for writes, clocks, holds in (
        ([], rows * (settle + gate), {"gate": gate}),
        ([(rm.GATE, 50), (rm.SETTLE, 20)], rows * 70, {"gate": 50}),
        ([(rm.SETTLE, 0)], rows * 53, {"gate": 50}),
        ([(rm.ROW_MASK, 0b0101)], 2 * 53, two),
        ([(rm.CONTROL, CONTINUOUS | DARK)], 3 * 53, two | {"dark": True}),
        (
            [
                *((rm.PEDESTAL + c, pedestal) for c, pedestal in enumerate(pedestals)),
                (rm.CONTROL, CONTINUOUS | pedestal_mode(1)),
            ],
            2 * 53,
            two | {"pedestal_mode": 1, "pedestals": pedestals},
        ),
        (
            [(rm.CONTROL, CONTINUOUS | DARK | pedestal_mode(2))],
            3 * 53,
            two | {"dark": True, "pedestal_mode": 2},
        ),
        ([(rm.CONTROL, CONTINUOUS), (rm.GATE, 600)], 2 * 603, two | {"gate": 600}),
    ):
        for address, value in writes:
            await host.write(address, value)
        assert await frame_clocks() == clocks
        await frame(**holds)

    # Range: all columns alike, then each its own; with the start of a frame.
    words = [0x1B4E >> n & ((1 << 2 * min(8, cols - 8 * n)) - 1) for n in range((cols + 7) // 8)]
    each = [(rm.RANGE_COLUMN + n, word) for n, word in enumerate(words)]
    for writes, pins in (
        ([(rm.GATE, 50)], int("10" * cols, 2)),
        ([(rm.RANGE, 1)], int("01" * cols, 2)),
        ([*each, (rm.CONTROL, CONTINUOUS | PER_COLUMN)], sum(w << 16 * n for n, w in enumerate(words))),
        ([(address, 0) for address, _ in each], 0),
    ):
        for address, value in writes:
            await host.write(address, value)
        await frame_clocks()
        assert int(dut.range_o.value) == pins

    # Single shots: one frame each, and none by itself.
    await host.write(rm.CONTROL, 0)
    await host.write(rm.ROW_MASK, (1 << rows) - 1)
    await chip.clocks(rows * 60 + 200)
    await host.frame_bytes()
    begun = chip.frame
    await chip.clocks(rows * 100)
    assert chip.frame == begun
    assert not int(dut.frame_ready_o.value)
    for _ in range(2):
        await host.write(rm.CONTROL, SHOT)
        await wait_ready(chip, rows * 60 + 100)
        begun += 1
        assert (chip.frame, await host.read(rm.FRAME_NUMBER)) == (begun, begun)
        same(await host.frame_bytes(), chip.expected(begun, gate=50))
        assert not await host.read(rm.STATUS) & READY
        await chip.clocks(rows * 100)
        assert chip.frame == begun
    report("done")


async def shot(chip: Chip, host: Pins, control: int) -> spi.Frame:
    """One frame, read when it is there."""
    if int(chip.dut.frame_ready_o.value):
        await host.frame()
    await host.write(rm.CONTROL, control)
    if not int(chip.dut.frame_ready_o.value):
        await RisingEdge(chip.dut.frame_ready_o)
    return await host.frame()


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def self_test(dut: Any) -> None:
    """Report the faults that a self-test finds in each faulty array; check its injected pulses at each rate."""
    s, chip, host = await start(dut, ratio=8)
    # Full scale is 31.
    for address, value in ((rm.CONTROL, 0), (rm.GATE, 62), (rm.DARK_MAX, 2), (rm.FULL_MIN, 28)):
        await host.write(address, value)
    await chip.clocks(2 * chip.rows * (s["parameters"]["GATE_CLOCKS"] + s["parameters"]["SETTLE_CLOCKS"]))

    async def found(**faults: list[Any]) -> dict[str, list[int]]:
        chip.set_faults(**faults)
        frame = await shot(chip, host, TEST)
        assert frame.test
        assert frame.slots[:4] == spi.SPECIAL_SLOTS
        kinds = "row", "inject", "dark", "full"
        masks = {n: await host.read(getattr(rm, f"{n.upper()}_FAULT")) for n in kinds}
        assert await host.read(rm.STATUS) & (TEST_DONE | FAULT) == TEST_DONE | FAULT * any(masks.values())
        injected = min(await host.read(rm.TEST_COUNT), 255)
        assert masks["inject"] == sum((n != injected) << c for c, n in enumerate(frame.slot(spi.SLOT_INJECT)))
        return {n: [k for k in range(16) if mask >> k & 1] for n, mask in masks.items() if mask}

    seen = [await found(**faults) for faults in s["faults"]]
    gate = 250
    await host.write(rm.GATE, gate)
    for rate in s["rates"]:
        await host.write(rm.TEST_RATE, rate)
        assert await found() == {}
        # A pulse either way, and half of one for the clocks on the way in.
        assert abs(await host.read(rm.TEST_COUNT) - rate * gate / 65536) <= 1.5, rate
    report(seen)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def lengths(dut: Any) -> None:
    """The longest and the shortest slots, each row by itself, and enable falling in the middle of a slot."""
    s, chip, host = await start(dut, levels=lambda _frame, _row: -1)
    longest = s["longest"]
    await host.write(rm.CONTROL, 0)
    await chip.clocks(2 * chip.rows * 70)
    each = [(6, 60, 1 << row) for row in range(chip.rows)]
    for settle, gate, mask in ((longest, longest, 0b10), (0, 0, (1 << chip.rows) - 1), *each):
        for address, value in ((rm.SETTLE, settle), (rm.GATE, gate), (rm.ROW_MASK, mask)):
            await host.write(address, value)
        frame = await shot(chip, host, SHOT)
        count = (max(gate, 1) + 1) // 2
        assert frame.gate_clocks == max(gate, 1)
        assert sum(1 << row for row in frame.slots) == mask
        assert (frame.codes == min(count, 255)).all()
        assert (frame.overflow == (count > 255)).all()
    await host.write(rm.CONTROL, CONTINUOUS)
    await RisingEdge(dut.frame_start_o)
    await chip.clocks(20)
    assert int(dut.row_select_o.value)
    dut.enable_i.value = 0
    await chip.clocks(4)
    assert (int(dut.row_select_o.value), int(dut.preset_o.value)) == (0, 1)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def size(dut: Any) -> None:
    """Geometry, the end of each list of registers, a whole frame, and one of a self-test: the longest."""
    s, chip, host = await start(dut, ratio=8)
    p = s["parameters"]
    assert await host.read(rm.GEOMETRY) == chip.rows << 8 | chip.cols
    form = p["BREAK_CLOCKS"] << rm.FORMAT_BREAK_CLOCKS_SHIFT | chip.code_bits
    assert await host.read(rm.FORMAT) == form
    model = RegisterModel(chip.rows, chip.cols, chip.code_bits, reset_values(p))
    for register in rm.REGISTERS.values():
        last = register.address + len(register.words(chip.rows, chip.cols, chip.code_bits)) - 1
        for address in {last, min(last + 1, 255)}:
            try:
                got = await host.read(address)
            except spi.NoSuchRegister:
                got = None
            assert (got is not None) == model.exists(address), f"{address:02X}"
            assert got == model.values.get(address, got), f"{address:02X}"
    # Long frames are read once: the third from here began after the write.
    await host.write(rm.PEDESTAL + chip.cols - 1, 5)
    await host.write(rm.CONTROL, CONTINUOUS | pedestal_mode(1))
    begun = chip.frame
    await chip.starts(3)
    data = await host.frame_bytes()
    number = spi.parse_frame(data).number
    assert number > begun
    pedestals = [0] * (chip.cols - 1) + [5]
    same(data, chip.expected(number, p["GATE_CLOCKS"], pedestal_mode=1, pedestals=pedestals))
    await host.write(rm.CONTROL, TEST)
    while not (frame := spi.parse_frame(await host.frame_bytes())).test:
        pass
    assert len(frame.slots) == chip.rows + 4


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def ratios(dut: Any) -> None:
    """Registers and frames at each ratio of SCK to clk; how many wait bytes come."""
    s, chip, host = await start(dut)
    gate, rng = 20, random.Random(5)
    waits: list[dict[str, Any]] = []
    for ratio in s["ratios"]:
        host.period_ps = round(chip.clock_ps / ratio) // 2 * 2
        await chip.clocks(10)
        seen: dict[str, list[int]] = {"write": [], "read": [], "frame": []}
        for _ in range(s["repeats"]):
            await Timer(rng.randrange(1, chip.clock_ps), "ps")
            value = rng.getrandbits(16)
            seen["write"].append(await host.write(rm.TEST_RATE, value))
            await Timer(rng.randrange(1, chip.clock_ps), "ps")
            assert await host.read(rm.TEST_RATE) == value
            seen["read"].append(len(host.received) - 2 - 4)
        await host.write(rm.GATE, gate)
        await host.write(rm.CONTROL, CONTINUOUS)
        await chip.starts(2)
        last = 0
        for _ in range(s["frames"]):
            await wait_ready(chip, 10_000)
            data = await host.frame_bytes()
            number = spi.parse_frame(data).number
            assert number > last, f"frame {number} behind {last} at ratio {ratio}"
            last = number
            same(data, chip.expected(number, gate=gate))
            seen["frame"].append(len(host.received) - 1 - 3 - len(data))
        waits.append({"ratio": ratio} | {name: [min(n), max(n)] for name, n in seen.items()})
    report(waits)


@cocotb.test(timeout_time=20, timeout_unit="sec")
async def traffic(dut: Any) -> None:
    """Random SPI traffic, most of it wrong, while frames run."""
    s, chip, host = await start(dut)
    p, rng = s["parameters"], random.Random(s["seed"])
    model = RegisterModel(chip.rows, chip.cols, chip.code_bits, reset_values(p))
    # Settings of a frame, which writes leave unchanged, so that every frame can be predicted.
    fixed = {rm.CONTROL, rm.SETTLE, rm.GATE, rm.ROW_MASK, *range(rm.PEDESTAL, 256)}
    free = sorted(set(model.values) - fixed)
    done = dict.fromkeys(("write", "refused", "read", "frame", "crc", "cut", "opcode", "stop", "bounce"), 0)
    gate = p["GATE_CLOCKS"]
    last_frame = 0

    async def check_frame() -> None:
        nonlocal last_frame
        data = await host.frame_bytes()
        if data:
            number = spi.parse_frame(data).number
            assert number >= last_frame, f"frame {number} behind {last_frame}"
            last_frame = number
            same(data, chip.expected(number, gate=gate))

    async def patiently(make: Any) -> Any:
        """Busy means that a request of a transaction that was cut is still crossing: ask again."""
        for _ in range(50):
            try:
                return await host.run(make())
            # Asked again, fifty times at most.
            except spi.Busy:
                continue
        raise AssertionError("busy for ever")

    async def write(address: int, value: int) -> bool:
        try:
            await patiently(lambda: spi.write_register(address, value))
        except spi.NoSuchRegister:
            return False
        return True

    for step in range(s["transactions"]):
        if step % 16 == 0:
            host.period_ps = round(chip.clock_ps * 10 ** rng.uniform(-1, s["slowest"])) // 2 * 2
        kind = rng.choices(list(done), s["weights"])[0]
        done[kind] += 1
        if kind == "write":
            address, value = rng.choice(free), rng.getrandbits(16)
            assert await write(address, value)
            assert model.write(address, value)
        elif kind == "refused":
            address = rng.choice([a for a in range(256) if a not in model.values])
            assert not await write(address, rng.getrandbits(16))
        elif kind == "read":
            address = rng.choice(sorted(model.values))
            got = await patiently(lambda a=address: spi.read_register(a))
            assert got == model.values[address], f"{address:02X}: {got:04X}, not {model.values[address]:04X}"
        elif kind == "frame":
            await check_frame()
        elif kind == "crc":
            command = bytearray(spi.write_command(rng.choice(sorted(model.values)), rng.getrandbits(16)))
            command[rng.randrange(1, 5)] ^= 1 << rng.randrange(8)
            await host.select()
            await host.exchange(bytes(command))
            assert await host.exchange(bytes(2)) == bytes((spi.TOKEN_CRC, 0))
            await host.deselect()
        elif kind == "cut":
            # Any command, broken off within any byte; a write stops before its CRC is whole.
            command = rng.choice(
                (
                    spi.write_command(rng.choice(sorted(model.values)), rng.getrandbits(16)),
                    spi.read_command(rng.randrange(256)) + bytes(4),
                    spi.frame_command() + bytes(12),
                )
            )
            bits = rng.randrange(8 * len(command))
            await host.select()
            await host.exchange(command[: bits // 8])
            await host.bits(command[bits // 8], bits % 8)
            await host.deselect(rng.choice((1_000, None)))
        elif kind == "opcode":
            opcode = rng.choice([n for n in range(256) if n not in (2, 3, 0x0B)])
            await host.select()
            await host.exchange(bytes((opcode,)))
            answer = await host.exchange(rng.randbytes(rng.randrange(1, 6)))
            assert answer == bytes((spi.TOKEN_OPCODE,)) + bytes(len(answer) - 1)
            await host.deselect()
        elif kind == "stop":
            # SCK stops in the middle of a command for about a frame, then continues.
            address, value = rng.choice(free), rng.getrandbits(16)
            command, at = spi.write_command(address, value), rng.randrange(1, 40)
            await host.select()
            for bit in range(40):
                if bit == at:
                    await chip.clocks(rng.randrange(1, 600))
                await host.bits(command[bit // 8] << bit % 8 & 0xFF, 1)
            for _ in range(400):
                if (token := await host.exchange(b"\x00")) != b"\x00":
                    break
            await host.deselect()
            assert token[0] in (spi.TOKEN_DONE, spi.TOKEN_BUSY), token
            if token[0] == spi.TOKEN_DONE:
                assert model.write(address, value)
        else:
            # CS bounces as it falls and as it rises, SCK with it.
            for _ in range(rng.randrange(1, 6)):
                host.cs.value = 0
                await Timer(rng.randrange(1, 50_000), "ps")
                if rng.random() < 0.3:
                    await host.bits(rng.randrange(256), rng.randrange(1, 4))
                host.cs.value = 1
                await Timer(rng.randrange(1, 50_000), "ps")
    host.period_ps = chip.clock_ps
    await host.deselect(8 * chip.clock_ps)
    for address, value in model.values.items():
        assert await host.read(address) == value
    await chip.starts(2)
    await wait_ready(chip, 5000)
    await check_frame()
    report({"done": done, "frames": chip.frame})


async def reset(dut: Any) -> None:
    """Power up, with nothing in Python that follows the rows: millions of clocks go by."""
    dut.rst_ni.value = 0
    await Timer(3 * CLOCK_PS, "ps")
    dut.rst_ni.value = 1
    await Timer(10 * CLOCK_PS, "ps")


@cocotb.test(timeout_time=10, timeout_unit="sec")
async def counters(dut: Any) -> None:
    """Frames beside a host that holds one, then commands that there are not."""
    frames = commands = scenario()["many"]
    Clock(dut.clk_i, CLOCK_PS, "ps").start()
    host = Pins(dut, CLOCK_PS)
    dut.enable_i.value = dut.comp_async_i.value = dut.row_sense_i.value = 0
    await reset(dut)
    for address, value in ((rm.SETTLE, 0), (rm.GATE, 1), (rm.ROW_MASK, 1)):
        await host.write(address, value)
    dut.enable_i.value = 1
    starts = []
    for _ in range(4):
        await RisingEdge(dut.frame_start_o)
        starts.append(get_sim_time("ps"))
    slot_ps = starts[-1] - starts[-2]
    await host.select()
    await host.exchange(next(spi.read_frame_bytes()) + bytes(4))
    await Timer(frames * slot_ps, "ps")
    await host.deselect()
    dut.enable_i.value = 0
    seen = {"number": await host.read(rm.FRAME_NUMBER)}
    seen["lost"] = await host.read(rm.LOST)
    await reset(dut)
    seen["lost_after_reset"] = await host.read(rm.LOST)
    # 24 clocks a command, 20 of them with CS low; its edges lie between those of SCK.
    dut.spi_copi_i.value = 1
    sck = Clock(dut.spi_sck_i, CLOCK_PS, "ps")
    sck.start()
    await Timer(3 * CLOCK_PS // 4, "ps")
    cs = Clock(dut.spi_cs_ni, 24 * CLOCK_PS, "ps", period_high=4 * CLOCK_PS)
    cs.start()
    await Timer(24 * CLOCK_PS * commands, "ps")
    cs.stop()
    sck.stop()
    await host.deselect()
    seen["errors"] = await host.read(rm.SPI_ERRORS)
    await reset(dut)
    seen["errors_after_reset"] = await host.read(rm.SPI_ERRORS)
    report(seen)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def wiring(dut: Any) -> None:
    """Every status bit, header flag and pin, with no parameter at its default."""
    s, chip, host = await start(dut, ratio=8, enable=False)
    p, rows, cols = s["parameters"], chip.rows, chip.cols
    gate, settle = p["GATE_CLOCKS"], p["SETTLE_CLOCKS"]

    async def begin(control: int) -> None:
        """Write CONTROL and wait for the frame that it begins."""
        begun = chip.frame
        await host.write(rm.CONTROL, control)
        while chip.frame == begun:
            await chip.clocks(1)

    async def status() -> int:
        return await host.read(rm.STATUS)

    # CIPO is driven while the chip is selected, and by nothing else.
    assert int(dut.spi_cipo_oe_o.value) == 0
    await host.select()
    assert int(dut.spi_cipo_oe_o.value) == 1
    await host.deselect()
    assert int(dut.spi_cipo_oe_o.value) == 0

    # Nothing is counted after a reset; then a command that there is not.
    assert [await host.read(name) for name in (rm.LOST, rm.SPI_ERRORS)] == [0, 0]
    await host.select()
    await host.exchange(bytes([0xFF, 0, 0]))
    await host.deselect()
    assert await host.read(rm.SPI_ERRORS) == 1

    # A chip that is enabled and has nothing to do does not scan.
    await host.write(rm.CONTROL, 0)
    dut.enable_i.value = 1
    await chip.clocks(20)
    assert await status() == 0
    await begin(CONTINUOUS)
    assert await status() & rm.STATUS_SCANNING_MASK

    # The break between two rows, and a whole frame of more than 512 bytes.
    driven = []
    while len(driven) < 4 * rows + 1:
        await ValueChange(dut.row_select_o)
        driven.append((get_sim_time("ps"), int(dut.row_select_o.value)))
    first = [value for _, value in driven].index(1)
    whole = driven[first : first + 2 * rows]
    assert [value for _, value in whole] == [0 if n % 2 else 1 << n // 2 for n in range(2 * rows)]
    breaks = {after - before for (before, value), (after, _) in pairwise(whole) if not value}
    assert breaks == {p["BREAK_CLOCKS"] * chip.clock_ps}
    await wait_ready(chip, 4 * rows * (gate + settle))
    assert await host.read(rm.LOST) > 0
    data = await host.frame_bytes()
    assert len(data) > 512
    same(data, chip.expected(spi.parse_frame(data).number, gate))

    # Slots that are shorter than the packing of a row wait for it.
    await host.write(rm.CONTROL, 0)
    await chip.clocks(2 * rows * (gate + settle))
    await host.write(rm.SETTLE, 0)
    await host.write(rm.GATE, 2)
    if int(dut.frame_ready_o.value):
        await host.frame_bytes()
    await begin(SHOT)
    await wait_ready(chip, 4 * rows * cols)
    same(await host.frame_bytes(), chip.expected(chip.frame, 2))
    await host.write(rm.SETTLE, settle)

    # The header has the gate that its frame began with; overflow has a bit for each column.
    mask, long = 1 << rows - 1 | 1, 2 ** (chip.code_bits + 1) + 50
    for n in range((rows + 15) // 16):
        await host.write(rm.ROW_MASK + n, mask >> 16 * n & 0xFFFF)
    await host.write(rm.GATE, long)
    await host.frame_bytes()
    await begin(SHOT)
    await host.write(rm.GATE, 40)
    await wait_ready(chip, 4 * long)
    same(await host.frame_bytes(), chip.expected(chip.frame, long, row_mask=mask))

    # A self-test: its pulses begin with its gate, its limits have 16 bits, its faults are in the next header.
    long = 2 ** (chip.code_bits + 1) - 20
    await host.write(rm.GATE, long)
    rate = 0x2AAA  # 337.98 pulses in 2 028 clocks: any phase at their start makes one more
    await host.write(rm.TEST_RATE, rate)
    counts = []
    await host.write(rm.DARK_MAX, long)
    for full_min, broken, lit in ((long // 2 - 1, 0, 1), (long // 2 - 1, 1, 0), (long // 2 + 1, 0, 0)):
        await host.write(rm.FULL_MIN, full_min)
        chip.set_faults(rows_low=[rows - 1] * broken, comparators_high=[0] * lit)
        frame = await shot(chip, host, TEST)
        assert frame.test
        counts.append(await host.read(rm.TEST_COUNT))
        faults = []
        for first, lines in ((rm.ROW_FAULT, rows), (rm.FULL_FAULT, cols), (rm.DARK_FAULT, cols)):
            words = [await host.read(first + n) for n in range((lines + 15) // 16)]
            faults.append(sum(word << 16 * n for n, word in enumerate(words)))
        wrong = 0 if full_min < long // 2 else (1 << cols) - 1
        assert faults == [broken << rows - 1, wrong, 0]
        assert await status() & (TEST_DONE | FAULT) == TEST_DONE | FAULT * bool(broken or wrong)
        chip.set_faults()
        assert (await shot(chip, host, SHOT)).fault == bool(broken or wrong)
    assert counts == [rate * long >> 16] * 3

    # A self-test that is asked for again in its first slot is done with the second one.
    await host.write(rm.GATE, 200)
    await begin(TEST)
    await begin(TEST)
    await wait_ready(chip, 2000)
    assert not await status() & TEST_DONE
    await host.frame_bytes()
    await wait_ready(chip, 8 * (200 + settle) + 500)
    assert await status() & TEST_DONE
    slots, slot = len(spi.parse_frame(await host.frame_bytes()).slots), 200 + settle

    # It is done at its end and not before, also if enable falls while its last row is packed; before that it is cut.
    for clocks, before, after in ((1.5 * slot, 0, TEST_CUT), (slots * slot + 8, None, TEST_DONE)):
        await begin(TEST)
        await chip.clocks(clocks)
        if before is not None:
            assert await status() & (TEST_DONE | TEST_CUT) == before
        dut.enable_i.value = 0
        await chip.clocks(20 * cols)
        assert await status() & (TEST_DONE | TEST_CUT) == after
        dut.enable_i.value = 1
        await chip.clocks(20)
    report("done")


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def off(dut: Any) -> None:
    """The clock stops at each level while a row is driven or tested; enable_i takes the analog side off."""
    _, chip, host = await start(dut, ratio=8)
    rng = random.Random(3)

    def on() -> int:
        outputs = dut.row_select_o, dut.charge_o, dut.test_current_o
        return sum(int(output.value) for output in outputs) or not int(dut.preset_o.value)

    longest = 0.0
    for level in (0, 1) * 6:
        chip.stopped = False
        await chip.reset()
        await host.write(rm.CONTROL, CONTINUOUS | TEST * rng.randrange(2))
        await chip.clocks(rng.uniform(20, 400))
        while not int(dut.row_select_o.value) | int(dut.test_current_o.value):
            await chip.clocks(1)
        while int(dut.clk_i.value) != level:
            await Timer(chip.clock_ps // 20, "ps")
        chip.stopped = True
        await chip.clocks(5)
        assert on()
        dut.enable_i.value = 0
        begun = get_sim_time("ns")
        await Timer(1, "ps")
        while on() and longest < 1000.0:
            await Timer(100, "ps")
            longest = max(longest, get_sim_time("ns") - begun)
        assert longest <= 100.0
    report(longest)


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def cuts(dut: Any) -> None:
    """enable_i falls at any time, often for less than a clock, most often around the last sample of
    a slot: each frame that comes is exact, no row is called broken, and a test that was cut says so.
    """
    s, chip, host = await start(dut, ratio=8)
    p, rng = s["parameters"], random.Random(s["seed"])
    rows, slot = chip.rows, p["GATE_CLOCKS"] + p["SETTLE_CLOCKS"]
    read = 0
    for n in range(s["cuts"]):
        await RisingEdge(dut.frame_start_o)
        whole = chip.frame
        # Three in four: within some clocks of the end of a slot.
        end = rng.randrange(1, rows + 1) * slot
        await chip.clocks(end + rng.uniform(-4, 5) if n % 4 else rng.uniform(0, rows * slot))
        dut.enable_i.value = 0
        await Timer(rng.choice((20_000, 90_000, chip.clock_ps, 5 * chip.clock_ps)), "ps")
        dut.enable_i.value = 1
        await chip.clocks(40)
        if int(dut.frame_ready_o.value):
            data = await host.frame_bytes()
            number = spi.parse_frame(data).number
            assert number <= whole
            same(data, chip.expected(number, p["GATE_CLOCKS"]))
            read += 1
    words = range((rows + 15) // 16)
    assert not any([await host.read(rm.ROW_FAULT + n) for n in words])
    report(read)


@cocotb.test(timeout_time=10, timeout_unit="sec")
async def commits(dut: Any) -> None:
    """Settings written under CONTROL.hold act together: each frame has slots, gate, settle, dark
    slot and pedestal mode of one release, that before its start.
    """
    s, chip, host = await start(dut, ratio=8, enable=False)
    rng = random.Random(s["seed"])
    words = range((chip.rows + 15) // 16)
    released: dict[int, tuple[Any, ...]] = {}  # number of the first frame that may have it -> settings
    starts: list[list[float]] = []  # of each frame, when its rows went on

    async def watch_frames() -> None:
        while True:
            await RisingEdge(dut.frame_start_o)
            starts.append([])

    async def watch_rows() -> None:
        while True:
            await ValueChange(dut.row_select_o)
            if int(dut.row_select_o.value) and starts:
                starts[-1].append(get_sim_time("ps") / chip.clock_ps)

    control = CONTINUOUS
    await host.write(rm.CONTROL, control | rm.CONTROL_HOLD_MASK)
    for task in (watch_frames, watch_rows):
        cocotb.start_soon(task())
    dut.enable_i.value = 1
    writes = read = 0
    while writes < s["writes"]:
        mask = 0
        while bin(mask).count("1") < 2:
            mask = rng.getrandbits(chip.rows) & rng.getrandbits(chip.rows)
        settle, gate, mode, dark = (rng.randrange(*ends) for ends in ((3, 40), (40, 90), (3,), (2,)))
        await host.write(rm.CONTROL, control | rm.CONTROL_HOLD_MASK)
        settings = [(rm.SETTLE, settle), (rm.GATE, gate)]
        settings += [(rm.ROW_MASK + n, mask >> 16 * n & 0xFFFF) for n in words]
        rng.shuffle(settings)
        for address, value in settings:
            await host.write(address, value)
            await chip.clocks(rng.expovariate(0.05) + 0.1)
        control = CONTINUOUS | DARK * dark | pedestal_mode(mode)
        # The frames that are there were begun before; the next has these settings.
        released[len(starts) + 1] = (mask, gate, settle, mode, dark)
        await host.write(rm.CONTROL, control)
        writes += len(settings) + 2
        await chip.clocks(rng.choice((1, rng.expovariate(0.01) + 1, rng.expovariate(0.002) + 1)))
        if int(dut.frame_ready_o.value):
            frame = await host.frame()
            settings_of = released[max(n for n in released if n <= frame.number)]
            rows_on = [row for row in frame.slots if row < spi.SLOT_INJECT]
            on, clocks = starts[frame.number - 1], frame.gate_clocks
            got = (sum(1 << row for row in rows_on), clocks, round(on[1] - on[0]) - clocks)
            got += (frame.pedestal_mode, int(frame.dark))
            assert got == settings_of, f"frame {frame.number}: {got}, not {settings_of}"
            read += 1
    report(read)
