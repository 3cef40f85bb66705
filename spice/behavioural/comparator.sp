* SPDX-License-Identifier: Apache-2.0
* Comparator: out = vdd where v(inp,inn) >= v_offset_v, else vss; gain_dc is the slope of out at that level.
* Defaults are the physical values of design.inc. Ideal: gain_dc >= 1e8 (a step), v_offset_v = 0, v_hysteresis_v = 0, t_delay_s = 0.
* A delay above comparator_early_s is left to whoever reads out, who looks at it t_delay_s earlier, as the decks of a scene are read.
.param comparator_early_s=1e9
.subckt comparator inp inn out ibias vdd vss
+ params: gain_dc={comparator_gain_dc} v_offset_v={comparator_v_offset_v} v_hysteresis_v={comparator_v_hysteresis_v}
+ t_delay_s={comparator_t_delay_s}
* The tanh is 1 - 2e-9 where the constants take over: a branch not taken is not evaluated, and nearly always that is the tanh.
.param v_linear = {10*(supply_vdd_v - supply_vss_v)/(2*gain_dc)}
.param t_own_s = {t_delay_s > comparator_early_s ? 0 : t_delay_s}
.if (t_own_s + v_hysteresis_v > 0)
* Beyond a twentieth of a clock the delay is a matched line, which is late by it and bends nothing. A pole makes a bend of the
* ramp round: of a packet's end a clock ago exp(-1 / delay in clocks) is left, 3 % at 0.3 clock, which beside a clamp was 28 codes.
* Up to there it is a pole, 2e-9 of a bend left, whose output edge costs no time steps.
* Both stand before the decision and the hysteresis behind the line.
* A line is for benches, whose steps must be shorter than it is. rel: a change of slope above this times the larger slope limits the
* step, counted from the point before the last: to less than nothing where a step was longer than the line ("timestep too small").
* Above 2 there is none.
* 10 fF: where the hysteresis turns round, the current jumps while the charge is near zero, and truncation control is content only below
* chgtol. With 1 S and t_own_s farad that was a step below the smallest ("timestep too small") beside the tolerances of a clamp; with
* 10 fF, chgtol is 1 V times reltol: 0.1 mV, or 10 nV beside a clamp.
* ngspice takes every .param, whatever .if it stands in: each is written once.
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
* Fed back by a sign, so one of its two states always agrees with itself: a finite gain in this loop would narrow the hysteresis
* and fold the operating point, which Newton cannot pass.
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
