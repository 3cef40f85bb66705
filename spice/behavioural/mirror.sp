* SPDX-License-Identifier: Apache-2.0
* Asymmetrical current mirror: k equal input devices, one output device; out sources 1/k (polarity = -1: sinks).
* k > 0 fixes the ratio; k = 0 takes it from the pins: k_0, k_1, k_2, k_3 for (d_k1, d_k0) = 00, 01, 10, 11.
* inv_i_range_a: the switches that set k compress the current, i becomes i / (1 + |i| inv_i_range_a). q_lag_c, i_ref_a: see mirror_lag.
* Defaults are the physical values of design.inc, but no compression and no lag. Ideal: ratio_error = 0, r_out_ohm = 1e18, t_pole_s = 0,
* inv_i_range_a = 0, q_lag_c = 0.
.subckt mirror in out d_k0 d_k1 ibias vdd vss vdd_d vss_d
+ params: k=0 k_0={interface_k_0} k_1={interface_k_1} k_2={interface_k_2} k_3={interface_k_3}
+ ratio_error={mirror_ratio_error} r_out_ohm={mirror_r_out_ohm} t_pole_s={mirror_t_pole_s} polarity=1
+ inv_i_range_a=0 q_lag_c=0 i_ref_a={converter_i0_a}
vin in 0 0
.if ((k > 0) && (t_pole_s + inv_i_range_a + q_lag_c <= 0))
fout 0 out vin {polarity*(1 + ratio_error)/k}
.else
* Copy or compression, then division, then lag.
.if (inv_i_range_a > 0)
bin 0 v_gate i = i(vin)/(1 + {inv_i_range_a}*abs(i(vin)))
.else
fin 0 v_gate vin 1
.endif
.if (k <= 0)
* 0.1 mS a device: groups of input devices are switched in parallel, as in the circuit. Gate capacitance stays, so the pole is
* t_pole_s at k_0 and faster by k / k_0 above. Needs k_0 < k_1, k_0 < k_2 and k_1 + k_2 < k_0 + k_3.
.model group sw vt={0.5*supply_v_logic_v} vh=0 ron=1e-3 roff=1e18
rgate v_gate 0 {1e4/k_0}
.if (t_pole_s > 0)
cgate v_gate 0 {1e-4*k_0*t_pole_s}
.endif
s1 v_gate v_1 d_k0 vss_d group
r1 v_1 0 {1e4/(k_1 - k_0)}
s2 v_gate v_2 d_k1 vss_d group
r2 v_2 0 {1e4/(k_2 - k_0)}
s3 v_gate v_3 d_k0 vss_d group
s4 v_3 v_4 d_k1 vss_d group
r4 v_4 0 {1e4/(k_3 + k_0 - k_1 - k_2)}
.if (q_lag_c > 0)
gout 0 v_late v_gate 0 {1e-4*(1 + ratio_error)}
.else
gout 0 out v_gate 0 {1e-4*polarity*(1 + ratio_error)}
.endif
.else
* 1 kohm, so that vntol = 1 uV is 1 nA
rgate v_gate 0 1e3
.if (t_pole_s > 0)
cgate v_gate 0 {1e-3*t_pole_s}
.endif
.if (q_lag_c > 0)
gout 0 v_late v_gate 0 {1e-3*(1 + ratio_error)/k}
.else
gout 0 out v_gate 0 {1e-3*polarity*(1 + ratio_error)/k}
.endif
.endif
.if (q_lag_c > 0)
.if (polarity > 0)
xlag v_late out 0 mirror_lag q_lag_c={q_lag_c} i_ref_a={i_ref_a}
.else
xlag v_late 0 out mirror_lag q_lag_c={q_lag_c} i_ref_a={i_ref_a}
.endif
.endif
.endif
.if (r_out_ohm < 1e17)
rout out 0 {r_out_ohm}
.endif
.ends mirror
