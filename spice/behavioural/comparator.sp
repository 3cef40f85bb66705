* SPDX-License-Identifier: Apache-2.0
* Comparator: out = vdd where v(inp,inn) >= v_offset_v, else vss; gain_dc is the slope of out at that level.
* Defaults are the physical values of design.inc. Ideal: gain_dc >= 1e8 (a step), v_offset_v = 0, v_hysteresis_v = 0, t_delay_s = 0.
* A delay above comparator_early_s is applied by the reader, which samples out t_delay_s earlier (decks of scenes).
.param comparator_early_s=1e9
.subckt comparator inp inn out ibias vdd vss
+ params: gain_dc={comparator_gain_dc} v_offset_v={comparator_v_offset_v} v_hysteresis_v={comparator_v_hysteresis_v}
+ t_delay_s={comparator_t_delay_s}
* The tanh is 1 - 2e-9 at the limits. ngspice evaluates only the branch taken, which is nearly always a constant.
.param v_linear = {10*(supply_vdd_v - supply_vss_v)/(2*gain_dc)}
.param t_own_s = {t_delay_s > comparator_early_s ? 0 : t_delay_s}
.if (t_own_s + v_hysteresis_v > 0)
* Above 1/20 of a clock the delay is a matched line, which distorts nothing. A pole rounds the corners of the
* ramp: exp(-1 / delay in clocks) of a corner is left a clock later, 3 % at 0.3 clock, or 28 codes with a clamp.
* Below, it is a pole (2e-9 of a corner left), whose output edge costs no time steps.
* Both precede the decision; the hysteresis follows the line.
* A line is for benches with steps shorter than it. rel: a change of slope above rel times the larger slope limits
* the step, counted from the last point but one; after a step longer than the line the limit is negative ("timestep
* too small"). A rel above 2 sets no limit.
* 10 fF: when the hysteresis switches, the current jumps at a charge near zero, and truncation control accepts only
* errors below chgtol. With 1 S and t_own_s farad that needs a step below the minimum ("timestep too small"); with
* 10 fF, chgtol is 1 V times reltol: 0.1 mV, or 10 nV with the tolerances of a clamp.
* ngspice reads every .param inside any .if: each is written once.
.param line = {t_own_s*converter_f_clk_hz > 0.05}
.param g_in = {(t_own_s > 0) && (line < 0.5) ? 1e-14/t_own_s : 1}
.if (line > 0.5)
gnear 0 v_near inp inn 2
rnear v_near 0 1
tdelay v_near 0 v_far 0 z0=1 td={t_own_s} rel=2.1
rfar v_far 0 1
gin 0 v_in v_far 0 1
.else
gin 0 v_in inp inn {g_in}
.if (t_own_s > 0)
cin v_in 0 1e-14
.endif
.endif
rin v_in 0 {1/g_in}
.if (v_hysteresis_v > 0)
* Feedback through a sign, so that one of two states is always consistent: a finite gain in this loop would narrow
* the hysteresis and fold the operating point, where Newton's method fails.
bhysteresis 0 v_in i = v(v_in) >= ({v_offset_v}) ? {0.5*g_in*v_hysteresis_v} : {-0.5*g_in*v_hysteresis_v}
.endif
.if (gain_dc < 1e8)
bout out 0 v = v(v_in) > ({v_offset_v + v_linear}) ? v(vdd) : (v(v_in) < ({v_offset_v - v_linear}) ? v(vss) :
+ 0.5*(v(vdd) + v(vss) + v(vdd,vss)*tanh((v(v_in) - ({v_offset_v}))*{2*gain_dc}/v(vdd,vss))))
.else
bout out 0 v = v(v_in) >= ({v_offset_v}) ? v(vdd) : v(vss)
.endif
.elseif (gain_dc < 1e8)
bout out 0 v = v(inp,inn) > ({v_offset_v + v_linear}) ? v(vdd) : (v(inp,inn) < ({v_offset_v - v_linear}) ? v(vss) :
+ 0.5*(v(vdd) + v(vss) + v(vdd,vss)*tanh((v(inp,inn) - ({v_offset_v}))*{2*gain_dc}/v(vdd,vss))))
.else
bout out 0 v = v(inp,inn) >= ({v_offset_v}) ? v(vdd) : v(vss)
.endif
.ends comparator
