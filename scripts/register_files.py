# SPDX-License-Identifier: Apache-2.0
"""Generate Verilog, Python, C and the table in docs from rtl/dermis_registers.rdl.

The SystemRDL compiler reads the map; this module writes Verilog-2005 with parameters.
PeakRDL-regblock writes SystemVerilog packages and structs of a fixed size, which two of the three
Verilog tools cannot read; the header of PeakRDL-cheader has no address constants (docs/registers.md).
The constant parts of the files are in scripts/templates.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from systemrdl import RDLCompileError, RDLCompiler
from systemrdl.messages import MessagePrinter, Severity
from systemrdl.node import FieldNode, RegNode

from dermis.errors import InputError
from dermis.scene.design import Design

SOURCE = "rtl/dermis_registers.rdl"
WORD_BITS = 16
LICENSE = "SPDX-License-Identifier: Apache-2.0"
ORIGIN = f"Generated from {SOURCE}; change it there and run: dermis generate"


@dataclass(frozen=True)
class Part:
    """A field: a run of bits of a register with one meaning."""

    name: str
    low: int
    width: int
    kind: str  # "constant", "input", "value" or "pulse"
    reset: int
    verilog: str
    desc: str

    @property
    def mask(self) -> int:
        """Mask of the field in its word."""
        return ((1 << self.width) - 1) << self.low

    @property
    def bits(self) -> str:
        """Range of bits for a table."""
        return f"{self.low + self.width - 1}:{self.low}" if self.width > 1 else f"{self.low}"


@dataclass(frozen=True)
class Entry:
    """A register, or a list of lanes over several words, at the size of the largest chip."""

    name: str
    address: int
    words: int
    lanes: str  # "", "ROWS" or "COLS"
    lane_bits: str
    parts: tuple[Part, ...]
    desc: str

    @property
    def writable(self) -> bool:
        """True if a write is accepted."""
        return any(part.kind in ("value", "pulse") for part in self.parts)

    @property
    def reset(self) -> int:
        """The whole word after reset."""
        return sum(part.reset << part.low for part in self.parts)

    @property
    def write_mask(self) -> int:
        """Bits that keep a written value."""
        return sum(part.mask for part in self.parts if part.kind == "value")


class _Quoting(MessagePrinter):
    """Collect the messages of the compiler for one line."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def print_message(self, severity: Severity, text: str, src_ref: Any) -> None:
        self.said.append(f"{severity.name.lower()}: {text}")


def parameters(design: Design) -> dict[str, int]:
    """Return the parameters of the map for a design."""
    return {
        "ROWS": design.array.rows,
        "COLS": design.array.cols,
        "CODE_BITS": design.timing.code_bits,
        "GATE_CLOCKS": design.timing.gate_clocks,
        "SETTLE_CLOCKS": design.timing.settle_clocks,
        "BREAK_CLOCKS": design.timing.break_clocks,
        "RANGE_INDEX": design.interface.k_options.index(design.interface.k),
    }


def entries(design: Design, root: Path) -> list[Entry]:
    """Read the map.

    Raises
    ------
    InputError
        It is not SystemRDL, or uses an unsupported feature.
    """
    printer = _Quoting()
    compiler = RDLCompiler(message_printer=printer)
    try:
        compiler.compile_file(str(root / SOURCE))
        top = compiler.elaborate(top_def_name="dermis_registers", parameters=parameters(design)).top
    except RDLCompileError as error:
        raise InputError(SOURCE, "SystemRDL", "; ".join(printer.said) or str(error), "a valid map") from None
    found = [_entry(node) for node in top.registers(unroll=False)]
    last = -1
    for entry in found:
        if entry.address <= last or entry.address + entry.words > 256:
            raise InputError(SOURCE, entry.name, entry.address, "rising word addresses below 256")
        last = entry.address + entry.words - 1
    return found


