# SPDX-License-Identifier: Apache-2.0
"""Benches of the blocks in SKY130 transistors: a deck per bench, and the quantities from its `.meas`.

A bench is one entry of BENCHES: the text of its device under test, stimulus and measures, and a function that turns
what ngspice found into quantities in SI units. A quantity `q` is judged against `sky130.q` of models/spec.toml, which
also covers `q.sink` and `q.source`; one without a limit is reported. Conditions are no business of a bench: models,
temperature, supplies and reference stand before it in the deck (`deck`), which also draws the mismatch.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from dermis.chip import sky130

SUPPLY_V = 1.65
"""Half the nominal supply: the rails are at plus and minus this (docs/sky130.md)."""

Found = Mapping[str, float]
"""Results of the `.meas` of a deck, by lower-case name."""


@dataclass(frozen=True)
class Condition:
    """Where a bench is measured.

    Attributes
    ----------
    corner : one of sky130.CORNERS or PASSIVE_CORNERS
    celsius : temperature
    supply : both rails, as a share of their nominal value
    sample : seed of the mismatch, from 1 on; None: every device is as its corner says
    """

    corner: str = "tt"
    celsius: float = 27.0
    supply: float = 1.0
    sample: int | None = None

    @property
    def at(self) -> str:
        """As the command line takes it, without the sample."""
        return f"{self.corner},{self.celsius:g},{self.supply:g}"

    def __str__(self) -> str:
        return self.at + ("" if self.sample is None else f" sample {self.sample}")


@dataclass(frozen=True)
class Bench:
    """One deck and its quantities.

    Attributes
    ----------
    name : lower_snake
    body : the deck between the supplies and `.end`; supplies, vref (0.5 V), agnd and the current ibias are there
    values : module-level function from what the `.meas` found to the quantities
    units : quantity -> SI unit, of everything that `values` gives
    samples : mismatch moves its quantities, so it takes part in Monte Carlo
    limit_s : wall clock of one attempt of ngspice
    trtol : ngspice's factor on the truncation error that a step may have; its own is 7
    """

    name: str
    body: str
    values: Callable[[Found], dict[str, float]]
    units: Mapping[str, str]
    samples: bool = False
    limit_s: float = 150.0
    trtol: float = 7.0


def deck(body: str, condition: Condition, options: str = "", blocks: Path | None = None) -> str:
    """The whole deck of a bench at a condition.

    Parameters
    ----------
    body : as in Bench
    condition : models, temperature, supplies, mismatch
    options : further words for an `.options` line
    blocks : a changed copy of spice/sky130, to be measured in its place
    """
    seed = () if condition.sample is None else (f".options seed={condition.sample}",)
    return "\n".join(
        (
            "bench",
            *sky130.deck_head(condition.corner, condition.celsius, condition.sample is not None, blocks),
            *seed,
            *((f".options {options}",) if options else ()),
            *sky130.supplies(SUPPLY_V, -SUPPLY_V, condition.supply),
            *sky130.REFERENCE,
            sky130.bias_current("ibias"),
            body.strip(),
            *_logic(body, condition.supply),
            ".end\n",
        )
    )


def _logic(body: str, scale: float) -> list[str]:
    """Return the sources of the digital nets that a bench drives as logic_x with 0 and 1 V."""
    names = dict.fromkeys(re.findall(r"\bv\w+ logic_(\w+) ", body))
    return [sky130.logic(name, scale) for name in names]


_LINE = "xline ibias vdd vss bias_line\n"
"""The gate line of a channel, for benches of blocks by themselves."""

RAILS = "vdd vss vdd_d vss_d"


# ---- reference -----------------------------------------------------------------------------------------------

REFERENCE = f"""\
{_LINE}\
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xn v_unit ibias vss vss nmos_long
xnc out vcn v_unit vss nmos w=5 l=0.5
vx out 0 0
.dc vx 0 0.1 0.1
.meas dc i_unit find i(vx) at=0
"""


def reference(found: Found) -> dict[str, float]:
    """Current of a cascoded unit of the charge source against 5 uA."""
    return {"reference_error": -found["i_unit"] / 5e-6 - 1.0}


# ---- amplifier -----------------------------------------------------------------------------------------------

AMPLIFIER = f"""\
{_LINE}\
xdut inp inn out ibias vdd vss ota
vin inp 0 dc 0 ac 1
lback out inn 1e9
cback inn 0 1e3
cload out 0 3p
.save v(out)
.ac dec 40 1 1g
.meas ac gain_db find vdb(out) at=1
.meas ac gbw_hz when vdb(out)=0
.meas ac phase_rad find vp(out) when vdb(out)=0
"""


def amplifier(found: Found) -> dict[str, float]:
    """Gain at 1 Hz, where it is one, and how far the phase is from -180 degrees there."""
    return {
        "amplifier_gain_db": found["gain_db"],
        "amplifier_gbw_hz": found["gbw_hz"],
        "amplifier_phase_margin_deg": 180.0 + found["phase_rad"] * 57.29578,
    }


AMPLIFIER_OFFSET = f"""\
{_LINE}\
xdut 0 out out ibias vdd vss ota
vx x 0 0
.dc vx 0 1 1
.meas dc offset find v(out) at=0
"""


def amplifier_offset(found: Found) -> dict[str, float]:
    """Output of the amplifier closed on itself."""
    return {"amplifier_offset_v": found["offset"]}


# ---- conveyor and mirror -------------------------------------------------------------------------------------

SHARES = (0.0, 0.01, 0.02, 0.05, *(n / 10 for n in range(1, 11)))
"""Currents of a line, as shares of that at x = 1/2: evenly, and closer to 64.25 kohm, which is 0.0078."""

_CHAIN = """\
xline ibias vdd vss bias_line
vy y 0 0
ix 0 x 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum {mirror}
vsum sum 0 0
"""


def chain_full_a(k: int) -> float:
    """Current into the conveyor at x = 1/2, amperes."""
    return 12.5e-6 * k


def _sweep(k: int) -> str:
    full = chain_full_a(k)
    meas = "".join(
        f".meas dc {name}{n} find {what} at={full * share:.9g}\n"
        for n, share in enumerate(SHARES)
        for name, what in (("out", "i(vsum)"), ("x", "v(x)"))
    )
    return f".dc ix 0 {full * 1.01:.9g} {full / 100:.9g}\n{meas}"


def chain_body(k: int, devices: int | None = None) -> str:
    """Conveyor and mirror of a fixed ratio k; `devices`: number of input devices instead of k."""
    return _CHAIN.format(mirror=f"ibias vdd vss mirror_fixed k={devices or k}") + _sweep(k)


def chain_by_pins_body(k: int) -> str:
    """The same with the ratio chosen at the pins: 20, 40, 80, 160 are 0 .. 3 in the pins (d_k1 d_k0)."""
    choice = (20, 40, 80, 160).index(k)
    pins = f"vk0 logic_k0 0 {choice % 2}\nvk1 logic_k1 0 {choice // 2}\n"
    return _CHAIN.format(mirror=f"d_k0 d_k1 ibias {RAILS} mirror") + pins + _sweep(k)


def chain_lsb(found: Found) -> list[float]:
    """Output current at each of SHARES, in packets a gate."""
    return [found[f"out{n}"] / 25e-6 * 510 for n in range(len(SHARES))]


def _off_line(x: Sequence[float], y: Sequence[float]) -> list[float]:
    """Distance of each y from the line through the first and the last point."""
    slope = (y[-1] - y[0]) / (x[-1] - x[0])
    return [b - y[0] - slope * (a - x[0]) for a, b in zip(x, y, strict=True)]


def code_residual_lsb(found: Found, k: int) -> list[float]:
    """Return the code error of a taxel at each of SHARES after calibration of gain and offset of its column.

    A taxel of conductance G draws G (V_b - v(x)), with V_b = 0.5 V, so the input impedance of the conveyor matters.
    """
    siemens = [chain_full_a(k) * share / (0.5 - found[f"x{n}"]) for n, share in enumerate(SHARES)]
    return _off_line(siemens, chain_lsb(found))


def chain(found: Found, k: int) -> dict[str, float]:
    """Distance of the output from the line through both ends, that line, and the column's voltage."""
    lsb = chain_lsb(found)
    last = len(SHARES) - 1
    return {
        f"chain_inl_lsb.k{k}": max(map(abs, _off_line(SHARES, lsb))),
        f"chain_code_inl_lsb.k{k}": max(map(abs, code_residual_lsb(found, k))),
        f"chain_gain_error.k{k}": (lsb[-1] - lsb[0]) / 255.0 - 1.0,
        f"chain_offset_lsb.k{k}": lsb[0],
        f"conveyor_r_x_ohm.k{k}": (found[f"x{last}"] - found[f"x{last - 1}"]) / (0.1 * chain_full_a(k)),
        f"conveyor_v_offset_v.k{k}": found[f"x{last}"],
    }


