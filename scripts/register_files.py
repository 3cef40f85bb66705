# SPDX-License-Identifier: Apache-2.0
"""Generate Verilog, constants for Python and C, and the table in docs from
rtl/dermis_registers.rdl.

The SystemRDL compiler reads the map; this module writes Verilog-2005 with parameters.
PeakRDL-regblock writes SystemVerilog packages and structs of a fixed size, which two of the three
Verilog tools cannot read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
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


# Verilog


def _lane_count(entry: Entry) -> str:
    """Return the number of lanes per word, as a Verilog expression."""
    return "1" if entry.lane_bits == "CODE_BITS" else str(WORD_BITS // int(entry.lane_bits))


def _vector(entry: Entry) -> str:
    """Return the width of all lanes together, as a Verilog expression."""
    return entry.lanes if entry.lane_bits == "1" else f"{entry.lane_bits}*{entry.lanes}"


def _range(width: int | str) -> str:
    if width == 1:
        return ""
    return f"[{width}-1:0]" if isinstance(width, str) else f"[{width - 1}:0]"


def _ports(found: list[Entry]) -> Iterator[tuple[str, str, str]]:
    """Return (direction, range, name) of every field's port."""
    for kind, direction, suffix in (
        ("value", "output", "_o"),
        ("pulse", "output", "_o"),
        ("input", "input", "_i"),
    ):
        for entry in found:
            for part in entry.parts:
                if part.kind == kind:
                    width = _vector(entry) if entry.lanes else part.width
                    yield direction, _range(width), part.name + suffix


