# SPDX-License-Identifier: Apache-2.0
"""Benches of the blocks in SKY130 transistors: a deck each, and the quantities from its `.meas`.

docs/characterise.md says what a bench is made of. Models, temperature, supplies, reference and mismatch are not
in it: they come before it in the deck (`deck`).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from dermis.chip import sky130
from dermis.scene.design import ROOT, TOPOLOGIES, load

DECKS = ROOT / "spice" / "characterise"
SUPPLY_V = 1.65
"""Half the nominal supply: the rails are at plus and minus this (docs/sky130.md)."""
RAILS = "vdd vss vdd_d vss_d"

Found = Mapping[str, float]
"""Results of the `.meas` of a deck, by lower-case name."""
Values = Callable[[Found], dict[str, float]]


@dataclass(frozen=True)
class Condition:
    corner: str = "tt"  # one of sky130.CORNERS or PASSIVE_CORNERS
    celsius: float = 27.0
    supply: float = 1.0  # both rails, as a share of their nominal value
    sample: int | None = None  # seed of the mismatch, from 1 on; None: every device is as its corner says

    @property
    def at(self) -> str:
        """As the command line takes it, without the sample."""
        return f"{self.corner},{self.celsius:g},{self.supply:g}"

    def __str__(self) -> str:
        return self.at + ("" if self.sample is None else f" sample {self.sample}")


@dataclass(frozen=True)
class Bench:
    """One deck and its quantities."""

    body: str  # between the supplies and `.end`; supplies, vref (0.5 V), agnd and the current ibias are there
    values: Values
    units: Mapping[str, str]  # quantity -> SI unit, of everything that `values` gives
    samples: bool = False  # mismatch moves its quantities, so it takes part in Monte Carlo
    trtol: float = 7.0  # ngspice's factor on the truncation error that a step may have; its own is 7


def body(name: str, **fields: object) -> str:
    """Return a deck of spice/characterise without comments, with its fields filled in."""
    lines = (DECKS / f"{name}.sp").read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if line[0] != "*").format_map(fields)


def deck(body: str, condition: Condition, options: str = "", blocks: Path | None = None) -> str:
    """Return the whole deck of a bench at a condition, with further words for an `.options` line.

    `blocks` is a changed copy of spice/sky130, to be measured in its place.
    """
    # The sources of the digital nets that a bench drives as logic_x with 0 and 1 V.
    driven = dict.fromkeys(re.findall(r"\bv\w+ logic_(\w+) ", body))
    seed = "" if condition.sample is None else f"seed={condition.sample}"
    lines = [
        "bench",
        *sky130.deck_head(condition.corner, condition.celsius, condition.sample is not None, blocks),
        *(f".options {words}" for words in (seed, options) if words),
        *sky130.supplies(SUPPLY_V, -SUPPLY_V, condition.supply),
        *sky130.REFERENCE,
        sky130.bias_current("ibias"),
        body.strip(),
        *(sky130.logic(name, condition.supply) for name in driven),
        ".end\n",
    ]
    return "\n".join(lines)


def _finds(places: Sequence[float], nets: Mapping[str, str]) -> str:
    """Return a `.meas` for each net at each place of a sweep, named by net and number of place."""
    found = ((n, place, name, net) for n, place in enumerate(places) for name, net in nets.items())
    return "\n".join(f".meas dc {name}{n} find {net} at={place:.9g}" for n, place, name, net in found)


def _lsb(current_a: float) -> float:
    """Return an output current in packets a gate."""
    return current_a / 25e-6 * 510


AMPLIFIER, AMPLIFIER_OFFSET = body("amplifier"), body("amplifier_offset")


def amplifier(found: Found) -> dict[str, float]:
    """Return the gain at 1 Hz, the frequency of gain one, and the phase margin there."""
    return {
        "amplifier_gain_db": found["gain_db"],
        "amplifier_gbw_hz": found["gbw_hz"],
        "amplifier_phase_margin_deg": 180.0 + found["phase_rad"] * 57.29578,
    }


def level(found: Found, block: str, nominal_v: float = 0.0, measured: str = "level") -> dict[str, float]:
    """Return the voltage at which a block's output turns, or that it puts out closed on itself, over a nominal one."""
    return {f"{block}_v": found[measured] - nominal_v}