_CHAIN_UNITS = {
    "chain_inl_lsb": "lsb",
    "chain_code_inl_lsb": "lsb",
    "chain_gain_error": "1",
    "chain_offset_lsb": "lsb",
    "conveyor_r_x_ohm": "ohm",
    "conveyor_v_offset_v": "V",
}


# ---- loop of the conveyor, pulse of the charge source ------------------------------------------------------------

# The amplifier answers y - x alone, so its loop gain is v(x) / (v(y) - v(x)). Capacitance of the column from that of a
# pad to seven times the design's; nothing pressed, where the pole of x is lowest, and 1 mA, where the loop is fastest.
LOOP_F = ("2p", "50p", "400p", "1n", "3n")
_LOOP_LOADS = {"idle": ("0", "1g"), "pressed": ("1m", "500")}
_LOOP_RUN = """\
alter ix dc = {i}
alter rx = {r}
alter cx = {c}
ac dec 40 1k 1g
let loop = v(x)/(1 - v(x))
let db = db(mag(loop))
let degrees = 57.29578*cph(loop)
meas ac {name} find degrees when db=0 fall=1
print {name}
"""
PHASE_MARGIN = (
    f"{_LINE}vy y 0 dc 0 ac 1\nix 0 x 0\nrx x 0 1g\ncx x 0 2p\nxconveyor y x z ibias vdd vss conveyor\nvz z 0 -0.6\n"
    ".control\n"
    + "".join(
        _LOOP_RUN.format(i=i, r=r, c=c, name=f"{load}_{c}")
        for load, (i, r) in _LOOP_LOADS.items()
        for c in LOOP_F
    )
    + "quit\n.endc\n"
)


def phase_margin(found: Found) -> dict[str, float]:
    """Phase of the conveyor's loop over -180 degrees where its gain is one, by load and capacitance."""
    return {f"phase_margin.{load}_{c}": 180.0 + found[f"{load}_{c}"] for load in _LOOP_LOADS for c in LOOP_F}


