# SPDX-License-Identifier: Apache-2.0
"""Hard inputs of the converter that need more than a list of duties: scales, times, traps and
refusals.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

from dermis import plan
from dermis.chip import hdl
from dermis.chip.sources import rtl_include_dirs, rtl_sources
from dermis.converter import vfc
from dermis.engines import closed, cosim, event, rtl
from dermis.errors import InputError
from dermis.processes import children
from dermis.records import Plan
from dermis.scene import scene
from dermis.scene.design import ROOT
from scripts.lint import header_values
from tb.programs.hard import converter_runs
from tb.programs.hard.case import Measured
from tb.programs.hard.converter_runs import GATE, World
from tb.reference import exact

UNIT_OHM = 250  # V_b / (k i0): x = 250 ohm / R


def _least(measured: Sequence[Measured]) -> Measured:
    """Return the worst of several results, with the sum of their seconds."""
    worst = max(measured, key=lambda m: math.inf if math.isnan(m.error) else m.error)
    return Measured(worst.error, worst.note, sum(m.seconds or 0.0 for m in measured))


def _differ(found: Any, expected: Any, seconds: float | None = None) -> Measured:
    """Return the largest difference of two lists of codes."""
    apart = [abs(int(a) - int(b)) for a, b in zip(found, expected, strict=True)]
    note = "" if not any(apart) else f"{list(map(int, found))[:12]}, exactly {list(map(int, expected))[:12]}"
    return Measured(float(max(apart)), note, seconds)


# ---- duties --------------------------------------------------------------------------------------------------


def windows(length: int, times: int) -> Measured:
    """Compare counts of successive windows of one duty with the walk, and with each other."""
    duties = [0.1, 1 / 3, math.sqrt(2) / 3, 123 / 510, 0.4999]
    begin = time.perf_counter()
    ends = np.array([converter_runs.loop({"x": duties}, length * n)[0] for n in range(1, times + 1)])
    seconds = time.perf_counter() - begin
    counts = np.diff(ends, axis=0, prepend=0)
    worst = 0
    for duty, own in zip(duties, counts.T, strict=True):
        bits = [int(bit) for bit in vfc.bits_exact(duty, length * times)]
        exactly = [sum(bits[n * length : (n + 1) * length]) for n in range(times)]
        worst = max(worst, *(abs(int(a) - b) for a, b in zip(own, exactly, strict=True)))
        worst = max(worst, int(own.max() - own.min()) - 1)
    return Measured(float(worst), f"{times} windows of {length} clocks", seconds)


def dips(window: float, clocks: float) -> tuple[float, ...]:
    """Return duties whose charge, with a latch, dips below the lower level of a window for
    `clocks`, or misses it.

    The first one comes at clock 2 with the charge at 2 x - 1/2; its packet lasts from 2.5 to 3.5. There the charge is
    3.5 x - 3/2, and has been below a level that it passes by e for e / (1 - x) + e / x.
    """
    middle = (1.5 - window / 2) / 3.5
    by = clocks / (1 / (1 - middle) + 1 / middle)
    return tuple((1.5 - window / 2 + side * by) / 3.5 for side in (-1, 1))


def glitches(module: str) -> Measured:
    """Count pulses of a synchronizer after a comparator that chatters in picoseconds, in Icarus."""
    rng = np.random.default_rng(5)
    covered = rng.random(4096) < 0.6
    ones, last = 0, False
    for bit in covered:
        last = bool(bit) and not last
        ones += last
    bench = Path(__file__).with_name("glitch_bench.sv")
    begin = time.perf_counter()
    sources = [source for source in rtl_sources() if source.stem in (module, "dermis_tech_dff")]
    command = hdl.program("icarus", module, {}, sources, rtl_include_dirs(), bench)
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        (work / "covered.txt").write_text("\n".join(str(int(bit)) for bit in covered))
        children.run_logged(command, work, work / "bench.log", 10.0, "Icarus")
        found = int((work / "pulses.txt").read_text())
    return Measured(float(abs(found - ones)), f"{found} pulses", time.perf_counter() - begin)


def asymptote(beside: float) -> World:
    """Return duties whose charge ends at a relative distance `beside` below and above the level,
    with a leak of 0.01 a clock.
    """
    effects = {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 400.0}, "comparator_offset": {"v_v": 0.2}}
    cell = exact.cell_of(0.0, effects, {})
    level = cell["rise"] * cell["leak"]
    return World(tuple(float(level * (1 + Fraction(side * beside))) for side in (-1, 1)), effects)


# ---- leak ----------------------------------------------------------------------------------------------------


def locking(periods: Sequence[int], keep: Fraction, clocks: int, nudge: float) -> Measured:
    """Compare counts at both edges of every plateau p/q, inside and outside by `nudge`, with fifty
    digits.

    The leak is the double nearest to -log(keep), for the walk as well, so only the loop's
    rounding remains.
    """
    with mpmath.workdps(exact.DIGITS):
        leak = float(-mpmath.log(mpmath.mpf(keep.numerator) / keep.denominator))
        lam = mpmath.exp(-mpmath.mpf(leak))
        rational = Fraction(int(mpmath.floor(lam * 2**160)), 2**160)
        places = [
            (float(edge) * (1 + side * nudge), p, q, side == inward)
            for q in periods
            for p, _ in exact.locked(q)
            for edge, inward in zip(exact.plateau(p, q, rational), (1, -1), strict=True)
            for side in (inward, -inward)
        ]
        duties = [place[0] for place in places]
        begin = time.perf_counter()
        same = [leak] * len(duties)
        found, _ = converter_runs.loop({"x": duties, "leak": same, "across": same}, clocks)
        seconds = time.perf_counter() - begin
        worst, where, outside = 0, "", 0
        for (x, p, q, inside), count in zip(places, found, strict=True):
            bits = exact.leaky_bits(mpmath.mpf(x), lam, clocks, mpmath.mpf(-0.5))
            settled = clocks // 2 // q * q  # whole periods, when the start no longer matters
            locks = sum(bits[-settled:]) == settled // q * p
            if inside and not locks:
                return Measured(
                    math.nan, f"the walk does not lock to {p}/{q} inside its plateau: edges wrong"
                )
            outside += not inside and not locks
            miss = abs(int(count) - sum(bits))
            if miss > worst:
                worst, where = miss, f"x = {x!r}: {count}, exactly {sum(bits)}"
    said = f"{len(duties)} duties; {outside} of the {len(duties) // 2} outside unlock within {clocks} clocks"
    return Measured(float(worst), where or said, seconds)


def plateau_edges(leak: Mapping[str, Any], margin: float) -> tuple[float, ...]:
    """Return both edges of the plateaus of 1/2 and 1/3, inside and outside by a margin."""
    with mpmath.workdps(exact.DIGITS):
        of = exact.cell_of(0.0, leak, {})["leak"]
        keep = mpmath.exp(-mpmath.mpf(of.numerator) / of.denominator)
        rational = Fraction(int(mpmath.floor(keep * 2**160)), 2**160)
    edges = [edge for q in (2, 3) for edge in exact.plateau(1, q, rational)]
    return tuple(float(edge) * (1 + side * margin) for edge in edges for side in (-1, 1))


def leaks(engine: str, first: int, last: int) -> Measured:
    """Compare time constants R C (1 + A) of 10^first .. 10^last seconds, at a gain of 1."""
    c_int_f = 5e-12
    worlds = [
        World(
            (0.1, 1 / 3, 0.4999), {"integrator_gain": {"gain_dc": 1.0, "r_in_ohm": 10.0**n / (2 * c_int_f)}}
        )
        for n in range(first, last + 1)
    ]
    return _least([converter_runs.codes(engine, world) for world in worlds])


def near_poles() -> dict[str, Any]:
    """Return leak and bandwidth with the closest time constants: lag across = 1 at a gain of 1."""
    gbw_hz, share, f_clk_hz, c_int_f = 1e6, 0.5, 5e6, 5e-12
    lag = share * f_clk_hz / (2 * math.pi * gbw_hz)
    return {
        "integrator_gain": {"gain_dc": 1.0, "r_in_ohm": lag / (c_int_f * f_clk_hz)},
        "integrator_bandwidth": {"gbw_hz": gbw_hz},
    }


def cells(fields: Mapping[str, float], duties: Sequence[float]) -> Measured:
    """Compare counts of converters given in packets and clocks with the walk in fifty digits."""
    whole = {name: [value] * len(duties) for name, value in fields.items()}
    begin = time.perf_counter()
    found, _ = converter_runs.loop({"x": duties, **whole}, GATE)
    seconds = time.perf_counter() - begin
    expected = [exact.interval({**exact.IDEAL, **fields, "x": Fraction(x)}, GATE)[0] for x in duties]
    return _differ(found, expected, seconds)


# ---- scale and time ------------------------------------------------------------------------------------------


def packets(engine: str) -> Measured:
    """Compare codes for reference currents over twelve decades."""
    codes = [0, 1, 2, 100, 127, 200, 254, 255]
    measured = []
    for exponent in range(-21, -8):
        made, _ = converter_runs.make_plan(World((0.0,) * 8), engine if engine == "closed" else "event")
        i0_a = 10.0**exponent * made.converter.f_clk_hz
        converter = dataclasses.replace(made.converter, i0_a=i0_a, c_int_f=i0_a / made.converter.f_clk_hz)
        unit_ohm = made.v_bias_v / (made.converter.k[0] * i0_a)
        with np.errstate(divide="ignore"):
            ohm = np.divide(unit_ohm * GATE, np.array(codes, dtype=float)).reshape(1, 1, 8)
        made = dataclasses.replace(made, converter=converter, resistance_ohm=ohm, force_n=None)
        begin = time.perf_counter()
        found = _run(engine, made)
        measured.append(_differ(found.ravel(), codes, time.perf_counter() - begin))
    return _least(measured)


def _run(engine: str, made: Plan) -> Any:
    if engine in ("icarus", "verilator"):
        return rtl.run(made, simulator=engine).codes
    return {"closed": closed, "event": event, "cosim": cosim}[engine].run(made).codes


def ripple(frame: int) -> Measured:
    """Compare the mean duty of two rows under supply ripple in a late frame with fifty digits."""
    relative, hertz, degrees = 0.9, 100003.0, 30.0
    data = {
        "array": {"rows": 2, "cols": 1},
        "stimulus": {"kind": "uniform", "code": [100]},
        "effects": {"supply_ripple": {"relative": relative, "frequency_hz": hertz, "phase_deg": degrees}},
    }
    made = dataclasses.replace(
        plan.make(scene.from_data(data, Path("hard.toml")), "event"), first_frame=frame
    )
    begin = time.perf_counter()
    found = event.run(made).info["x"].ravel()
    seconds = time.perf_counter() - begin
    timing, worst = made.timing, 0.0
    duty = Fraction(made.v_bias_v) / (80 * Fraction(25e-6) * Fraction(float(made.resistance_ohm[0, 0, 0])))
    turns_a_clock = Fraction(hertz) / Fraction(timing.f_clk_hz)
    with mpmath.workdps(exact.DIGITS):
        for row in range(2):
            clock = (frame * 2 + row) * timing.slot_clocks + timing.settle_clocks
            phases = [
                2 * mpmath.pi * mpmath.mpf(turns.numerator) / turns.denominator + mpmath.radians(degrees)
                for turns in (
                    (clock * turns_a_clock) % 1,
                    (clock * turns_a_clock) % 1 + timing.gate_clocks * turns_a_clock,
                )
            ]
            swing = (mpmath.cos(phases[0]) - mpmath.cos(phases[1])) / (phases[1] - phases[0])
            mean = mpmath.mpf(duty.numerator) / duty.denominator * (1 + mpmath.mpf(relative) * swing)
            worst = max(worst, abs(float(mean - mpmath.mpf(found[row]))))
    return Measured(worst, "", seconds)


def jitter(t_s: float) -> Measured:
    """Compare mean and spread of codes under jitter with a walk from edge to edge, in standard
    errors.
    """
    frames, duty = 40, 100.3 / GATE
    data = {
        "array": {"rows": 8, "cols": 16},
        "stimulus": {"kind": "uniform", "r_ohm": [UNIT_OHM / duty] * frames},
        "effects": {"clock_jitter": {"t_s": t_s}},
        "run": {"seed": 11},
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), "event")
    begin = time.perf_counter()
    found = event.run(made).codes.ravel().astype(float)
    seconds = time.perf_counter() - begin
    rng = np.random.default_rng(12)
    edges = np.arange(GATE + 3) + t_s * made.timing.f_clk_hz * rng.standard_normal((found.size, GATE + 3))
    ones, taken = np.zeros(found.size), np.zeros(found.size)
    q = np.zeros((3, found.size))  # of this clock and of the two before
    for n in range(1, GATE + 1):
        # A one of clock n - 2 has its packet from edge n - 1 to this edge; that of n - 1 begins
        # here.
        taken += q[1] * (edges[:, n] - edges[:, n - 1])
        bit = (-0.5 + duty * edges[:, n] - taken >= 0) & (q[0] == 0)
        q = np.stack([bit.astype(float), q[0], q[1]])
        ones += bit
    spread = math.hypot(found.std(), ones.std())
    apart = abs(found.mean() - ones.mean()) / (spread / math.sqrt(found.size))
    # The variance of a variance: 2 v^2 / n for either.
    v = found.var(), ones.var()
    wider = abs(v[0] - v[1]) / math.sqrt(2 * (v[0] ** 2 + v[1] ** 2) / found.size)
    note = f"{found.mean():.3f} +- {found.std():.3f} codes, from edge to edge {ones.mean():.3f} +- {ones.std():.3f}"
    return Measured(float(max(apart, wider)), note, seconds)


# ---- ghosts and traps ----------------------------------------------------------------------------------------


def ghost(engine: str) -> Measured:
    """Read a taxel of 312 ohm in row 0 and one of code 2 in row 1, with the preset between them."""
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": {"kind": "uniform", "code": [0]}}
    made = plan.make(scene.from_data(data, Path("hard.toml")), "cosim" if engine == "cosim" else "event")
    ohm = np.array([[312.0] * 2, [UNIT_OHM * GATE / 2] * 2]).reshape(1, 2, 2)
    made = dataclasses.replace(made, resistance_ohm=ohm, force_n=None)
    begin = time.perf_counter()
    found = _run(engine, made)
    return _differ(found.ravel(), [255, 255, 2, 2], time.perf_counter() - begin)


OVERLOAD, TWO = Fraction(UNIT_OHM, 312), Fraction(2, GATE)


def ghost_unpreset(engine: str) -> Measured:
    """Read rows of 312 ohm, code 2 and code 2, of which only the first starts from the preset."""
    begin = time.perf_counter()
    if engine == "icarus":
        # A range that is never reached: without any effect the model is a straight line from preset
        # to preset.
        wide = {"integrator_range": {"v_max_v": 1e6, "v_min_v": -1e6}}
        world = World((float(OVERLOAD),) * 8 + (float(TWO),) * 16, wide)
        made, x = converter_runs.make_plan(world, "rtl", rows=3)
        with tempfile.TemporaryDirectory() as place:
            scanner = scanner_that_presets_once(Path(place))
            bits = rtl.effect_bits(made)
            found = converter_runs.through_verilog(made, x, bits, "icarus", instead=[scanner])[0, :, 0]
        expected = unpreset([OVERLOAD, TWO, TWO], made.timing.settle_clocks)
        return _differ(found, expected, time.perf_counter() - begin)
    # Without the settle clocks between the rows each gate begins with the charge of the one before.
    first = vfc.count_exact(OVERLOAD, GATE)
    left = Fraction(-1, 2) + GATE * OVERLOAD - first
    expected = vfc.count_exact(TWO, GATE, w0=left)
    if engine == "closed":
        found = int(vfc.count(float(TWO), GATE, w0=float(left)))
    else:
        found = int(converter_runs.loop({"x": [float(TWO)], "w0": [float(left)]}, GATE)[0][0])
    return _differ([found], [expected], time.perf_counter() - begin)


def scanner_that_presets_once(directory: Path) -> Path:
    """Write a copy of the row scanner that presets only in the first settle after enable."""
    text = (ROOT / "rtl" / "dermis_row_scanner.v").read_text()
    old = "  assign preset_o       = preset_q;\n"
    if text.count(old) != 1:
        raise ValueError("rtl/dermis_row_scanner.v no longer has the line to change")
    new = """  reg gated_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) gated_q <= 1'b0;
    else         gated_q <= active_q & (gated_q | ~preset_q);
  assign preset_o      = preset_q & ~(gated_q & active_q);
