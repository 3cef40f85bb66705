# SPDX-License-Identifier: Apache-2.0
"""Generate Verilog, Python, C and the table in docs from rtl/dermis_registers.rdl.

The SystemRDL compiler reads the map; the templates of scripts/templates are Verilog-2005 with parameters.
docs/registers.md says why the generators of PeakRDL do not serve.
"""

from dataclasses import dataclass
from pathlib import Path

from systemrdl import RDLCompileError, RDLCompiler
from systemrdl.messages import MessagePrinter
from systemrdl.node import FieldNode, RegNode

from dermis.errors import InputError
from dermis.scene.design import Design
from scripts import templates

SOURCE = "rtl/dermis_registers.rdl"
WORD_BITS = 16
ORIGIN = f"Generated from {SOURCE}; change it there and run: dermis generate"
ACCESS = {"constant": "r", "input": "r", "value": "rw", "pulse": "w, acts once"}


@dataclass(frozen=True)
class Part:
    """A field: a run of bits of a register with one meaning, or one lane of a list.

    `lanes` and `lane_bits` are those of its register; the properties are Verilog.
    """

    register: str
    lanes: str  # "", "ROWS" or "COLS"
    lane_bits: str
    name: str
    low: int
    width: int
    kind: str  # "constant", "input", "value" or "pulse"
    reset: int
    verilog: str
    desc: str

    @property
    def mask(self) -> int:
        return ((1 << self.width) - 1) << self.low

    @property
    def bits(self) -> str:
        return f"{self.low + self.width - 1}:{self.low}" if self.width > 1 else f"{self.low}"

    @property
    def all_lanes(self) -> str:
        return self.lanes if self.lane_bits == "1" else f"{self.lane_bits}*{self.lanes}"

    @property
    def constant(self) -> str | None:
        """Name of its value, if that is an expression."""
        if self.verilog.isdigit():
            return None
        own = self.name.upper()
        return f"{self.register}_{'VALUE' if own == self.register else own}"

    @property
    def literal(self) -> str:
        """Constant, or value after reset; of a list all lanes."""
        if not self.lanes:
            number = f"{self.width}'h{self.reset:0{-(-self.width // 4)}X}"
            return f"{self.constant}[{self.width - 1}:0]" if self.constant else number
        if self.constant:
            return f"{{{self.lanes}{{{self.constant}_LANE}}}}"
        bit = {0: "0", (1 << WORD_BITS) - 1: "1"}.get(self.reset)
        if bit is None:
            allowed = "reset of a list: all 0, all 1, or `verilog` for one lane"
            raise InputError(SOURCE, self.register, self.reset, allowed)
        return f"{{({self.all_lanes}){{1'b{bit}}}}}"

    def at(self, index: str) -> tuple[str, str, str]:
        """Return the place of a lane in its list, its place in a word, and the number of that word."""
        width = self.lane_bits
        if width == "CODE_BITS":
            return f"{width}*{index} +: {width}", f"{width}-1:0", f"{index}[7:0]"
        per = WORD_BITS // int(width)
        shift = per.bit_length() - 1
        lane, word = index, f"{index} % {per}"
        if width != "1":
            lane, word = f"{width}*{lane} +: {width}", f"{width}*({word}) +: {width}"
        return lane, word, f"{{{shift}'d0, {index}[7:{shift}]}}"


@dataclass(frozen=True)
class Entry:
    """A register, or a list of lanes over several words, at the size of the largest chip."""

    name: str
    address: int
    words: int
    parts: tuple[Part, ...]
    desc: str

    @property
    def reset(self) -> int:
        return sum(part.reset << part.low for part in self.parts)

    def mask(self, *kinds: str) -> int:
        return sum(part.mask for part in self.parts if part.kind in kinds)


def parameters(design: Design) -> dict[str, int]:
    values = {"ROWS": design.array.rows, "COLS": design.array.cols}
    for name in ("code_bits", "gate_clocks", "settle_clocks", "break_clocks"):
        values[name.upper()] = getattr(design.timing, name)
    return values | {"RANGE_INDEX": design.interface.k_options.index(design.interface.k)}