amplifier_offset = partial(level, block="amplifier_offset", measured="offset")


def row_driver_body(driven: int) -> str:
    """Return the deck of a row driver that is on (1) or grounds its row (0)."""
    return body("row_driver", driven=driven).strip()


def row_driver(found: Found, side: str) -> dict[str, float]:
    """Return the voltage drop of a row at 16 mA, over that current."""
    return {f"row_driver_r_ohm.{side}": (found["none"] - found["full"]) / 16e-3}


def row_change(found: Found) -> dict[str, float]:
    """Return the largest current from the bias at a change of rows, and what of it goes to agnd, with both delays."""
    return {
        "row_change_peak_ma": -1e3 * found["lowest"],
        "row_change_through_ma": 1e3 * found["through"],
        "row_change_s.up": found["up"] - 100e-9,
        "row_change_s.down": found["down"] - 600e-9,
    }


def esd_clamp(found: Found) -> dict[str, float]:
    """Return what the clamp takes of a discharge, of a supply that rises in 10 us and at rest, and diodes at 10 mA."""
    return {f"esd_clamp_a.{name}": -found[name] for name in ("zap", "ramp", "rest")} | {
        f"esd_pad_v.{name}": found[name] for name in ("up", "down")
    }


ORDERS = {
    "analog_first": ("now", "later"), "digital_first": ("later", "now"), "together": ("now", "now"),
    "no_digital": ("now", "never"), "no_analog": ("never", "now"),
}  # fmt: skip
"""Ramps of the analog and of the digital supply."""


def _sequencing_body(ramp_s: float) -> str:
    times = {"ramp": ramp_s, "late": 2 * ramp_s, "end": 3 * ramp_s, "step": ramp_s / 50, "stop": 4 * ramp_s}
    given = {name: f"{value:.9g}" for name, value in times.items()}
    ways = [
        {"order": f"{order}_{wanted}", "analog": analog, "digital": digital, "wanted": wanted}
        for order, (analog, digital) in ORDERS.items()
        for wanted in (0, 1)
    ]
    return body("sequencing", ways="".join(body("sequencing_way", **way, **given) for way in ways), **given)


def sequencing(found: Found, ramp: str) -> dict[str, float]:
    """Return the largest current of 16 rows and columns from the bias while supplies come up, by order."""
    looked = ("through", 0), *((name, wanted) for name in ("before", "end") for wanted in (0, 1))
    return {
        f"sequencing_ma.{order}_{ramp}": 16e3
        * max(abs(found[f"{name}_{order}_{wanted}"]) for name, wanted in looked)
        for order in ORDERS
    }


SHARES = (0.0, 0.01, 0.02, 0.05, *(n / 10 for n in range(1, 11)))
"""Currents of a line, as shares of that at x = 1/2: evenly, and closer to 64.25 kohm, which is 0.0078."""


def chain_full_a(k: int) -> float:
    """Return the current into the conveyor at x = 1/2, amperes."""
    return 12.5e-6 * k


def _chain(k: int, mirror: str, pins: str = "") -> str:
    full = chain_full_a(k)
    places = [full * share for share in SHARES]
    sweep = f".dc ix 0 {full * 1.01:.9g} {full / 100:.9g}\n"
    return body("chain", mirror=mirror, sweep=pins + sweep + _finds(places, {"out": "i(vsum)", "x": "v(x)"}))


def chain_by_pins_body(k: int) -> str:
    """Return the chain with the ratio chosen at the pins: 20, 40, 80, 160 are 0 .. 3."""
    choice = sky130.MIRROR_RATIOS.index(k)
    pins = f"vk0 logic_k0 0 {choice % 2}\nvk1 logic_k1 0 {choice // 2}\n"
    return _chain(k, f"d_k0 d_k1 ibias {RAILS} mirror", pins)


def chain_lsb(found: Found) -> list[float]:
    """Return the output current at each of SHARES, in packets a gate."""
    return [_lsb(found[f"out{n}"]) for n in range(len(SHARES))]


def _off_line(x: Sequence[float], y: Sequence[float]) -> list[float]:
    """Return the distance of each y from the line through the first and the last point."""
    slope = (y[-1] - y[0]) / (x[-1] - x[0])
    return [b - y[0] - slope * (a - x[0]) for a, b in zip(x, y, strict=True)]