# Edges of the core's last flop. A pulse lasts from where the gates of the pair cross to where they cross again.
_PULSE_S, _EDGE_S = 200e-9, 0.2e-9
_PULSE = """\
xline ibias vdd vss bias_line
vcharge logic_charge 0 pwl(0 0 50n 0 {up!r} 1 {down!r} 1 {end!r} 0)
xdut d_charge out ibias vdd vss vdd_d vss_d {source}
vout out 0 0
.options reltol=1e-4
.tran 0.05n 270n 0 0.5n
.meas tran rise when v(xdut.on)=v(xdut.off) rise=1
.meas tran fall when v(xdut.on)=v(xdut.off) fall=1
"""


def pulse_body(source: str) -> str:
    """One pulse of a charge source."""
    up, down = 50e-9 + _EDGE_S, 50e-9 + _PULSE_S
    return _PULSE.format(up=up, down=down, end=down + _EDGE_S, source=source)


def pulse(found: Found, side: str) -> dict[str, float]:
    """Delay of the falling edge less that of the rising one, from d_charge to the gates of the pair."""
    return {f"pulse_asymmetry.{side}": found["fall"] - found["rise"] - _PULSE_S}


# ---- overload ------------------------------------------------------------------------------------------------

# One row, driven by its driver: a taxel that is too strong on column 0, 1 kohm on column 1, and 1 kohm from column to
# column. The swept source chooses 500 ohm, 100 ohm or a short of 10 mohm.
OVERLOADS = ("full", "100", "short")
OVERLOAD = f"""\
{_LINE}\
{sky130.bias_current("ibias1")}
xline1 ibias1 vdd vss bias_line
vs s 0 0
vb vb 0 0.5
vrow logic_row 0 1
xdriver d_row row vb 0 {RAILS} row_driver
bstrong row x i = (v(row) - v(x))*(v(s) < 0.5 ? 2m : (v(s) < 1.5 ? 10m : 100))
rside x x1 1k
rtaxel row x1 1k
vy y 0 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum ibias vdd vss mirror_fixed
vsum sum 0 0
xconveyor1 y x1 z1 ibias1 vdd vss conveyor
xmirror1 z1 sum1 ibias1 vdd vss mirror_fixed
vsum1 sum1 0 0
.dc vs 0 2 0.1
"""
OVERLOAD += "".join(
    f".meas dc {name}{n} find {what} at={n}\n"
    for n in range(len(OVERLOADS))
    for name, what in (("x", "v(x)"), ("row", "v(row)"), ("out", "i(vsum1)"))
)


def overload(found: Found) -> dict[str, float]:
    """Return the voltage of the column of a strong taxel, and what its neighbour reads more than at 500 ohm."""
    codes = [found[f"out{n}"] / 25e-6 * 510 for n in range(len(OVERLOADS))]
    volts = {f"overload_column_v.{name}": found[f"x{n}"] for n, name in enumerate(OVERLOADS)}
    return volts | {
        "overload_row_v.short": found["row2"],
        "overload_neighbour": codes[1] - codes[0],
        "short_neighbour": codes[2] - codes[0],
    }


# ---- start-up ------------------------------------------------------------------------------------------------

# A bank of its own behind d_enable, which goes high at 1 us: its output feeds the line of a channel. Gear's formula,
# because trapezoids of 100 ns ring for ever on the cascode's node of 2 ns.
START_UP = f"""\
{_LINE}\
venable logic_enable 0 pwl(0 0 1u 0 1.01u 1)
rref_own r_own 0 50k
xbank vref r_own gate cp vdd vss bias
xenable d_enable gate {RAILS} power_down
xout gate cp ibias_own vdd bias_output
xline_own ibias_own vdd vss bias_line
xbias_cn_p ibias_own vbp_own vdd vss bias_p
xbias_cn vbp_own vcn_own vdd vss bias_cascode_n
xn v_unit ibias_own vss vss nmos_long k=5
xnc packet vcn_own v_unit vss nmos w=5 l=0.5 k=5
vpacket packet 0 0
.save i(vpacket)
.options reltol=1e-4 method=gear
.tran 100n 201u
.meas tran off find i(vpacket) at=0.9u
.meas tran end find i(vpacket) at=200u
.meas tran low when i(vpacket)=-24.75u cross=last
"""


def start_up(found: Found) -> dict[str, float]:
    """Return the time from enable to 99 % of the current of a packet, and that current off and at the end."""
    return {
        "start_up_s": found["low"] - 1e-6,
        "start_up_off_a": -found["off"],
        "start_up_error": -found["end"] / 25e-6 - 1.0,
    }


# ---- wires ---------------------------------------------------------------------------------------------------

# Sixteen columns at direct current, each with a bias current of its own. Column 0 has a taxel of 1 kohm and 14 of 500
# ohm on held rows; the other 15 go from 0 to 1 mA. The charge sources are on. All share 1 ohm in each return, or in the
# mid rail; rows, vbias and the reference are at the pads. The offset null, which has no direct path, is left out: it
# takes away what moves the column.
WIRE_OHM = 1.0
OTHERS = 15


