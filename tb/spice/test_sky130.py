# SPDX-License-Identifier: Apache-2.0
"""The blocks of spice/sky130 by themselves, at three corners: what a channel made of them rests on."""

from __future__ import annotations

from pathlib import Path

import pytest

from dermis import sky130, spice_batch, verdict

CORNERS = (("tt", 27.0), ("ss", -40.0), ("ff", 125.0))
# One corner in every test run, the others in the long one: each run of ngspice is a second or two.
AT = [
    pytest.param(*at, marks=pytest.mark.long if n else (), id=f"{at[0]}_{at[1]:g}")
    for n, at in enumerate(CORNERS)
]
corners = pytest.mark.parametrize(("corner", "celsius"), AT)

SUPPLIES = """\
vdd vdd 0 {vdd}
vss vss 0 -{vdd}
vref vref 0 0.5
xbias vref ibias vdd vss bias
"""


def measure(
    tmp_path: Path, body: str, corner: str, celsius: float, vdd: float = 1.65, mismatch: bool = False
) -> dict[str, float]:
    """Run a bench of the sky130 view and return what it measures."""
    deck = tmp_path / "bench.sp"
    head = "\n".join(sky130.deck_head(corner, celsius, mismatch))
    deck.write_text(f"bench\n{head}\n{SUPPLIES.format(vdd=vdd)}{body}\n.end\n")
    # Operating points of transistors start from gmin stepping, the ladder's second rung.
    return dict(spice_batch.run(deck, limit_s=150.0).values)


def within(name: str, value: float) -> None:
    row = verdict.judge(name, value)
    assert row["status"] == "PASS", (
        f"{name} = {row['value']} {row['unit']}, allowed {row['min']} .. {row['max']}"
    )


@corners
@pytest.mark.parametrize("vdd", [1.485, 1.815])
def test_the_reference_line_makes_its_current_at_every_supply(tmp_path, corner, celsius, vdd) -> None:
    # The drain where the line is, as a cascode holds it.
    body = "xn out ibias vss vss nmos w=5 l=2\neout out x ibias 0 1\nvx x 0 0\n.dc vx 0 0.1 0.1\n"
    body += ".meas dc i_unit find i(vx) at=0"
    found = measure(tmp_path, body, corner, celsius, vdd)
    within("sky130.reference_error", -found["i_unit"] / 5e-6 - 1.0)