def _line(suffix: str, x: Sequence[float], lsb: Sequence[float]) -> dict[str, float]:
    """Return the distance of an output from the line through both ends, and that line."""
    return {
        f"chain_inl_lsb.{suffix}": max(map(abs, _off_line(x, lsb))),
        f"chain_gain_error.{suffix}": (lsb[-1] - lsb[0]) / 255.0 - 1.0,
        f"chain_offset_lsb.{suffix}": lsb[0],
    }


def code_residual_lsb(found: Found, k: int) -> list[float]:
    """Return the code error of a taxel at each of SHARES after calibration of gain and offset of its column.

    A taxel of conductance G draws G (V_b - v(x)), with V_b = 0.5 V, so the input impedance of the conveyor matters.
    """
    siemens = [chain_full_a(k) * share / (0.5 - found[f"x{n}"]) for n, share in enumerate(SHARES)]
    return _off_line(siemens, chain_lsb(found))


def chain(found: Found, k: int) -> dict[str, float]:
    """Return the line of the output, its bend, and the column's voltage and input resistance."""
    last = len(SHARES) - 1
    return _line(f"k{k}", SHARES, chain_lsb(found)) | {
        f"chain_code_inl_lsb.k{k}": max(map(abs, code_residual_lsb(found, k))),
        f"conveyor_r_x_ohm.k{k}": (found[f"x{last}"] - found[f"x{last - 1}"]) / (0.1 * chain_full_a(k)),
        f"conveyor_v_offset_v.k{k}": found[f"x{last}"],
    }


def multi(found: Found) -> dict[str, float]:
    """Return the line of both outputs of the conveyor that has two."""
    positive, negative = ([_lsb(found[f"{side}{n}"]) for n in range(11)] for side in ("zp", "zn"))
    return _line("zp", range(11), positive) | _line("zn", range(11), negative)


# Capacitance of the column from that of a pad to seven times the design's; nothing pressed, where the pole
# of x is lowest, and 1 mA, where the loop is fastest.
_LOOP_F = ("2p", "50p", "400p", "1n", "3n")


def _phase_margin_body() -> str:
    loads = (("idle", "0", "1g"), ("pressed", "1m", "500"))
    runs = [body("phase_margin_run", load=load, i=i, r=r, c=c) for load, i, r in loads for c in _LOOP_F]
    return body("phase_margin", runs="".join(runs))


def named(found: Found, prefix: str, add: float = 0.0) -> dict[str, float]:
    """Return every measurement, by its name after a prefix."""
    return {f"{prefix}.{name}": value + add for name, value in found.items()}


R_X_HZ = (100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000)


def overload(found: Found) -> dict[str, float]:
    """Return the voltage of the column of a strong taxel, and what its neighbour reads more than at 500 ohm."""
    codes = [_lsb(found[f"out{n}"]) for n in range(3)]
    volts = {f"overload_column_v.{name}": found[f"x{n}"] for n, name in enumerate(("full", "100", "short"))}
    return volts | {
        "overload_row_v.short": found["row2"],
        "overload_neighbour": codes[1] - codes[0],
        "short_neighbour": codes[2] - codes[0],
    }


def _crosstalk_body(return_ohm: float, mid_rail_ohm: float) -> str:
    others = "".join(body("crosstalk_other", n=n) for n in range(1, 16))
    return body("crosstalk", return_ohm=return_ohm, mid_rail_ohm=mid_rail_ohm, others=others.strip())


def crosstalk(found: Found, wire: str) -> dict[str, float]:
    """Return the change of the code of column 0 with 1 ohm in a wire that 16 columns share."""
    idle, pressed = (found[f"out_{when}"] / -found[f"packet_{when}"] for when in ("idle", "pressed"))
    return {f"{wire}_crosstalk": 510.0 * (pressed - idle)}


_SIGN = {"sink": 1, "source": -1, "direct": 1}
_T_CLK_S, _PULSE_S = 200e-9, 200e-9
_SLOPE_V_S = 0.68e6  # 3.4 uA on 5 pF