def crosstalk_body(wire: str) -> str:
    """Column 0 among 15 others, `WIRE_OHM` in the wires of all: "return" is vss and vdd, "mid_rail" is agnd."""
    ohm = {name: WIRE_OHM if wire == kind else 1e-3 for kind, name in (("return", "s"), ("mid_rail", "a"))}
    rails = "vdd_c vss_c vdd_d vss_d"
    lines = [
        f"rvss vss_c vss {ohm['s']}",
        f"rvdd vdd_c vdd {ohm['s']}",
        f"ragnd agnd_c agnd {ohm['a']}",
        "vs s 0 0",
        "vhold logic_hold 0 1",
        "vcharge logic_charge 0 1",
        "vrow row 0 0.5",
        "rrow row col 1k",
        f"rheld col 0 {500 / 14!r}",
        "xline ibias vdd_c vss_c bias_line",
        "xconveyor agnd_c col z ibias vdd_c vss_c conveyor",
        "xmirror z out ibias vdd_c vss_c mirror_fixed",
        "vout out sum 0",
        f"xcharge d_charge packet ibias {rails} charge_source",
        "vpacket packet sum 0",
        f"xintegrator sum agnd_c d_hold v_int vref ibias {rails} integrator",
    ]
    for n in range(1, OTHERS + 1):
        lines += [
            sky130.bias_current(f"ibias{n}"),
            f"bcol{n} 0 col{n} i = v(s)*1e-3",
            f"xline{n} ibias{n} vdd_c vss_c bias_line",
            f"xconveyor{n} agnd_c col{n} z{n} ibias{n} vdd_c vss_c conveyor",
            f"xmirror{n} z{n} sum{n} ibias{n} vdd_c vss_c mirror_fixed",
            f"xcharge{n} d_charge sum{n} ibias{n} {rails} charge_source",
            f"xintegrator{n} sum{n} agnd_c d_hold v_int{n} vref ibias{n} {rails} integrator",
        ]
    meas = "".join(
        f".meas dc {name}_{when} find i(v{name}) at={at}\n"
        for name in ("out", "packet")
        for when, at in (("idle", 0), ("pressed", 1))
    )
    return "\n".join(lines) + f"\n.dc vs 0 1 0.25\n{meas}"


def crosstalk(found: Found, wire: str) -> dict[str, float]:
    """Change of the code of column 0."""
    idle, pressed = (found[f"out_{when}"] / -found[f"packet_{when}"] for when in ("idle", "pressed"))
    return {f"{wire}_crosstalk": 510.0 * (pressed - idle)}


# ---- integrator, comparator and charge source ----------------------------------------------------------------

# A charge of 1 us into 5 pF, then a packet: slopes and steps of the integrator are the currents, its first value
# the preset.
_VFC = """\
vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0)
vcharge logic_charge 0 pwl(0 0 2u 0 2.001u 1 2.2u 1 2.201u 0)
iin 0 sum {i_in}
xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {vfc}
.tran 10n 3.2u
.meas tran v_0 find v(xdut.v_int) at=1.1u
.meas tran v_1 find v(xdut.v_int) at=1.9u
.meas tran v_2 find v(xdut.v_int) at=2.3u
.meas tran v_3 find v(xdut.v_int) at=3.1u
.meas tran comp_0 find v(comp) at=0.9u
.meas tran comp_1 find v(comp) at=1.95u
.meas tran comp_2 find v(comp) at=3.1u
"""
_SLOPE_V_S = 0.68e6  # 3.4 uA on 5 pF


def vfc_body(polarity: int) -> str:
    """Integrator, comparator and charge source of a polarity."""
    return _LINE + _VFC.format(i_in=polarity * _SLOPE_V_S * 5e-12, vfc=_vfc(polarity))


def _vfc(polarity: int) -> str:
    return "vfc" if polarity > 0 else "vfc_inverted"


def vfc(found: Found, polarity: int) -> dict[str, float]:
    """Preset, slope and packet; the preset is half a packet less the charge of the 99 ns after its release."""
    side = "sink" if polarity > 0 else "source"
    slope = (found["v_0"] - found["v_1"]) / 0.8e-6 * polarity
    packet = (found["v_2"] - found["v_1"]) * polarity + slope * 0.4e-6
    return {
        f"capacitor_error.{side}": _SLOPE_V_S / slope - 1.0,
        f"preset_error_v.{side}": polarity * found["v_0"] + _SLOPE_V_S * 0.0995e-6 - 0.5,
        f"packet_error.{side}": packet * (_SLOPE_V_S / slope) - 1.0,
    }


_VFC_UNITS = {"capacitor_error": "1", "preset_error_v": "V", "packet_error": "1"}

# Packets in the rhythms of x = 1/2 and x = 1/10, the input current with them: what the integrator gains over whole
# periods is the packet less the input's charge, so it says how much smaller a packet in a crowd is.
_T_CLK_S = 200e-9
_DENSE_S, _SPARSE_S = (1.1e-6, 1.5e-6, 1.9e-6, 2.3e-6), (3.2e-6, 5.2e-6)
_DENSITY = """\
vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0)
vcharge logic_charge 0 pwl(0 0 {packets})
iin 0 sum pwl(0 {dense} 2.7u {dense} 2.701u {sparse})
xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {vfc}
.tran 10n 7.2u
.meas tran dense_0 find v(xdut.v_int) at=1.49u
.meas tran dense_1 find v(xdut.v_int) at=2.69u
.meas tran sparse_0 find v(xdut.v_int) at=5.19u
.meas tran sparse_1 find v(xdut.v_int) at=7.19u
"""


