# SPDX-License-Identifier: Apache-2.0
"""The four channels: exact where ideal, alike in x, and fit to survive shorts, opens and the end of range."""

from collections.abc import Callable

import pytest

from dermis.scene.design import Design

Measure = Callable[..., dict[str, float]]

CONVEYORS = {"m": "conveyor_mirror", "i": "conveyor_mirror_inverted", "o": "multi_output_conveyor"}
TOPOLOGIES = {"d": "direct"} | CONVEYORS
SIGN = {"d": 1, "m": 1, "i": -1, "o": 1}


def physical(design: Design) -> dict[str, float]:
    """Every non-ideality of a channel at its value of design.toml."""
    integrator = "gain_dc t_gbw_s v_offset_v v_out_max_v v_out_min_v r_in_ohm r_preset_ohm"
    named = {
        "int": ("integrator", integrator),
        "comp": ("comparator", "gain_dc v_offset_v v_hysteresis_v t_delay_s"),
        "conv": ("conveyor", "r_x_ohm v_offset_v t_pole_s r_z_ohm i_out_max_a gain_error"),
        "mir": ("mirror", "ratio_error r_out_ohm t_pole_s"),
        "out": ("mirror", "q_lag_c"),
    }
    known = design.stored() | design.derived()
    values = {f"{k}_{p}": known[f"{block}.{p}"] for k, (block, ps) in named.items() for p in ps.split()}
    range_a = design.mirror.v_overdrive_v / design.mirror.r_switch_ohm
    return values | {"out_inv_i_range_a": 1 / range_a, "packet_error": design.charge.packet_error}


def duty(design: Design, r_ohm: float) -> float:
    """x of a taxel."""
    return design.interface.v_bias_v / (design.interface.k * design.converter.i0_a * r_ohm)


def check_exact(got: dict[str, float], x: float, packets: int, limit_v: float = 1e-9) -> None:
    """The bench channel__tran against charge balance: v_int = 1/2 - n x + packets, in volts, after n clocks."""
    scale = 1 + max(0.0, abs(0.5 - 190 * x))
    end = 0.5 - 190 * x + packets
    clocked = {"clock": 0.5 - x, "train": 0.5 - (1 + 2 * packets) * x + packets, "end": end}
    for name, sign in SIGN.items():
        for when in ("preset", "again"):
            assert got[f"v_{when}_{name}"] == pytest.approx(sign * 0.5, abs=limit_v)
        for when, v_int in clocked.items():
            assert got[f"v_{when}_{name}"] == pytest.approx(sign * v_int, abs=limit_v * scale)
        assert got[f"comp_end_{name}"] == pytest.approx(1.65 if end <= 0 else -1.65)


@pytest.mark.parametrize("r_ohm", [500.0, 510.0, 2000.0, 64250.0, 1e18])
def test_ideal_channels_integrate_exactly(measure: Measure, design: Design, r_ohm: float) -> None:
    got = measure("channel__tran", params={"r_taxel": r_ohm})
    check_exact(got, duty(design, r_ohm), 10)


@pytest.mark.parametrize(("method", "step_s"), [("trap", 10e-9), ("trap", 1e-6), ("gear", 100e-9)])
def test_ideal_channels_are_exact_at_any_step_and_method(
    measure: Measure, design: Design, method: str, step_s: float
) -> None:
    got = measure("channel__tran", params={"t_step": step_s, "n_packets": 60}, options=f"method={method}")
    check_exact(got, duty(design, 500.0), 60)


@pytest.mark.paper
@pytest.mark.parametrize(
    ("method", "step_s", "options"),
    [
        # The loosest that ngspice takes by default.
        ("gear", 1e-6, "trtol=7 reltol=1e-3"),
        # The tightest that the longest deck ends with.
        ("trap", 10e-9, "trtol=1 reltol=1e-6 chgtol=5e-18 abstol=1e-13 vntol=1e-9"),
    ],
)
@pytest.mark.parametrize("r_ohm", [1e-3, 31.0, 312.0, 500.0, 1e18])
@pytest.mark.parametrize("kind", ["ideal", "physical"])
def test_channels_survive_short_open_and_rail_and_are_preset_again(
    measure: Measure, design: Design, kind: str, r_ohm: float, method: str, step_s: float, options: str
) -> None:
    got = measure(
        "channel__tran",
        dut=physical(design) if kind == "physical" else {},
        params={"r_taxel": r_ohm, "t_step": step_s},
        options=f"method={method} {options}",
    )
    drop = 0.0
    for name, sign in SIGN.items():
        end = sign * got[f"v_end_{name}"]
        if kind == "physical":
            # the amplifier of the direct interface alone may be pushed 50 mV further, by a stiff column
            low, high = design.integrator.v_out_min_v, design.integrator.v_out_max_v
            assert low - 0.06 < end < high + 0.06
            # the preset drops r_preset over what comes in; a short brings the conveyor's limit, compressed, / k
            i = min(design.interface.v_bias_v / r_ohm, design.conveyor.i_out_max_a)
            i /= 1 + i * design.mirror.r_switch_ohm / design.mirror.v_overdrive_v
            drop = design.integrator.r_preset_ohm * i / design.interface.k
        if name == "d" and kind == "physical":
            continue  # 80 times the current: what 1 kohm then drops has a test of its own
        # The loose options solve the preset to reltol 1e-3 of 1.65 V, three times.
        assert sign * got[f"v_again_{name}"] == pytest.approx(0.5 - drop, abs=5e-3)
        if r_ohm > 1e17:
            assert got[f"comp_end_{name}"] == pytest.approx(-1.65)
        if r_ohm < 400:
            assert got[f"comp_end_{name}"] == pytest.approx(1.65)