def _vfc_body(side: str) -> str:
    current = _SIGN[side] * _SLOPE_V_S * 5e-12
    if side != "direct":
        dut = "vfc" if side == "sink" else "vfc_inverted"
        return "xline ibias vdd vss bias_line\n" + body("vfc", i_in=current, dut=dut)
    # 80 times the current, on the column's 400 pF.
    text = body("vfc", i_in=80 * _SLOPE_V_S * 5e-12, dut="channel_direct")
    # With reltol 1e-3, edges of 400 sources cost a packet 0.3 codes at ss, -40 C, 0.9.
    return text.replace("xdut", "ccolumn sum 0 400p\nxdut", 1) + ".options reltol=1e-4\n"


def vfc(found: Found, side: str) -> dict[str, float]:
    """Return preset, slope and packet; the preset is corrected for the 99 ns after its release."""
    sign = _SIGN[side]
    slope = (found["v_0"] - found["v_1"]) / 0.8e-6 * sign
    packet = (found["v_2"] - found["v_1"]) * sign + slope * 0.4e-6
    return {
        f"capacitor_error.{side}": _SLOPE_V_S / slope - 1.0,
        f"preset_error_v.{side}": sign * found["v_0"] + _SLOPE_V_S * 0.0995e-6 - 0.5,
        f"packet_error.{side}": packet * (_SLOPE_V_S / slope) - 1.0,
    }


def density(found: Found, side: str) -> dict[str, float]:
    """Return the bend of the middle of the range, where a packet shrinks with rate.

    With a packet q (1 + e x / (1/2)) the count is x (1 - 2 e x), whose distance from the line through 0 and x = 1/2 is
    e / 8 of a packet a clock at x = 1/4, 510 e / 8 codes; e is the difference of the two rhythms, over the 4/5 of the
    range between them.
    """
    charge = _SIGN[side] * 5e-12
    dense = 12.5e-6 * 2 * _T_CLK_S + charge * (found["dense_1"] - found["dense_0"]) / 3
    sparse = 2.5e-6 * 10 * _T_CLK_S + charge * (found["sparse_1"] - found["sparse_0"])
    return {f"packet_density_lsb.{side}": 510 / 8 * (dense / sparse - 1.0) / 0.8}


def pulse(found: Found, side: str) -> dict[str, float]:
    """Return the delay of the falling edge less that of the rising one, at the gates of the pair."""
    return {f"pulse_asymmetry.{side}": found["fall"] - found["rise"] - _PULSE_S}


def start_up(found: Found) -> dict[str, float]:
    """Return the time from enable to 99 % of the packet current, and that current off and at the end."""
    return {
        "start_up_s": found["low"] - 1e-6,
        "start_up_off_a": -found["off"],
        "start_up_error": -found["end"] / 25e-6 - 1.0,
    }


def column(found: Found) -> dict[str, float]:
    """Return the offset of the column before the first gate, at the end of two gates, and between."""
    return {
        "column_raw_offset_v": found["raw"] + 3e-3,
        "column_offset_v": max(found["first"], found["second"], key=abs),
        "column_held_offset_v": found["held"],
    }


SETTLING_NS = (1000, 2000, 3000, 5000, 8000, 11000, 14000)


def settling(found: Found, side: str) -> dict[str, float]:
    """Return the packets that settling adds to a gate at both clocks, and the column's voltages."""
    lsb = {
        f"settling_lsb.{side}_{mhz}mhz": _lsb(found[name] / (510 / (mhz * 1e6)) - found["i_end"])
        for mhz, name in ((5, "slow"), (8, "fast"))
    }
    volts = {f"settling_v.t{t}": found[f"x{t}"] for t in SETTLING_NS} if side == "low" else {}
    return lsb | volts


def _channel_body(topology: str) -> str:
    integrator = "xdut.v_int" if topology == "direct" else "xdut.xvfc.v_int"
    ratio = "vk0 logic_k0 0 0\nvk1 logic_k1 0 1\n" if topology == "switched" else ""  # k = 80
    pins = "d_k0 d_k1" if ratio else ""
    return ratio + body("channel", topology=topology, integrator=integrator, pins=pins)


