# SPDX-License-Identifier: Apache-2.0
"""Effects of a channel in transistors: benches of its blocks, and their parameters.

No bench closes the loop: the parameters predict how the loop will count, and tb.programs.equivalence.gate measures
whether it does. Every bench is the body of a deck and a function from its `.meas` to parameters.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping
from functools import partial

import numpy as np

from dermis.effects import EFFECTS
from dermis.scene.extracted import Measured, channel
from scripts.characterise import runs
from scripts.characterise.benches import (
    AMPLIFIER,
    AMPLIFIER_OFFSET,
    Condition,
    amplifier,
    amplifier_offset,
    body,
    row_driver,
    row_driver_body,
)

Found = Mapping[str, float]
"""Results of the `.meas` of a deck."""

Bench = tuple[str, Callable[[Found], list[Measured]]]

I0_A, C_F, T_CLK_S = 25e-6, 5e-12, 200e-9
"""Nominal values of the circuit; a packet is I0_A * T_CLK_S."""

POINTS = 11  # currents of a line, from none to x = 1/2, evenly
LIFT_V = 0.02  # step of the summing node that measures its load: far more than in operation


def polarity(topology: str) -> int:
    """Return -1 if the mirror sinks, and all blocks after it are inverted."""
    return -1 if topology == "conveyor_mirror_inverted" else 1


def _ohm(conductance_s: float) -> float:
    # Below a picosiemens it is the simulator's own gmin.
    return 1.0 / max(conductance_s, 1e-12)


_COPY = {
    "conveyor_mirror": "xconveyor y x z ibias vdd vss conveyor\n"
    "xmirror z sum ibias vdd vss mirror_fixed k={k}",
    "conveyor_mirror_inverted": "xconveyor y x z ibias vdd vss conveyor\n"
    "xmirror z sum ibias vdd vss mirror_inverted k={k}",
    "multi_output_conveyor": "xconveyor y x sum 0 ibias vdd vss conveyor_multi k={k}",
}

# Preset as long as the chip's, gates long enough for the null to find its level; the first one only does that.
_PRESET_S, _GATE_S, _READ_S = 23e-6, 45e-6, 20e-6
_SHARES = (0.0, 0.0, 0.5, 1.0)  # of the current of x = 1/2, slot by slot


def column_body(topology: str, k: int) -> str:
    """Return the column as the channel holds it, offset null included: slots of the chip with three currents."""
    slot, full = _PRESET_S + _GATE_S, 12.5e-6 * k
    steps, meas = "0 0", ""
    for n, share in enumerate(_SHARES):
        steps += f" {n * slot + 1e-7!r} {full * share!r} {(n + 1) * slot!r} {full * share!r}"
        end = n * slot + _PRESET_S + _GATE_S
        if n:
            meas += f".meas tran x{n} avg v(x) from={end - _READ_S!r} to={end - 1e-7!r}\n"
    times = {"preset_s": _PRESET_S, "gate_s": _GATE_S, "slot_s": slot, "end_s": len(_SHARES) * slot}
    return body("extract_column", steps=steps, copy=_COPY[topology].format(k=k), meas=meas, **times)


def column(k: int, found: Found) -> list[Measured]:
    """Fit a line through the column's voltage at three currents."""
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
    source, step_a = "charge_source" + "_inverted" * (polarity(topology) < 0), 12.5e-6 * k / (POINTS - 1)
    copy = _COPY[topology].format(k=k)
    return body("extract_chain", meas=meas, step_a=step_a, copy=copy, lift_v=LIFT_V, source=source)


