# SPDX-License-Identifier: Apache-2.0
"""dermis.lockstep with Verilog and SPICE that are not this chip's: the examples of docs/lockstep.md,
and what the room refuses.
"""

import contextlib
import re
import shutil
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dermis.chip import hdl
from dermis.lockstep import ngspice
from dermis.scene.design import ROOT
from scripts.markdown import filled

EXAMPLES = ROOT / "docs" / "examples"
LIMIT_S = 60.0


def run(simulator: str, verilog: Path, module: Path, work: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run a cocotb test; return what failed, empty for nothing."""
    build = hdl.build(simulator, verilog.stem, {}, sources=[verilog], where="lockstep")
    shutil.copytree(module.parent, work, dirs_exist_ok=True)
    monkeypatch.syspath_prepend(work)  # the simulator has the path of this process
    with contextlib.suppress(SystemExit):  # of cocotb's runner, for a test that failed
        hdl.run_cocotb(simulator, build, verilog.stem, module.stem, work, {}, limit_s=LIMIT_S)
    failed = ET.parse(work / "results.xml").getroot().iter("failure")
    return "\n".join(found.get("error_msg", "") + (found.text or "") for found in failed)


@pytest.mark.parametrize("simulator", ["icarus", pytest.param("verilator", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", ["sigma_delta", "sar", "oscillator"])
def test_an_example_meets_its_closed_form(
    name: str, simulator: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = EXAMPLES / name
    failed = run(simulator, folder / f"{name}.v", folder / f"test_{name}.py", tmp_path / "run", monkeypatch)
    assert failed == ""


# Text of clock_loop.c, a fault in its place, and the example that must fail.
FAULTS = {
    "prediction": ("fmax(rest < NEAR_V ? go : 0.9 * go, ", "fmax(2.0 * go, ", "oscillator"),
    "rounded": ("double time = lp.now + ", "double time = lp.now + 1e-12 + ", "oscillator"),
    "bit": ("net->value[w] >> bit & 1 ? net->high : net->low);\n        }", "net->low);\n        }", "sar"),
    "low": ("net->high : net->low);\n        }", "1.0 : 0.0);\n        }", "sigma_delta"),
}


@pytest.mark.parametrize(
    "fault", [pytest.param(f, marks=[pytest.mark.long] * (f != "rounded")) for f in FAULTS]
)
def test_an_example_sees_a_fault(fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right, wrong, name = FAULTS[fault]
    source = tmp_path / "clock_loop.c"
    source.write_text(filled(ngspice.LOOP_SOURCE.read_text(), {right: wrong}, source.name))
    work = tmp_path / "run"
    work.mkdir()
    seed = "from pathlib import Path\nfrom dermis.lockstep import ngspice\n"
    seed += f"ngspice.LOOP_SOURCE = Path({str(source)!r})\n"
    shutil.copytree(EXAMPLES / name, tmp_path / "seeded")
    module = tmp_path / "seeded" / f"seeded_{fault}.py"
    module.write_text(seed + (EXAMPLES / name / f"test_{name}.py").read_text())
    assert run("icarus", EXAMPLES / name / f"{name}.v", module, work, monkeypatch)


VERILOG = """`timescale 1ns / 1ps
module own (input clk, input clk_b, input rst_n, input comp, input comp_b, output reg dac, output reg [3:0] code,
            output reg other, output reg late, output reg caught, output reg fell, output reg pulse);
  real level;
  reg [3:0] memory [0:3];
  always @(posedge clk or negedge rst_n)
    if (!rst_n) begin dac <= 0; code <= 0; level <= 0.0; end
    else begin dac <= comp; code <= code + 4'd1; level <= 0.125 * code; end
  always @(posedge clk_b or negedge rst_n) if (!rst_n) other <= 0; else other <= ~other;
  initial {late, caught, fell} = 0;
  always @(negedge clk) fell <= comp;
  always @(posedge comp_b) caught <= ~caught;
  always @(posedge clk) late <= #3 ~late;
  initial pulse = 0;
  always @(posedge clk) begin pulse <= #10 1; pulse <= #60 0; end
endmodule
"""

PYTHON = """import cocotb, math
import numpy as np
from cocotb.triggers import ClockCycles, RisingEdge, Timer
from cocotb.utils import get_sim_time
from pathlib import Path
from dermis.errors import DermisError
from dermis.lockstep import Compare, Cosim, Drive

RC = '''an RC on each of two sources
vd_a d_a 0 external
vd_b d_b 0 external
r1 d_a x 10k
c1 x 0 100p
r2 d_b y 10k
c2 y 0 1p
.options reltol=1e-6 vntol=1e-9 abstol=1e-15
'''


def cosim(inputs, outputs={"dut.comp": Compare("x", above=0.5)}, more="", **options):
    period_s = 1e-6 if isinstance(options.get("clock", ""), str) else None
    options = dict(clock="dut.clk", period_s=period_s, reset="dut.rst_n", step_s=1e-8, log="own.log") | options
    return Cosim(RC + more, inputs, outputs, **options)


async def said(dut, sim, clocks=20):
    try:
        async with sim.running(dut):
            await ClockCycles(dut.clk, clocks)
    except DermisError as error:
        return str(error)
    return ""
"""

TESTS = {
    "two_circuits_one_after_the_other": """
    for _ in range(2):
        clocks = {"dut.clk": 1e-6, "dut.clk_b": 0.7e-6}
        sim = cosim({"dut.dac": Drive("vd_a"), "dut.other": Drive("vd_b")}, clock=clocks, probes=["d_b", "y"])
        assert await said(dut, sim) == ""
        gaps = np.diff(np.round(sim.times[1:] * 1e12))
        assert len(set(gaps)) > 5 and not (gaps % 5e4).any(), gaps  # the edges of both clocks, merged
        assert sim.samples["d_b"].max() == 1.0 and sim.samples["y"].max() > 0.9
""",
    "a_code_and_a_real_net": """
    sim = cosim({"dut.code": Drive("vd_a", high=0.25), "dut.level": Drive("vd_b", low=0.1, high=1.1)},
                probes=["d_a", "d_b"])
    assert await said(dut, sim, 40) == ""
    two = cosim({"dut.level": Drive(["vd_a", "vd_b"])})
    assert (await said(dut, two, 1)).endswith("= ('vd_a', 'vd_b'): one source")
    code, level = sim.samples["d_a"][2:] / 0.25, sim.samples["d_b"][2:] - 0.1
    assert np.allclose(np.diff(code) % 16, 1.0, rtol=0, atol=1e-9)  # volt
    assert np.allclose(level[1:], 0.125 * code[:-1], rtol=0, atol=1e-9), (level, code)  # a clock later
""",
    "a_delay_is_an_error_by_name_or_exact": """
    inputs = {"dut.late": Drive("vd_a"), "dut.dac": Drive("vd_b")}
    assert "own.late changed at " in await said(dut, cosim(inputs))
    sim = cosim(inputs, settle_s=5e-9, probes=["x"])
    assert await said(dut, sim) == ""
    # from event 1 on: 0 or 1 with a period of two clocks, each edge 3 ns late with a ramp of 1 ns
    v, worst, before = sim.samples["x"][0], 0.0, 0.0
    for n in range(1, len(sim.times) - 1):
        level = float(n % 2) if before == 0.0 else 0.0
        v = before + (v - before) * math.exp(-(sim.times[n] - sim.times[n - 1] if n == 1 else 3e-9) / 1e-6)
        slope = (level - before) / 1e-9
        start = before - 1e-6 * slope
        v = start + slope * 1e-9 + (v - start) * math.exp(-1e-3)
        v = level + (v - level) * math.exp(-(sim.times[n + 1] - sim.times[n] - 4e-9) / 1e-6)
        worst, before = max(worst, abs(v - sim.samples["x"][n + 1])), level
    assert worst < 1e-5, worst  # of ngspice; 3 ns are 1e-3
""",
    "a_crossing_before_a_delayed_edge_is_exact": """
    inputs = {"dut.late": Drive("vd_a"), "dut.level": Drive("vd_b", high=8.0)}
    outputs = {"dut.comp_b": Compare("y", above=0.2, crossing=True)}
    for settle_s in (3.5e-9, 6e-9):
        sim = cosim(inputs, outputs, settle_s=settle_s)
        assert await said(dut, sim, 6) == "" and sim.overshoot_v < 2e-12
        y, t = sim.samples["y"], sim.times
        at = np.flatnonzero(np.abs(y - 0.2) < 1e-9)[0]
        # the first step of 1 V: a ramp of 1 ns, tau is 10 ns; the late edge comes 3 ns after the clock
        end = 1.0 - 10.0 * (1.0 - math.exp(-0.1))
        exact = 1e-9 + 1e-8 * math.log((1.0 - end) / 0.8)
        assert abs(t[at] - t[at - 1] - exact) < 1e-12, t[at] - t[at - 1] - exact
""",
    "a_crossing_between_clocks_is_answered_when_it_happens": """
    inputs = {"dut.dac": Drive("vd_a"), "dut.caught": Drive("vd_b")}
    outputs = {"dut.comp": Compare("d_a", above=0.5), "dut.comp_b": Compare("x", above=0.4, crossing=True)}
    tick = "vtick tick 0 pulse(0 1 2.3u 1n 1n 4u 8u)" + chr(10) + "r3 d_a 0 1k" + chr(10) + "r1 tick x"
    rc = RC.replace("r1 d_a x", tick)
    options = dict(clock="dut.clk", period_s=1e-6, reset="dut.rst_n", step_s=2e-9, probes=["y"], log="own.log")
    sim = Cosim(rc, inputs, outputs, **options)
    assert await said(dut, sim, 30) == ""
    x, y, t = sim.samples["x"], sim.samples["y"], sim.times
    (at,) = np.nonzero(np.abs(x - 0.4) < 1e-9)
    assert len(at) == 7 and sim.overshoot_v < 2e-12, at
    # the first rise begins at 2.3 us from 0 V with a ramp of 1 ns: x - 0.4 = 0 after this time
    end = 1.0 - 1e3 * (1.0 - math.exp(-1e-3))
    exact = 2.301e-6 + 1e-6 * math.log((1.0 - end) / 0.6)
    assert abs(t[at[0]] - exact) < 1e-12, t[at[0]] - exact
    assert (t[at[0]] * 1e12) % 1.0 > 1e-3, "between two units of time of the Verilog"
    # y follows from then on: tau is 10 ns, and the next clock is a third of a microsecond later
    held = np.exp(-(t[at[0] + 1] - t[at[0]]) / 1e-8)
    assert abs(y[at[0]]) < 1e-9 and abs(y[at[0] + 1] - 1.0) < 1e-5 + 2.0 * held
    assert int(dut.caught.value) == 0 and len(at[::2]) == 4  # four rises
""",
    "wrong_names_and_widths_are_one_line": """
    for options, words in (
        (dict(period_s=None), "period_s"),
        (dict(clock=None), "step_s"),
        (dict(settle_s=math.nan), "settle_s"),
        (dict(period_s=math.inf), "clock"),
        (dict(clock={"dut.clk": 1e-6, "dut.clk_b": 1.2345678e-7}), "unit of time"),
        (dict(period_s=1 / 48e6), "unit of time"),
        (dict(clock="dut.comp"), "a net that the circuit does not drive"),
        (dict(reset="dut.comp"), "a net that the circuit does not drive"),
        (dict(clock={"dut.clk": 1e-6}, period_s=1e-6), "none beside periods by net"),
        (dict(period_s="1u"), "finite numbers"),
        (dict(clock="dut.code"), "one bit"),
    ):
        try:
            sim = cosim({"dut.dac": Drive("vd_a")}, **{"step_s": None} | options)
            found = await said(dut, sim)
        except DermisError as error:
            found = str(error)
        assert words in found and chr(10) not in found, (options, found)
    for inputs, outputs, words in (
        ({"dut.dac": "vd_a"}, {}, "a Drive"),
        ({"dut.dac": Drive(None)}, {}, "a Drive"),
        ({"dut.dac": Drive("vd_a", low="0")}, {}, "finite numbers"),
        ({}, {"dut.comp": "x"}, "a Compare"),
        ({}, {"dut.comp": Compare("x", above="0.5")}, "finite numbers"),
    ):
        try:
            found = cosim(inputs, outputs)
        except DermisError as error:
            found = str(error)
        assert words in found and chr(10) not in found, found
    for inputs, words in (
        ({"dut.nothing": Drive("vd_a"), "dut.dac": Drive("vd_b")}, "dut.nothing"),
        ({"dut.memory": Drive("vd_a"), "dut.dac": Drive("vd_b")}, "no memory"),
        ({"dut.code": Drive(("vd_a", "vd_b"))}, "one source, or 4"),
        ({"dut.dac": Drive("vd_a")}, "vd_b"),
        ({"dut.dac": Drive("vd_a"), "dut.other": Drive("VD_A")}, "VD_A: a source that no other"),
        ({"dut.code": Drive(["vd_a"] * 4)}, "vd_a: a source that no other"),
    ):
        found = await said(dut, cosim(inputs))
        assert words in found and chr(10) not in found, found
    outputs = {"dut.comp": Compare("x", above=0.5, crossing=True)}
    sim = cosim({"dut.dac": Drive("vd_a"), "dut.other": Drive("vd_b")}, outputs, settle_s=0.5e-6)
    found = await said(dut, sim)
    assert "below half" in found, found
""",
    "a_process_goes_on_after_a_fault": """
    inputs = {"dut.dac": Drive("vd_a"), "dut.other": Drive("vd_b")}
    for _ in range(3):
        sim = cosim({"dut.caught": Drive("vd_a"), "dut.level": Drive("nothing")})
        assert "vd_b" in await said(dut, sim)
        wrong = ("x1 x none", "none"), ("c9 alone 0 1p", "alone"), (".include none.inc", "none.inc")
        for more, words in (*wrong, (".tran 1n 1u uic", "no analysis"),
                     (".options reltol=1e-6 interp", "interp"), ("*# set interp", "no .control block or *# command"),
                     ("o1 x 0 y 0 line" + chr(10) + ".model line ltra r=1 l=1u c=1n len=1", "lossless")):
            found = await said(dut, cosim(inputs, {}, more))
            assert words in found, (words, found)
        assert "nowhere" in await said(dut, cosim(inputs, probes=["nowhere"]))
    sim = cosim(inputs, probes=["d_a"])
    assert await said(dut, sim, 10) == "" and int(dut.code.value) in (9, 10, 11), "one clock drives it"
""",
    "corners_of_its_own_sources_are_met": """
    inputs = {"dut.dac": Drive("vd_a"), "dut.code": Drive("vd_b")}
    # 1 mA for 20 ns and two ramps of 1 ns into 100 pF
    pulse = "vp p 0 pulse(0 1 2.33u 1n 1n 20n 1)" + chr(10) + "gq 0 q p 0 1m" + chr(10) + "cq q 0 100p" + chr(10)
    pulse += "rq q 0 1g" + chr(10)
    for step in (1e-6, 1e-7):
        sim = cosim(inputs, {"dut.comp": Compare("q", above=0.1)}, pulse, step_s=step)
        assert await said(dut, sim, 5) == ""
        assert abs(sim.samples["q"][-1] - 0.21) < 1e-4, (step, sim.samples["q"])  # of ngspice, on the ramps
        sim = cosim(inputs, {"dut.comp_b": Compare("p", above=0.5, crossing=True)}, pulse, step_s=step)
        assert "passed 0.5 V by 0.5 V" in await said(dut, sim, 5), "a pulse between two points"
""",
    "a_crossing_at_a_clock_edge_is_told_there": """
    inputs = {"dut.dac": Drive("vd_a"), "dut.code": Drive("vd_b")}
    for at in (2.499999e-6, 2.4999985e-6, 2.4999995e-6, 2.50001e-6):  # an edge is at 2.499999 us
        ramp = f"vp p 0 pwl(0 0 {2 * at} 1)" + chr(10) + "rp p 0 1k" + chr(10)
        outputs = {"dut.comp": Compare("p", above=2.0), "dut.comp_b": Compare("p", above=0.5, crossing=True)}
        sim = cosim(inputs, outputs, ramp, step_s=None)
        async with sim.running(dut):
            began = get_sim_time("step")
            await RisingEdge(dut.comp_b)
            told = 1e-12 * (get_sim_time("step") - began)
            await ClockCycles(dut.clk, 2)
        assert abs(told - at) < 2.5e-12, (at, told)  # two units of time: rounded up, and clear of an edge
    # thresholds this near are crossed in the first step after one another
    for apart in (1e-11, 1e-7):
        above = {"dut.comp": 0.5, "dut.comp_b": 0.5 + apart}
        outputs = {net: Compare("p", above=v, crossing=True) for net, v in above.items()}
        sim = cosim(inputs, outputs, ramp, step_s=None)
        assert await said(dut, sim, 5) == "" and sim.overshoot_v < 2e-12
    # high from 2.2 us to 2.35 us, which is within settle_s before the edge at 2.5 us
    pulse = "vp p 0 pwl(0 0 2.1u 0 2.3u 1 2.4u 0)" + chr(10) + "rp p 0 1k" + chr(10)
    sim = cosim(inputs, {"dut.comp_b": Compare("p", above=0.5, crossing=True)}, pulse, settle_s=0.4e-6)
    assert "crossed twice" in await said(dut, sim, 5)
""",
    "both_edges_of_a_clock": """
    inputs = {"dut.dac": Drive("vd_a"), "dut.fell": Drive("vd_b")}
    ramp = "vp p 0 pwl(0 0 10u 1)" + chr(10) + "rp p 0 1k" + chr(10)
    options = dict(more=ramp, probes=["d_b"], step_s=None)
    for above in (0.42, 0.47, 0.52):  # before the falling edge at 5 us, or after the rising one
        sim = cosim(inputs, {"dut.comp": Compare("p", above=above)}, both_edges=True, **options)
        assert await said(dut, sim, 9) == ""
        assert np.allclose(np.diff(sim.times)[1:], 5e-7, rtol=1e-9, atol=0)
        falls = np.flatnonzero((sim.samples["p"] > above) & (np.round(sim.times * 1e6, 3) % 1.0 < 0.1))
        assert sim.samples["d_b"][falls[0]] == 0.0 and sim.samples["d_b"][falls[0] + 1] == 1.0, above
    sim = cosim(inputs, {"dut.comp": Compare("p", above=0.5)}, **options)
    assert "own.fell changed at " in await said(dut, sim)
""",
    "a_netlist_in_another_folder": """
    folder = Path("its own")
    (folder / "parts").mkdir(parents=True)
    part = ".SUBCKT RC A B", "R1 A B 10k", "C1 B 0 100p", ".ENDS"
    (folder / "parts" / "rc.inc").write_text(chr(10).join(part))
    lines = "title", ".Include 'parts/rc.inc'", "VD_A D_A 0", "+ EXTERNAL", "X1 D_A", "+ X RC", ".END", "R9 X 0 1"
    (folder / "top.sp").write_text(chr(10).join(lines))
    options = dict(clock="dut.clk", period_s=1e-6, reset="dut.rst_n", step_s=1e-8, log="own.log")
    outputs = {"dut.comp": Compare("x", above=0.5)}
    sim = Cosim(folder / "top.sp", {"dut.other": Drive("vd_a", low=1.0)}, outputs, **options)
    assert await said(dut, sim) == ""
    assert abs(sim.samples["x"] - 1.0).max() < 1e-6, "what follows .END is no part of it"
""",
    "an_output_that_the_verilog_drives_is_named": """
    outputs = {"dut.dac": Compare("d_b", above=0.5)}
    clocks = {"dut.clk": 1e-6, "dut.clk_b": 0.7e-6}
    sim = cosim({"dut.late": Drive("vd_a"), "dut.other": Drive("vd_b")}, outputs, clock=clocks, settle_s=5e-9)
    assert "own.dac is not as the circuit set it" in await said(dut, sim)
""",
    "a_clock_that_the_verilog_drives_is_named": """
    sim = cosim({"dut.code": Drive("vd_a"), "dut.other": Drive("vd_b")}, clock={"dut.clk": 1e-6, "dut.dac": 0.7e-6})
    assert "something else drives it" in await said(dut, sim)
""",
    "a_pole_far_below_the_step_does_not_ring": """
    diode = ".model dd d is=1e-15" + chr(10) + "d1 d_a z dd" + chr(10) + "r3 z 0 10k" + chr(10) + "c3 z 0 100p"
    rc = RC.split(".options")[0].replace("r2 d_b y 10k", "r2 d_b y 1k")
    inputs, outputs = {"dut.other": Drive("vd_a"), "dut.dac": Drive("vd_b")}, {"dut.comp": Compare("x", above=0.5)}
    options = dict(clock={"dut.clk": 0.9e-6, "dut.clk_b": 1e-6}, reset="dut.rst_n", probes=["d_b", "y", "z"])
    for step in (None, 2e-7):
        sim = Cosim(rc + diode, inputs, outputs, step_s=step, log="own.log", **options)
        assert await said(dut, sim, 200) == ""
        # y has 1 ns, and settles between edges that are 100 ns apart; z is a peak detector
        late = np.diff(sim.times, prepend=0) > 5e-8
        assert abs(sim.samples["y"] - sim.samples["d_b"])[late].max() < 1e-3
        assert sim.samples["z"].max() < 0.6 and sim.samples["z"].min() > -1e-3, "one diode below 1 V"
""",
    "without_a_clock_a_crossing_is_told_when_it_happens": """
    ramp = "vp p 0 pwl(0 0 10u 1)" + chr(10) + "rp p 0 1k" + chr(10)
    for above in (0.1037, 0.4371):
        outputs = {"dut.comp_b": Compare("p", above=above)}
        inputs = {"dut.caught": Drive("vd_a"), "dut.fell": Drive("vd_b")}
        sim = cosim(inputs, outputs, ramp, clock=None, reset=None, step_s=1e-9, settle_s=4e-7)
        async with sim.running(dut):
            began = get_sim_time("step")
            await RisingEdge(dut.comp_b)
            told = 1e-12 * (get_sim_time("step") - began)
            await Timer(1, unit="us")
        assert abs(told - above * 1e-5) < 2.5e-12, (told, above)  # two units of time
""",
    "default_drives_have_the_error_of_ngspice_alone": """
    rc = RC.split("r1")[0] + "r1 d_a x 100k" + chr(10) + "c1 x 0 100p" + chr(10) + "r2 d_b 0 1k" + chr(10)
    rc += "bq 0 q i=1u*v(d_a)*v(d_a)" + chr(10) + "cq q 0 1n" + chr(10) + "rq q 0 1e12"
    inputs, outputs = {"dut.other": Drive("vd_a"), "dut.dac": Drive("vd_b")}, {"dut.comp": Compare("x", above=0.5)}
    sim = Cosim(rc, inputs, outputs, clock="dut.clk_b", period_s=1e-6, reset="dut.rst_n", probes=["q"], log="own.log")
    async with sim.running(dut):
        await ClockCycles(dut.clk_b, 200)
    t, x, q = sim.times[1:], sim.samples["x"][1:], sim.samples["q"]
    exact, worst, tau = 0.0, 0.0, 1e-5
    for n in range(1, len(t)):
        # event n - 1 begins the ramp of 1 ns to 1 or to 0
        end, slope = float(n % 2), (2 * (n % 2) - 1) / 1e-9
        start = (1 - end) - tau * slope
        exact = start + slope * 1e-9 + (exact - start) * math.exp(-1e-9 / tau)
        exact = end + (exact - end) * math.exp(-(t[n] - t[n - 1] - 1e-9) / tau)
        worst = max(worst, abs(exact - x[n]))
    assert worst < 2e-4, worst  # ngspice alone has 2e-5; 1.8e-3 with longer steps than it asks for
    # 1 us, and a third of each ramp, of 1 uA into 1 nF; ngspice has a seventh of a ramp too little
    pulses = q[3::2][1:] - q[3::2][:-1]
    assert abs(pulses - 1e-3 * (1 - 1e-3 / 3)).max() < 3e-7, pulses
""",
    "two_edges_of_a_source_within_settle_s": """
    inputs = {"dut.dac": Drive("vd_b")}
    for step, abrupt in ((1e-6, True), (1e-8, False)):
        sim = cosim(inputs | {"dut.pulse": Drive("vd_a", abrupt=abrupt)}, settle_s=7e-8, step_s=step)
        found = await said(dut, sim)
        assert found == "", found
        t, x = sim.times[1:], sim.samples["x"][1:]
        # from 10 ns to 60 ns after each event, with ramps of 1 ns, into 1 us: two ramps are a step 0.5 ns later
        gained = math.exp(-(1e-6 - 60.5e-9) / 1e-6) - math.exp(-(1e-6 - 10.5e-9) / 1e-6)
        exact = 0.0
        for n in range(1, len(t)):
            exact = exact * math.exp(-(t[n] - t[n - 1]) / 1e-6) + gained
            assert abs(x[n] - exact) < 1e-4, (step, n, x[n], exact)  # of ngspice; 0.01 was lost
""",
    "a_circuit_without_a_source_of_the_verilog": """
    sine = "a sine" + chr(10) + "v1 x 0 sin(0 1 100k)" + chr(10) + "r1 x y 1k" + chr(10) + "c1 y 0 1p" + chr(10)
    outputs, given = {"dut.comp_b": Compare("x", above=0.1, crossing=True)}, dict(step_s=1e-8, log="own.log")
    for clock in (dict(clock="dut.clk", period_s=1e-6, reset="dut.rst_n"), {}):
        sim = Cosim(sine, {}, outputs, probes="y", **given, **clock)
        async with sim.running(dut):
            await Timer(55, unit="us")
        above = sim.samples["x"] > 0.1 - 1e-9
        rises = above[1:] & ~above[:-1]
        assert rises.sum() == 6 and len(sim.samples["y"]) == len(sim.times), rises.sum()
    # an input that its netlist lacks leaves the process to the next circuit
    wrong = Cosim(sine, {"dut.dac": Drive("v1")}, outputs, clock="dut.clk", period_s=1e-6, reset="dut.rst_n", **given)
    assert "an external source" in await said(dut, wrong)
    sim = Cosim(sine, {}, outputs, clock="dut.clk", period_s=1e-6, reset="dut.rst_n", **given)
    assert await said(dut, sim) == ""
""",
    "crossings_faster_than_the_verilog_is_told": """
    sine = "a sine" + chr(10) + "v1 x 0 sin(0 1 10meg)" + chr(10) + "r1 x 0 1k" + chr(10)
    for settle_s, words in ((1e-7, "follow each other faster"), (0.0, "")):
        sim = Cosim(sine, {}, {"dut.comp_b": Compare("x", above=0.1)}, step_s=1e-8, settle_s=settle_s, log="own.log")
        found = ""
        try:
            async with sim.running(dut):
                await Timer(2, unit="us")
        except DermisError as error:
            found = str(error)
        assert words in found and bool(words) == bool(found), found
    # the circuit is ahead of the Verilog by one crossing
    assert (np.abs(sim.samples["x"] - 0.1) < 1e-9)[sim.times <= 2e-6].sum() == 40, sim.samples
""",
    "an_x_is_named": """
    assert "own.dac is x" in await said(dut, cosim({"dut.dac": Drive("vd_a"), "dut.late": Drive("vd_b")}, reset=None))
""",
}


@pytest.mark.parametrize("simulator", ["icarus", pytest.param("verilator", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", TESTS)
def test_own_circuits(name: str, simulator: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    delayed = "a_delay_is_an_error_by_name_or_exact", "two_edges_of_a_source_within_settle_s"
    if simulator == "verilator" and name in ("an_x_is_named", *delayed):
        pytest.skip("Verilator has no X, and ignores delays as it is built here")
    monkeypatch.delitem(sys.modules, "own_test", raising=False)
    verilog = re.sub(r"<= #\d+ ", "<= ", VERILOG) if simulator == "verilator" else VERILOG
    (tmp_path / "own.v").write_text(verilog)
    (tmp_path / "test").mkdir()
    module = tmp_path / "test" / "own_test.py"
    module.write_text(f"{PYTHON}\n\n@cocotb.test()\nasync def {name}(dut):{TESTS[name]}")
    assert run(simulator, tmp_path / "own.v", module, tmp_path / "run", monkeypatch) == ""