def channel(found: Found, topology: str) -> dict[str, float]:
    """Return errors of the integral of 1 kohm, in packets, and of a packet, and the comparator against the rails."""
    sign = -1 if topology == "conveyor_mirror_inverted" else 1
    slope_v = sign * (found["fast_0"] - found["fast_1"])
    packet_v = sign * (found["after"] - found["before"]) + slope_v
    return {
        f"channel_error.slope.{topology}": slope_v / packet_v / 0.5 - 1.0,
        f"channel_error.packet.{topology}": packet_v - 1.0,
        f"channel_output_v.{topology}": max(abs(found[at] - found[f"{at}_rail"]) for at in ("low", "high")),
    }


def _front_end_body() -> str:
    pins = " ".join({"r_ref": "r_ref_x", "vdd": "vdd_front"}.get(p, p) for p in sky130.front_end_pins(2, 2))
    return body("front_end", front_end=sky130.front_end(2, 2).strip(), pins=pins)


def front_end(found: Found) -> dict[str, float]:
    """Return errors of two columns, a packet, a preset and test currents, the worst digital output, and the supply."""
    pedestal_a, bias_v = 16e-6, 0.45
    fast_v, slow_v = found["fast_0"] - found["fast_1"], (found["slow_0"] - found["slow_1"]) / 5  # in 0.4 us
    packet_v = found["after"] - found["before"] + fast_v
    fast_a, slow_a = (volts / packet_v * 5e-12 / 0.4e-6 for volts in (fast_v, slow_v))
    # Resistance of the process's poly resistor over that at 25 C.
    nominal, poly = (1 - 2.47e-3 * (c - 25) + 2.7e-6 * (c - 25) ** 2 for c in (27.0, found["celsius"]))
    test_a = load().calibration.i_test_a * nominal / poly
    tests = [
        -found[name] / ((0.55e-3 + many * test_a) * bias_v / 0.5) - 1.0
        for many, name in enumerate(("i_one", "i_both"), 1)
    ]
    outputs = [name for name in found if "_sense" in name or "_comp" in name]
    return {
        "front_end_error.fast": fast_a / ((bias_v / 1e3 + pedestal_a) / 80) - 1.0,
        "front_end_error.slow": slow_a / ((bias_v / 10e3 + pedestal_a) / 40) - 1.0,
        "front_end_error.packet": packet_v - 1.0,
        "front_end_error.preset": max((found[f"preset_{n}"] / 0.5 - 1.0 for n in (0, 1)), key=abs),
        "front_end_error.test": max(tests, key=abs),
        "front_end_output_v": max(abs(found[name] - found[name.partition("_")[0]]) for name in outputs),
        "front_end_off_a": max(abs(found["i_off"]), abs(found["i_down"])),
        "front_end_on_a": found["i_on"],
    }


def supply(found: Found, topology: str) -> dict[str, float]:
    """Return a channel's current from vdd and into vss, and a chip's to vss in its worst row.

    A sinking charge source takes its current from the 0 V rail to vss, so it is in the second alone.
    """
    reference_a = -found["all"] - found["idle"]
    return {
        f"supply_channel_a.{topology}": found["idle"],
        f"supply_channel_vss_a.{topology}": found["pressed"] - 1e-3,
        f"supply_array_a.{topology}": 16 * found["pressed"] + reference_a,
    }


def _supply_rejection_body() -> str:
    loads = (("one", "1g"), ("all", "33.333"))
    columns = "".join(body("supply_rejection_column", load=load, held=held) for load, held in loads)
    sources = ("vdd", "vdd_d", "vss", "vref", "vb")
    analyses = "".join(body("supply_rejection_source", source=source) for source in sources)
    return body("supply_rejection", columns=columns, analyses=analyses)


def supply_rejection(found: Found) -> dict[str, float]:
    """Return codes a millivolt on each supply, of mid-rail against ground, and on both references."""
    return {
        "supply_rejection.vdd": max(found["vdd_one"], found["vdd_all"]),
        "supply_rejection.vdd_d": max(found["vdd_d_one"], found["vdd_d_all"]),
        "mid_rail_rejection.one": found["vss_one_gate"],
        "mid_rail_rejection.all": found["vss_all_gate"],
        "reference_gain.vref": found["vref_one_slow"],
        "reference_gain.vbias": found["vb_one_slow"],
    }


def noise_body(source: str, dut: str, share: str = "s^2", highest: str = "1meg") -> str:
    """Return the deck of the noise of a circuit: its source, share of the spectrum and highest frequency."""
    return body("noise", dut=dut.strip(), source=source, share=share, highest=highest)


