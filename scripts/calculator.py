# SPDX-License-Identifier: Apache-2.0
"""Design calculator: from sensor range, array, frame time and bits to f_clk, gate, i0, V_b, k, C.

It applies the paper's equations with the mirror ratio k where the paper drops it (docs/numbers.md).
For targets that cannot be met it names each missed limit and the nearest targets that meet it.
Arithmetic is exact, on the decimals as written: the paper's targets give k = 80 and not 80.0000001.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import click
import tomlkit
from pydantic import BaseModel

from dermis.chip import hdl
from dermis.chip import spi_protocol as spi
from dermis.converter import vfc
from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.report import verdict
from dermis.scene import design as design_module
from dermis.scene.design import ABSOLUTE_ZERO_C, K_BOLTZMANN_J_PER_K, Design, exact, spec
from dermis.scene.schema import entry, validate
from scripts.synth.command import sdc_periods

HALF = Fraction(1, 2)
FILE = "command line"
RANGE_COLUMNS = ("R [ohm]", "F [N]", "x", "f [Hz]", "code", "code by eq. (3)", "dR [ohm]", "dF [N]")

Changes = dict[str, float | int | None]
"""New values of some targets; None removes one."""

CHOSEN = (
    "interface.v_bias_v", "interface.k", "converter.i0_a", "converter.c_int_f", "converter.f_clk_hz",
    "timing.gate_clocks",
)  # fmt: skip
"""Values that the calculator chooses, where they are no targets."""

_target = partial(entry, None)


class Targets(BaseModel, strict=True, extra="forbid", frozen=True, allow_inf_nan=False):
    """Design targets; an omitted one comes from models/design.toml or follows from the others."""

    rows: int | None = _target("rows of the array", ge=1, le=1024)
    cols: int | None = _target("columns of the array, one converter each", ge=1, le=1024)
    frame_s: float | None = _target("time of one frame in s", gt=1e-9, lt=1e6)
    frame_rate_hz: float | None = _target("frames per second, instead of frame_s", gt=1e-6, lt=1e9)
    bits: int | None = _target("bits of a code", ge=1, le=16)
    settle_fraction: float | None = _target("smallest share of a row slot for settling", ge=0, lt=1)
    r_min_ohm: float | None = _target("sensor resistance at full force in ohm", gt=1e-3, lt=1e12)
    r_max_ohm: float | None = _target("highest sensor resistance to be read in ohm", gt=1e-3, lt=1e12)
    force_max_n: float | None = _target("full force in N, k_force_n_ohm / r_min_ohm", gt=1e-9, lt=1e9)
    force_min_n: float | None = _target("lowest force to be read in N, instead of r_max_ohm", gt=1e-9, lt=1e9)
    k_force_n_ohm: float | None = _target("force times resistance in N.ohm", gt=1e-9, lt=1e15)
    i_sensor_a: float | None = _target("largest taxel current in A; sets v_bias_v", gt=1e-12, lt=1e3)
    v_bias_v: float | None = _target("bias of the driven row in V, instead of i_sensor_a", gt=1e-9, lt=1e6)
    c_int_f: float | None = _target("integration capacitor in F", gt=1e-18, lt=1)
    packet_v: float | None = _target("largest step of the integrator per packet in V", gt=1e-9, lt=1e6)
    k: int | None = _target("mirror ratio", ge=1, le=100_000)
    i0_a: float | None = _target("reference current in A", gt=1e-15, lt=10)
    f_clk_hz: float | None = _target("clock in Hz; default: computed", gt=1, lt=1e12)
    gate_clocks: int | None = _target("gate in clocks; default: computed", ge=1, le=2**24)
    gain_dc: float | None = _target("open-loop gain of the integrator", gt=1, lt=1e12)
    topology: Literal[design_module.TOPOLOGIES] | None = _target("interface between column and converter")

    def take(self, name: str, default: float | Fraction) -> Fraction:
        """Return the exact value of a target, or of its default."""
        value = getattr(self, name)
        return exact(default if value is None else value)


def make_targets(**targets: Any) -> Targets:
    """Check targets and return them; InputError for a wrong name, type or value, or two targets for one quantity."""
    made: Targets = validate(Targets, targets, FILE)
    twice = {"frame_rate_hz": "frame_s", "i_sensor_a": "v_bias_v", "force_min_n": "r_max_ohm"}
    for name, other in twice.items():
        if None not in (value := getattr(made, name), getattr(made, other)):
            raise InputError(FILE, name, value, f"no value, because {other} sets the same quantity")
    k_force = made.k_force_n_ohm
    if None not in (made.r_min_ohm, made.force_max_n, k_force):
        said = exact(made.r_min_ohm) * exact(made.force_max_n)
        if said != exact(k_force):
            raise InputError(FILE, "k_force_n_ohm", k_force, f"r_min_ohm force_max_n = {float(said)!r}")
    return made


@dataclass(frozen=True)
class Answer:
    """The design that follows from the targets, exact, with its verdict.

    `rows` has one verdict row per limit; `nearest` gives, for each missed limit, targets that meet it.
    """

    targets: Targets
    base: Design
    topology: str
    array_rows: int
    array_cols: int
    bits: int
    frame_s: Fraction
    f_clk_hz: Fraction
    slot_clocks: int
    gate_clocks: int
    r_min_ohm: Fraction
    r_max_ohm: Fraction
    k_force_n_ohm: Fraction
    v_bias_v: Fraction
    k: Fraction
    i0_a: Fraction
    c_int_f: Fraction
    tau_leak_s: Fraction
    settle_clocks: int
    """Clocks of a slot before the gate; negative when the gate does not fit."""
    rows: tuple[verdict.Row, ...] = ()
    nearest: Mapping[str, Changes] = field(default_factory=dict)

    @property
    def feasible(self) -> bool:
        return verdict.exit_code(self.rows) == 0

    @property
    def code_max(self) -> int:
        return 2**self.bits - 1

    @property
    def packet_v(self) -> Fraction:
        """Packet on the integration capacitor; both are k times larger with the direct interface."""
        return self.i0_a / self.f_clk_hz / self.c_int_f

    @property
    def r_unit_ohm(self) -> Fraction:
        """Resistance V_b / (k i0) with one packet per clock, x = 1."""
        return self.v_bias_v / (self.k * self.i0_a)

    def duty(self, resistance_ohm: Fraction) -> Fraction:
        return self.r_unit_ohm / resistance_ohm

    def code(self, resistance_ohm: Fraction) -> int:
        """Return the code of a resistance by exact charge balance."""
        return min(self.code_max, vfc.count_rational(self.duty(resistance_ohm), self.gate_clocks))

    def values(self) -> dict[str, float | int | str]:
        """Return the answer as a flat dict with units in the keys."""
        values: dict[str, Any] = {
            "topology": self.topology,
            "rows": self.array_rows,
            "cols": self.array_cols,
            "bits": self.bits,
            "frame_s": self.frame_s,
            "frame_rate_hz": 1 / self.frame_s,
            "slot_s": self.slot_clocks / self.f_clk_hz,
            "f_clk_hz": self.f_clk_hz,
            "slot_clocks": self.slot_clocks,
            "gate_clocks": self.gate_clocks,
            "settle_clocks": self.settle_clocks,
            "gate_s": self.gate_clocks / self.f_clk_hz,
            "settle_s": self.settle_clocks / self.f_clk_hz,
            "f_max_hz": self.f_clk_hz / 2,
            "r_min_ohm": self.r_min_ohm,
            "r_max_ohm": self.r_max_ohm,
            "force_max_n": self.k_force_n_ohm / self.r_min_ohm,
            "force_min_n": self.k_force_n_ohm / self.r_max_ohm,
            "k_force_n_ohm": self.k_force_n_ohm,
            "v_bias_v": self.v_bias_v,
            "i_sensor_a": self.v_bias_v / self.r_min_ohm,
            "k": int(self.k) if self.k.denominator == 1 else self.k,
            "i0_a": self.i0_a,
            "c_int_f": self.c_int_f,
            "packet_c": self.i0_a / self.f_clk_hz,
            "packet_v": self.packet_v,
            "tau_leak_s": self.tau_leak_s,
        }
        return {name: float(v) if isinstance(v, Fraction) else v for name, v in values.items()}

    def design(self) -> Design:
        """Return models/design.toml with this answer in it, checked by the loader; InputError if a limit is missed."""
        missed = [f"{row['name']} ({row['note']})" for row in self.rows if row["status"] != "PASS"]
        if missed:
            raise InputError(FILE, "targets", "impossible", f"targets that meet {'; '.join(missed)}")
        own, base = self.values(), self.base
        tables = {
            "array": ("rows", "cols"),
            "sensor": ("force_max_n", "r_min_ohm", "r_max_ohm"),
            "interface": ("topology", "v_bias_v"),
            "converter": ("i0_a", "c_int_f", "f_clk_hz"),
            "timing": ("frame_s", "gate_clocks"),
        }
        new = {table: {name: own[name] for name in names} for table, names in tables.items()}
        new["timing"]["code_bits"] = self.bits
        # A k within k_distance of an option is that option.
        new["interface"]["k"] = round(self.k)
        if self.f_clk_hz > exact(base.converter.f_clk_hz):
            # An edge is 1/200 of a faster clock at most.
            new["converter"]["t_edge_s"] = min(base.converter.t_edge_s, float(1 / self.f_clk_hz / 200))
        new["integrator"] = {"gain_dc": float(self.targets.gain_dc or base.integrator.gain_dc)}
        # The same parts of full scale.
        grown = self.k * self.i0_a / (exact(base.interface.k) * exact(base.converter.i0_a))
        stored = base.calibration.model_dump().items()
        new["calibration"] = {name: float(exact(value) * grown) for name, value in stored}
        return base.replace(**new)

    def range_table(self, points: int = 12) -> list[tuple[float, ...]]:
        """Return rows of `RANGE_COLUMNS` from r_min to r_max in steps of equal ratio, of three digits.

        dR and dF are the change of one code at that resistance; dF is constant.
        """
        low, ratio = float(self.r_min_ohm), float(self.r_max_ohm / self.r_min_ohm)
        inner = [_digits(low * ratio ** (i / (points - 1)), 3, round) for i in range(1, points - 1)]
        d_force = self.k_force_n_ohm / (self.gate_clocks * self.r_unit_ohm)
        table = []
        for r in [self.r_min_ohm, *(exact(r) for r in inner), self.r_max_ohm]:
            x = self.duty(r)
            rate = self.f_clk_hz * min(x, HALF)
            d_r = r * r / (self.gate_clocks * self.r_unit_ohm)
            eq3 = min(self.code_max, int(vfc.count_restarting(float(x), self.gate_clocks)))
            cells = (r, self.k_force_n_ohm / r, x, rate, self.code(r), eq3, d_r, d_force)
            table.append(tuple(float(c) for c in cells))
        return table


def _digits(value: Fraction | float, digits: int, rounding: Callable[[Fraction], int]) -> float:
    scale = Fraction(10) ** (digits - 1 - math.floor(math.log10(value)))
    return float(rounding(exact(value) * scale) / scale)


_at_least, _at_most = (partial(_digits, digits=6, rounding=way) for way in (math.ceil, math.floor))


def solve(targets: Targets | None = None, base: Design | None = None) -> Answer:
    """Size the chip for the targets; values that they omit are chosen, or those of `base` (models/design.toml).

    Without any target it judges `base` as it is. The answer is always complete; `feasible` is False and `rows` has the
    reason where it cannot be built. InputError if targets contradict one another (r_max_ohm below r_min_ohm).
    """
    targets, base = targets or Targets(), base or design_module.load()
    if targets == Targets():
        stored = {key.partition(".")[2]: value for key, value in base.stored().items() if key in CHOSEN}
        targets = make_targets(**stored)
    take = targets.take

    topology = targets.topology or base.interface.topology
    array_rows, array_cols = int(take("rows", base.array.rows)), int(take("cols", base.array.cols))
    bits = int(take("bits", base.timing.code_bits))
    r_min, r_max, k_force = _sensor(targets, base)
    i_max = spec()["calculator.sensor_current_a"].max
    v_bias = min(exact(base.interface.v_bias_v), exact(i_max) * r_min)
    v_bias = take("v_bias_v", v_bias if targets.i_sensor_a is None else exact(targets.i_sensor_a) * r_min)

    # Eqs (1), (9) with k: at r_min one packet every second clock, V_b / (k i0 r_min) = 1/2.
    full_scale_a, x_full = v_bias / (HALF * r_min), HALF
    if None not in (targets.k, targets.i0_a):
        x_full = v_bias / (r_min * targets.k * exact(targets.i0_a))

    gate = targets.gate_clocks or _gate(bits, min(x_full, HALF))
    rate = targets.frame_rate_hz
    frame_s = take("frame_s", 1 / exact(rate) if rate else base.timing.frame_s)
    slot_s = frame_s / array_rows
    settle = take("settle_fraction", Fraction(base.timing.settle_clocks, base.timing.slot_clocks))
    needed = _slot_clocks(gate, settle, base)
    if targets.f_clk_hz is None:
        slot_clocks = needed
        f_clk = slot_clocks / slot_s
    else:
        f_clk = exact(targets.f_clk_hz)
        slot_clocks = _floor(slot_s * f_clk)
        if slot_clocks < 1:
            allowed = f"at least one clock in a slot of {float(slot_s):g} s"
            raise InputError(FILE, "f_clk_hz", targets.f_clk_hz, allowed)
        # A slot is whole clocks; the frame gets that little shorter.
        frame_s = array_rows * slot_clocks / f_clk

    k, i0, c_int = _charge(targets, base, full_scale_a, f_clk)
    gain_dc = take("gain_dc", base.integrator.gain_dc)
    source_ohm = {
        # Without a conveyor every taxel of a column loads the virtual ground.
        "direct": r_min / array_rows,
        "multi_output_conveyor": exact(base.conveyor.r_z_ohm),
    }.get(topology, exact(base.mirror.r_out_ohm))
    scale = k if topology == "direct" else Fraction(1)
    source_ohm = 1 / (1 / source_ohm + 1 / exact(base.integrator.r_in_ohm))
    tau = (gain_dc + 1) * source_ohm * c_int * scale

    answer = Answer(
        targets, base, topology, array_rows, array_cols, bits, frame_s, f_clk, slot_clocks, gate,
        r_min, r_max, k_force, v_bias, k, i0, c_int, tau, slot_clocks - gate,
    )  # fmt: skip
    return _judged(answer, slot_s, settle, needed, source_ohm, scale)


def _sensor(targets: Targets, base: Design) -> tuple[Fraction, Fraction, Fraction]:
    """Return r_min, r_max, K_f; K_f is that of the sensor if only one end of the range is given."""
    sensor, ends = base.sensor, (targets.r_min_ohm, targets.force_max_n)
    r_min, force_max = ends if None not in ends else (sensor.r_min_ohm, sensor.force_max_n)
    k_force = targets.take("k_force_n_ohm", exact(r_min) * exact(force_max))
    r_min = targets.take("r_min_ohm", k_force / targets.take("force_max_n", sensor.force_max_n))
    force_min = targets.take("force_min_n", k_force / targets.take("r_max_ohm", sensor.r_max_ohm))
    r_max = k_force / force_min
    if r_max > r_min:
        return r_min, r_max, k_force
    if targets.force_min_n is not None:
        allowed = f"below the full force of {float(k_force / r_min):g} N"
        raise InputError(FILE, "force_min_n", targets.force_min_n, allowed)
    raise InputError(FILE, "r_max_ohm", float(r_max), f"above the {float(r_min):g} ohm at full force")


def _closest(k: Fraction, base: Design) -> int:
    """Return the switchable ratio next to k."""
    return min(base.interface.k_options, key=lambda option: abs(k / option - 1))


def _charge(
    targets: Targets, base: Design, full_scale_a: Fraction, f_clk: Fraction
) -> tuple[Fraction, Fraction, Fraction]:
    """Return k, i0, C: full scale fixes k i0, the swing fixes i0 T = C packet_v.

    Without k or i0 the smallest switchable k is taken that keeps the packet within the swing.
    """
    swing = targets.take("packet_v", base.converter.packet_v)
    wanted_c = targets.take("c_int_f", base.converter.c_int_f)
    if targets.k is not None:
        k = Fraction(targets.k)
        i0 = targets.take("i0_a", full_scale_a / k)
    elif targets.i0_a is not None:
        i0 = exact(targets.i0_a)
        k = full_scale_a / i0
        nearest = _closest(k, base)
        # A rounded i0 still means the nearest whole ratio.
        k = Fraction(nearest) if abs(k / nearest - 1) <= exact(spec()["calculator.k_distance"].max) else k
    else:
        ideal = full_scale_a / (wanted_c * swing * f_clk)
        ideal *= 1 - Fraction(1, 10**12)  # a design that was written has its values as doubles
        k = Fraction(next((o for o in base.interface.k_options if o >= ideal), base.interface.k_options[-1]))
        i0 = full_scale_a / k
    c_int = wanted_c if targets.c_int_f is not None else i0 / f_clk / swing
    return k, i0, c_int


def _floor(value: Fraction) -> int:
    """Round down what doubles of a written design may have made a little less than whole."""
    return math.floor(value * (1 + exact(design_module.ROUNDING)))


def _gate(bits: int, duty: Fraction) -> int:
    """Return the shortest gate in which this duty at full scale counts to the highest code: eq. (6) made exact."""
    return math.ceil((2**bits - 1) / duty)


def _slot_clocks(gate: int, settle: Fraction, base: Design) -> int:
    """Return the clocks of a slot; the row scanner sets the minimum (docs/rtl.md)."""
    return max(math.ceil(gate / (1 - settle)), gate + base.timing.break_clocks + 2)


def _judged(
    answer: Answer, slot_s: Fraction, settle: Fraction, needed: int, source_ohm: Fraction, scale: Fraction
) -> Answer:
    """Add the verdict rows, and for each missed limit the nearest targets that meet it.

    `scale` multiplies c_int_f and i0 T: k for the direct interface, else 1.
    """
    targets, base = answer.targets, answer.base
    rows: list[verdict.Row] = []
    nearest: dict[str, Changes] = {}

    def limit(name: str) -> Fraction:
        rule = spec()[f"calculator.{name}"]
        return exact(rule.max if rule.max is not None else rule.min)

    def row(name: str, value: Fraction | float | int, note: str, changes: Changes | None) -> None:
        if not isinstance(value, int):
            apart = abs(value - limit(name))  # doubles of a written design are off by their rounding
            value = float(limit(name) if apart <= design_module.ROUNDING * limit(name) else value)
        judged = verdict.judge(f"calculator.{name}", value, note)
        if judged["status"] == "FAIL" and changes is not None:
            if targets.frame_rate_hz is not None and "frame_s" in changes:
                rate = _at_most(1 / exact(changes["frame_s"]))
                changes = {n: v for n, v in changes.items() if n != "frame_s"} | {"frame_rate_hz": rate}
            # Only a target that was given can be removed.
            changes = {n: v for n, v in changes.items() if v is not None or getattr(targets, n) is not None}
            nearest[judged["name"]] = changes
            said = ", ".join(f"{k} = {v:g}" if v is not None else f"no {k}" for k, v in changes.items())
            judged["note"] = f"{note}; nearest: {said}"
        rows.append(judged)

    r_min, k, i0, v_bias, f_clk = answer.r_min_ohm, answer.k, answer.i0_a, answer.v_bias_v, answer.f_clk_hz
    x_full = answer.duty(r_min)
    usable = min(x_full, HALF)

    either, ohm = ("v_bias_v", 1) if targets.i_sensor_a is None else ("i_sensor_a", r_min)
    note, most = f"{float(v_bias):g} V on {float(r_min):g} ohm", limit("sensor_current_a") * r_min
    row("sensor_current_a", v_bias / r_min, note, {either: _at_most(most / ohm)})
    supply = exact(base.supply.vdd_v)
    most = supply * limit("v_bias_supply")
    note = f"{float(v_bias):g} V of {float(most):g} V"
    row("v_bias_supply", v_bias / supply, note, {either: _at_most(most / ohm)})

    options = base.interface.k_options
    closest = _closest(k, base)
    switched: Changes = {"k": closest} if targets.k is not None else {"k": closest, "i0_a": None}
    note = f"k = {float(k):g}, switchable {', '.join(map(str, options))}"
    row("k_distance", abs(k / closest - 1), note, switched)
    smaller: Changes = {"i0_a": _at_least(v_bias / (HALF * r_min) / k), "gate_clocks": None}
    row("duty_full_scale", x_full, f"x = V_b / (k i0 R) at {float(r_min):g} ohm", smaller)

    # Pulses counted at any phase; where those suffice, pulses counted from the half-packet preset.
    counted = _floor(answer.gate_clocks * usable)
    if counted >= answer.code_max:
        counted = vfc.count_rational(usable, answer.gate_clocks)
    holds = (counted + 1).bit_length() - 1
    note = f"{answer.gate_clocks} clocks count to {counted} at r_min ({holds} bits), wanted {answer.code_max}"
    gate: Changes = {"gate_clocks": _gate(answer.bits, usable)}
    row("full_scale_code_error_lsb", counted - answer.code_max, note, gate)
    # gate x + 1/2 must reach code 1
    reach = answer.gate_clocks * answer.r_unit_ohm / (limit("code_at_r_max") - HALF)
    end: Changes = {"r_max_ohm": _at_most(reach)}
    if targets.force_min_n is not None:
        end = {"force_min_n": _at_least(answer.k_force_n_ohm / reach)}
    row("code_at_r_max", answer.code(answer.r_max_ohm), f"code at {float(answer.r_max_ohm):g} ohm", end)

    left = answer.slot_clocks - needed
    note = f"slot {answer.slot_clocks}, gate {answer.gate_clocks}, with settling {needed} clocks"
    if left < 0:
        clocks = {b: _slot_clocks(_gate(b, usable), settle, base) for b in range(1, 17)}
        held = [b for b, needs in clocks.items() if needs <= answer.slot_clocks]
        note += f"; f_clk_hz = {_at_least(needed / slot_s):g} would do"
        note += f", or {held[-1]} bits" if held else ""
    row("gate_margin_clocks", left, note, {"frame_s": _at_least(answer.array_rows * needed / f_clk)})
    beyond, nearer = _beyond_the_chip(answer, usable)
    row("beyond_the_chip", len(beyond), "; ".join(beyond) or "what the Verilog is made for", nearer)
    settle_min, lag_s = limit("settle_s"), Fraction(0)
    if answer.topology != "direct":
        lag_s = exact(base.mirror.q_lag_c) / (i0 * answer.duty(answer.r_max_ohm))
        settle_min = max(settle_min, limit("mirror_settling") * lag_s)
    if targets.f_clk_hz is not None:
        # Whole clocks, so that rounding a slot down cannot remove the last one.
        clocks = max(answer.gate_clocks + math.ceil(settle_min * f_clk), needed)
        longer: Changes = {"frame_s": _at_least(answer.array_rows * clocks / f_clk)}
    elif settle >= Fraction(1, 20):
        longer = {"frame_s": _at_least(answer.frame_s * settle_min / (slot_s * settle))}
    elif settle_min <= slot_s / 2:
        longer = {"settle_fraction": _at_least(settle_min / slot_s)}
    else:
        longer = {"settle_fraction": 0.5, "frame_s": _at_least(2 * settle_min * answer.array_rows)}
    row("settle_s", answer.settle_clocks / f_clk, f"{answer.settle_clocks} clocks", longer)
    if lag_s:
        settled, note = answer.settle_clocks / f_clk / lag_s, f"time constant {float(lag_s):.3g} s at r_max"
        # A longer frame has a slower clock, for which another k may be the smallest that does.
        kept = {"k": int(answer.k)} if targets.k is None and targets.i0_a is None else {}
        row("mirror_settling", settled, note, longer | kept)

    def slower(most_hz: Fraction) -> Changes:
        """Return the target that makes a clock of at most this frequency."""
        if targets.f_clk_hz is not None:
            return {"f_clk_hz": _at_most(most_hz)}
        return {"frame_s": _at_least(answer.array_rows * answer.slot_clocks / most_hz)}

    delay = exact(base.comparator.t_delay_s)
    note, nearer = f"delay {float(delay):g} s at {float(f_clk):g} Hz", None
    if delay:
        most = limit("comparator_delay_clocks") / delay
        note, nearer = f"{note}, so f_clk up to {float(most):g} Hz", slower(most)
    row("comparator_delay_clocks", delay * f_clk, note, nearer)
    row("core_clock_hz", f_clk, "before layout, at the slow corner", slower(limit("core_clock_hz")))

    sck_hz = exact(1e9 / sdc_periods()["sck"])
    size = spi.frame_bytes(answer.array_rows, answer.array_cols, answer.bits)

    def spi_s(clock_hz: Fraction) -> Fraction:
        """Return the time in which a frame is read, with the wait bytes of docs/spi.md."""
        return 8 * (1 + math.ceil((3 + 4 * sck_hz / clock_hz) / 8) + 3 + size) / sck_hz

    read_s = longest = spi_s(f_clk)
    for _ in range(
        9 if targets.f_clk_hz is None else 0
    ):  # a longer frame has a slower clock, which answers later
        longest = spi_s(f_clk * min(1, answer.frame_s / longest))
    if targets.f_clk_hz is not None:  # slots are whole clocks
        longest = answer.array_rows * math.ceil(longest / answer.array_rows * f_clk) / f_clk
    note = f"{size} bytes in {float(read_s):.3g} s at {float(sck_hz):g} Hz of SCK"
    row("spi_time", read_s / answer.frame_s, note, {"frame_s": _at_least(longest / limit("spi_time"))})

    charge = i0 / f_clk
    swing = min(exact(base.swing_v), targets.take("packet_v", base.swing_v))
    smaller = {"packet_v": _at_most(swing)}
    if targets.c_int_f is not None:
        smaller = {"c_int_f": _at_least(charge / swing)}
    note = f"packet {float(answer.packet_v):g} V, at most {float(swing):g} V"
    row("packet_swing", answer.packet_v / swing, note, smaller)
    c_int, packet = answer.c_int_f * scale, float(charge * scale)
    row("c_int_f", c_int, f"packet {packet:g} C", {"c_int_f": _at_least(limit("c_int_f") / scale)})

    # The plateau of q = 2 is the widest: (1 - lam) / (1 + lam) = tanh(T / (2 tau)) in x.
    tau = float(answer.tau_leak_s)
    plateau = answer.gate_clocks * math.tanh(1 / float(f_clk) / (2 * tau))
    part = float(limit("leak_plateau_lsb")) / answer.gate_clocks
    tau_min = 1 / float(f_clk) / (2 * math.atanh(part)) if part < 1 else 0.0
    more_gain = {"gain_dc": _at_least(max(tau_min / float(source_ohm * c_int) - 1, 1.0))} if tau_min else None
    row("leak_plateau_lsb", plateau, f"R_leak C = {tau:.4g} s, at least {tau_min:.4g} s", more_gain)

    kt = K_BOLTZMANN_J_PER_K * (base.ambient.temperature_c - ABSOLUTE_ZERO_C)
    noise = math.sqrt(kt * float(c_int)) / packet
    c_quiet = (float(limit("kt_c_lsb")) * packet) ** 2 / kt / float(scale)
    quiet: Changes = {"c_int_f": _at_most(c_quiet), "packet_v": None}
    if targets.k is None and targets.i0_a is None:
        # With the capacitor alone given, k and so the packet would change.
        quiet["k"] = round(k)
    row("kt_c_lsb", noise, f"{noise * packet:.3g} C on a packet of {packet:.3g} C", quiet)

    return dataclasses.replace(answer, rows=tuple(rows), nearest=nearest)


def _beyond_the_chip(answer: Answer, usable: Fraction) -> tuple[list[str], Changes]:
    """Return what dermis_top is not made for, and the nearest targets that it is made for."""
    targets, break_clocks = answer.targets, answer.base.timing.break_clocks
    sizes = answer.array_rows, answer.array_cols, answer.bits, answer.gate_clocks, answer.settle_clocks
    beyond = [
        (key.partition(".")[2], f"{key} = {value}: {allowed}")
        for key, value, allowed in hdl.chip_limits(*sizes, break_clocks)
        # A gate that does not fit into its slot has a row of its own.
        if answer.settle_clocks >= break_clocks + 2 or key != "timing.settle_clocks"
    ]
    missed, gate = dict(beyond), answer.gate_clocks
    cols = min(answer.array_cols, hdl.SIDE_MAX)
    changes: Changes = {name: hdl.SIDE_MAX for name in ("rows", "cols") if name in missed}
    if "gate_clocks" in missed and targets.gate_clocks is not None:
        gate = changes["gate_clocks"] = min(max(gate, hdl.gate_min(cols, answer.bits)), hdl.WORD_MAX)
    elif "gate_clocks" in missed:
        gates = {bits: _gate(bits, usable) for bits in range(1, 17)}
        fitting = [b for b, clocks in gates.items() if hdl.gate_min(cols, b) <= clocks <= hdl.WORD_MAX]
        changes["bits"] = min(fitting, key=lambda bits: abs(bits - answer.bits), default=None)
        gate = gates.get(changes["bits"], gate)
    if "settle_clocks" in missed and targets.f_clk_hz is not None:
        changes["frame_s"] = _at_most(answer.array_rows * (gate + hdl.WORD_MAX) / answer.f_clk_hz)
    elif "settle_clocks" in missed:
        changes["settle_fraction"] = _at_most(Fraction(hdl.WORD_MAX, gate + hdl.WORD_MAX))
    return list(missed.values()), changes


def print_answer(answer: Answer) -> None:
    sizing = [(n, v if isinstance(v, str) else f"{v:.6g}") for n, v in answer.values().items()]
    verdict.print_table("Design", ("value", ""), sizing, ("",))
    cells = [[f"{cell:.6g}" for cell in row] for row in answer.range_table()]
    verdict.print_table("Over the range", RANGE_COLUMNS, cells, RANGE_COLUMNS)
    verdict.print_rows(answer.rows, "Feasibility")


SIZED = ("interface.k", "converter.i0_a", "converter.c_int_f")
"""Values that spice/sky130 is drawn for; no command resizes it."""


def write_design(answer: Answer, path: Path = design_module.DESIGN_FILE) -> list[str]:
    """Write the answer into a design file, keeping comments and reasons; return the changed keys.

    InputError, and an unchanged file, if a limit is missed or the result is no valid design.
    """
    new, old = answer.design().stored(), answer.base.stored()
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    changed = [key for key, value in new.items() if value != old[key]]
    for key in changed:
        section, name = key.split(".")
        table: Any = document[section]
        said = table.item(name).trivia.comment
        item = tomlkit.item(new[key])
        item.comment(said or f"dermis calc; the reason above is that of {old[key]!r}")
        table[name] = item
    if changed:
        write_atomic(path, tomlkit.dumps(document))
    return changed


@click.command("calc")
@click.option("--write", is_flag=True, help="Write the answer into models/design.toml.")
def calc_command(write: bool, **values: Any) -> None:
    """Size the chip: clock, gate, i0, V_b, k and C from the targets given.

    Without options it judges the design of models/design.toml as it is. Exit 1: a limit is missed; the
    verdict names the nearest targets that meet it. Exit 2: a target is invalid, or --write was
    given and a limit is missed.
    """
    answer = solve(make_targets(**values))
    verdict.write_rows("calc", answer.rows)
    if write:
        changed = write_design(answer)
        click.echo(f"written: {', '.join(changed)}; next: make generate" if changed else "no change")
        if moved := [key for key in changed if key in SIZED]:
            click.echo(
                f"the transistors of spice/sky130 are sized for the old {', '.join(moved)}: resize mirror, charge "
                'source and integrator, or keep run.views = "behavioural" (docs/sky130.md)'
            )
        return
    print_answer(answer)
    if not answer.feasible:
        raise click.exceptions.Exit(1)


for _name, _about in Targets.model_fields.items():
    _kind = click.Choice(design_module.TOPOLOGIES) if _name == "topology" else get_args(_about.annotation)[0]
    _help = f"{_about.description[0].upper()}{_about.description[1:]}."
    click.option(f"--{_name.replace('_', '-')}", _name, type=_kind, help=_help)(calc_command)