"""
    wrong = directory / "scanner_that_presets_once.v"
    wrong.write_text(text.replace(old, new))
    return wrong


def unpreset(duties: Sequence[Fraction], settle: int) -> list[int]:
    """Return codes of successive rows when only the first is preset and the converter runs through
    each settle.

    During the break between two rows the current of the first continues, as in
    models/verilog/array.sv; with the preset it has no effect.
    """
    w, last, counts = Fraction(-1, 2), False, []
    rest, before = header_values()["DERMIS_BREAK_CLOCKS"], Fraction(0)
    for row, x in enumerate(duties):
        ones = 0
        for n in range(GATE + (settle if row else 0)):
            w += (before if row and n < rest else x) - last
            last = w >= 0 and not last
            ones += last and (not row or n >= settle)
        counts.append(min(ones, 255))
        before = x
    return counts


TRAP_DUTIES = (Fraction(1, 2), Fraction(200, 510), Fraction(100, 510), Fraction(10, 510))


def two_flops(x: Fraction, first_gates: bool) -> int:
    """Count rising edges of two flip-flops on one clock edge, gated by the second one (and the
    first).
    """
    w, first, second, edges = Fraction(-1, 2) + x, False, False, 0
    for _ in range(GATE):
        sample = w >= 0 and not second and not (first and first_gates)
        edges += sample and not first
        first, second = sample, first
        w += x - second
    return edges


def trap(name: str) -> Measured:
    """Read codes through one of the wrong synchronizers of tb/rtl/traps, in Icarus."""
    made, x = converter_runs.make_plan(World(tuple(map(float, TRAP_DUTIES))), "rtl")
    begin = time.perf_counter()
    file = ROOT / "tb" / "rtl" / "traps" / f"{name}.v"
    found = converter_runs.through_verilog(made, x, 0, "icarus", instead=[file]).ravel()[: len(TRAP_DUTIES)]
    expected = [min(255, two_flops(x, name == "sync_both_qbar")) for x in TRAP_DUTIES]
    return _differ(found, expected, time.perf_counter() - begin)


# ---- refusals ------------------------------------------------------------------------------------------------


def _asked(data: dict[str, Any]) -> InputError | None:
    """Return the error of a scene with these tables."""
    tables = {"array": {"rows": 1, "cols": 2}, "stimulus": {"kind": "uniform", "code": [5]}, **data}
    try:
        plan.make(scene.from_data(tables, Path("hard.toml")), "event")
    except InputError as error:
        return error
    return None


def refused(data: dict[str, Any], key: str) -> Measured:
    """Return 0 if a scene ends with an InputError that names the key, else 1."""
    error = _asked(data)
    if error is None:
        return Measured(1.0, "accepted")
    return Measured(0.0 if key in error.key else 1.0, str(error))


def every_number_refused() -> Measured:
    """Count the keys of a scene that accept NaN, or an infinity that their table does not allow."""
    through, asked = [], 0
    for key, _, allowed, _ in scene.schema_rows():
        if not any(word in allowed for word in ("number", "one of interface.k_options")):
            continue
        table, _, name = key.rpartition(".")
        kind = table.partition(" kind = ")[2]
        values = [math.nan, -math.inf] + ([] if "inf is legal" in allowed else [math.inf])
        for value in values:
            given = [value] * 2 if "a list of" in allowed and "or a list" not in allowed else value
            data: Any = {name: given} | ({"kind": kind} if kind else {})
            for part in reversed(table.partition(" ")[0].split(".")):
                data = {part: data}
            error = _asked(data)
            asked += 1
            if error is None or name not in error.key:
                through.append(f"{key} = {value}: {'accepted' if error is None else error}")
    return Measured(float(len(through)), "; ".join(through[:3]) or f"{asked} values refused")


def bad_resistances() -> Measured:
    """Count the invalid resistances that a list, a csv and an npy file accept."""
    wrong, through = (math.nan, -math.inf, -1.0, -1e-300), []
    with tempfile.TemporaryDirectory() as place:
        for value in wrong:
            for kind in ("list", "csv", "npy"):
                if kind == "list":
                    stimulus: dict[str, Any] = {"kind": "uniform", "r_ohm": [500.0, value]}
                else:
                    file = Path(place) / f"taxels.{kind}"
                    ohm = np.array([[500.0, value]])
                    np.savetxt(file, ohm, delimiter=",") if kind == "csv" else np.save(file, ohm)
                    stimulus = {"kind": "resistance", "file": str(file)}
                if _asked({"stimulus": stimulus}) is None:
                    through.append(f"{kind}: {value}")
    data = {"array": {"rows": 1, "cols": 2}, "stimulus": {"kind": "uniform", "r_ohm": [-0.0]}}
    short = closed.run(plan.make(scene.from_data(data, Path("hard.toml")), "closed")).codes
    if (short != 255).any():
        through.append(f"minus zero reads {short.ravel().tolist()}")
    return Measured(float(len(through)), "; ".join(through))


def nan_duty() -> Measured:
    """Return 0 if the formula refuses a duty of NaN."""
    try:
        found = vfc.count(np.array([0.1, math.nan]))
    except ValueError as error:
        return Measured(0.0, str(error))
    return Measured(1.0, f"counts {found.tolist()}")