def noise(found: Found, at: str) -> dict[str, float]:
    """Return the rms of a code, from the mean current of a gate.

    For the offset null it is that of a column of 16 taxels of 500 ohm, whose 32 mS turn a voltage into a current.
    """
    rms = found["rms"] * 16 / 500 / 80 if at == "null" else found["rms"]
    return {f"noise_lsb.{at}": _lsb(rms)}


# With trtol 7 the edges cost a packet 0.31 codes at ss, -40 C, 0.9; with 1 it is 0.03.
_EDGES_TRTOL = 1.0
_UNITS = {
    "lsb": "lsb", "crosstalk": "lsb", "neighbour": "lsb", "error": "1", "ohm": "ohm", "v": "V", "a": "A", "s": "s",
    "asymmetry": "s", "125c": "1", "ma": "mA", "hz": "Hz", "db": "dB", "deg": "deg", "margin": "deg",
    "class": "1", "moved": "1", "rejection": "lsb/mV", "gain": "lsb/mV",
    "overshoot": "1",
}  # fmt: skip
"""SI unit by the last word of a quantity's name, up to the first dot."""
_MEAS = re.compile(r"^\.?(?:meas \w+|print) (\w+)", re.MULTILINE)


def unit(quantity: str) -> str:
    return _UNITS[quantity.partition(".")[0].rpartition("_")[2]]


BENCHES: dict[str, Bench] = {}
_SIDES = ("sink", "source")
_OUTPUT = "xout{0} gate cp line{0} vdd bias_output\nxline{0} line{0} vdd vss bias_line"


def _add(
    name: str,
    values: Callable[..., dict[str, float]],
    text: str | None = None,
    *,
    samples: bool = False,
    trtol: float = Bench.trtol,
    **given: object,
) -> None:
    """Add a bench; its quantities are those that `values`, given more, makes of any measures of its deck."""
    text, values = body(name) if text is None else text, partial(values, **given)
    probe = {measure: 1.0 + 0.1 * n * n for n, measure in enumerate(dict.fromkeys(_MEAS.findall(text)))}
    units = {quantity: unit(quantity) for quantity in values(probe)}
    BENCHES[name] = Bench(text, values, units, samples, trtol)


# A cascoded unit of the charge source.
_add("reference", lambda found: {"reference_error": -found["i_unit"] / 5e-6 - 1.0}, samples=True)
# Of the voltage at the external resistor.
_add(
    "reference_step",
    lambda m: {"reference_overshoot": (m["most"] - m["after"]) / (m["after"] - m["before"])},
    body("reference_step", outputs="\n".join(map(_OUTPUT.format, range(17)))),
)
_add("amplifier", amplifier)
_add("amplifier_offset", amplifier_offset, samples=True)
_add("chain_k80", chain, _chain(80, "ibias vdd vss mirror_fixed k=80"), samples=True, k=80)
for _k in (20, 40, 160):
    _add(f"chain_k{_k}", chain, chain_by_pins_body(_k), k=_k)
for _side in _SIDES:
    _add(f"vfc_{_side}", vfc, _vfc_body(_side), samples=True, trtol=_EDGES_TRTOL, side=_side)
# From the crossing of a ramp of 0.5 V a clock.
_add("comparator", lambda found: {"comparator_delay_s": found["late"] - 140e-9}, samples=True)
_add("comparator_offset", level, samples=True, block="comparator_offset", measured="offset")
_add("density_sink", density, body("density", sign="", dut="vfc"), side="sink")
_add("density_source", density, body("density", sign="-", dut="vfc_inverted"), side="source")
_BOTH = _finds([n * 1e-4 for n in range(11)], {"zp": "i(vzp)", "zn": "i(vzn)"})
_add("conveyor_multi", multi, body("conveyor_multi", measures=_BOTH), samples=True)
_add("direct", vfc, _vfc_body("direct"), samples=True, trtol=_EDGES_TRTOL, side="direct")
_add("column", column, samples=True)
_add("phase_margin", named, _phase_margin_body(), prefix="phase_margin", add=180.0)
for _side, _source in zip(_SIDES, ("charge_source", "charge_source_inverted"), strict=True):
    _add(f"pulse_{_side}", pulse, body("pulse", source=_source), trtol=1.0, side=_side)