def chain(topology: str, k: int, found: Found) -> list[Measured]:
    """Fit a line through the current, and the load of the summing node."""
    sign, duty = polarity(topology), np.linspace(0.0, 0.5, POINTS)
    out = sign * np.array([found[f"out{n}"] for n in range(POINTS)]) / I0_A
    gain, offset = _nearest_line(duty, out)
    apart_lsb = 510.0 * float(np.max(np.abs(out - gain * duty - offset)))
    g_out, g_off = ((found[f"{at}11"] - found[f"{at}12"]) / (2.0 * LIFT_V) for at in ("out", "off"))
    leak_a = sign * found["off0"]
    most_ma = duty[-1] * k * I0_A * 1e3
    line = f"line through the current into the integrator, 0 .. {most_ma:g} mA into the column"
    start = f"where that line begins, and {leak_a * 1e9:+.2f} nA of the charge source, off"
    return [
        Measured("mirror_ratio", "ratio_error", gain - 1.0, f"{line}; {apart_lsb:.2f} LSB from it at most"),
        Measured("offset_current", "i_a", offset * I0_A + leak_a, start),
        Measured("mirror_output", "r_out_ohm", _ohm(g_out), f"summing node moved by +-{LIFT_V * 1e3:g} mV"),
        Measured("integrator_gain", "r_in_ohm", _ohm(g_off), "the same at the charge source, off"),
    ]


def _nearest_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return slope and start of the minimax line.

    It is parallel to a chord, half way between the points farthest above and below it; all are tried.
    """
    lines = []
    for j, i in itertools.combinations(range(len(x)), 2):
        slope = (y[i] - y[j]) / (x[i] - x[j])
        rest = y - slope * x
        lines.append((rest.max() - rest.min(), slope, (rest.min() + rest.max()) / 2.0))
    return float(min(lines)[1]), float(min(lines)[2])


# Two runs of packets, each after a preset: one every second clock, as at x = 1/2, and one every eighth.
_RUNS = {
    "fast": {"at": 1e-6, "i": 11e-6, "free": 3, "pace": 2, "packets": 8},
    "slow": {"at": 7e-6, "i": 2.9e-6, "free": 8, "pace": 8, "packets": 3},
}
_BEFORE_S = 10e-9  # a value is read so long before an edge


def vfc_body(sign: int, k: int = 1) -> str:
    """Return integrator, comparator and charge source of a polarity, their loop open.

    Above 1, k is that of the direct interface: the channel itself, whose currents and capacitor are k times as large.
    """
    line, dut = "xline ibias vdd vss bias_line", "vfc" + "_inverted" * (sign < 0)
    if k > 1:
        line, dut = "ccolumn sum 0 400p", "channel_direct"
    charge, meas = "", ""
    for name, run in _RUNS.items():
        first = run["at"] + run["free"] * T_CLK_S
        for n in range(run["packets"]):
            t = first + n * run["pace"] * T_CLK_S
            charge += f" {t!r} 0 {t + 1e-9!r} 1 {t + T_CLK_S!r} 1 {t + T_CLK_S + 1e-9!r} 0"
        times = {
            "from": run["at"] + T_CLK_S - _BEFORE_S,
            "to": first - _BEFORE_S,
            "end": first + run["packets"] * run["pace"] * T_CLK_S - _BEFORE_S,
        }
        meas += "".join(f".meas tran {name}_{at} find v(xdut.v_int) at={t!r}\n" for at, t in times.items())
    fast, slow = (sign * k * run["i"] for run in _RUNS.values())
    return body("extract_vfc", charge=charge, fast=fast, slow=slow, line=line, dut=dut, meas=meas)


def vfc(sign: int, found: Found) -> list[Measured]:
    """Return packet and preset in charge: a code depends neither on the capacitor nor on the direct interface's k."""
    packets, starts = [], []
    for name, run in _RUNS.items():
        begin, to, end = (sign * found[f"{name}_{at}"] for at in ("from", "to", "end"))
        slope = (begin - to) / ((run["free"] - 1) * T_CLK_S)
        capacitor = run["i"] / slope
        taken = end - to + slope * run["packets"] * run["pace"] * T_CLK_S
        packets.append(capacitor * taken / run["packets"] / (I0_A * T_CLK_S) - 1.0)
        starts.append(capacitor * (begin + slope * (T_CLK_S - _BEFORE_S)) / (I0_A * T_CLK_S) - 0.5)
    apart = f"mean of packets every 2 and every 8 clocks, {1e4 * (packets[0] - packets[1]):+.1f}e-4 apart"
    currents = " and ".join(f"{run['i'] * 1e6:g}" for run in _RUNS.values())
    preset_v = -sum(starts) / 2.0 * (I0_A * T_CLK_S / C_F)
    released = f"charge behind the preset's release, mean at {currents} uA"
    return [
        Measured("charge_packet", "packet_error", sum(packets) / 2.0, apart),
        Measured("preset_error", "v_v", preset_v, released),
    ]


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
    """Return offset and delay: late = delay + offset / slope, from two slopes."""
    late = {name: found[name] - begin - start / slope for name, (start, begin, slope) in _RAMPS.items()}
    inverse = {name: 1.0 / slope for name, (_, _, slope) in _RAMPS.items()}
    offset = (late["slow"] - late["fast"]) / (inverse["slow"] - inverse["fast"])
    delay = late["fast"] - offset * inverse["fast"]
    return [
        Measured("comparator_offset", "v_v", offset, "from ramps of 2.5 V/us and 50 mV/us"),
        Measured("comparator_delay", "t_s", max(delay, 0.0), "the same ramps"),
    ]


