# SPDX-License-Identifier: Apache-2.0
"""Four stiff circuits of the IVP test set (CWI Amsterdam, University of Bari) as decks and as
equations of their own.

The test set (F. Mazzia, C. Magherini: Test Set for Initial Value Problem Solvers, release 2.4)
gives laws, numbers, initial state and end values of each. A deck and its equations are written
separately from those laws, so an error in one shows against the other. In the decks a charge that
depends on voltages is a node at the voltage charge / unit with a linear capacitor of one unit,
whose current is copied to the nodes of the charge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp

from dermis.chip.analog import Edge
from dermis.chip.ngspice import Deck

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StiffCircuit:
    """A circuit with published end values.

    Attributes
    ----------
    name : one word, as in the test set.
    title : description.
    t_stop_s : end of the published span, seconds.
    t_edge_s : length of the edges of the digital side; without edges, ngspice's printing step.
    lines : deck without title and options.
    sources, levels : sources of the digital side, and their levels at time 0 in volt.
    edges : (time in seconds, source, level in volt), ascending.
    probes : nodes that hold the states, in the order of the published values.
    published : end values of the test set; None if it has none.
    times_s : times at which solutions are compared; the last one is the end.
    reference : computes the states [times, probes] at times_s; `fine` in 0, 1: the second is the more accurate.
    scale : unit of every probe in SI is probe volt * scale (charges and currents are probed as voltages).
    """

    name: str
    title: str
    t_stop_s: float
    t_edge_s: float
    lines: tuple[str, ...]
    probes: tuple[str, ...]
    published: tuple[float | None, ...]
    times_s: tuple[float, ...]
    reference: Callable[[int], Floats]
    sources: tuple[str, ...] = ()
    levels: tuple[float, ...] = ()
    edges: tuple[Edge, ...] = ()
    scale: tuple[float, ...] = field(default=())

    def deck(self, options: str) -> Deck:
        """Return the deck with a line of options."""
        lines = (self.name.replace("_", " "), *self.lines)
        lines += tuple(f"{name} {name[2:]} 0 external" for name in self.sources)
        return Deck((*lines, options), self.sources, self.levels, (True,) * len(self.sources), self.probes)


def charge_lines(name: str, ends: tuple[str, str], charge: str, unit_c: float, start_c: float) -> list[str]:
    """Return lines of a charge (expression in coulomb) between two nodes; it is start_c at time
    0.
    """
    return [
        f"bq_{name} q_{name} 0 v = ({charge})/{unit_c!r}",
        f"cq_{name} q_{name} m_{name} {unit_c!r}",
        f"vq_{name} m_{name} 0 0",
        f"fq_{name} {ends[0]} {ends[1]} vq_{name} 1",
        f".ic v(q_{name})={start_c / unit_c!r} v(m_{name})=0",
    ]


# ---- transistor amplifier: five capacitors, two transistors, an algebraic part of index 1 -------------------------

_AMP = {"ub": 6.0, "uf": 0.026, "alpha": 0.99, "beta": 1e-6, "r0": 1e3, "r": 9e3}
_AMP_C = (1e-6, 2e-6, 3e-6, 4e-6, 5e-6)
_AMP_START = (0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0)


def _amp_lines() -> tuple[str, ...]:
    p, c = _AMP, _AMP_C

    def law(share: float, base: str, emitter: str) -> str:
        return f"i = {share * p['beta']!r}*(exp((v({base})-v({emitter}))/{p['uf']!r})-1)"

    lines = ["vub ub 0 6", "vue ue 0 sin(0 0.1 100)", "r0 ue y1 1k", f"c1 y1 y2 {c[0]!r}"]
    lines += ["r1 y2 0 9k", "r2 y2 ub 9k", "r3 y3 0 9k", f"c2 y3 0 {c[1]!r}", "r4 y4 ub 9k"]
    lines += [f"c3 y4 y5 {c[2]!r}", "r5 y5 0 9k", "r6 y5 ub 9k", "r7 y6 0 9k", f"c4 y6 0 {c[3]!r}"]
    lines += ["r8 y7 ub 9k", f"c5 y7 y8 {c[4]!r}", "r9 y8 0 9k"]
    for base, emitter, collector in (("y2", "y3", "y4"), ("y5", "y6", "y7")):
        lines.append(f"bb{base} {base} {emitter} {law(1.0 - p['alpha'], base, emitter)}")
        lines.append(f"bc{base} {collector} {emitter} {law(p['alpha'], base, emitter)}")
    lines.append(".ic " + " ".join(f"v(y{i})={v!r}" for i, v in enumerate(_AMP_START, 1)))
    return tuple(lines)


def _amp_nodes(t: float, u: Floats) -> tuple[float, ...]:
    """Return the eight node voltages for the voltages u of the five capacitors: two scalar
    equations, by Newton's method.
    """
    p = _AMP
    ue = 0.1 * math.sin(200.0 * math.pi * t)
    u1, y3, u3, y6, u5 = u
    r, share = p["r"], 1.0 - p["alpha"]

    def solve(conductance: float, current: float, emitter: float) -> tuple[float, float]:
        """Return y with conductance y + share g(y - emitter) = current; starts above the root of a
        convex function.
        """
        y = emitter + 0.5
        for _ in range(200):
            e = p["beta"] * math.exp((y - emitter) / p["uf"])
            step = (conductance * y + share * (e - p["beta"]) - current) / (conductance + share * e / p["uf"])
            y -= step
            if abs(step) < 1e-15 * max(1.0, abs(y)):  # a few roundings of y
                break
        return y, p["beta"] * (math.exp((y - emitter) / p["uf"]) - 1.0)

    y2, g1 = solve(2.0 / r + 1.0 / p["r0"], p["ub"] / r + (ue - u1) / p["r0"], y3)
    y1 = y2 + u1
    y5, g2 = solve(3.0 / r, 2.0 * p["ub"] / r - u3 / r - p["alpha"] * g1, y6)
    y4 = y5 + u3
    y8 = 0.5 * (p["ub"] - u5 - p["alpha"] * g2 * r)
    return y1, y2, y3, y4, y5, y6, y8 + u5, y8


def _amp_rates(t: float, u: Floats) -> Floats:
    p, c = _AMP, _AMP_C
    y1, y2, y3, y4, y5, y6, _, y8 = _amp_nodes(t, u)
    ue = 0.1 * math.sin(200.0 * math.pi * t)
    g1 = p["beta"] * (math.exp((y2 - y3) / p["uf"]) - 1.0)
    g2 = p["beta"] * (math.exp((y5 - y6) / p["uf"]) - 1.0)
    return np.array(
        [
            (ue - y1) / p["r0"] / c[0],
            (g1 - y3 / p["r"]) / c[1],
            ((p["ub"] - y4) / p["r"] - p["alpha"] * g1) / c[2],
            (g2 - y6 / p["r"]) / c[3],
            y8 / p["r"] / c[4],
        ]
    )


def _amp_reference(fine: int) -> Floats:
    """Solve by explicit Runge-Kutta of order 8: with the algebraic part solved the fastest rate is
    some 1e4 / s.
    """
    start = [_AMP_START[0] - _AMP_START[1], 3.0, 3.0, 3.0, 6.0]
    rtol = (1e-11, 1e-13)[fine]
    # Capacitor voltages are some volts, and pass through zero: a thousandth of what is allowed of a
    # volt.
    done = solve_ivp(
        _amp_rates, (0.0, 0.2), start, "DOP853", _AMP_TIMES, rtol=rtol, atol=1e-3 * rtol, max_step=1e-4
    )
    return np.array([_amp_nodes(t, u) for t, u in zip(done.t, done.y.T, strict=True)])


_AMP_TIMES = tuple(0.005 * n for n in range(1, 41))

TRANSISTOR_AMPLIFIER = StiffCircuit(
    name="transistor_amplifier",
    title="two-stage transistor amplifier, 0.2 s",
    t_stop_s=0.2,
    t_edge_s=1e-4,
    lines=_amp_lines(),
    probes=tuple(f"y{i}" for i in range(1, 9)),
    published=(
        -0.5562145012262709e-2,
        3.006522471903042,
        2.849958788608128,
        2.926422536206241,
        2.704617865010554,
        2.761837778393145,
        4.770927631616772,
        1.236995868091548,
    ),
    times_s=_AMP_TIMES,
    reference=_amp_reference,
)

# ---- NAND gate: three transistors with charges that depend on voltages ---------------------------------------------

# The test set counts in kohm, pF, ns, V and mA.
_K, _P, _N, _M = 1e3, 1e-12, 1e-9, 1e-3
_NAND_R_GATE, _NAND_R_BULK = 4.0, 10.0
_NAND_C_GATE, _NAND_C_BULK, _NAND_C_NODE = 0.6e-4, 2.4e-5, 0.5e-4
_NAND_BARRIER, _NAND_SLOPE, _NAND_I_SAT, _NAND_V_T = 0.87, 0.02, 1e-14, 25.85
# Threshold, body effect, its potential, beta in mA/V^2 forward and with drain and source exchanged.
# That the last is a tenth for the enhancement type is odd, and the published end values belong to
# it: 1.748e-3 misses them by 5 mV.
_NAND_DEPLETION = (-2.43, 0.2, 1.28, 5.35e-4, 5.35e-4)
_NAND_ENHANCEMENT = (0.2, 0.035, 1.01, 1.748e-3, 1.748e-4)
_NAND_START = (5.0, 5.0, -2.5, -2.5, 5.0, 3.62385, 5.0, -2.5, -2.5, 3.62385, 0.0, 3.62385, -2.5, -2.5)
# Each transistor: law, drain, gate, source, then bulk at its source side and bulk at its drain side
# as (bulk, node).
_NAND_FETS = (
    (_NAND_DEPLETION, "y2", "y5", "y1", ("y3", "y5"), ("y4", "vdd")),
    (_NAND_ENHANCEMENT, "y7", "v1", "y6", ("y8", "y10"), ("y9", "y5")),
    (_NAND_ENHANCEMENT, "y12", "v2", "y11", ("y13", "0"), ("y14", "y10")),
)


def _nand_junction_c(v: float) -> float:
    """Return the charge of a bulk junction in units of its capacitance, V: of 1/sqrt(1 - v/b) below
    0, of 1 + v/(2b) above.
    """
    b = _NAND_BARRIER
    return 2.0 * b * (1.0 - math.sqrt(1.0 - v / b)) if v <= 0.0 else v + v * v / (4.0 * b)


def _nand_lines() -> tuple[str, ...]:
    b = _NAND_BARRIER
    start = {f"y{i}": v for i, v in enumerate(_NAND_START, 1)} | {"0": 0.0, "vdd": 5.0}
    rg, rb = (repr(r * _K) for r in (_NAND_R_GATE, _NAND_R_BULK))
    cg = repr(_NAND_C_GATE * _P)
    lines = ["vvdd vdd 0 5", "vvbb vbb 0 -2.5"]
    lines += [f"cn5 y5 0 {_NAND_C_NODE * _P!r}", f"cn10 y10 0 {_NAND_C_NODE * _P!r}"]

    def volt(node: str) -> str:
        return "0" if node == "0" else f"v({node})"

    def across(p: str, n: str) -> str:
        return f"({volt(p)}-{volt(n)})"

    for number, (law, d, g, s, at_source, at_drain) in enumerate(_NAND_FETS, 1):
        v_t0, gamma, phi, beta, beta_back = law
        outer_s, outer_d = at_source[1], at_drain[1]
        lines += [f"rs{number} {s} {outer_s} {rg}", f"rd{number} {d} {outer_d} {rg}"]
        lines += [f"cs{number} {g} {s} {cg}", f"cd{number} {g} {d} {cg}"]

        def current(vds: str, vg: str, vb: str) -> str:
            level = f"({v_t0!r}+{gamma!r}*(sqrt(max({phi!r}-{vb},0))-{math.sqrt(phi)!r}))"  # noqa: B023
            over = f"max({vg}-{level},0)"
            return f"min({vds},{over})*(2*{over}-min({vds},{over}))*(1+{_NAND_SLOPE!r}*{vds})"

        ahead = current(across(d, s), across(g, s), across(*at_source))
        back = current(across(s, d), across(g, d), across(*at_drain))
        taken = f"{across(d, s)} > 0 ? {beta * _M!r}*{ahead} : {-beta_back * _M!r}*{back}"
        lines.append(f"bds{number} {d} {s} i = {taken}")
        for kind, (bulk, node) in (("s", at_source), ("d", at_drain)):
            v = across(bulk, node)
            lines.append(f"rb{kind}{number} {bulk} vbb {rb}")
            leak = f"{_NAND_I_SAT * _M!r}*({v} > 0 ? 0 : 1-exp(min({v},0)/{_NAND_V_T!r}))"
            lines.append(f"bl{kind}{number} {node} {bulk} i = {leak}")
            unit = _NAND_C_BULK * _P
            low = f"{2 * b!r}*(1-sqrt(1-min({v},0)/{b!r}))"
            high = f"max({v},0)*(1+max({v},0)/{4 * b!r})"
            at_start = unit * _nand_junction_c(start[bulk] - start[node])
            lines += charge_lines(f"{kind}{number}", (bulk, node), f"{unit!r}*({low}+{high})", unit, at_start)
    lines.append(".ic " + " ".join(f"v(y{i})={v!r}" for i, v in enumerate(_NAND_START, 1)))
    return tuple(lines)


def _nand_input(t: float, delay: float, high: float, period: float) -> tuple[float, float]:
    """Return an input and its slope: 5 ns up, `high` ns at 5 V, 5 ns down; at a corner the slope
    after it.
    """
    phase = t % period
    if phase < delay:
        return 0.0, 0.0
    if phase < delay + 5.0:
        return phase - delay, 1.0
    if phase < delay + 5.0 + high:
        return 5.0, 0.0
    return period - phase, -1.0


def _nand_current(
    law: tuple[float, ...], vds: float, vgs: float, vgd: float, vbs: float, vbd: float
) -> float:
    """Return the drain current in mA, after Shichman and Hodges."""
    v_t0, gamma, phi, forward, back = law
    beta, vg, vb = (forward, vgs, vbs) if vds > 0.0 else (-back, vgd, vbd)
    over = vg - v_t0 - gamma * (math.sqrt(max(phi - vb, 0.0)) - math.sqrt(phi))
    size = abs(vds)
    if over <= 0.0:
        return 0.0
    inner = over * over if size >= over else size * (2.0 * over - size)
    return beta * inner * (1.0 + _NAND_SLOPE * size)


def _nand_rates(t: float, y: Floats, piece: float) -> Floats:
    """Return dy/dt in V/ns; `piece` is a time between the two corners of the inputs around t."""
    slopes = [_nand_input(piece, 5.0, 5.0, 20.0)[1], _nand_input(piece, 15.0, 15.0, 40.0)[1]]
    levels = [_nand_input(piece, 5.0, 5.0, 20.0)[0], _nand_input(piece, 15.0, 15.0, 40.0)[0]]
    v = {f"y{i}": x for i, x in enumerate(y.tolist(), 1)} | {"0": 0.0, "vdd": 5.0}
    v |= {
        f"v{i}": level + slope * (t - piece)
        for i, (level, slope) in enumerate(zip(levels, slopes, strict=True), 1)
    }
    slope_of = {"v1": slopes[0], "v2": slopes[1]}
    into = dict.fromkeys(v, 0.0)
    index = {f"y{i}": i - 1 for i in range(1, 15)}
    matrix = np.zeros((14, 14))
    rhs = np.zeros(14)

    def capacitor(a: str, b: str, c: float) -> None:
        for here, there in ((a, b), (b, a)):
            if here in index:
                matrix[index[here], index[here]] += c
                if there in index:
                    matrix[index[here], index[there]] -= c
                else:
                    rhs[index[here]] += c * slope_of.get(there, 0.0)

    def flow(a: str, b: str, i: float) -> None:
        into[a] -= i
        into[b] += i

    capacitor("y5", "0", _NAND_C_NODE)
    capacitor("y10", "0", _NAND_C_NODE)
    for law, d, g, s, at_source, at_drain in _NAND_FETS:
        flow(s, at_source[1], (v[s] - v[at_source[1]]) / _NAND_R_GATE)
        flow(d, at_drain[1], (v[d] - v[at_drain[1]]) / _NAND_R_GATE)
        vbs, vbd = (v[b] - v[n] for b, n in (at_source, at_drain))
        flow(d, s, _nand_current(law, v[d] - v[s], v[g] - v[s], v[g] - v[d], vbs, vbd))
        capacitor(g, s, _NAND_C_GATE)
        capacitor(g, d, _NAND_C_GATE)
        for (bulk, node), across in ((at_source, vbs), (at_drain, vbd)):
            into[bulk] -= (v[bulk] + 2.5) / _NAND_R_BULK
            if across <= 0.0:
                flow(bulk, node, _NAND_I_SAT * math.expm1(across / _NAND_V_T))
                c = _NAND_C_BULK / math.sqrt(1.0 - across / _NAND_BARRIER)
            else:
                c = _NAND_C_BULK * (1.0 + across / (2.0 * _NAND_BARRIER))
            capacitor(bulk, node, c)
    rhs += [into[name] for name in index]
    return np.linalg.solve(matrix, rhs)


def _nand_reference(fine: int) -> Floats:
    """Solve between the corners of the inputs, every 5 ns, by LSODA's backward differences at a
    tolerance near rounding.
    """
    rtol = (1e-10, 1e-12)[fine]
    state, found = np.array(_NAND_START), []
    for begin in range(0, 80, 5):
        times = list(range(begin + 1, begin + 6))
        middle = begin + 2.5
        # Volts again: a tenth, since node 11 comes within 0.2 mV of zero.
        done = solve_ivp(
            _nand_rates, (begin, begin + 5), state, "LSODA", times, args=(middle,), rtol=rtol, atol=0.1 * rtol
        )
        found.append(done.y.T)
        state = done.y[:, -1]
    return np.concatenate(found)


def _nand_edges() -> tuple[Edge, ...]:
    edges = [(t, 0, level) for p in range(4) for t, level in ((20 * p + 5, 5.0), (20 * p + 15, 0.0))]
    edges += [(t, 1, level) for p in range(2) for t, level in ((40 * p + 15, 5.0), (40 * p + 35, 0.0))]
    return tuple((t * _N, source, level) for t, source, level in sorted(edges))


NAND_GATE = StiffCircuit(
    name="nand_gate",
    title="NAND gate of three MOS transistors, 80 ns",
    t_stop_s=80 * _N,
    t_edge_s=5 * _N,
    lines=_nand_lines(),
    probes=tuple(f"y{i}" for i in range(1, 15)),
    published=(
        4.971088699385777,
        4.999752103929311,
        -2.499998781491227,
        -2.499999999999975,
        4.970837023296724,
        -0.2091214032073855,
        4.970593243278363,
        -2.500077409198803,
        -2.499998781491227,
        -0.2090289583878100,
        -0.2399999999966269e-3,
        -0.2091214032073855,
        -2.499999999999991,
        -2.500077409198803,
    ),
    times_s=tuple(t * _N for t in range(1, 81)),
    reference=_nand_reference,
    sources=("v_v1", "v_v2"),
    levels=(0.0, 0.0),
    edges=_nand_edges(),
)

# ---- charge pump: one transistor that is nothing but charge, index 2 -------------------------------------------------

_PUMP = {"vt0": 0.20, "gamma": 0.035, "phi": 1.01, "cox": 4e-12, "cs": 1.6e-12, "cd": 0.4e-12}
_PUMP_UNIT_C = 1e-12
_PUMP_TIMES = tuple(10 * _N * n for n in range(1, 121))


def _pump_charges() -> tuple[str, str]:
    """Return the gate charge and the charge of source or drain (half of the channel each, Ward's
    symmetrical split) over `unit`.
    """
    p = _PUMP
    flat = repr(p["vt0"] - p["gamma"] * math.sqrt(p["phi"]) - p["phi"])
    gamma = repr(p["gamma"])
    low = "min(v(s),v(d))"
    root = f"sqrt(max({p['phi']!r}+{low},0))"
    level = f"({p['vt0']!r}+{gamma}*({root}-{math.sqrt(p['phi'])!r}))"
    source = f"max(v(vin)-{low}-{level},1e-12)"
    drain = f"max(v(vin)-max(v(s),v(d))-{level},0)"
    channel = f"({source}+{drain}-{source}*{drain}/({source}+{drain}))"
    on = f"v(vin)-{low} > {level}"
    off = f"{gamma}*(sqrt(max({(p['gamma'] / 2) ** 2!r}+v(vin)-({flat}),0))-{p['gamma'] / 2!r})"
    away = f"v(vin)-({flat})"
    gate = f"v(vin) <= {flat} ? {away} : ({on} ? {2 / 3!r}*{channel}+{gamma}*{root} : {off})"
    end = f"({on} ? {-1 / 3!r}*{channel} : 0)"
    return f"{p['cox']!r}*({gate})", f"{p['cox']!r}*{end}"


@mp.workdps(50)
def _pump_gate_at_rest() -> Any:
    """Return the gate charge at 0 V, and its derivative by the gate voltage: closed forms, 50
    digits.
    """
    vt0, gamma, phi, cox = mpf("0.2"), mpf("0.035"), mpf("1.01"), mpf("4e-12")
    root = mp.sqrt(gamma**2 / 4 - (vt0 - gamma * mp.sqrt(phi) - phi))
    return cox * gamma * (root - gamma / 2), cox * gamma / (2 * root)


def _pump_lines() -> tuple[str, ...]:
    gate, end = _pump_charges()
    at_rest = float(_pump_gate_at_rest()[0])
    lines = [f"cs s 0 {_PUMP['cs']!r}", f"cd d 0 {_PUMP['cd']!r}"]
    lines += charge_lines("g", ("vin", "0"), gate, _PUMP_UNIT_C, at_rest)
    lines += charge_lines("s", ("s", "0"), end, _PUMP_UNIT_C, 0.0)
    lines += charge_lines("d", ("d", "0"), end, _PUMP_UNIT_C, 0.0)
    lines += ["hi i 0 vq_g -1e3", ".ic v(s)=0 v(d)=0 v(vin)=0 v(i)=0"]
    return tuple(lines)


def _pump_input(t_ns: float) -> float:
    phase = t_ns % 120.0
    return float(np.interp(phase, [0.0, 50.0, 60.0, 110.0, 120.0], [0.0, 0.0, 20.0, 20.0, 0.0]))


@mp.workdps(50)
def _pump_point(v_gate: float) -> tuple[Any, Any]:
    """Return the charge of the source's capacitor and of the gate at a gate voltage.

    Charge that leaves the channel at either end stays on that end's capacitor, so both have the
    same charge q. There is no history: q = cox / 3 H(v_gate, q), solved by bisection, as the right
    side falls with q.
    """
    p = {k: mpf(repr(v)) for k, v in _PUMP.items()}
    gate = mpf(v_gate)
    flat = p["vt0"] - p["gamma"] * mp.sqrt(p["phi"]) - p["phi"]

    def channel(q: Any) -> tuple[Any, Any]:
        s, d = q / p["cs"], q / p["cd"]
        root = mp.sqrt(p["phi"] + s)
        level = p["vt0"] + p["gamma"] * (root - mp.sqrt(p["phi"]))
        over_s, over_d = gate - s - level, max(gate - d - level, mpf(0))
        if over_s <= 0:
            return mpf(0), root
        return over_s + over_d - over_s * over_d / (over_s + over_d), root

    if channel(mpf(0))[0] == 0:
        half = p["gamma"] / 2
        return mpf(0), p["cox"] * p["gamma"] * (mp.sqrt(half**2 + gate - flat) - half)
    low, high = mpf(0), p["cox"] * gate
    for _ in range(150):  # halves 8e-11 C to below 1e-55
        q = (low + high) / 2
        low, high = (q, high) if p["cox"] / 3 * channel(q)[0] > q else (low, q)
    h, root = channel(low)
    return low, p["cox"] * (mpf(2) / 3 * h + p["gamma"] * root)


@mp.workdps(50)
def _pump_reference(fine: int) -> Floats:
    """Return gate charge over `unit`, source and drain, in volt, and the current over 1 mA; exact
    except for the last rounding.

    The current is known in closed form where the transistor is off: along the last edge, at its
    end.
    """
    rows = []
    for t in _PUMP_TIMES:
        q, gate = _pump_point(_pump_input(round(t / _N, 6)))
        rows.append([float(gate) / _PUMP_UNIT_C, float(q) / _PUMP["cs"], float(q) / _PUMP["cd"], math.nan])
    rows[-1][3] = float(_pump_gate_at_rest()[1] * mpf("2e9") / mpf("1e-3"))
    return np.array(rows)


CHARGE_PUMP = StiffCircuit(
    name="charge_pump",
    title="charge pump, a MOS transistor modelled by charge only, 1200 ns",
    t_stop_s=1200 * _N,
    t_edge_s=10 * _N,
    lines=_pump_lines(),
    probes=("q_g", "s", "d", "i"),
    published=(0.126280042987675933170893e-12, 0.0, 0.0, 0.152255686815577679043511e-3),
    times_s=_PUMP_TIMES,
    reference=_pump_reference,
    sources=("v_vin",),
    levels=(0.0,),
    edges=tuple(((120 * n + t) * _N, 0, v) for n in range(10) for t, v in ((50, 20.0), (110, 0.0))),
    scale=(_PUMP_UNIT_C, 1.0, 1.0, 1e-3),
)

# ---- ring modulator: four diodes with 2 pF each, oscillations of 5 MHz below 1 kHz and 10 kHz ------------------------

_RING = {"c": 1.6e-8, "cs": 2e-12, "cp": 1e-8, "r": 25e3, "rp": 50.0, "lh": 4.45, "ls1": 2e-3, "ls2": 5e-4}
_RING |= {"rg1": 36.3, "rg2": 17.3, "ri": 50.0, "rc": 600.0, "gamma": 40.67286402e-9, "delta": 17.7493332}
_RING_TIMES = tuple(1e-5 * n for n in range(1, 101))
_RING_START_TIMES = _RING_TIMES[:10]


def _ring_lines() -> tuple[str, ...]:
    p = _RING
    lines = ["vuin1 uin1 0 sin(0 0.5 1k)", "vuin2 uin2 0 sin(0 2 10k)"]
    across = {
        1: "v(y3)-v(y5)-v(y7)-v(uin2)",
        2: "-v(y4)+v(y6)-v(y7)-v(uin2)",
        3: "v(y4)+v(y5)+v(y7)+v(uin2)",
        4: "-v(y3)-v(y6)+v(y7)+v(uin2)",
    }
    # The current of a diode is copied: out of the nodes that it leaves, into those that it enters.
    leaves = {1: ("y3",), 2: ("y6",), 3: ("y4", "y5", "y7"), 4: ("y7",)}
    comes = {1: ("y5", "y7"), 2: ("y4", "y7"), 3: (), 4: ("y3", "y6")}
    for n, v in across.items():
        lines += [f"bd{n} 0 a{n} i = {p['gamma']!r}*(exp({p['delta']!r}*({v}))-1)", f"vd{n} a{n} 0 0"]
        lines += [f"fd{n}{y} {y} 0 vd{n} 1" for y in leaves[n]] + [
            f"fd{n}{y} 0 {y} vd{n} 1" for y in comes[n]
        ]
    lines += [f"c1 y1 0 {p['c']!r}", f"c2 y2 0 {p['c']!r}", f"r1 y1 0 {p['r']!r}", f"r2 y2 0 {p['r']!r}"]
    lines += [f"c{n} y{n} 0 {p['cs']!r}" for n in (3, 4, 5, 6)] + [
        f"c7 y7 0 {p['cp']!r}",
        f"r7 y7 0 {p['rp']!r}",
    ]
    # Each winding: its own voltage, its inductance, its resistance, and the nodes its current is
    # copied into.
    windings = {
        8: ("-v(y1)", p["lh"], 0.0, {"y1": 1.0}),
        9: ("-v(y2)", p["lh"], 0.0, {"y2": 1.0}),
        10: ("0.5*v(y1)-v(y3)", p["ls2"], p["rg2"], {"y1": -0.5, "y3": 1.0}),
        11: ("-0.5*v(y1)+v(y4)", p["ls2"], p["rg2"], {"y1": 0.5, "y4": -1.0}),
        12: ("0.5*v(y2)-v(y5)", p["ls2"], p["rg2"], {"y2": -0.5, "y5": 1.0}),
        13: ("-0.5*v(y2)+v(y6)", p["ls2"], p["rg2"], {"y2": 0.5, "y6": -1.0}),
        14: ("-v(y1)+v(uin1)", p["ls1"], p["ri"] + p["rg1"], {"y1": 1.0}),
        15: ("-v(y2)", p["ls1"], p["rc"] + p["rg1"], {"y2": 1.0}),
    }
    for n, (volt, henry, ohm, into) in windings.items():
        lines += [f"bw{n} w{n} 0 v = {volt}", f"l{n} w{n} x{n} {henry!r} ic=0"]
        lines.append(f"r{n} x{n} z{n} {ohm!r}" if ohm else f"vx{n} x{n} z{n} 0")
        lines.append(f"vw{n} z{n} 0 0")
        lines += [f"fw{n}{y} 0 {y} vw{n} {share!r}" for y, share in into.items()]
        lines.append(f"hw{n} y{n} 0 vw{n} 1e3")  # probed as volt for mA
    lines.append(".ic " + " ".join(f"v(y{n})=0" for n in range(1, 8)))
    return tuple(lines)


def _ring_rates() -> Callable[[Floats, float], Floats]:
    import numba

    p = dict(_RING)
    c, cs, cp, r, rp, lh = (p[k] for k in ("c", "cs", "cp", "r", "rp", "lh"))
    ls1, ls2, rg1, rg2, ri, rc = (p[k] for k in ("ls1", "ls2", "rg1", "rg2", "ri", "rc"))
    gamma, delta, tau = p["gamma"], p["delta"], 2.0 * math.pi

    @numba.njit
    def rates(y: Floats, t: float) -> Floats:
        out = np.empty(15)
        in1, in2 = 0.5 * math.sin(tau * 1e3 * t), 2.0 * math.sin(tau * 1e4 * t)
        d1 = gamma * math.expm1(delta * (y[2] - y[4] - y[6] - in2))
        d2 = gamma * math.expm1(delta * (-y[3] + y[5] - y[6] - in2))
        d3 = gamma * math.expm1(delta * (y[3] + y[4] + y[6] + in2))
        d4 = gamma * math.expm1(delta * (-y[2] - y[5] + y[6] + in2))
        out[0] = (y[7] - 0.5 * y[9] + 0.5 * y[10] + y[13] - y[0] / r) / c
        out[1] = (y[8] - 0.5 * y[11] + 0.5 * y[12] + y[14] - y[1] / r) / c
        out[2] = (y[9] - d1 + d4) / cs
        out[3] = (-y[10] + d2 - d3) / cs
        out[4] = (y[11] + d1 - d3) / cs
        out[5] = (-y[12] - d2 + d4) / cs
        out[6] = (d1 + d2 - d3 - d4 - y[6] / rp) / cp
        out[7] = -y[0] / lh
        out[8] = -y[1] / lh
        out[9] = (0.5 * y[0] - y[2] - rg2 * y[9]) / ls2
        out[10] = (-0.5 * y[0] + y[3] - rg2 * y[10]) / ls2
        out[11] = (0.5 * y[1] - y[4] - rg2 * y[11]) / ls2
        out[12] = (-0.5 * y[1] + y[5] - rg2 * y[12]) / ls2
        out[13] = (-y[0] + in1 - (ri + rg1) * y[13]) / ls1
        out[14] = (-y[1] - (rc + rg1) * y[14]) / ls1
        return out

    return rates


def _ring_reference(until: tuple[float, ...], fine: int) -> Floats:
    """Solve by LSODA's backward differences: the fastest rate is 3e11 / s where a diode takes over,
    3e8 over the span.
    """
    tolerance = (1e-12, 2e-13)[fine]
    times = (0.0, *until)
    # Voltages are known to 1e-12 V, the currents, of the order of a milliampere, to 1e-15 A.
    absolute = tolerance * np.array([1.0] * 7 + [1e-3] * 8)
    found = odeint(_ring_rates(), np.zeros(15), times, rtol=tolerance, atol=absolute, mxstep=10**8)[1:]
    found[:, 7:] *= 1e3
    return found


RING_MODULATOR = StiffCircuit(
    name="ring_modulator",
    title="ring modulator, four diodes and twelve windings, 1 ms",
    t_stop_s=1e-3,
    t_edge_s=1e-7,
    lines=_ring_lines(),
    probes=tuple(f"y{i}" for i in range(1, 16)),
    published=(
        -0.2339057358486745e-1,
        -0.7367485485540825e-2,
        0.2582956709291169,
        -0.4064465721283450,
        -0.4039455665149794,
        0.2607966765422943,
        0.1106761861269975,
        0.2939904342435596e-6,
        -0.2840029933642329e-7,
        0.7267198267264553e-3,
        0.7929487196960840e-3,
        -0.7255283495698965e-3,
        -0.7941401968526521e-3,
        0.7088495416976114e-4,
        0.2390059075236570e-4,
    ),
    times_s=_RING_TIMES,
    reference=partial(_ring_reference, _RING_TIMES),
    scale=(1.0,) * 7 + (1e-3,) * 8,
)

RING_MODULATOR_START = replace(
    RING_MODULATOR,
    name="ring_modulator_start",
    title="the first 0.1 ms of the ring modulator, in which all four diodes have conducted",
    t_stop_s=1e-4,
    published=(None,) * 15,
    times_s=_RING_START_TIMES,
    reference=partial(_ring_reference, _RING_START_TIMES),
)

CIRCUITS = {
    c.name: c for c in (TRANSISTOR_AMPLIFIER, NAND_GATE, CHARGE_PUMP, RING_MODULATOR, RING_MODULATOR_START)
}
