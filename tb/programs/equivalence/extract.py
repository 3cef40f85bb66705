# SPDX-License-Identifier: Apache-2.0
"""Effects of a channel in transistors: benches of its blocks, and their parameters.

No bench closes the loop: the parameters predict how the loop will count, and tb.programs.equivalence.gate measures
whether it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from dermis.effects import EFFECTS
from dermis.scene.extracted import Measured, channel
from scripts.characterise.benches import (
    AMPLIFIER,
    AMPLIFIER_OFFSET,
    RAILS,
    Condition,
    amplifier,
    amplifier_offset,
    row_driver,
    row_driver_body,
)

Found = Mapping[str, float]
Measure = Callable[[str, Condition], Found]
"""Runs the body of a deck at a condition and returns its `.meas`."""

I0_A, C_F, T_CLK_S = 25e-6, 5e-12, 200e-9
"""Nominal values of the circuit; a packet is I0_A * T_CLK_S."""

POINTS = 11
"""Currents of a line, from none to x = 1/2, evenly."""

LIFT_V = 0.02
"""Step of the summing node that measures its load: far more than in operation."""


def polarity(topology: str) -> int:
    """-1 if the mirror sinks, and all blocks after it are inverted."""
    return -1 if topology == "conveyor_mirror_inverted" else 1


def _of(block: str, sign: int) -> str:
    """Name of a block of the converter for a polarity."""
    return block if sign > 0 else f"{block}_inverted"


# ---- from column to summing node -----------------------------------------------------------------------------

_COPY = {
    "conveyor_mirror": "xconveyor y x z ibias vdd vss conveyor\n"
    "xmirror z sum ibias vdd vss mirror_fixed k={k}",
    "conveyor_mirror_inverted": "xconveyor y x z ibias vdd vss conveyor\n"
    "xmirror z sum ibias vdd vss mirror_inverted k={k}",
    "multi_output_conveyor": "xconveyor y x sum 0 ibias vdd vss conveyor_multi k={k}",
}

# The swept source is a number: 0 .. 10 are the currents, 11 and 12 the half of them with the summing node moved.
_CHAIN = """\
xline ibias vdd vss bias_line
vs s 0 0
vy y 0 0
bix 0 x i = {step!r}*(v(s) < 10.5 ? v(s) : 5)
{copy}
vsum sum lift 0
blift lift 0 v = v(s) < 10.5 ? 0 : (v(s) < 11.5 ? -{lift} : {lift})
vd logic_charge 0 0
xcharge d_charge out ibias vdd vss vdd_d vss_d {charge_source}
vout out lift 0
.options reltol=1e-6
.dc vs 0 12 1
"""


# Preset as long as the chip's, gates long enough for the null to find its level; the first one only does that.
_PRESET_S, _GATE_S, _READ_S = 23e-6, 45e-6, 20e-6
_COLUMN = """\
xline ibias vdd vss bias_line
vpreset logic_preset 0 pulse(1 0 {preset!r} 1n 1n {gate!r} {slot!r})
ix 0 x pwl({steps})
ccolumn x 0 400p
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
{copy}
vsum sum 0 0
.tran 100n {stop!r}
"""
_SHARES = (0.0, 0.0, 0.5, 1.0)
"""Of the current of x = 1/2, slot by slot."""


def column_body(topology: str, k: int) -> str:
    """The column as the channel holds it, offset null included: slots of the chip with three currents."""
    slot, full = _PRESET_S + _GATE_S, 12.5e-6 * k
    steps, meas = "0 0", ""
    for n, share in enumerate(_SHARES):
        steps += f" {n * slot + 1e-7!r} {full * share!r} {(n + 1) * slot!r} {full * share!r}"
        end = n * slot + _PRESET_S + _GATE_S
        if n:
            meas += f".meas tran x{n} avg v(x) from={end - _READ_S!r} to={end - 1e-7!r}\n"
    text = _COLUMN.format(
        preset=_PRESET_S,
        gate=_GATE_S,
        slot=slot,
        steps=steps,
        copy=_COPY[topology].format(k=k),
        stop=len(_SHARES) * slot,
    )
    return text + meas


def column_of_channel_body(topology: str, k: int) -> str:
    """The same of a whole channel, wired as it is there, whose integrator nobody takes packets from."""
    line = "xline ibias vdd vss bias_line\n"
    null = f"xnull x y d_preset agnd ibias {RAILS} offset_null\n"
    own = f"{null}{_COPY[topology].format(k=k)}\nvsum sum 0 0\n"
    channel = (
        f"vcharge logic_charge 0 0\n"
        f"xdut x d_charge d_preset comp vref agnd ibias {RAILS} channel_{topology} k={k}\n"
    )
    return column_body(topology, k).replace(line, "").replace(own, channel)


def column(found: Found, k: int) -> list[Measured]:
    """A line through the column's voltage at three currents."""
    current = 12.5e-6 * k * np.array(_SHARES[1:])
    r_x, v_x = np.polyfit(current, [found[f"x{n}"] for n in range(1, len(_SHARES))], 1)
    bench = f"column's voltage late in a gate, 0 .. {current[-1] * 1e3:g} mA, offset null at work"
    return [
        Measured("column_input", "r_ohm", max(float(r_x), 0.0), f"line through the {bench}"),
        Measured("column_offset", "v_v", float(v_x), "where that line begins"),
    ]