OTA = """\
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


@corners
def test_the_amplifier_has_gain_bandwidth_and_phase_margin(tmp_path, corner, celsius) -> None:
    found = measure(tmp_path, OTA, corner, celsius)
    within("sky130.amplifier_gain_db", found["gain_db"])
    within("sky130.amplifier_gbw_hz", found["gbw_hz"])
    within("sky130.amplifier_phase_margin_deg", 180.0 + found["phase_rad"] * 57.29578)


CHAIN = """\
vy y 0 0
ix 0 x 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum 0 0 ibias vdd vss mirror k={k}
vsum sum 0 0
.dc ix 0 {full} {step}
"""


def chain(
    tmp_path: Path, corner: str, celsius: float, k: int, devices: int | None = None
) -> tuple[list[float], list[float]]:
    """Output current in packets a gate, and voltage of x, at eleven currents up to x = 1/2; `devices`: not k."""
    full = 12.5e-6 * k
    points = [full * n / 10 for n in range(11)]
    meas = "".join(
        f".meas dc out{n} find i(vsum) at={at!r}\n.meas dc x{n} find v(x) at={at!r}\n"
        for n, at in enumerate(points)
    )
    found = measure(
        tmp_path, CHAIN.format(k=devices or k, full=full * 1.01, step=full / 10) + meas, corner, celsius
    )
    return [found[f"out{n}"] / 25e-6 * 510 for n in range(11)], [found[f"x{n}"] for n in range(11)]


@corners
def test_conveyor_and_mirror_are_linear_and_hold_the_column(tmp_path, corner, celsius) -> None:
    lsb, x = chain(tmp_path, corner, celsius, 80)
    gain = (lsb[10] - lsb[0]) / 255.0
    inl = [have - lsb[0] - gain * 25.5 * n for n, have in enumerate(lsb)]
    within("sky130.chain_inl_lsb", max(map(abs, inl)))
    within("sky130.chain_gain_error", gain - 1.0)
    within("sky130.chain_offset_lsb", lsb[0])
    within("sky130.conveyor_r_x_ohm", (x[10] - x[9]) / 1e-4)
    within("sky130.conveyor_v_offset_v", x[10])


@pytest.mark.parametrize(("pins", "k"), [((0, 0), 20), ((0, 1), 40), ((1, 0), 80), ((1, 1), 160)])
def test_the_pins_choose_the_ratio(tmp_path: Path, pins: tuple[int, int], k: int) -> None:
    d_k1, d_k0 = pins
    body = CHAIN.replace("sum 0 0 ibias", "sum d_k0 d_k1 ibias") + f"vk0 d_k0 0 {d_k0}\nvk1 d_k1 0 {d_k1}\n"
    full = 12.5e-6 * k
    body = body.format(k=0, full=full * 1.01, step=full)
    found = measure(
        tmp_path,
        body + f".meas dc none find i(vsum) at=0\n.meas dc full find i(vsum) at={full!r}",
        *CORNERS[0],
    )
    within("sky130.chain_gain_error", (found["full"] - found["none"]) / 12.5e-6 - 1.0)


# A charge of 1 us into 5 pF, then a packet: slopes and steps of the integrator are the currents, its first value
# the preset.
VFC = """\
vpre d_preset 0 pwl(0 1 1u 1 1.001u 0)
vcharge d_charge 0 pwl(0 0 2u 0 2.001u 1 2.2u 1 2.201u 0)
iin 0 sum {i_in}
xdut sum d_charge d_preset comp ibias vdd vss vfc polarity={polarity}
.tran 10n 3.2u
.meas tran v_0 find v(xdut.v_int) at=1.1u
.meas tran v_1 find v(xdut.v_int) at=1.9u
.meas tran v_2 find v(xdut.v_int) at=2.3u
.meas tran v_3 find v(xdut.v_int) at=3.1u
.meas tran comp_0 find v(comp) at=0.9u
.meas tran comp_1 find v(comp) at=1.95u
.meas tran comp_2 find v(comp) at=3.1u
"""


# A known miss: the sourced packet of Fig. 5b is short by 5 %. It is not the headroom of the pair (its gates 0.4 V
# lower and four times the width change it by 0.1 %) and not the gate line (one of its own changes nothing).
SHORT = pytest.mark.xfail(
    strict=True, reason="sky130.packet_error of the sourcing charge source is -0.05 at ss"
)


@pytest.mark.parametrize(
    ("corner", "celsius", "polarity"),
    [
        (*CORNERS[0], 1),
        pytest.param(*CORNERS[1], -1, marks=[SHORT, pytest.mark.long]),
        pytest.param(*CORNERS[2], 1, marks=pytest.mark.long),
    ],
)
def test_preset_integral_decision_and_packet(tmp_path, corner, celsius, polarity) -> None:
    found = measure(tmp_path, VFC.format(i_in=polarity * 3.4e-6, polarity=polarity), corner, celsius)
    # 3.4 uA on 5 pF is 0.68 V/us; the preset is half a packet less what came in the 99 ns behind its release.
    slope = (found["v_0"] - found["v_1"]) / 0.8e-6 * polarity
    within("sky130.capacitor_error", 0.68e6 / slope - 1.0)
    within("sky130.preset_error_v", polarity * found["v_0"] + 0.68e6 * 0.0995e-6 - 0.5)
    packet = (found["v_2"] - found["v_1"]) * polarity + slope * 0.4e-6
    within("sky130.packet_error", packet * (0.68e6 / slope) - 1.0)
    assert found["comp_0"] < 0.0, "while it is preset no decision stands"
    assert found["comp_1"] > 0.0, "0.6 V of charge are past the level"
    assert found["comp_2"] < 0.0, "a packet takes them back"


RAMP = """\
vin inn 0 pwl(0 0.1 100n 0.1 {to})
xdut 0 inn out ibias vdd vss comparator
cout out 0 50f
.tran 2n 1.2u
.meas tran late when v(out)=0 rise=1
"""


@corners
def test_the_comparator_decides_within_a_fifth_of_a_clock(tmp_path, corner, celsius) -> None:
    found = measure(tmp_path, RAMP.format(to="300n -0.4"), corner, celsius)
    within("sky130.comparator_delay_s", found["late"] - 140e-9)


@corners
@pytest.mark.parametrize("driven", [0, 1])
def test_a_row_driver_is_an_ohm_either_way(tmp_path, corner, celsius, driven) -> None:
    body = f"vd d 0 {driven}\nvb vb 0 0.5\nxdut d row vb 0 vdd vss row_driver\nil row 0 0\n"
    body += ".dc il 0 16m 16m\n.meas dc none find v(row) at=0\n.meas dc full find v(row) at=0.016"
    found = measure(tmp_path, body, corner, celsius)
    within("sky130.row_driver_r_ohm", (found["none"] - found["full"]) / 16e-3)


def test_a_wrong_device_is_noticed(tmp_path: Path) -> None:
    """One device of the mirror's 80 forgotten: 1.2 % of gain, six times what the circuit has by itself."""
    lsb, _ = chain(tmp_path, "tt", 27.0, 80)
    fault, _ = chain(tmp_path, "tt", 27.0, 80, devices=79)
    assert (fault[10] - fault[0]) / (lsb[10] - lsb[0]) == pytest.approx(
        80 / 79, rel=1e-3
    )  # r_out of the output


def test_mismatch_gives_every_chip_its_own_offset(tmp_path: Path) -> None:
    """Three seeds, three offsets of the amplifier: some millivolts, where without mismatch there is none."""
    body = "xdut 0 out out ibias vdd vss ota\nvx x 0 0\n.dc vx 0 1 1\n.meas dc offset find v(out) at=0"
    own = measure(tmp_path, body, *CORNERS[0])["offset"]
    drawn = [
        measure(tmp_path, f".options seed={n}\n{body}", *CORNERS[0], mismatch=True)["offset"]
        for n in (1, 2, 3)
    ]
    assert len(set(drawn)) == len(drawn)
    # One sigma of a pair of 80 um2 is about 1 mV: five of them bound it, a tenth is far above what is systematic.
    assert all(abs(own) < 1e-4 < abs(v - own) < 5e-3 for v in drawn), (own, drawn)