@pytest.mark.paper
def test_physical_direct_interface_cannot_be_preset_through_1_kohm(measure: Measure, design: Design) -> None:
    # 1 mA through 1 kohm: what is left of the preset is 0.5 V - 1 V, the loss a k times smaller switch would avoid.
    # Tolerances: three times and once ngspice's reltol of 1e-3 on 1.65 V.
    for share, lost_v, limit_v in ((1, 1.0, 5e-3), (design.interface.k, 12.5e-3, 2e-3)):
        dut = physical(design) | {"int_r_preset_ohm": design.integrator.r_preset_ohm / share}
        got = measure("channel__tran", dut=dut, params={"r_taxel": 500.0})
        assert got["v_again_d"] == pytest.approx(0.5 - lost_v, abs=limit_v)


@pytest.mark.parametrize("name", TOPOLOGIES)
def test_dc_transfer_of_each_channel_is_its_k_and_sign(measure: Measure, design: Design, name: str) -> None:
    got = measure(f"channel_{TOPOLOGIES[name]}__dc")
    k = 1 if name == "d" else design.interface.k
    # A linear circuit: one Newton step; what is left is gmin beside the conductances, and rounding.
    assert got["transfer"] == pytest.approx(SIGN[name] / k, rel=1e-9, abs=0)
    assert got["i_int_all"] == pytest.approx(-SIGN[name] * 16e-3 / k, rel=1e-8, abs=0)
    assert abs(got["i_int_open"]) < 1e-15
    assert abs(got["v_col_full"]) < 1e-9, "the column is not at virtual ground"
    v_int = SIGN[name] * 0.5 + got["i_int_full"] * 1e3
    # The deck's vntol is 1e-12 V; three operations on 1 kohm.
    assert got["v_int_full"] == pytest.approx(v_int, abs=1e-9)


@pytest.mark.parametrize("name", CONVEYORS)
def test_dc_transfer_carries_every_gain_error_and_offset(measure: Measure, design: Design, name: str) -> None:
    got = measure(f"channel_{TOPOLOGIES[name]}__dc", dut=physical(design) | {"conv_gain_error": 0.003})
    ratio = 1.003 if name == "o" else 1.003 * (1 + design.mirror.ratio_error)
    copied = got["i_col_full"] * (1 if name == "o" else 1.003)
    ratio /= 1 + copied * design.mirror.r_switch_ohm / design.mirror.v_overdrive_v
    # finite output resistances see the summing node move by mV only
    assert abs(got["transfer"]) == pytest.approx(ratio / design.interface.k, rel=2e-5, abs=0)
    p = design.conveyor
    # 1 mA on 0.5 ohm and an offset, 1 mV in all, to the nanovolt that reltol 1e-9 of 1 V leaves.
    assert got["v_col_full"] == pytest.approx(p.v_offset_v + p.r_x_ohm * got["i_col_full"], rel=1e-6, abs=0)


@pytest.mark.parametrize("name", CONVEYORS)
def test_short_column_takes_the_limit_of_the_conveyor(measure: Measure, design: Design, name: str) -> None:
    got = measure(f"channel_{TOPOLOGIES[name]}__dc", dut={"conv_i_out_max_a": 10e-3})
    # Beyond the limit the conveyor keeps 100 kohm: 0.5 V add 5 uA to 10 mA.
    assert got["i_col_all"] == pytest.approx(10e-3, rel=1e-3, abs=0)
    assert abs(got["i_int_all"]) == pytest.approx(10e-3 / design.interface.k, rel=1e-3, abs=0)
    assert got["i_col_full"] == pytest.approx(1e-3, rel=1e-9, abs=0)