_add("return_crosstalk", crosstalk, _crosstalk_body(1.0, 1e-3), wire="return")
_add("mid_rail_crosstalk", crosstalk, _crosstalk_body(1e-3, 1.0), wire="mid_rail")
_add("overload", overload)
_add("start_up", start_up)
_add("r_x", lambda found: {f"r_x_ohm.f{f}": found[f"r{f}"] for f in R_X_HZ})
_add("settling_low", settling, body("settling", one=0.5, other=0), side="low")
_add("settling_high", settling, body("settling", one=0, other=0.5), side="high")
for _name in TOPOLOGIES:
    _add(f"supply_{_name}", supply, body("supply", topology=_name), topology=_name)
_add("supply_blocks", named, prefix="supply_block_a")
_add("supply_rejection", supply_rejection, _supply_rejection_body())
_add("noise_full", noise, noise_body("ix", body("noise_taxel", k=80, i="1m", r="500")), at="full")
_add("noise_low", noise, noise_body("ix", body("noise_taxel", k=80, i="7.8u", r="64.25k")), at="low")
_NULL = noise_body("vpreset", body("noise_null"), "1 + s^2 - 2*s*cos(turn)", "100meg")
_add("noise_null", noise, _NULL, at="null")
_PACKET = noise_body("vc", body("noise_packet", high_v=sky130.V_DIGITAL_V))
_add("noise_packet", noise, _PACKET, at="packet")
_add("row_driver_driven", row_driver, row_driver_body(1), side="driven")
_add("row_driver_held", row_driver, row_driver_body(0), side="held")
_add(
    "test_current",
    lambda m: {"test_current_a": m["at_27"], "test_current_ratio_125c": m["at_125"] / m["at_27"]},
)
_add("pedestal", lambda found: {"pedestal_error": found["at_0"] / 16e-6 - 1.0})
_add("row_sense", level, block="row_sense", nominal_v=0.25)
_add("level_down", level, block="level_down")
_add("row_change", row_change, trtol=1.0)
_add("esd_clamp", esd_clamp)
for _name in (*TOPOLOGIES, "switched"):
    _add(f"channel_{_name}", channel, _channel_body(_name), topology=_name)
_add("front_end", front_end, _front_end_body(), trtol=1.0)  # with 7 a floating node is at 5.6 V
_add("sequencing_10us", sequencing, _sequencing_body(10e-6), ramp="10us")
_add("sequencing_10ms", sequencing, _sequencing_body(10e-3), ramp="10ms")

# Codes of 255 that a unit of a quantity is worth at x = 1/2, where it is worth most; by name up to the first dot. A
# transient without any of them is not measured with another step or formula.
CODES_A_UNIT: dict[str, float] = {
    **dict.fromkeys(("packet_error", "chain_gain_error", "reference_error", "start_up_error"), 255.0),
    **dict.fromkeys(("chain_inl_lsb", "chain_offset_lsb", "chain_code_inl_lsb"), 1.0),
    **dict.fromkeys(("packet_density_lsb", "settling_lsb"), 1.0),
    # A pulse longer by 1 ns of 200 is a packet larger by 0.5 %.
    "pulse_asymmetry": 255.0 / _PULSE_S,
    # Where a count begins, in packets of 1 V; the capacitor decides what half a volt of preset is in packets.
    **dict.fromkeys(("preset_error_v", "comparator_offset_v"), 1.0),
    "capacitor_error": 0.5,
    # On 16 taxels of 500 ohm, 32 mS.
    "column_offset_v": 16 / 500 / 80 / 25e-6 * 510,
    # Of a full row of 500 ohm.
    "row_driver_r_ohm": 255.0 * 16 / 500,
    # A late decision is x packets a clock of 200 ns late.
    "comparator_delay_s": 0.5 / 200e-9,
}

# Total nonlinearity of a code: conveyor and mirror, and packets; sums of magnitudes, in lsb.
SUMS: dict[str, tuple[str, ...]] = {
    f"code_inl_lsb.{side}": ("chain_code_inl_lsb.k80", f"packet_density_lsb.{side}") for side in _SIDES
}