def chain_body(topology: str, k: int) -> str:
    """Return the path from column to summing node, and a charge source on a separate node."""
    meas = "".join(f".meas dc out{n} find i(vsum) at={n}\n" for n in range(POINTS + 2))
    meas += "".join(f".meas dc off{n} find i(vout) at={n}\n" for n in (0, 11, 12))
    meas += ".meas dc supply find i(vdd) at=5\n"
    step = 12.5e-6 * k / (POINTS - 1)
    return meas + _CHAIN.format(
        copy=_COPY[topology].format(k=k),
        step=step,
        lift=LIFT_V,
        charge_source=_of("charge_source", polarity(topology)),
    )


def chain(found: Found, topology: str, k: int) -> list[Measured]:
    """Fit a line through the current, and the load of the summing node."""
    duty = np.linspace(0.0, 0.5, POINTS)
    out = polarity(topology) * np.array([found[f"out{n}"] for n in range(POINTS)]) / I0_A
    # The minimax line: its distance is half of that of the chord.
    gain, offset = _nearest_line(duty, out)
    apart_lsb = 510.0 * float(np.max(np.abs(out - gain * duty - offset)))
    g_out = (found["out11"] - found["out12"]) / (2.0 * LIFT_V)
    g_off = (found["off11"] - found["off12"]) / (2.0 * LIFT_V)
    bench = f"0 .. {duty[-1] * k * I0_A * 1e3:g} mA into the column"
    return [
        Measured(
            "mirror_ratio",
            "ratio_error",
            gain - 1.0,
            f"line through the current into the integrator, {bench}; {apart_lsb:.2f} LSB from it at most",
        ),
        Measured(
            "offset_current",
            "i_a",
            offset * I0_A + polarity(topology) * found["off0"],
            f"where that line begins, and {polarity(topology) * found['off0'] * 1e9:+.2f} nA of the charge source, off",
        ),
        Measured("mirror_output", "r_out_ohm", _ohm(g_out), f"summing node moved by +-{LIFT_V * 1e3:g} mV"),
        Measured("integrator_gain", "r_in_ohm", _ohm(g_off), "the same at the charge source, off"),
    ]