def density_body(polarity: int) -> str:
    """Three packets in the rhythm of x = 1/2, then one in that of x = 1/10."""
    packets = " ".join(
        f"{t:.9g} 0 {t + 1e-9:.9g} 1 {t + _T_CLK_S:.9g} 1 {t + _T_CLK_S + 1e-9:.9g} 0"
        for t in (*_DENSE_S, *_SPARSE_S)
    )
    dense, sparse = polarity * 12.5e-6, polarity * 2.5e-6
    return _LINE + _DENSITY.format(packets=packets, dense=dense, sparse=sparse, vfc=_vfc(polarity))


def density(found: Found, polarity: int) -> dict[str, float]:
    """How far the middle of the range is off the line through its ends, where a packet shrinks with their rate.

    With a packet q (1 + e x / (1/2)) the count is x (1 - 2 e x), whose distance from the line through 0 and x = 1/2 is
    e / 8 of a packet a clock at x = 1/4, 510 e / 8 codes; e is what the two rhythms differ by, over the 4/5 of the
    range that lie between them.
    """
    c_f = 5e-12
    dense = 12.5e-6 * 2 * _T_CLK_S + polarity * c_f * (found["dense_1"] - found["dense_0"]) / 3
    sparse = 2.5e-6 * 10 * _T_CLK_S + polarity * c_f * (found["sparse_1"] - found["sparse_0"])
    side = "sink" if polarity > 0 else "source"
    return {f"packet_density_lsb.{side}": 510 / 8 * (dense / sparse - 1.0) / 0.8}


COMPARATOR = f"""\
{_LINE}\
vin inn 0 pwl(0 0.1 100n 0.1 300n -0.4)
xdut 0 inn out ibias vdd vss comparator
cout out 0 50f
.tran 2n 1.2u
.meas tran late when v(out)=0 rise=1
"""


def comparator(found: Found) -> dict[str, float]:
    """From where the ramp of 0.5 V a clock passes the other input; an offset of 1 mV is 0.4 ns of it."""
    return {"comparator_delay_s": found["late"] - 140e-9}


# A level that moves by 10 mV moves where a count begins by 0.01 packet: half a millivolt is fine enough a step.
COMPARATOR_OFFSET = f"""\
{_LINE}\
vin inn 0 0
xdut 0 inn out ibias vdd vss comparator
.dc vin -50m 50m 0.5m
.meas dc offset when v(out)=0
"""


def comparator_offset(found: Found) -> dict[str, float]:
    """Input at which the output is half way."""
    return {"comparator_offset_v": found["offset"]}


# ---- conveyor with two outputs, direct interface -------------------------------------------------------------

MULTI = f"""\
{_LINE}\
vy y 0 0
ix 0 x 0
xconveyor y x zp zn ibias vdd vss conveyor_multi
vzp zp 0 0
vzn 0 zn 0
.dc ix 0 1.01m 0.1m
{"".join(f".meas dc {side}{n} find i(v{side}) at={n}e-4{chr(10)}" for side in ("zp", "zn") for n in range(11))}"""


def multi(found: Found) -> dict[str, float]:
    """Both outputs as `chain` has the mirror's: distance from the line through its ends, that line."""
    values = {}
    for side in ("zp", "zn"):
        lsb = [found[f"{side}{n}"] / 25e-6 * 510 for n in range(11)]
        values[f"chain_inl_lsb.{side}"] = max(map(abs, _off_line(range(11), lsb)))
        values[f"chain_gain_error.{side}"] = (lsb[-1] - lsb[0]) / 255.0 - 1.0
        values[f"chain_offset_lsb.{side}"] = lsb[0]
    return values


# The bench of the VFC with 80 times the current, on the column's 400 pF.
DIRECT = _VFC.replace(
    "xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {vfc}",
    "ccolumn sum 0 400p\nxdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d channel_direct",
).format(i_in=80 * _SLOPE_V_S * 5e-12)
# With 1e-3, edges of 400 sources cost a packet 0.3 codes at ss, -40 C, 0.9.
DIRECT += ".options reltol=1e-4\n"


def direct(found: Found) -> dict[str, float]:
    """As `vfc`, of the interface without conveyor and mirror."""
    return {name.replace("sink", "direct"): value for name, value in vfc(found, 1).items()}


# ---- column: offset, input resistance, settling --------------------------------------------------------------

# A column of 16 taxels of 500 ohm, one of them driven. 3 mV in series with y stand for the conveyor, so that
# there is something to null where mismatch draws nothing; the first gate finds y, the second is as all others.
_OFFSET_V = 3e-3
COLUMN = f"""\
{_LINE}\
vpreset logic_preset 0 pwl(0 1 5u 1 5.001u 0 45u 0 45.001u 1 68u 1 68.001u 0)
vrow row 0 0.5
rrow row x 500
rheld x 0 33.333
cx x 0 400p
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
voffset y y_off {_OFFSET_V}
xconveyor y_off x z ibias vdd vss conveyor
vz z 0 -0.6
.save v(x) v(y)
.tran 50n 101u
.meas tran raw find v(x) at=4.9u
.meas tran first find v(x) at=44u
.meas tran held find v(x) at=67.9u
.meas tran second find v(x) at=100u
"""


def column(found: Found) -> dict[str, float]:
    """Voltage of the column less the seeded offset before the first gate, and at the end of two gates and between."""
    return {
        "column_raw_offset_v": found["raw"] + _OFFSET_V,
        "column_offset_v": max(found["first"], found["second"], key=abs),
        "column_held_offset_v": found["held"],
    }


