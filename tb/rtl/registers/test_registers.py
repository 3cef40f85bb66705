# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_registers at several sizes: each address against the map, each port against its register."""

import random
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, play

from dermis.chip import register_map as rm

SIZES = {"1x1x1": (1, 1, 1), "17x9x12": (17, 9, 12), "128x128x16": (128, 128, 16)}
# Ports that show or feed a register: register -> port: (lowest bit, bits).
OUTPUTS = {
    "CONTROL": {"continuous": (0, 1), "dark": (3, 1), "pedestal_mode": (4, 2)}
    | {"range_per_column": (6, 1), "hold": (7, 1)},
    "RANGE": {"range": (0, 2)},
    **{name: {name.lower(): (0, 16)} for name in ("SETTLE", "GATE", "TEST_RATE", "DARK_MAX", "FULL_MIN")},
}
STATUS = "scanning frame_ready test_done fault test_cut underflow".split()
INPUTS = {
    "STATUS": {field: (n, 1) for n, field in enumerate(STATUS)},
    **{name: {name.lower(): (0, 16)} for name in ("FRAME_NUMBER", "LOST", "SPI_ERRORS", "TEST_COUNT")},
}
LIST_OUTPUTS = ("ROW_MASK", "RANGE_COLUMN", "PEDESTAL")
LIST_INPUTS = ("ROW_FAULT", "INJECT_FAULT", "DARK_FAULT", "FULL_FAULT")


def every_address(simulator: str, size: str, trap: Path | None = None) -> int:
    """Access all 256 addresses in random order and compare all ports behind each; return how many exist."""
    rows, cols, code_bits = SIZES[size]
    rng = random.Random(1)
    full = min(150, 2 ** (code_bits + 1) - 1)
    resets = {"GATE": 300, "SETTLE": 7, "DARK_MAX": -(-full // 32), "FULL_MIN": full * 18 // 25}
    existing = {n: r.words(rows, cols, code_bits) for n, r in rm.REGISTERS.items()}
    place = {r.address + i: (n, i) for n, r in rm.REGISTERS.items() for i in range(len(existing[n]))}
    values = {a: resets.get(n, rm.REGISTERS[n].reset) & existing[n][i] for a, (n, i) in place.items()}
    values[rm.GEOMETRY] = rows << 8 | cols
    values[rm.FORMAT] = 1 << 9 | 1 << 8 | code_bits

    def joined(name: str) -> int:
        register = rm.REGISTERS[name]
        width = register.lane_bits * (16 // register.lane_bits) if register.lane_bits else code_bits
        return sum(values[register.address + i] << width * i for i in range(len(existing[name])))

    def shown() -> dict[str, int]:
        found = {f"{name.lower()}_o": joined(name) for name in LIST_OUTPUTS}
        for name, fields in OUTPUTS.items():
            value = values[rm.REGISTERS[name].address]
            found |= {f"{field}_o": value >> low & (1 << bits) - 1 for field, (low, bits) in fields.items()}
        return found

    def fed() -> dict[str, int]:
        """Draw the inputs that feed registers."""
        drawn = {}
        for name, fields in INPUTS.items():
            parts = {field: (rng.getrandbits(bits), low) for field, (low, bits) in fields.items()}
            values[rm.REGISTERS[name].address] = sum(part << low for part, low in parts.values())
            drawn |= {f"{field}_i": part for field, (part, _) in parts.items()}
        for name in LIST_INPUTS:
            lanes = drawn[f"{name.lower()}_i"] = rng.getrandbits(rows if name == "ROW_FAULT" else cols)
            for i in range(len(existing[name])):
                values[rm.REGISTERS[name].address + i] = lanes >> 16 * i & 0xFFFF
        return drawn

    idle = {"valid_i": 0, "write_i": 0, "address_i": 0}
    nothing = {"rdata_o": 0, "error_o": 0, "shot_o": 0, "test_o": 0}
    steps, wanted = [idle | {"wdata_i": 0} | fed()], [nothing | shown()]
    for address in rng.sample(range(256), 256):
        for write in rng.sample((0, 1), 2):
            # A read with all ones on the bus: what only a write may do would show.
            data = rng.getrandbits(16) if write else 0xFFFF
            steps.append({"valid_i": 1, "write_i": write, "address_i": address, "wdata_i": data} | fed())
            name, i = place.get(address, ("", 0))
            register = rm.REGISTERS.get(name)
            allowed = register is not None and (not write or bool(register.writable))
            want: dict[str, Any] = {"error_o": not allowed}
            if not write:
                want["rdata_o"] = values[address] & register.readable if register else 0
            elif allowed:
                values[address] = data & register.writable & existing[name][i]
            acts = write and address == rm.CONTROL
            want |= {"shot_o": acts and data >> 1 & 1, "test_o": acts and data >> 2 & 1}
            wanted.append(want | shown())
            # Without valid_i nothing is written, nothing acts and nothing shows.
            steps.append(steps[-1] | {"valid_i": 0, "wdata_i": rng.getrandbits(16)})
            wanted.append(nothing | shown())
    parameters = {"ROWS": rows, "COLS": cols, "CODE_BITS": code_bits, "GATE_CLOCKS": 300, "SETTLE_CLOCKS": 7}
    seen = play(simulator, "dermis_registers", steps, list(wanted[0]), parameters | {"SYNC_LATCH": 1}, trap)
    for step, want, edges in zip(steps, wanted, seen, strict=True):
        for outputs in edges:
            assert {name: outputs[name] for name in want} == want, f"address {step['address_i']:02X}"
    return len(place)


@pytest.mark.parametrize(
    ("simulator", "size"),
    [*(("icarus", size) for size in SIZES), pytest.param("verilator", "17x9x12", marks=pytest.mark.long)],
)
def test_every_address_is_the_register_of_the_map(simulator: str, size: str) -> None:
    addresses = every_address(simulator, size)
    assert addresses == sum(len(r.words(*SIZES[size])) for r in rm.REGISTERS.values())


FAULTS = {
    "a write without its address": ("      if (address_i == 8'h05) begin", "      begin"),
    "a word that does not exist answers": (
        "m < ROWS; m = m + 1)\n        if (address_i == 8'h20",
        "m < ROWS + 16; m = m + 1)\n        if (address_i == 8'h20",
    ),
    "a read-only register takes a write": (
        "8'h08: begin\n          known = ~write_i",
        "8'h08: begin\n          known = 1'b1",
    ),
    "two columns share a pedestal": ("pedestal_d[CODE_BITS*n +:", "pedestal_d[CODE_BITS*(n/2) +:"),
    "a pulse acts on a read": ("assign shot_o = write &", "assign shot_o = valid_i &"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    trap = changed(tmp_path, "dermis_registers", FAULTS[fault])
    with pytest.raises(AssertionError, match=r"address|1 failed"):
        every_address("icarus", "17x9x12", trap)