def entries(design: Design, root: Path) -> list[Entry]:
    """Read the map; InputError if it is not SystemRDL, or uses an unsupported feature."""
    said: list[str] = []
    printer = MessagePrinter()
    printer.print_message = lambda severity, text, _: said.append(f"{severity.name.lower()}: {text}")
    compiler = RDLCompiler(message_printer=printer)
    try:
        compiler.compile_file(str(root / SOURCE))
        top = compiler.elaborate(top_def_name="dermis_registers", parameters=parameters(design)).top
    except RDLCompileError as error:
        raise InputError(SOURCE, "SystemRDL", "; ".join(said) or str(error), "a valid map") from None
    found = [_entry(node) for node in top.registers(unroll=False)]
    last = -1
    for entry in found:
        if entry.address <= last or entry.address + entry.words > 256:
            raise InputError(SOURCE, entry.name, entry.address, "rising word addresses below 256")
        last = entry.address + entry.words - 1
    return found


def _entry(node: RegNode) -> Entry:
    lanes, lane_bits = node.get_property("lanes") or "", node.get_property("lane_bits") or ""
    parts = tuple(_part(field, lanes, lane_bits) for field in node.fields())
    words = node.array_dimensions[0] if node.is_array else 1
    if node.get_property("regwidth") != WORD_BITS:
        raise InputError(SOURCE, node.inst_name, node.get_property("regwidth"), f"{WORD_BITS} bits")
    if bool(lanes) != node.is_array or (lanes and (lane_bits == "" or len(parts) != 1)):
        raise InputError(SOURCE, node.inst_name, lanes, "an array has lanes, lane_bits and one field")
    if lanes and parts[0].kind not in ("value", "input"):
        raise InputError(SOURCE, node.inst_name, parts[0].kind, "lanes are written or measured")
    return Entry(node.inst_name, node.raw_address_offset // 2, words, parts, node.get_property("desc") or "")


def _part(field: FieldNode, lanes: str, lane_bits: str) -> Part:
    register = field.parent.inst_name
    access = (field.is_sw_readable, field.is_sw_writable, field.is_hw_readable, field.is_hw_writable)
    kinds = {
        (True, True, True, False): "value",
        (True, False, True, True): "input",
        (True, False, False, True): "input",
        (True, False, False, False): "constant",
    }
    kind = "pulse" if field.get_property("singlepulse") else kinds.get(access)
    if kind is None:
        allowed = "sw=rw hw=r, sw=r hw=w, sw=r hw=na or a singlepulse"
        raise InputError(SOURCE, f"{register}.{field.inst_name}", "its access", allowed)
    reset = int(field.get_property("reset") or 0)
    verilog, desc = field.get_property("verilog") or str(reset), field.get_property("desc") or ""
    place = (field.inst_name, field.low, field.width)
    return Part(register, lanes, lane_bits, *place, kind, reset, verilog, desc)


def files(design: Design, root: Path) -> dict[str, str]:
    """Return every generated file as ``{path from the root: text}``."""
    found = entries(design, root)
    parts = [part for entry in found for part in entry.parts]
    # Address, mask and shift; a field over the whole word has no mask.
    constants = [(entry.name, f"0x{entry.address:02X}") for entry in found]
    for part in parts:
        if part.width < WORD_BITS and not part.lanes:
            name = f"{part.register}_{part.name.upper()}"
            constants += [(f"{name}_MASK", f"0x{part.mask:04X}"), (f"{name}_SHIFT", str(part.low))]
    return templates.filled(
        ("rtl/dermis_registers.v", "rtl/dermis_registers.h", "models/dermis/chip/register_map.py"),
        origin=ORIGIN,
        range_index=parameters(design)["RANGE_INDEX"],
        entries=found,
        parts=parts,
        constants=constants,
        resets=[(f"{e.name}_RESET", f"0x{e.reset:04X}") for e in found if e.mask("value")],
    )


def table(design: Design, root: Path) -> str:
    lines = [
        "| address | register | bits | name | access | reset | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    for entry in entries(design, root):
        last = entry.address + entry.words - 1
        place = f"{entry.address:02X}" if entry.words == 1 else f"{entry.address:02X}..{last:02X}"
        lines.append(f"| {place} | `{entry.name}` | | | | | {entry.desc} |")
        for part in reversed(entry.parts):
            shown = f"0x{part.reset:X}" if part.reset > 9 and not part.constant else str(part.reset)
            reset = "" if part.kind in ("input", "pulse") else shown
            lines.append(f"| | | {part.bits} | `{part.name}` | {ACCESS[part.kind]} | {reset} | {part.desc} |")
    return "\n".join(lines)