R_X_HZ = (100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000)
R_X = f"""\
{_LINE}\
vy y 0 0
ix 0 x dc 1m ac 1
xconveyor y x z ibias vdd vss conveyor
cx x 0 400p
vz z 0 -0.6
.save v(x)
.ac dec 20 100 11meg
{"".join(f".meas ac r{f} find vm(x) at={f}{chr(10)}" for f in R_X_HZ)}"""


def r_x(found: Found) -> dict[str, float]:
    """Impedance at the column at 1 mA, with its 400 pF and without the offset null."""
    return {f"r_x_ohm.f{f}": found[f"r{f}"] for f in R_X_HZ}


SETTLING_NS = (1000, 2000, 3000, 5000, 8000, 11000, 14000)
# Two taxels at the ends of the range, the other 14 pressed. The second slot begins at 45 us; its gate 115 clocks later,
# 14.375 us at 8 MHz and 23 us at 5 MHz. Its count is the integral of the current over its gate.
_SETTLING = """xline ibias vdd vss bias_line
vpreset logic_preset 0 pwl(0 1 5u 1 5.001u 0 45u 0 45.001u 1 59.375u 1 59.376u 0)
vone one 0 pwl(0 {one} 45u {one} 45.001u 0 45.2u 0 45.201u {other})
vother other 0 pwl(0 {other} 45u {other} 45.001u 0 45.2u 0 45.201u {one})
rone one x 500
rother other x 64.25k
rheld x 0 35.714
cx x 0 400p
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor y x z ibias vdd vss conveyor
xmirror z sum ibias vdd vss mirror_fixed k=80
vsum sum 0 0
.save i(vsum) v(x) v(y)
.tran 50n 171u
.meas tran i_end find i(vsum) at=170.9u
.meas tran fast integ i(vsum) from=59.375u to=123.125u
.meas tran slow integ i(vsum) from=68u to=170u
"""


def settling_body(side: str) -> str:
    """A row of 64.25 kohm after one of 500 ohm ("low"), or the reverse ("high")."""
    one, other = (0.5, 0) if side == "low" else (0, 0.5)
    times = "".join(f".meas tran x{t} find v(x) at={45200 + t}n\n" for t in SETTLING_NS)
    return _SETTLING.format(one=one, other=other) + times


def settling(found: Found, side: str) -> dict[str, float]:
    """Packets that the way to the last current adds to a gate, at both clocks, and the column on that way."""
    lsb = {
        f"settling_lsb.{side}_{mhz}mhz": (found[name] / (510 / (mhz * 1e6)) - found["i_end"]) / 25e-6 * 510
        for mhz, name in ((5, "slow"), (8, "fast"))
    }
    volts = {f"settling_v.t{t}": found[f"x{t}"] for t in SETTLING_NS} if side == "low" else {}
    return lsb | volts


# ---- supply --------------------------------------------------------------------------------------------------

TOPOLOGIES = ("direct", "conveyor_mirror", "conveyor_mirror_inverted", "multi_output_conveyor")
_SUPPLY = """vpreset logic_preset 0 1
vcharge logic_charge 0 0
vchannel vdd vdd_c 0
vreturn vss_c vss 0
ix 0 col 0
xdut col d_charge d_preset comp vref agnd ibias vdd_c vss_c vdd_d vss_d channel_{topology}
.dc ix 0 1.01m 0.1m
.meas dc idle find i(vchannel) at=0
.meas dc pressed find i(vreturn) at=1m
.meas dc all find i(vdd) at=0
"""


def supply_body(topology: str) -> str:
    """A channel with separate rails; the reference uses those of the deck."""
    return _SUPPLY.format(topology=topology)


def supply(found: Found, topology: str) -> dict[str, float]:
    """A channel's current from vdd, and into vss less a taxel's; what a chip takes to vss in its worst row.

    A sinking charge source takes its current from the 0 V rail to vss, so it is in the second alone.
    """
    reference_a = -found["all"] - found["idle"]
    return {
        f"supply_channel_a.{topology}": found["idle"],
        f"supply_channel_vss_a.{topology}": found["pressed"] - 1e-3,
        f"supply_array_a.{topology}": 16 * found["pressed"] + reference_a,
    }


_BLOCKS = {
    "offset_null": "col y d_preset agnd ibias vdd_offset_null vss vdd_d vss_d offset_null",
    "conveyor": "y col z ibias vdd_conveyor vss conveyor",
    "mirror": "z sum ibias vdd_mirror vss mirror_fixed",
    "integrator": "sum agnd d_preset v_int vref ibias vdd_integrator vss vdd_d vss_d integrator",
    "charge_source": "d_charge sum ibias vdd_charge_source vss vdd_d vss_d charge_source",
    "comparator": "0 v_int comp ibias vdd_comparator vss comparator",
}
SUPPLY_BLOCKS = (
    _LINE
    + "vpreset logic_preset 0 1\nvcharge logic_charge 0 0\nix 0 col 0\n.dc ix 0 1u 1u\n"
    + "".join(f"v{name} vdd vdd_{name} 0\nx{name} {pins}\n" for name, pins in _BLOCKS.items())
    + "".join(f".meas dc {name} find i(v{name}) at=0\n" for name in _BLOCKS)
)


def supply_blocks(found: Found) -> dict[str, float]:
    """Current of each block of a channel from vdd."""
    return {f"supply_block_a.{name}": found[name] for name in _BLOCKS}


# ---- noise ---------------------------------------------------------------------------------------------------

