# SPDX-License-Identifier: Apache-2.0
"""Write the SPICE deck of a plan: row drivers, array and one channel per column, from the records only.

A record field at its default writes nothing beyond the ideal setting of its block, so an effect
that is off leaves no element behind. Every number is formatted from a float and every name is made
here: no text of a scene reaches a deck.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dermis import fields
from dermis.array.network import Network
from dermis.chip import sky130
from dermis.chip.spice_text import array_subckt, spice_number
from dermis.errors import InputError
from dermis.lockstep.ngspice import Deck
from dermis.places import ROOT
from dermis.records import Plan
from dermis.scene.views import CONVERTER, Views

SPICE = ROOT / "spice"

SHARED = ("devices.inc", "level_shifter.sp", "bias.sp", "ota.sp")
"""Files of spice/sky130 that its blocks use."""

# Up to this part of a clock the delay of a comparator is the pole of its block: of a bend a clock ago 2e-9 is left.
# Above it, a pole would round bends (3 % at 0.3 clock, 28 codes with a clamp), so the block has no pole and its output
# is sampled that much earlier, on a time point (comparator_early_s, Deck.late_s). Nothing else in the block depends on
# time, so its delay may be at its input or output. No transmission line: ngspice counts its limit of steps from the
# point before the last, which is negative after a step longer than the line ("timestep too small").
_DELAY_POLE_CLOCKS = 0.05

OF_BLOCK = {
    "row_driver": {"r_row_driven_ohm", "r_row_grounded_ohm"},
    "conveyor": {"r_column_ohm", "v_column_offset_v", "gain", "inv_i_range_a", "q_mirror_c"},
    "integrator": {"inv_gain_dc", "g_in_s", "v_int_max_v", "v_int_min_v", "preset_error_v", "t_gbw_s"},
    "comparator": {"v_comp_offset_v", "v_hysteresis_v", "t_comp_delay_s"},
    "charge_source": {"packet_error"},
}
"""Record fields that set the behaviour of a block; refused for a block of transistors."""

HONOURS = fields.of(*fields.FAMILIES) - fields.of("noise")
"""Record fields that a deck can express; a field that is not named here is refused."""

# A deck without a pole has straight lines between the corners of its sources, and trapezoidal integration of a
# capacitor follows those exactly at any step: there is no truncation error to limit (trtol), and the tolerances are
# those of Newton's method, which linear decks meet in the least number of iterations anyway.
_OPTIONS_EXACT = {"reltol": 1e-6, "abstol": 1e-13, "vntol": 1e-9, "trtol": 1e12}

# With a pole the step follows the truncation error. Ten times tighter changes no code of nonideal_channel and takes
# 1.8 times the steps; trtol 7 is ngspice's own, said because XSPICE elements would turn it into 1.
_OPTIONS_POLE = {"reltol": 1e-4, "abstol": 1e-12, "vntol": 1e-7, "chgtol": 1e-14, "trtol": 7.0}

# A clamp inside the converter's own swing is met at every packet, and what it takes decides which clock the next one
# falls on. At 1e-4 a code of a range of -0.25 .. 0.6 V is off by 3; at 1e-5 by 1; here by none.
_OPTIONS_CLAMP = {"reltol": 1e-6, "vntol": 1e-9, "chgtol": 1e-16, "trtol": 3.0}
# abstol there, of the deck's largest reference current: 1e-13 A at 25 uA. The direct interface has k times that: with
# 1e-13 A and its milliampere Newton's method could not meet the rounding of a capacitance between two ideal sources
# ("timestep too small").
_ABSTOL_CLAMP = 4e-9

# With a clamp, an edge of a packet lasts this part of a clock (1 ps). A ramp of r clocks moves r / 2 of a packet past
# the sample at its end and x^2 r / 2 into the clamp. Without a clamp the charge comes back; with it, the loss decides
# the clock of the next packet: 3 codes by 1 ns at x = 0.495 and a range of -0.56 V.
_EDGE_CLAMP_CLOCKS = 5e-6

# Transistors. Newton's method has to be done with a node of an open-loop amplifier: abstol above the noise of a
# megohm there (1 nA is 4e-5 of i0). chgtol is 2e-4 of a packet.
OPTIONS_TRANSISTORS = {"reltol": 1e-3, "abstol": 1e-9, "vntol": 1e-6, "chgtol": 1e-15}

# Row drivers alone: the error of a row from clock to clock is below dermis.chip.split.STILL_V. A node between open
# transistors has only their leakage, which at -40 C is too little for that tolerance: rshunt, in ohm, is 1 pA more.
_OPTIONS_ROWS = OPTIONS_TRANSISTORS | {"reltol": 1e-6, "vntol": 1e-9, "rshunt": 1e12}

# Longest step after an edge, relative to the time since it. Truncation control alone takes the transitions of a level
# shifter in one step, at any tolerance: packets were 0.4 % too small at -40 C and 0.9 of the supply, a code 1.0 LSB too
# large. With it codes are within 0.02 LSB of steps ten times as short (docs/views.md,
# test_the_steps_do_not_make_the_code).
STEP_GROWTH_TRANSISTORS = 0.25


def source_names(rows: int, cols: int, columns: Sequence[int] | None = None) -> tuple[str, ...]:
    """Names of the sources that the digital side drives: rows, preset, charge switches of all or some columns."""
    return (
        *(f"v_d_row{r}" for r in range(rows)),
        "v_d_preset",
        *(f"v_d_charge{c}" for c in (range(cols) if columns is None else columns)),
    )


def ranges_of(plan: Plan) -> tuple[int, ...]:
    """Return the range of each column's k, as the chip's registers have it; none for the direct interface."""
    options = plan.scene.design.interface.k_options
    return () if plan.topology == "direct" else tuple(options.index(k) for k in plan.converter.k.tolist())


def honours(plan: Plan) -> frozenset[str]:
    """Record fields that the decks of a plan can express in the views it takes."""
    blocks = set(plan.views.in_transistors(plan.topology))
    if _channel_in_transistors(plan.views, plan.topology):
        blocks |= set(CONVERTER)  # its channel takes no parameters
    lost = set().union(*(OF_BLOCK[block] for block in blocks))
    if plan.topology == "direct" and "integrator" in blocks:
        lost |= {"v_column_offset_v"}
    return HONOURS - lost


def refuses(plan: Plan) -> InputError | None:
    """Return the error for a plan outside the limits of its transistor views, or None."""
    views, world = plan.views, plan.scene
    blocks = views.in_transistors(plan.topology)
    interface, design = world.table.interface, world.design
    if not blocks:
        return None
    if views.columns is not None and len(parts(plan)) == 1 and len(views.columns) < plan.cols:
        allowed = "every column, where columns see each other: the direct interface, or lateral resistors"
        return InputError(world.path, "run.views.columns", list(views.columns), allowed)
    channel = blocks & set(CONVERTER)
    if plan.topology == "direct" and 0 < len(channel) < len(CONVERTER):
        block = next(b for b in CONVERTER if b not in channel)
        allowed = '"sky130" as the rest of the channel: the direct interface has blocks of other sizes'
        return InputError(world.path, f"run.views.{block}", '"behavioural"', allowed)
    most_v = design.supply.vdd_v * views.supply_scale
    if "row_driver" in blocks and interface.v_bias_v > most_v:
        allowed = f"at most {most_v:g}, the supply of row drivers in transistors"
        return InputError(world.path, "interface.v_bias_v", interface.v_bias_v, allowed)
    if not channel and "conveyor" not in blocks:
        return None
    mirror, ratios = plan.topology == "conveyor_mirror" and "conveyor" in blocks, design.interface.k_options
    if mirror and ratios != sky130.MIRROR_RATIOS:
        made = f"{sky130.MIRROR_RATIOS}, the ratios of the sky130 mirror"
        return InputError("models/design.toml", "interface.k_options", ratios, made)
    drawn = {"k": sky130.DIRECT_K} if plan.topology == "direct" else {}
    for key, made in (drawn | sky130.DRAWN).items():
        if (value := getattr(interface, key)) != made:
            allowed = f'{made:g}, the size of the sky130 channel, or run.views = "behavioural"'
            return InputError(world.path, f"interface.{key}", value, allowed)
    return None


def parts(plan: Plan) -> tuple[tuple[int, ...], ...]:
    """Columns by the circuit that has them: circuits that may be solved apart, that of the row drivers without any.

    The cost of transistors grows with devices and steps, and every column needs time points of its
    own. Columns of conveyors are at their virtual grounds, so they only share the current of the
    rows; lateral resistors and the direct interface couple them. Models are solved fastest together.
    Row drivers, a third of the transistors of a column's circuit, step only when a row is switched.
    """
    columns = range(plan.cols)
    heavy = [c for c in columns if plan.views.has_transistors(c, plan.topology)]
    laterals = {"g_lateral_row_s", "g_lateral_column_s"} & plan.active_fields()
    if not heavy or plan.topology == "direct" or laterals:
        return (tuple(columns),)
    light = tuple(c for c in columns if c not in heavy)
    # Row drivers in transistors are a circuit of their own if rows are still while a gate is open.
    drivers = ((),) if plan.views.row_driver == "sky130" and not plan.drive.active_fields() else ()
    return (*drivers, *((c,) for c in heavy), *((light,) if light else ()))


def _channel_in_transistors(views: Views, topology: str) -> bool:
    """Return True if the channel is in transistors, with its conveyor or as one block."""
    blocks = views.in_transistors(topology)
    return ("conveyor" if topology != "direct" else "integrator") in blocks


def _includes(views: Views, topology: str) -> list[str]:
    """The lines that bring the blocks of a deck, each from the folder of its view."""
    blocks = views.in_transistors(topology)
    if not blocks:
        return [f'.include "{SPICE / name}"' for name in ("design.inc", "behavioural/blocks.inc")]

    def of(transistors: bool) -> str:
        return "sky130" if transistors else "behavioural"

    conveyor, channel = "conveyor" in blocks, _channel_in_transistors(views, topology)
    files = [
        *(f"sky130/{name}" for name in SHARED),
        f"{of('row_driver' in blocks)}/row_driver.sp",
        *(f"{of(conveyor)}/{name}.sp" for name in ("conveyor", "conveyor_multi", "mirror")),
        "sky130/offset_null.sp" if conveyor else "behavioural/mirror_lag.sp",
        *(f"{of(block in blocks)}/{block}.sp" for block in CONVERTER),
        f"{of(blocks >= set(CONVERTER))}/vfc.sp",
        f"{of(channel)}/channel_{'switched' if channel and topology == 'conveyor_mirror' else topology}.sp",
    ]
    return [
        f'.include "{SPICE / "design.inc"}"',
        f'.include "{sky130.models(views.corner)}"',
        f".temp {spice_number(views.temperature_c)}",
        f".param supply_v_logic_v={spice_number(sky130.logic_v(views.supply_scale))}",
        *(f'.include "{SPICE / name}"' for name in files),
    ]


def _channel_parameters(plan: Plan, network: Network, column: int) -> dict[str, float]:
    """Parameters of one channel that are away from the ideal channel, and the packet."""
    converter = plan.converter
    direct = plan.topology == "direct"
    packet_v = float(converter.packet_v()[column])
    values = {
        "i0_a": float(converter.i0_a[column]),
        "c_int_f": float(converter.c_int_f[column]),
        # v_preset_v is minus the stored charge, whatever the polarity of the channel
        "v_preset_v": 0.5 * packet_v - float(converter.preset_error_v[column]),
    }
    ideal = {
        "packet_error": (converter.packet_error, 0.0),
        "comp_v_offset_v": (converter.v_comp_offset_v, 0.0),
        "comp_v_hysteresis_v": (converter.v_hysteresis_v, 0.0),
        "comp_t_delay_s": (converter.t_comp_delay_s, 0.0),
        "int_v_out_max_v": (converter.v_int_max_v, np.inf),
        "int_v_out_min_v": (converter.v_int_min_v, -np.inf),
        "int_t_gbw_s": (converter.t_gbw_s, 0.0),
    }
    if direct:
        ideal["int_v_offset_v"] = (network.v_column_offset_v, 0.0)
    else:
        values["k"] = float(converter.k[column])
        copies = "conv_gain_error" if plan.topology == "multi_output_conveyor" else "mir_ratio_error"
        ideal |= {
            "conv_r_x_ohm": (np.maximum(network.r_column_ohm - network.r_pad_column_ohm, 0.0), 0.0),
            "conv_v_offset_v": (network.v_column_offset_v, 0.0),
            "out_inv_i_range_a": (converter.inv_i_range_a, 0.0),
            "out_q_lag_c": (converter.q_mirror_c, 0.0),
            copies: (converter.gain - 1.0, 0.0),
        }
    values |= {name: float(v[column]) for name, (v, off) in ideal.items() if v[column] != off}
    if converter.inv_gain_dc[column]:
        values["int_gain_dc"] = 1.0 / float(converter.inv_gain_dc[column])
    if converter.g_in_s[column]:
        values["int_r_in_ohm"] = 1.0 / float(converter.g_in_s[column])
    return values


def _late_s(plan: Plan) -> tuple[NDArray[np.float64], float]:
    """Return how long before the clock each comparator is sampled, in s; 0 for a delay up to the second value."""
    delay = np.broadcast_to(plan.converter.t_comp_delay_s, plan.cols)
    early = _DELAY_POLE_CLOCKS / plan.timing.f_clk_hz
    return np.where(delay > early, delay, 0.0), early


def _assignments(values: Mapping[str, float]) -> str:
    return " ".join(f"{name}={spice_number(value)}" for name, value in values.items())


def frame_deck(
    plan: Plan,
    frame: int,
    levels: Sequence[float],
    *,
    record: bool = False,
    columns: Sequence[int] | None = None,
    first_row: int = 0,
) -> Deck:
    """Write the deck of one frame.

    Parameters
    ----------
    plan, frame : whose resistances stand in the array
    levels : value of every source at time zero, in the order of `source_names`, of all columns
    record : probe the integrators as well, for waveforms
    columns : one of `parts`: those that the deck has channels for; the others end at their virtual grounds. If row
        drivers are a part, the rows of the others are sources of their voltages: `v_row0` and so on in place of
        `v_d_row0`. All columns and the row drivers by default
    first_row : row whose driving is time zero: of ripple and motion the deck has what they are there in a scan of all
        rows

    Returns a Deck. Its probes are the comparator outputs, then, if recorded, the integrator outputs; without columns
    the rows.
    """
    network = plan.network(frame)
    rows, cols = network.rows, network.cols
    driven = not columns or () not in parts(plan)
    columns = tuple(range(cols)) if columns is None else tuple(columns)
    ranges = ranges_of(plan)
    views = plan.views.at(columns)
    if not driven:
        views = views.model_copy(update={"row_driver": "behavioural"})
    transistors = views.in_transistors(plan.topology)
    direct = plan.topology == "direct"
    in_transistors = _channel_in_transistors(views, plan.topology)
    switched = plan.topology == "conveyor_mirror" and in_transistors
    supply = plan.scene.design.supply
    begin = first_row * plan.timing.slot_clocks + plan.timing.break_clocks
    supplies = sky130.supplies(supply.vdd_v, supply.vss_v, views.supply_scale)
    lines = [
        f"dermis frame {frame}: {rows} x {cols}, {plan.topology}",
        *_includes(views, plan.topology),
        f".param converter_f_clk_hz={spice_number(plan.timing.f_clk_hz)}",
        *(supplies if transistors else supplies[:2]),
        f"vbias vbias 0 {_bias(plan, frame, begin)}",
    ]
    late, early_s = _late_s(plan)
    if (late := late[list(columns)]).any():
        lines.append(f".param comparator_early_s={spice_number(early_s)}")
    names = source_names(rows, cols, columns)
    row_sources = () if driven else tuple(f"v_row{r}" for r in range(rows))
    logic = names[len(row_sources) :]

    def element(name: str, ends: str, value: float) -> None:
        """Write an element, unless it is none."""
        if value:
            lines.append(f"{name} {ends} {spice_number(float(value))}")

    biased = bool(transistors - {"row_driver"})
    lines += sky130.REFERENCE if biased else ["vibias ibias 0 0"]
    # A dc value together with `external` crashes libngspice 39.
    lines += [f"{name} {'logic' if transistors else 'd'}_{name[4:]} 0 external" for name in logic]
    if transistors:
        lines += [sky130.logic(name[4:], views.supply_scale) for name in logic]
    rails = "vdd vss vdd_d vss_d" if transistors else "vdd vss 0 0"
    if driven:
        lines += _row_drivers(plan, network, "row_driver" in transistors, rails)
    lines += [f"{name} {name[2:]} 0 external" for name in row_sources]

    # Of other columns nothing reaches a row that is a source, but for what they draw through its trace.
    there = range(cols) if driven or network.r_trace_row_ohm else columns
    lines += _array(plan, frame, network, begin, there)
    for r in range(rows):
        element(f"crow{r}", f"row{r} 0", network.c_row_f)
    for c in columns:
        element(f"ccolumn{c}", f"col{c} 0", network.c_column_f)
    pins = [f"row{r}" for r in range(rows)] + [f"col{c}" for c in there]
    lines.append(f"xarray {' '.join(pins)} array")
    lines += [line for c in there if c not in columns for line in _far_column(plan, network, c)]

    for c in columns:
        pad_ohm, node = float(network.r_pad_column_ohm), f"col{c}"
        if pad_ohm:
            node = f"pad_col{c}"
            element(f"rpad_col{c}", f"col{c} {node}", pad_ohm)
        if direct and (series_ohm := _without_pad(network.r_column_ohm[c], pad_ohm)):
            element(f"rcolumn{c}", f"{node} vg{c}", series_ohm)
            node = f"vg{c}"
        element(f"ileak{c}", f"0 col{c}", network.i_leak_a[c])
        subckt, pins = f"channel_{plan.topology}", f"d_charge{c} d_preset"
        if switched:
            subckt, pins, values = "channel_switched", f"{pins} d_range{2 * c} d_range{2 * c + 1}", ""
            for bit in (0, 1):
                level = spice_number(sky130.logic_v(views.supply_scale) * (ranges[c] >> bit & 1))
                lines.append(f"vd_range{2 * c + bit} d_range{2 * c + bit} vss_d {level}")
        elif in_transistors:
            k = plan.scene.table.interface.k if direct else float(plan.converter.k[c])
            values = _assignments({"k": k})
        else:
            values = _assignments(_channel_parameters(plan, network, c))
        references = "0 0 ibias"
        if biased:
            references = f"vref agnd ibias{c}"
            lines.append(sky130.bias_current(f"ibias{c}"))
            lines += [] if in_transistors else [f"xline{c} ibias{c} vdd vss bias_line"]
        lines.append(f"xch{c} {node} {pins} comp{c} {references} {rails} {subckt} {values}".rstrip())
        summing = node if direct else f"xch{c}.v_sum"
        element(f"ioffset{c}", f"0 {summing}", -plan.converter.v_sign * plan.converter.i_offset_a[c])
    # Beside transistors neither tolerances nor edges are those of a clamp: gates are driven by edges that a chip has,
    # and what 1 ns of ramp moves is below their own tolerances.
    bites = not transistors and plan.converter.range_clips()
    if transistors:
        lines.append(transistor_options() if columns else f".options {_assignments(_OPTIONS_ROWS)}")
    else:
        i0_a = float(plan.converter.i0_a[list(columns)].max())
        lines.append(options(has_pole(plan), clamp_i0_a=i0_a if bites else None))
    probes = [f"comp{c}" for c in columns] or [f"row{r}" for r in range(rows)]
    if record and columns:
        probes += [integrator_nodes(c)[direct and in_transistors] for c in columns]
    abrupt = (driven,) * rows + (True,) + (False,) * len(columns)
    started = (*levels[: rows + 1], *(levels[rows + 1 + c] for c in columns))
    edge_s = _EDGE_CLAMP_CLOCKS / plan.timing.f_clk_hz if bites else math.inf
    late_s = (*late.tolist(), *(0.0,) * (len(probes) - len(late))) if late.any() else ()
    # 1/40 of the ripple's period: a trapezoidal error of 0.2 %.
    longest = (
        1.0 / (40.0 * plan.drive.f_ripple_hz) if plan.drive.ripple and plan.drive.f_ripple_hz else math.inf
    )
    growth = STEP_GROWTH_TRANSISTORS if transistors else 0.0
    circuit = tuple(lines), (*row_sources, *logic), started, abrupt, tuple(probes)
    return Deck(*circuit, longest, edge_s, growth, late_s)


def _row_drivers(plan: Plan, network: Network, transistors: bool, rails: str) -> Iterator[str]:
    """Write the drivers of all rows, with what lies between them and the array."""
    driver = {}
    # A floating row has 1e-18 S to ground, lost in the matrix next to a pad: there the driver includes the pad.
    pad_ohm = float(network.r_pad_row_ohm) if math.isfinite(network.r_row_grounded_ohm) else 0.0
    if not transistors:
        driver = {
            "r_on_ohm": _without_pad(network.r_row_driven_ohm, pad_ohm),
            "r_ground_ohm": min(_without_pad(network.r_row_grounded_ohm, pad_ohm), 1e18),  # inf: floating
            "v_bias_v": float(network.v_bias_v),
        }
        if network.r_return_ohm or plan.drive.ripple:
            driver["follow"] = 2 if network.r_return_ohm else 1
    ground, end, values = "0", "row", " ".join(filter(None, ("row_driver", _assignments(driver))))
    if network.r_return_ohm:
        ground = "ground_rows"
        yield f"rreturn {ground} 0 {spice_number(float(network.r_return_ohm))}"
    if pad_ohm:
        end = "pad_row"
        yield from (f"rpad_row{r} {end}{r} row{r} {spice_number(pad_ohm)}" for r in range(network.rows))
    yield from (f"xrow{r} d_row{r} {end}{r} vbias {ground} {rails} {values}" for r in range(network.rows))


def _without_pad(total_ohm: float, pad_ohm: float) -> float:
    """Return the part of a series resistance that is not in the pad."""
    return max(float(total_ohm) - float(pad_ohm), 0.0)


def _far_column(plan: Plan, network: Network, column: int) -> Iterator[str]:
    """Write a column whose channel is in another circuit: its virtual ground and the elements before it.

    Transistors hold it within 0.2 mV (sky130.conveyor_v_offset_v). All columns of a row of 500 ohm
    off by that change what the row draws by 6 uA of 16 mA, and a driver of 1 ohm by 6 uV of 0.5 V:
    0.003 LSB.
    """
    r, v = float(network.r_pad_column_ohm), 0.0
    if not plan.views.has_transistors(column, plan.topology):
        r, v = float(network.r_column_ohm[column]), float(network.v_column_offset_v[column])
    end = f"far{column}" if r else f"col{column}"
    if r:
        yield f"rfar{column} col{column} {end} {spice_number(r)}"
    yield f"vfar{column} {end} 0 {spice_number(v)}"


def _bias(plan: Plan, frame: int, begin: int) -> str:
    """Return the bias: a number, or a continuing sine; `begin` is time zero in clocks."""
    drive, level = plan.drive, plan.v_bias_v
    if not drive.ripple:
        return spice_number(level)
    if not drive.f_ripple_hz:  # ngspice would take one period a transient
        return spice_number(level * (1.0 + drive.ripple * math.sin(drive.phase_ripple_rad)))
    turns = drive.turns(plan.first_frame + frame, begin, plan.timing.f_clk_hz)
    phase = math.degrees(drive.phase_ripple_rad) + 360.0 * turns
    numbers = (level, drive.ripple * level, drive.f_ripple_hz, 0.0, 0.0, phase)
    return f"sin({' '.join(spice_number(float(n)) for n in numbers)})"


def _array(plan: Plan, frame: int, network: Network, begin: int, columns: Sequence[int]) -> list[str]:
    """Write some columns of a frame's array from clock `begin` on, with motion to the next frame if it is on."""
    own = list(columns)
    slope = None
    g_taxel_s = network.g_taxel_s
    floor = plan.scene.design.array.r_floor_ohm
    if plan.drive.motion:
        later = plan.next_conductance_s(slice(frame, frame + 1))[0]
        now, then = (np.minimum(g, 1.0 / floor) for g in (network.g_taxel_s, later))
        slope = (then - now) / plan.drive.t_frame_s
        g_taxel_s = now + slope * (begin / plan.timing.f_clk_hz)
    with np.errstate(divide="ignore"):
        resistance = np.divide(1.0, g_taxel_s[:, own])
        row, column = (1.0 / g if g else None for g in (network.g_lateral_row_s, network.g_lateral_column_s))
    return array_subckt(
        network.rows, len(own), resistance, row, design=plan.scene.design, lateral_column_ohm=column,
        trace_row_ohm=float(network.r_trace_row_ohm), trace_column_ohm=float(network.r_trace_column_ohm),
        taxel_f=float(network.c_taxel_f), slope_s_per_s=None if slope is None else slope[:, own],
    ).splitlines()  # fmt: skip