def verilog(found: list[Entry], range_index: int) -> str:
    """Return rtl/dermis_registers.v."""
    values = [(e, p) for e in found for p in e.parts if p.kind == "value"]
    single = [(e, p) for e, p in values if not e.lanes]
    lists = [(e, p) for e, p in values if e.lanes]
    out = [
        f"// {LICENSE}",
        f"// Registers of the chip. {ORIGIN}",
        "// Interface: valid_i for one clock is an access; each field is a port of its name. Map: docs/registers.md.",
        "// Timing: a write is on the ports after the edge that samples valid_i; pulses are high in that clock;",
        "// rdata_o and error_o are combinational.",
        "// Why rdata_o is 0 without valid_i: address_i comes from SCK and is stable only while valid_i is high.",
        '`include "dermis_design.vh"',
        "`default_nettype none",
        "",
        "module dermis_registers #(",
        "  parameter ROWS          = `DERMIS_ROWS,",
        "  parameter COLS          = `DERMIS_COLS,",
        "  parameter CODE_BITS     = `DERMIS_CODE_BITS,",
        "  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,",
        "  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,",
        "  parameter BREAK_CLOCKS  = `DERMIS_BREAK_CLOCKS,",
        "  parameter SYNC_LATCH    = 0,",
        f"  parameter RANGE_INDEX   = {range_index}",
        ") (",
    ]
    ports = [
        ("input", "", "clk_i"),
        ("input", "", "rst_ni"),
        ("input", "", "valid_i"),
        ("input", "", "write_i"),
        ("input", "[7:0]", "address_i"),
        ("input", "[15:0]", "wdata_i"),
        *_ports(found),
        ("output", "[15:0]", "rdata_o"),
        ("output", "", "error_o"),
    ]
    wide = max(len(width) for _, width, _ in ports)
    lines = [f"  {direction:<6} wire {width:<{wide}} {name}" for direction, width, name in ports]
    out += [line + "," for line in lines[:-1]] + [lines[-1], ");", ""]

    out += ["  // Numbers with a size, which Verilog-2005 gives to a parameter's bits only."]
    for entry in found:
        for part in entry.parts:
            if not part.verilog.isdigit() and not entry.lanes:
                out.append(f"  localparam integer {_constant(entry, part)} = {part.verilog};")
    for entry, part in lists:
        if not part.verilog.isdigit():
            width = int(entry.lane_bits)
            out.append(f"  localparam integer {_constant(entry, part)} = {part.verilog};")
            out.append(
                f"  localparam [{width - 1}:0] {_constant(entry, part)}_LANE = "
                f"{_constant(entry, part)}[{width - 1}:0];"
            )
    out += [""]
    for _, part in single:
        out.append(f"  reg  {_range(part.width):<{wide}} {part.name}_q;")
    for entry, part in lists:
        out.append(f"  reg  {_range(_vector(entry)):<{wide}} {part.name}_q;")
        out.append(f"  reg  {_range(_vector(entry)):<{wide}} {part.name}_d;")
    out += [f"  reg  {'[15:0]':<{wide}} rdata;", f"  reg  {'':<{wide}} known;", ""]
    out += ["  wire write = valid_i & write_i;", "", "  integer n;", "  integer m;", ""]

    # An index that keeps its value would be a flop or a latch, so it is set in every pass.
    out += ["  always @* begin", "    n = 0;"]
    out += [f"    {part.name}_d = {part.name}_q;" for _, part in lists]
    out += ["    if (write) begin"]
    for entry, part in lists:
        out += _lane_loop(entry, "n", f"{part.name}_d[{{lane}}] = wdata_i[{{word}}];")
    out += ["    end", "  end", ""]

    out += ["  always @(posedge clk_i or negedge rst_ni)", "    if (!rst_ni) begin"]
    for entry, part in single:
        out.append(f"      {part.name}_q <= {_literal(entry, part)};")
    for entry, part in lists:
        out.append(f"      {part.name}_q <= {_list_reset(entry, part)};")
    out += ["    end else if (write) begin"]
    for entry in found:
        mine = [part for part in entry.parts if part.kind == "value" and not entry.lanes]
        if mine:
            out.append(f"      if (address_i == 8'h{entry.address:02X}) begin")
            out += [f"        {part.name}_q <= wdata_i{_slice(part)};" for part in mine]
            out.append("      end")
    out += [f"      {part.name}_q <= {part.name}_d;" for _, part in lists]
    out += ["    end", ""]

    out += [
        "  always @* begin",
        "    m     = 0;",
        "    rdata = 16'd0;",
        "    known = 1'b0;",
        "    if (valid_i) begin",
        "      case (address_i)",
    ]
    for entry in found:
        if entry.lanes:
            continue
        out.append(f"        8'h{entry.address:02X}: begin")
        out.append(f"          known = {'1' if entry.writable else '~write_i'};".replace("= 1;", "= 1'b1;"))
        for part in entry.parts:
            if part.kind != "pulse":
                out.append(f"          rdata{_slice(part)} = {_source(entry, part)};")
        out.append("        end")
    out += ["        default: known = 1'b0;", "      endcase"]
    for entry in found:
        if entry.lanes:
            part = entry.parts[0]
            name = part.name + ("_q" if part.kind == "value" else "_i")
            known = "1'b1" if entry.writable else "~write_i"
            out += _lane_loop(entry, "m", f"rdata[{{word}}] = {name}[{{lane}}];", f"known = {known};")
    out += ["    end", "  end", ""]

    for _, part in [*single, *lists]:
        out.append(f"  assign {part.name}_o = {part.name}_q;")
    for entry in found:
        for part in entry.parts:
            if part.kind == "pulse":
                out.append(
                    f"  assign {part.name}_o = write & (address_i == 8'h{entry.address:02X}) & wdata_i[{part.low}];"
                )
    out += ["  assign rdata_o = rdata;", "  assign error_o = valid_i & ~known;", "", "endmodule", ""]
    return "\n".join([*out, "`default_nettype wire", ""])


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
    per, width = int(_lane_count(entry)), entry.lane_bits
    shift = per.bit_length() - 1
    if per == 1:
        word_index, lane, word = f"{index}[7:0]", f"{width}*{index} +: {width}", f"{width}-1:0"
    else:
        word_index = f"{{{shift}'d0, {index}[7:{shift}]}}"
        lane, word = index, f"{index} % {per}"
        if width != "1":
            lane, word = f"{width}*{lane} +: {width}", f"{width}*({word}) +: {width}"
    lines = [
        f"      for ({index} = 0; {index} < {entry.lanes}; {index} = {index} + 1)",
        f"        if (address_i == 8'h{entry.address:02X} + {word_index}) begin",
    ]
    lines += ["          " + statement.format(lane=lane, word=word) for statement in statements]
    return [*lines, "        end"]


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
    out = [
        f"# {LICENSE}",
        f'"""The register map. {ORIGIN}."""',
        "",
        "from __future__ import annotations",
        "",
        "from typing import NamedTuple",
        "",
    ]
    out += [f"{name} = {_number(value, digits)}" for name, value, digits in _constants(found)]
    out += ["", ""]
    out += [
        "class Register(NamedTuple):",
        '    """A register, or a list of lanes over several words; masks and reset are those of a full word.',
        "",
        "    `lanes` is what there is one lane of (a row, a column, nothing), `lane_bits` the width, 0 for CODE_BITS.",
        "    `readable` bits can be other than 0, `writable` ones stay as written, `pulse` ones act and read 0.",
        '    """',
        "",
        "    address: int",
        "    lanes: str",
        "    lane_bits: int",
        "    reset: int",
        "    readable: int",
        "    writable: int",
        "    pulse: int",
        "",
        "    def words(self, rows: int, cols: int, code_bits: int) -> list[int]:",
        '        """Bits that exist in each word of a chip of this size."""',
        "        if not self.lanes:",
        "            return [0xFFFF]",
        "        bits = self.lane_bits or code_bits",
        "        per_word = 16 // self.lane_bits if self.lane_bits else 1",
        '        left = rows if self.lanes == "rows" else cols',
        "        masks = []",
        "        while left > 0:",
        "            masks.append((1 << bits * min(left, per_word)) - 1)",
        "            left -= per_word",
        "        return masks",
        "",
        "",
        "REGISTERS: dict[str, Register] = {",
    ]
    for entry in found:
        lanes = {"": '""', "ROWS": '"rows"', "COLS": '"cols"'}[entry.lanes]
        bits = int(entry.lane_bits) if entry.lane_bits.isdigit() else 0
        readable = sum(part.mask for part in entry.parts if part.kind != "pulse")
        pulse = sum(part.mask for part in entry.parts if part.kind == "pulse")
        cells = [f"0x{entry.address:02X}", lanes, str(bits)]
        cells += [f"0x{v:04X}" for v in (entry.reset, readable, entry.write_mask, pulse)]
        out.append(f'    "{entry.name}": Register({", ".join(cells)}),')
    return "\n".join([*out, "}", ""])


def c_header(found: list[Entry]) -> str:
    """Return rtl/dermis_registers.h: addresses as the SPI counts them, masks, shifts, reset
    values.
    """
    constants = [(f"DERMIS_{name}", _number(value, digits)) for name, value, digits in _constants(found)]
    constants += [
        (f"DERMIS_{entry.name}_RESET", _number(entry.reset, 4)) for entry in found if entry.write_mask
    ]
    width = max(len(name) for name, _ in constants)
    out = [
        f"/* {LICENSE} */",
        f"/* Register map for firmware. {ORIGIN} */",
        "/* Addresses are those of the SPI commands; a list goes on from its own, one address a word. */",
        "#ifndef DERMIS_REGISTERS_H",
        "#define DERMIS_REGISTERS_H",
        "",
    ]
    out += [f"#define {name:<{width}} {value}u" for name, value in constants]
    return "\n".join([*out, "", "#endif", ""])


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