# A gate of 102 us takes the mean of the current: its square is the spectrum times sinc^2(f T), from a drift of a second
# up to 1 MHz, where sinc^2 is 1e-5. The sum runs over a fine logarithmic grid.
_NOISE = """\
xline ibias vdd vss bias_line
{dut}
.control
noise v(out) {source} dec 100 1 {highest}
setplot noise1
let turn = 3.14159265 * frequency * 102u
let s = sin(turn) / turn
let power = onoise_spectrum^2 * ({share})
let rms = sqrt(vecmax(integ(power)))
print rms
quit
.endc
"""
_CURRENT = "vsum sum 0 0\nhout out 0 vsum 1\n"


def noise_body(i: str, r: str) -> str:
    """Conveyor and mirror with a taxel and its current.

    No other taxel is pressed: where 32 mS turn the conveyor's noise into current, the offset null holds the column, and
    its noise (`noise_null`) takes the place of the conveyor's below 80 kHz, above which a gate averages.
    """
    dut = _CURRENT + (
        f"ix 0 x dc {i} ac 1\nrx x 0 {r}\ncx x 0 400p\nvy y 0 0\nxconveyor y x z ibias vdd vss conveyor\n"
        "xmirror z sum ibias vdd vss mirror_fixed k=80"
    )
    return _NOISE.format(dut=dut, source="ix", share="s^2", highest="1meg")


NOISE_PACKET = _NOISE.format(
    dut=_CURRENT
    + f"vc d_charge vss_d dc {sky130.V_DIGITAL_V} ac 1\nxdut d_charge sum ibias vdd vss vdd_d vss_d charge_source",
    source="vc",
    share="s^2",
    highest="1meg",
)
# The value that the offset null stores when a gate begins, less the mean of the same noise over the gate:
# 1 - sinc exp(-j pi f T).
# Stored and followed are both through the pole of the amplifier on 20 pF, across which it stands while it is closed
# on itself.
NOISE_NULL = _NOISE.format(
    dut="vpreset logic_preset 0 dc 1 ac 1\nxdut 0 y d_preset agnd ibias vdd vss vdd_d vss_d offset_null\n"
    "eout out 0 xdut.v_in xdut.v_side 1",
    source="vpreset",
    share="1 + s^2 - 2*s*cos(turn)",
    highest="100meg",
)


def noise(found: Found, at: str) -> dict[str, float]:
    """Rms of a code, from the mean current of a gate."""
    return {f"noise_lsb.{at}": found["rms"] / 25e-6 * 510}


def noise_null(found: Found) -> dict[str, float]:
    """Rms of a code of a column of 16 taxels of 500 ohm, whose 32 mS turn a voltage into a current."""
    return {"noise_lsb.null": found["rms"] * 16 / 500 / 80 / 25e-6 * 510}


# ---- row driver ----------------------------------------------------------------------------------------------


def row_driver_body(driven: int) -> str:
    """The current of a whole row, out of the driver."""
    return (
        f"vd logic_row 0 {driven}\nvb vb 0 0.5\nxdut d_row row vb 0 vdd vss vdd_d vss_d row_driver\nil row 0 0\n"
        ".dc il 0 16m 16m\n.meas dc none find v(row) at=0\n.meas dc full find v(row) at=0.016"
    )


def row_driver(found: Found, side: str) -> dict[str, float]:
    """Voltage drop of a row at 16 mA, over that current."""
    return {f"row_driver_r_ohm.{side}": (found["none"] - found["full"]) / 16e-3}


# With 7 the edges of charge and preset cost a packet 0.31 codes at ss, -40 C, 0.9; with 1 it is 0.03.
_EDGES_TRTOL = 1.0

# ---- all -----------------------------------------------------------------------------------------------------


def _with(units: Mapping[str, str], suffix: str) -> dict[str, str]:
    return {f"{name}.{suffix}": unit for name, unit in units.items()}


_COLUMN_UNITS = dict.fromkeys(("column_raw_offset_v", "column_offset_v", "column_held_offset_v"), "V")


def _multi_units() -> dict[str, str]:
    kinds = {"chain_inl_lsb": "lsb", "chain_gain_error": "1", "chain_offset_lsb": "lsb"}
    return _with(kinds, "zp") | _with(kinds, "zn")


def _settling_units(side: str) -> dict[str, str]:
    volts = {f"settling_v.t{t}": "V" for t in SETTLING_NS} if side == "low" else {}
    return {f"settling_lsb.{side}_{mhz}mhz": "lsb" for mhz in (5, 8)} | volts


