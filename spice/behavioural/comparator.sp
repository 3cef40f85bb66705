* SPDX-License-Identifier: Apache-2.0
* Comparator: out = vdd where inp >= inn, else vss.
* Defaults are the physical values of design.inc. Ideal: gain_dc >= 1e8 (a step), v_offset_v = 0, v_hysteresis_v = 0, t_delay_s = 0.
.subckt comparator inp inn out ibias vdd vss
+ params: gain_dc={comparator_gain_dc} v_offset_v={comparator_v_offset_v} v_hysteresis_v={comparator_v_hysteresis_v}
+ t_delay_s={comparator_t_delay_s}
.if (t_delay_s + v_hysteresis_v > 0)
* The pole stands before the decision: a ramp is late by exactly t_delay_s and the output edge itself costs no time steps.
* Positive feedback goes through the pole as well (10 ps at least); without any the operating point folds and Newton finds no way over.
gin 0 v_in inp inn 1
rin v_in 0 1
cin v_in 0 {max(t_delay_s, 1e-11)}
bsign 0 v_sign i = tanh((v(v_in) - ({v_offset_v}))*{2*gain_dc}/v(vdd,vss))
rsign v_sign 0 1
.if (v_hysteresis_v > 0)
ghys 0 v_in v_sign 0 {0.5*v_hysteresis_v}
.endif
bout out 0 v = 0.5*(v(vdd) + v(vss) + v(vdd,vss)*v(v_sign))
.elseif (gain_dc < 1e8)
bout out 0 v = 0.5*(v(vdd) + v(vss) + v(vdd,vss)*tanh((v(inp,inn) - ({v_offset_v}))*{2*gain_dc}/v(vdd,vss)))
.else
bout out 0 v = v(inp,inn) >= ({v_offset_v}) ? v(vdd) : v(vss)
.endif
.ends comparator