def transistor_options() -> str:
    """The `.options` line of a deck with transistors in it."""
    return f".options {_assignments(OPTIONS_TRANSISTORS)}"


def options(pole: bool, clamp_i0_a: float | None = None) -> str:
    """The `.options` line of a deck with a time constant besides its integrators, without, or with a clamp that bites.

    `clamp_i0_a` is the largest reference current, in A, of a deck with such a clamp, else None.
    """
    if clamp_i0_a is not None:
        return ".options " + _assignments({**_OPTIONS_CLAMP, "abstol": _ABSTOL_CLAMP * clamp_i0_a})
    return ".options " + _assignments(_OPTIONS_POLE if pole else _OPTIONS_EXACT)


def integrator_nodes(column: int) -> tuple[str, str]:
    """Return the names of an integrator's node: of most channels, and of the direct one."""
    return f"xch{column}.xvfc.v_int", f"xch{column}.v_int"


# A leak this many clocks long bends a clock's straight line by 1 / (12 n^2) of what it takes: 3e-5 of a packet in all.
_LEAK_CLOCKS = 50.0


def has_pole(plan: Plan) -> bool:
    """Return True if the deck has a time constant, besides the integrators, that the steps must resolve.

    Comparator (not one that is looked at earlier), range clamp, bandwidth, slow mirror,
    capacitance, and an integrator that leaks within some clocks. What only moves (ripple, taxels)
    is followed well enough by steps of a clock, or of `Deck.longest_step_s`.
    """
    converter = plan.converter
    clamped = np.isfinite(converter.v_int_max_v) | np.isfinite(converter.v_int_min_v)
    delayed = converter.t_comp_delay_s - _late_s(plan)[0]
    fields = (delayed, converter.v_hysteresis_v, converter.t_gbw_s, converter.q_mirror_c)
    capacitances = {"c_row_f", "c_column_f", "c_taxel_f"} & plan.surrounding.keys()
    if any(map(np.any, (*fields, clamped))) or any(plan.surrounding[c] for c in capacitances):
        return True
    if not converter.inv_gain_dc.any():
        return False
    across = converter.g_in_s
    if plan.topology == "direct":
        across = across + plan.conductance_s().sum(axis=1).max(axis=0)
    leak = across * converter.inv_gain_dc / (converter.c_int_f * converter.f_clk_hz)
    return bool(np.any(leak * _LEAK_CLOCKS > 1.0))