def _nearest_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and start of the line whose largest distance from the points is the least.

    That line lies parallel to a chord, half way between the points farthest above and below it; with so few points all
    chords are tried.
    """
    best = (math.inf, 0.0, 0.0)
    for i in range(len(x)):
        for j in range(i):
            slope = (y[i] - y[j]) / (x[i] - x[j])
            rest = y - slope * x
            low, high = float(rest.min()), float(rest.max())
            best = min(best, (high - low, slope, (low + high) / 2.0))
    return float(best[1]), float(best[2])


def _ohm(conductance_s: float) -> float:
    # Below a picosiemens it is the simulator's own gmin.
    return 1.0 / max(conductance_s, 1e-12)


# ---- integrator and charge source ----------------------------------------------------------------------------

# Two runs of packets, each after a preset: one every second clock, as at x = 1/2, and one every eighth.
_FAST = {"at": 1e-6, "i": 11e-6, "free": 3, "pace": 2, "packets": 8}
_SLOW = {"at": 7e-6, "i": 2.9e-6, "free": 8, "pace": 8, "packets": 3}
_BEFORE_S = 10e-9  # a value is read so long before an edge


def vfc_body(sign: int, k: int = 1) -> str:
    """Integrator, comparator and charge source of a polarity, their loop open.

    Above 1, k is that of the direct interface: the channel itself, whose currents and capacitor are k times as large.
    """
    line, dut = "xline ibias vdd vss bias_line", _of("vfc", sign)
    if k > 1:
        line, dut = "ccolumn sum 0 400p", "channel_direct"
    pulses, meas = [], ""
    for name, run in (("fast", _FAST), ("slow", _SLOW)):
        first = run["at"] + run["free"] * T_CLK_S
        for n in range(run["packets"]):
            t = first + n * run["pace"] * T_CLK_S
            pulses += [(t, 0), (t + 1e-9, 1), (t + T_CLK_S, 1), (t + T_CLK_S + 1e-9, 0)]
        times = {
            "held": run["at"] - _BEFORE_S,
            "from": run["at"] + T_CLK_S - _BEFORE_S,
            "to": first - _BEFORE_S,
            "end": first + run["packets"] * run["pace"] * T_CLK_S - _BEFORE_S,
        }
        meas += "".join(f".meas tran {name}_{at} find v(xdut.v_int) at={t!r}\n" for at, t in times.items())
        meas += f".meas tran {name}_comp_held find v(comp) at={times['held']!r}\n"
        meas += f".meas tran {name}_comp_to find v(comp) at={times['to']!r}\n"
    charge = " ".join(f"{t!r} {v}" for t, v in pulses)
    # reltol: ten times finer than ngspice's own: a packet is a difference of levels, and 1e-3 of it is a quarter LSB.
    return (
        f"vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0 4.8u 0 4.801u 1 7u 1 7.001u 0)\n"
        f"vcharge logic_charge 0 pwl(0 0 {charge})\n"
        f"iin 0 sum pwl(0 {sign * k * _FAST['i']} 4.9u {sign * k * _FAST['i']} 4.91u {sign * k * _SLOW['i']})\n"
        f"{line}\n"
        f"xdut sum d_charge d_preset comp vref agnd ibias {RAILS} {dut}\n"
        f".options reltol=1e-4\n.tran 10n 13.5u\n{meas}.meas tran supply avg i(vdd) from=0.5u to=13.4u\n"
    )


def vfc_runs(found: Found, sign: int) -> dict[str, dict[str, float]]:
    """Return capacitor, start and packet of both runs, each relative to nominal."""
    values = {}
    for name, run in (("fast", _FAST), ("slow", _SLOW)):
        held, begin, to, end = (sign * found[f"{name}_{at}"] for at in ("held", "from", "to", "end"))
        slope = (begin - to) / ((run["free"] - 1) * T_CLK_S)
        capacitor = run["i"] / slope
        start = begin + slope * (T_CLK_S - _BEFORE_S)
        taken = end - to + slope * run["packets"] * run["pace"] * T_CLK_S
        values[name] = {
            "capacitor": capacitor / C_F - 1.0,
            "start": capacitor * start / (I0_A * T_CLK_S) - 0.5,
            "packet": capacitor * taken / run["packets"] / (I0_A * T_CLK_S) - 1.0,
            "held": held,
        }
    return values


def vfc(found: Found, sign: int) -> list[Measured]:
    """Packet and preset in charge: the capacitor has no part in a code, nor has the k of the direct interface."""
    runs = vfc_runs(found, sign)
    fast, slow = runs["fast"], runs["slow"]
    packet_v = I0_A * T_CLK_S / C_F
    return [
        Measured(
            "charge_packet",
            "packet_error",
            (fast["packet"] + slow["packet"]) / 2.0,
            f"mean of packets every 2 and every 8 clocks, {1e4 * (fast['packet'] - slow['packet']):+.1f}e-4 apart",
        ),
        Measured(
            "preset_error",
            "v_v",
            -(fast["start"] + slow["start"]) / 2.0 * packet_v,
            f"charge behind the preset's release, mean at {_FAST['i'] * 1e6:g} and {_SLOW['i'] * 1e6:g} uA",
        ),
    ]


# ---- comparator ----------------------------------------------------------------------------------------------

_RAMPS = {"fast": (0.1, 100e-9, 2.5e6), "slow": (0.02, 100e-9, 5e4)}
"""Where each begins in V, when, and its slope in V/s: those of x = 1/2 and of x = 1/100."""


def comparator_body(sign: int) -> str:
    """Return the comparator as in the converter, on two ramps."""
    lines, meas = ["xline ibias vdd vss bias_line"], ""
    for name, (start, begin, slope) in _RAMPS.items():
        end = begin + 2.0 * start / slope
        lines.append(
            f"v{name} {name} 0 pwl(0 {sign * start} {begin!r} {sign * start} {end!r} {-sign * start})"
        )
        pins = f"0 {name}" if sign > 0 else f"{name} 0"
        lines.append(f"x{name} {pins} out_{name} ibias vdd vss comparator")
        meas += f".meas tran {name} when v(out_{name})=0 rise=1\n"
    return "\n".join(lines) + f"\n.tran 2n 1u\n{meas}"


def comparator(found: Found) -> list[Measured]:
    """Offset and delay: late = delay + offset / slope, from two slopes."""
    late = {name: found[name] - begin - start / slope for name, (start, begin, slope) in _RAMPS.items()}
    inverse = {name: 1.0 / slope for name, (_, _, slope) in _RAMPS.items()}
    offset = (late["slow"] - late["fast"]) / (inverse["slow"] - inverse["fast"])
    delay = late["fast"] - offset * inverse["fast"]
    return [
        Measured("comparator_offset", "v_v", offset, "from ramps of 2.5 V/us and 50 mV/us"),
        Measured("comparator_delay", "t_s", max(delay, 0.0), "the same ramps"),
    ]


# ---- direct interface ----------------------------------------------------------------------------------------

_WIDE = "ota pairs=320 branches=320"
"""Amplifier of integrator_direct, which is this much larger than that of the others."""

_OFF = f"""\
xline ibias vdd vss bias_line
vs s 0 0
vd logic_charge 0 0
xcharge d_charge out ibias vdd vss vdd_d vss_d charge_source units=400
vout out s 0
.dc vs -{LIFT_V} {LIFT_V} {LIFT_V}
.meas dc low find i(vout) at=-{LIFT_V}
.meas dc none find i(vout) at=0
.meas dc high find i(vout) at={LIFT_V}
"""


def _direct_bodies(k: int) -> dict[str, str]:
    amp, small = "ibias vdd vss ota\n", f"ibias vdd vss {_WIDE}\n"
    return {
        "amplifier": AMPLIFIER.replace(amp, small).replace("cload out 0 3p", f"cload out 0 {3 * k}p"),
        "offset": AMPLIFIER_OFFSET.replace(amp, small),
        "off": _OFF,
        "vfc": vfc_body(1, k),
    }


def _direct(name: str, found: Found) -> list[Measured]:
    if name == "offset":
        offset = amplifier_offset(found)["amplifier_offset_v"]
        return [Measured("column_offset", "v_v", offset, "amplifier closed on itself")]
    # Current into the charge source, in A, with the column at +-LIFT_V and at 0.
    load = (found["high"] - found["low"]) / (2.0 * LIFT_V)
    return [
        Measured("offset_current", "i_a", -found["none"], "charge source, off"),
        Measured("integrator_gain", "r_in_ohm", _ohm(-load), f"the same, moved by +-{LIFT_V * 1e3:g} mV"),
    ]


# ---- all -----------------------------------------------------------------------------------------------------


def bodies(topology: str, k: int) -> dict[str, str]:
    """Every deck of a channel by name, cheap ones first; those of blocks that channels share are the same text."""
    sign = polarity(topology)
    drivers = {"row_driver.driven": row_driver_body(1), "row_driver.held": row_driver_body(0)}
    if topology == "direct":
        return drivers | {"comparator": comparator_body(sign)} | _direct_bodies(k)
    return drivers | {
        "amplifier": AMPLIFIER,
        "comparator": comparator_body(sign),
        "chain": chain_body(topology, k),
        "vfc": vfc_body(sign),
        "column": column_body(topology, k),
    }


def parameters(name: str, found: Found, topology: str, k: int) -> list[Measured]:
    """Return the results of one deck as parameters."""
    if name == "amplifier":
        amp = amplifier(found)
        gain = 10.0 ** (amp["amplifier_gain_db"] / 20.0)
        load_pf = 3 * (k if topology == "direct" else 1)
        return [
            Measured("integrator_gain", "gain_dc", gain, "amplifier, at 1 Hz"),
            Measured("integrator_bandwidth", "gbw_hz", amp["amplifier_gbw_hz"], f"amplifier on {load_pf} pF"),
        ]
    if name.startswith("row_driver"):
        side = name.removeprefix("row_driver.")
        parameter = {"driven": "r_ohm", "held": "grounded_r_ohm"}[side]
        return [
            Measured("row_driver", parameter, *row_driver(found, side).values(), f"16 mA out of a {side} row")
        ]
    if name in ("offset", "off"):
        return _direct(name, found)
    return {
        "column": lambda: column(found, k),
        "chain": lambda: chain(found, topology, k),
        "vfc": lambda: vfc(found, polarity(topology)),
        "comparator": lambda: comparator(found),
    }[name]()


def effects(found: Mapping[str, Found], topology: str, k: int) -> list[Measured]:
    """Return the parameters of a channel from all its decks, in the order of the effects."""
    every = [m for name in found for m in parameters(name, found[name], topology, k)]
    return sorted(every, key=lambda m: list(EFFECTS).index(m.effect))


def channels(
    condition: Condition, wanted: Iterable[tuple[str, int]], measure: Measure
) -> dict[str, list[Measured]]:
    """Channels, each a topology and k, at a condition; a deck that several have is measured once."""
    known: dict[str, Found] = {}

    def once(body: str) -> Found:
        if body not in known:
            known[body] = measure(body, condition)
        return known[body]

    return {
        channel(t, k): effects({name: once(body) for name, body in bodies(t, k).items()}, t, k)
        for t, k in wanted
    }
