# SPDX-License-Identifier: Apache-2.0
"""The only lines that a deck may hold: every form is listed, so that whatever else gets there is
seen.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cache

from dermis.chip import netlist, sky130
from dermis.errors import InputError
from dermis.scene.design import ROOT, TOPOLOGIES

_NUMBER = r"-?[0-9]{1,40}(?:\.[0-9]{1,40})?(?:e[+-]?[0-9]{1,3})?"
_NODE = (
    r"(?:0|vdd|vss|vbias|ibias|vg[0-9]+|row[0-9]+|col[0-9]+|comp[0-9]+|d_row[0-9]+|d_preset|d_charge[0-9]+"
)
_NODE += r"|[uv]_r[0-9]+c[0-9]+|r[0-9]+|c[0-9]+|pad_(?:row|col)[0-9]+|ground_rows)"
_RAILS = "vdd vss (?:0 0|vdd_d vss_d)"
_REFERENCES = "(?:0 0 ibias|vref agnd ibias[0-9]+)"
_LOGIC = r"(?:row[0-9]+|preset|charge[0-9]+)"
_CELL = r"_r[0-9]+c[0-9]+"
_VALUES = rf"(?: [a-z][a-z0-9_]*={_NUMBER})+"
_CHANNEL = f"channel_(?:{'|'.join(TOPOLOGIES)})"
_OPTION = (
    r"(?:reltol|abstol|vntol|chgtol|trtol|gmin|method|maxord|itl1|itl2|itl4|cshunt|rshunt|gminsteps|srcsteps)"
)

FORMS = {
    "title": rf"dermis frame [0-9]+: [0-9]+ x [0-9]+, (?:{'|'.join(TOPOLOGIES)})",
    "clock": rf"\.param (?:converter_f_clk_hz|comparator_early_s)={_NUMBER}",
    "supply": rf"(?:vdd vdd|vss vss|vibias ibias|vbias vbias) 0 {_NUMBER}",
    "ripple": rf"vbias vbias 0 sin\({_NUMBER}(?: {_NUMBER}){{5}}\)",
    "external": r"v_d_(?:row[0-9]+ d_row[0-9]+|preset d_preset|charge[0-9]+ d_charge[0-9]+) 0 external",
    "row": "v_row[0-9]+ row[0-9]+ 0 external",
    "reference": "|".join(re.escape(line) for line in (*sky130.REFERENCE, "vss_d vss_d vss 0")),
    "digital supply": rf"vdd_d vdd_d vss_d {_NUMBER}",
    "logic": rf"v_d_{_LOGIC} logic_{_LOGIC} 0 external|e{_LOGIC} d_{_LOGIC} vss_d logic_{_LOGIC} 0 {_NUMBER}",
    "logic level": rf"\.param supply_v_logic_v={_NUMBER}",
    "bias current": r"xout_ibias[0-9]+ v_gate v_cp ibias[0-9]+ vdd bias_output",
    "bias line": r"xline[0-9]+ ibias[0-9]+ vdd vss bias_line",
    "temperature": rf"\.temp {_NUMBER}",
    "row driver": rf"xrow[0-9]+ d_row[0-9]+ (?:pad_)?row[0-9]+ vbias (?:0|ground_rows) {_RAILS} row_driver"
    f"(?:{_VALUES})?",
    "return": rf"rreturn ground_rows 0 {_NUMBER}",
    "pad": rf"rpad_(?:row[0-9]+ pad_row[0-9]+ row[0-9]+|col[0-9]+ col[0-9]+ pad_col[0-9]+) {_NUMBER}",
    "subckt": r"\.subckt array|\.ends array",
    "pins": rf"\+(?: {_NODE})+",
    "taxel": rf"[rc]taxel{_CELL} {_NODE} {_NODE} {_NUMBER}",
    "moving taxel": rf"btaxel{_CELL} {_NODE} {_NODE} i = v\({_NODE},{_NODE}\)\*\({_NUMBER} \+ \({_NUMBER}\)\*time\)",
    "lateral": rf"rlat(?:_col)?{_CELL} {_NODE} {_NODE} {_NUMBER}",
    "trace": rf"rtrace_(?:row|col){_CELL} {_NODE} {_NODE} {_NUMBER}",
    "line": rf"(?:crow|ccolumn)[0-9]+ {_NODE} 0 {_NUMBER}",
    "array": rf"xarray(?: {_NODE})+ array",
    "column": rf"rcolumn[0-9]+ {_NODE} {_NODE} {_NUMBER}",
    "far column": rf"rfar[0-9]+ col[0-9]+ far[0-9]+ {_NUMBER}|vfar[0-9]+ (?:col|far)[0-9]+ 0 {_NUMBER}",
    "current": rf"(?:ileak|ioffset)[0-9]+ 0 (?:{_NODE}|xch[0-9]+\.v_sum) {_NUMBER}",
    "channel": rf"xch[0-9]+ {_NODE} d_charge[0-9]+ d_preset comp[0-9]+ {_REFERENCES} {_RAILS} {_CHANNEL}"
    f"{_VALUES}",
    "range": rf"vd_range[0-9]+ d_range[0-9]+ vss_d {_NUMBER}",
    "switched channel": rf"xch[0-9]+ {_NODE} d_charge[0-9]+ d_preset d_range[0-9]+ d_range[0-9]+ comp[0-9]+ "
    f"{_REFERENCES} {_RAILS} channel_switched",
    "options": rf"\.options(?: {_OPTION}=(?:{_NUMBER}|gear|trap))+",
}
"""Name -> the form, to be met by the whole line."""

PARAMETER = rf"\.param [a-z][a-z0-9_]* = {_NUMBER}"
"""Form of a line of spice/design.inc that is not a comment."""

_DECK = re.compile("|".join(f"(?:{form})" for form in FORMS.values()))


_BLOCKS = (
    "row_driver",
    "conveyor",
    "conveyor_multi",
    "mirror",
    "integrator",
    "comparator",
    "charge_source",
    "vfc",
)
_BLOCKS += tuple(f"channel_{topology}" for topology in TOPOLOGIES)
_FILES = (
    "design.inc",
    "behavioural/blocks.inc",
    "behavioural/mirror_lag.sp",
    *(f"sky130/{name}" for name in (*netlist.SHARED, "offset_null.sp", "channel_switched.sp")),
    *(f"{view}/{block}.sp" for view in ("behavioural", "sky130") for block in _BLOCKS),
)


@cache
def includes() -> frozenset[str]:
    """The lines by which a deck includes a file of spice/ or the models of a corner, each by its
    whole path.
    """
    files = [ROOT / "spice" / name for name in _FILES]
    with suppress(InputError):  # without the models no deck includes any
        files += [sky130.models(corner) for corner in sky130.CORNERS]
    return frozenset(f'.include "{file}"' for file in files)


def strange_lines(lines: Iterable[str]) -> list[str]:
    """The lines of a deck that have none of the allowed forms; a line with a line end inside is one
    of them.
    """
    return [line for line in lines if line not in includes() and not _DECK.fullmatch(line)]


def strange_parameters(text: str) -> list[str]:
    """The lines of a parameter file that are neither `.param name = number` nor a comment."""
    return [
        line
        for line in text.split("\n")
        if line and not re.fullmatch(PARAMETER, line) and not re.fullmatch(r"\*[ -~]*", line)
    ]