def _entry(node: RegNode) -> Entry:
    lanes, lane_bits = node.get_property("lanes") or "", node.get_property("lane_bits") or ""
    parts = tuple(_part(field) for field in node.fields())
    words = node.array_dimensions[0] if node.is_array else 1
    if node.get_property("regwidth") != WORD_BITS:
        raise InputError(SOURCE, node.inst_name, node.get_property("regwidth"), f"{WORD_BITS} bits")
    if bool(lanes) != node.is_array or (lanes and (lane_bits == "" or len(parts) != 1)):
        raise InputError(SOURCE, node.inst_name, lanes, "an array has lanes, lane_bits and one field")
    if lanes and parts[0].kind not in ("value", "input"):
        raise InputError(SOURCE, node.inst_name, parts[0].kind, "lanes are written or measured")
    desc = node.get_property("desc") or ""
    return Entry(node.inst_name, node.raw_address_offset // 2, words, lanes, lane_bits, parts, desc)


def _part(field: FieldNode) -> Part:
    read, write = field.is_sw_readable, field.is_sw_writable
    if field.get_property("singlepulse"):
        kind = "pulse"
    elif read and write and field.is_hw_readable and not field.is_hw_writable:
        kind = "value"
    elif read and not write and field.is_hw_writable:
        kind = "input"
    elif read and not write and not field.is_hw_readable:
        kind = "constant"
    else:
        allowed = "sw=rw hw=r, sw=r hw=w, sw=r hw=na or a singlepulse"
        raise InputError(SOURCE, f"{field.parent.inst_name}.{field.inst_name}", "its access", allowed)
    reset = field.get_property("reset") or 0
    verilog = field.get_property("verilog") or str(reset)
    desc = field.get_property("desc") or ""
    return Part(field.inst_name, field.low, field.width, kind, int(reset), verilog, desc)


def files(design: Design, root: Path) -> dict[str, str]:
    """Return every generated file as ``{path from the root: text}``."""
    found = entries(design, root)
    return {
        "rtl/dermis_registers.v": verilog(found, parameters(design)["RANGE_INDEX"]),
        "rtl/dermis_registers.h": c_header(found),
        "models/dermis/chip/register_map.py": python_module(found),
    }


def _filled(name: str, **fields: object) -> str:
    """Return a template of scripts/templates with its fields."""
    template = (Path(__file__).parent / "templates" / f"{name}.in").read_text(encoding="utf-8")
    return Template(template).substitute(license=LICENSE, origin=ORIGIN, **fields)


# Verilog


def _vector(entry: Entry) -> str:
    """Return the width of all lanes together, as a Verilog expression."""
    return entry.lanes if entry.lane_bits == "1" else f"{entry.lane_bits}*{entry.lanes}"


def _range(width: int | str) -> str:
    if width == 1:
        return ""
    return f"[{width}-1:0]" if isinstance(width, str) else f"[{width - 1}:0]"


def verilog(found: list[Entry], range_index: int) -> str:
    """Return rtl/dermis_registers.v."""
    by_kind = {
        kind: [(e, p) for e in found for p in e.parts if p.kind == kind]
        for kind in ("value", "pulse", "input")
    }
    single = [(e, p) for e, p in by_kind["value"] if not e.lanes]
    lists = [(e, p) for e, p in by_kind["value"] if e.lanes]
    ports = [("input", "", name) for name in ("clk_i", "rst_ni", "valid_i", "write_i")]
    ports += [("input", "[7:0]", "address_i"), ("input", "[15:0]", "wdata_i")]
    for kind, direction, suffix in (
        ("value", "output", "_o"),
        ("pulse", "output", "_o"),
        ("input", "input", "_i"),
    ):
        ports += [
            (direction, _range(_vector(e) if e.lanes else p.width), p.name + suffix) for e, p in by_kind[kind]
        ]
    ports += [("output", "[15:0]", "rdata_o"), ("output", "", "error_o")]
    wide = max(len(width) for _, width, _ in ports)

    sizes = [
        f"localparam integer {_constant(e, p)} = {p.verilog};"
        for e in found
        for p in e.parts
        if not p.verilog.isdigit() and not e.lanes
    ]
    for e, p in lists:
        if not p.verilog.isdigit():
            lane, constant = f"[{int(e.lane_bits) - 1}:0]", _constant(e, p)
            sizes.append(f"localparam integer {constant} = {p.verilog};")
            sizes.append(f"localparam {lane} {constant}_LANE = {constant}{lane};")
    registers = [(_range(p.width), f"{p.name}_q") for _, p in single]
    registers += [(_range(_vector(e)), f"{p.name}_{end}") for e, p in lists for end in "qd"]
    registers += [("[15:0]", "rdata"), ("", "known")]

    resets = [f"{p.name}_q <= {_literal(e, p)};" for e, p in single]
    resets += [f"{p.name}_q <= {_list_reset(e, p)};" for e, p in lists]
    writes, reads, read_lists = [], [], []
    for e in found:
        known = "known = 1'b1;" if e.writable else "known = ~write_i;"
        if e.lanes:
            part = e.parts[0]
            read_lists += _lane_loop(e, "m", f"rdata[{{word}}] = {_source(e, part)}[{{lane}}];", known)
            continue
        if mine := [p for p in e.parts if p.kind == "value"]:
            written = (f"  {p.name}_q <= wdata_i{_slice(p)};" for p in mine)
            writes += [f"if (address_i == 8'h{e.address:02X}) begin", *written, "end"]
        read = (f"  rdata{_slice(p)} = {_source(e, p)};" for p in e.parts if p.kind != "pulse")
        reads += [f"8'h{e.address:02X}: begin", f"  {known}", *read, "end"]
    writes += [f"{p.name}_q <= {p.name}_d;" for _, p in lists]
    outputs = [f"assign {p.name}_o = {p.name}_q;" for _, p in [*single, *lists]]
    outputs += [
        f"assign {p.name}_o = write & (address_i == 8'h{e.address:02X}) & wdata_i[{p.low}];"
        for e, p in by_kind["pulse"]
    ]
    written_lists = [
        line for e, p in lists for line in _lane_loop(e, "n", f"{p.name}_d[{{lane}}] = wdata_i[{{word}}];")
    ]
    return _filled(
        "dermis_registers.v",
        range_index=range_index,
        ports=_indented(2, (f"{way:<6} wire {width:<{wide}} {name}" for way, width, name in ports), ",\n"),
        sizes=_indented(2, sizes),
        registers=_indented(2, (f"reg  {width:<{wide}} {name};" for width, name in registers)),
        # An index that keeps its value would be a flop or a latch, so it is set in every pass.
        keep=_indented(4, (f"{p.name}_d = {p.name}_q;" for _, p in lists)),
        written_lists=_indented(6, written_lists),
        resets=_indented(6, resets),
        writes=_indented(6, writes),
        reads=_indented(8, reads),
        read_lists=_indented(6, read_lists),
        outputs=_indented(2, outputs),
    )


def _indented(spaces: int, lines: Iterable[str], end: str = "\n") -> str:
    return end.join(" " * spaces + line for line in lines)


def _constant(entry: Entry, part: Part) -> str:
    return f"{entry.name}_{part.name.upper()}" if part.name.upper() != entry.name else f"{entry.name}_VALUE"


def _slice(part: Part) -> str:
    if part.width == WORD_BITS:
        return ""
    return f"[{part.low + part.width - 1}:{part.low}]" if part.width > 1 else f"[{part.low}]"


def _literal(entry: Entry, part: Part) -> str:
    if part.verilog.isdigit():
        digits = -(-part.width // 4)
        return f"{part.width}'h{int(part.verilog):0{digits}X}"
    return f"{_constant(entry, part)}[{part.width - 1}:0]"


def _list_reset(entry: Entry, part: Part) -> str:
    if not part.verilog.isdigit():
        return f"{{{entry.lanes}{{{_constant(entry, part)}_LANE}}}}"
    bit = {0: "0", (1 << WORD_BITS) - 1: "1"}.get(part.reset)
    if bit is None:
        raise InputError(
            SOURCE, entry.name, part.reset, "reset of a list: all 0, all 1, or `verilog` for one lane"
        )
    return f"{{({_vector(entry)}){{1'b{bit}}}}}"


def _source(entry: Entry, part: Part) -> str:
    if part.kind == "constant":
        return _literal(entry, part)
    return part.name + ("_q" if part.kind == "value" else "_i")


def _lane_loop(entry: Entry, index: str, *statements: str) -> list[str]:
    """Return the statements for each lane of a list, executed at the address of its word."""
    width = entry.lane_bits
    per = 1 if width == "CODE_BITS" else WORD_BITS // int(width)
    shift = per.bit_length() - 1
    lane, word = (index, f"{index} % {per}") if per > 1 else (f"{width}*{index} +: {width}", f"{width}-1:0")
    if per > 1 and width != "1":
        lane, word = f"{width}*{lane} +: {width}", f"{width}*({word}) +: {width}"
    word_index = f"{{{shift}'d0, {index}[7:{shift}]}}" if per > 1 else f"{index}[7:0]"
    return [
        f"for ({index} = 0; {index} < {entry.lanes}; {index} = {index} + 1)",
        f"  if (address_i == 8'h{entry.address:02X} + {word_index}) begin",
        *("    " + statement.format(lane=lane, word=word) for statement in statements),
        "  end",
    ]


# Python and C


def _constants(found: list[Entry]) -> Iterator[tuple[str, int, int]]:
    """Return (name, value, hexadecimal digits) of each address, mask and shift; a field over the
    whole word has no mask.
    """
    for entry in found:
        yield entry.name, entry.address, 2
    for entry in found:
        for part in entry.parts:
            if part.width < WORD_BITS and not entry.lanes:
                yield f"{entry.name}_{part.name.upper()}_MASK", part.mask, 4
                yield f"{entry.name}_{part.name.upper()}_SHIFT", part.low, 0


def _number(value: int, digits: int) -> str:
    return f"0x{value:0{digits}X}" if digits else str(value)


def python_module(found: list[Entry]) -> str:
    """Return models/dermis/chip/register_map.py."""
    registers = []
    for entry in found:
        readable = sum(part.mask for part in entry.parts if part.kind != "pulse")
        pulse = sum(part.mask for part in entry.parts if part.kind == "pulse")
        bits = entry.lane_bits if entry.lane_bits.isdigit() else "0"
        cells = [f"0x{entry.address:02X}", f'"{entry.lanes.lower()}"', bits]
        cells += [f"0x{v:04X}" for v in (entry.reset, readable, entry.write_mask, pulse)]
        registers.append(f'    "{entry.name}": Register({", ".join(cells)}),')
    constants = "\n".join(f"{name} = {_number(value, digits)}" for name, value, digits in _constants(found))
    return _filled("register_map.py", constants=constants, registers="\n".join(registers))


def c_header(found: list[Entry]) -> str:
    """Return rtl/dermis_registers.h: addresses of the SPI, masks, shifts, reset values."""
    resets = ((f"{e.name}_RESET", e.reset, 4) for e in found if e.write_mask)
    constants = [
        (f"DERMIS_{name}", _number(value, digits)) for name, value, digits in (*_constants(found), *resets)
    ]
    width = max(len(name) for name, _ in constants)
    lines = "\n".join(f"#define {name:<{width}} {value}u" for name, value in constants)
    return _filled("dermis_registers.h", constants=lines)


# Documentation


def table(design: Design, root: Path) -> str:
    """Return the table of docs/registers.md."""
    out = [
        "| address | register | bits | name | access | reset | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    access = {"constant": "r", "input": "r", "value": "rw", "pulse": "w, acts once"}
    for entry in entries(design, root):
        last = entry.address + entry.words - 1
        place = f"{entry.address:02X}" if entry.words == 1 else f"{entry.address:02X}..{last:02X}"
        out.append(f"| {place} | `{entry.name}` | | | | | {entry.desc} |")
        for part in reversed(entry.parts):
            reset = "" if part.kind in ("input", "pulse") else _shown(part)
            bits = part.bits
            out.append(f"| | | {bits} | `{part.name}` | {access[part.kind]} | {reset} | {part.desc} |")
    return "\n".join(out)


def _shown(part: Part) -> str:
    return f"0x{part.reset:X}" if part.reset > 9 and part.verilog.isdigit() else str(part.reset)