_WIDE = "ibias vdd vss ota pairs=320 branches=320\n"
"""Amplifier of integrator_direct, which is this much larger than that of the others."""


def _amplifier(load_pf: int, found: Found) -> list[Measured]:
    amp = amplifier(found)
    gain = 10.0 ** (amp["amplifier_gain_db"] / 20.0)
    return [
        Measured("integrator_gain", "gain_dc", gain, "amplifier, at 1 Hz"),
        Measured("integrator_bandwidth", "gbw_hz", amp["amplifier_gbw_hz"], f"amplifier on {load_pf} pF"),
    ]


def _row_driver(parameter: str, side: str, found: Found) -> list[Measured]:
    (ohm,) = row_driver(found, side).values()
    return [Measured("row_driver", parameter, ohm, f"16 mA out of a {side} row")]


def _offset(found: Found) -> list[Measured]:
    offset_v = amplifier_offset(found)["amplifier_offset_v"]
    return [Measured("column_offset", "v_v", offset_v, "amplifier closed on itself")]


def _off(found: Found) -> list[Measured]:
    load = (found["high"] - found["low"]) / (2.0 * LIFT_V)
    return [
        Measured("offset_current", "i_a", -found["none"], "charge source, off"),
        Measured("integrator_gain", "r_in_ohm", _ohm(-load), f"the same, moved by +-{LIFT_V * 1e3:g} mV"),
    ]


def benches_of(topology: str, k: int) -> list[Bench]:
    """Return every bench of a channel; those of blocks that channels share have the same text."""
    sign = polarity(topology)
    shared: list[Bench] = [
        (row_driver_body(1), partial(_row_driver, "r_ohm", "driven")),
        (row_driver_body(0), partial(_row_driver, "grounded_r_ohm", "held")),
        (comparator_body(sign), comparator),
        (vfc_body(sign, k if topology == "direct" else 1), partial(vfc, sign)),
    ]
    if topology == "direct":
        small = "ibias vdd vss ota\n"
        wide = AMPLIFIER.replace(small, _WIDE).replace("cload out 0 3p", f"cload out 0 {3 * k}p")
        return [
            *shared,
            (wide, partial(_amplifier, 3 * k)),
            (AMPLIFIER_OFFSET.replace(small, _WIDE), _offset),
            (body("extract_off", lift_v=LIFT_V), _off),
        ]
    return [
        *shared,
        (AMPLIFIER, partial(_amplifier, 3)),
        (chain_body(topology, k), partial(chain, topology, k)),
        (column_body(topology, k), partial(column, k)),
    ]


def channels(condition: Condition, wanted: Iterable[tuple[str, int]]) -> dict[str, list[Measured]]:
    """Return the parameters of channels, each a topology and k, at a condition, in the order of the effects.

    A deck that several channels have is measured once.
    """
    known: dict[str, Found] = {}
    found = {}
    for topology, k in wanted:
        values = []
        for text, parameters in benches_of(topology, k):
            known[text] = known.get(text) or runs.measured(text, condition)
            values += parameters(known[text])
        found[channel(topology, k)] = sorted(values, key=lambda m: list(EFFECTS).index(m.effect))
    return found