_ALL = (
    Bench("reference", REFERENCE, reference, {"reference_error": "1"}, samples=True),
    Bench(
        "amplifier",
        AMPLIFIER,
        amplifier,
        {"amplifier_gain_db": "dB", "amplifier_gbw_hz": "Hz", "amplifier_phase_margin_deg": "deg"},
    ),
    Bench("amplifier_offset", AMPLIFIER_OFFSET, amplifier_offset, {"amplifier_offset_v": "V"}, samples=True),
    Bench("chain_k80", chain_body(80), partial(chain, k=80), _with(_CHAIN_UNITS, "k80"), samples=True),
    *(
        Bench(f"chain_k{k}", chain_by_pins_body(k), partial(chain, k=k), _with(_CHAIN_UNITS, f"k{k}"))
        for k in (20, 40, 160)
    ),
    Bench(
        "vfc_sink",
        vfc_body(1),
        partial(vfc, polarity=1),
        _with(_VFC_UNITS, "sink"),
        samples=True,
        trtol=_EDGES_TRTOL,
    ),
    Bench(
        "vfc_source",
        vfc_body(-1),
        partial(vfc, polarity=-1),
        _with(_VFC_UNITS, "source"),
        samples=True,
        trtol=_EDGES_TRTOL,
    ),
    Bench("comparator", COMPARATOR, comparator, {"comparator_delay_s": "s"}, samples=True),
    Bench(
        "comparator_offset",
        COMPARATOR_OFFSET,
        comparator_offset,
        {"comparator_offset_v": "V"},
        samples=True,
    ),
    *(
        Bench(
            f"density_{side}",
            density_body(polarity),
            partial(density, polarity=polarity),
            {f"packet_density_lsb.{side}": "lsb"},
        )
        for polarity, side in ((1, "sink"), (-1, "source"))
    ),
    Bench("conveyor_multi", MULTI, multi, _multi_units(), samples=True),
    Bench("direct", DIRECT, direct, _with(_VFC_UNITS, "direct"), samples=True, trtol=_EDGES_TRTOL),
    Bench("column", COLUMN, column, _COLUMN_UNITS, samples=True),
    Bench(
        "phase_margin",
        PHASE_MARGIN,
        phase_margin,
        {f"phase_margin.{load}_{c}": "deg" for load in _LOOP_LOADS for c in LOOP_F},
    ),
    *(
        Bench(
            f"pulse_{side}",
            pulse_body(source),
            partial(pulse, side=side),
            {f"pulse_asymmetry.{side}": "s"},
            trtol=1.0,
        )
        for side, source in (("sink", "charge_source"), ("source", "charge_source_inverted"))
    ),
    *(
        Bench(
            f"{wire}_crosstalk",
            crosstalk_body(wire),
            partial(crosstalk, wire=wire),
            {f"{wire}_crosstalk": "lsb"},
        )
        for wire in ("return", "mid_rail")
    ),
    Bench(
        "overload",
        OVERLOAD,
        overload,
        dict.fromkeys((f"overload_column_v.{name}" for name in OVERLOADS), "V")
        | {"overload_row_v.short": "V", "overload_neighbour": "lsb", "short_neighbour": "lsb"},
    ),
    Bench(
        "start_up",
        START_UP,
        start_up,
        {"start_up_s": "s", "start_up_off_a": "A", "start_up_error": "1"},
    ),
    Bench("r_x", R_X, r_x, {f"r_x_ohm.f{f}": "ohm" for f in R_X_HZ}),
    *(
        Bench(f"settling_{side}", settling_body(side), partial(settling, side=side), _settling_units(side))
        for side in ("low", "high")
    ),
    *(
        Bench(
            f"supply_{topology}",
            supply_body(topology),
            partial(supply, topology=topology),
            {f"supply_{what}_a.{topology}": "A" for what in ("channel", "channel_vss", "array")},
        )
        for topology in TOPOLOGIES
    ),
    Bench("supply_blocks", SUPPLY_BLOCKS, supply_blocks, {f"supply_block_a.{name}": "A" for name in _BLOCKS}),
    *(
        Bench(f"noise_{at}", noise_body(i, r), partial(noise, at=at), {f"noise_lsb.{at}": "lsb"})
        for at, i, r in (("full", "1m", "500"), ("low", "7.8u", "64.25k"))
    ),
    Bench("noise_null", NOISE_NULL, noise_null, {"noise_lsb.null": "lsb"}),
    Bench("noise_packet", NOISE_PACKET, partial(noise, at="packet"), {"noise_lsb.packet": "lsb"}),
    *(
        Bench(
            f"row_driver_{side}",
            row_driver_body(driven),
            partial(row_driver, side=side),
            {f"row_driver_r_ohm.{side}": "ohm"},
        )
        for driven, side in ((1, "driven"), (0, "held"))
    ),
)
BENCHES: dict[str, Bench] = {bench.name: bench for bench in _ALL}

# Codes of 255 that a unit of a quantity is worth at x = 1/2, where it is worth most; by name up to the first dot.
CODES_A_UNIT: dict[str, float] = {
    "packet_error": 255.0,
    "chain_gain_error": 255.0,
    "reference_error": 255.0,
    "chain_inl_lsb": 1.0,
    "chain_offset_lsb": 1.0,
    "chain_code_inl_lsb": 1.0,
    "packet_density_lsb": 1.0,
    # A pulse longer by 1 ns of 200 is a packet larger by 0.5 %.
    "pulse_asymmetry": 255.0 / _PULSE_S,
    # Where a count begins, in packets of 1 V; the capacitor decides what half a volt of preset is in packets.
    "preset_error_v": 1.0,
    "capacitor_error": 0.5,
    "comparator_offset_v": 1.0,
    # On 16 taxels of 500 ohm, 32 mS.
    "column_offset_v": 16 / 500 / 80 / 25e-6 * 510,
    "settling_lsb": 1.0,
    "start_up_error": 255.0,
    # A late decision is x packets a clock of 200 ns late.
    "comparator_delay_s": 0.5 / 200e-9,
}

# Total nonlinearity of a code: conveyor and mirror, and packets; sums of magnitudes, in lsb.
SUMS: dict[str, tuple[str, ...]] = {
    f"code_inl_lsb.{side}": ("chain_code_inl_lsb.k80", f"packet_density_lsb.{side}")
    for side in ("sink", "source")
}
