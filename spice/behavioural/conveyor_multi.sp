* SPDX-License-Identifier: Apache-2.0
* Multiple-output conveyor: x follows y, zp sources 1/k of the current into x, zn sinks it; no mirror follows.
* inv_i_range_a: the switches that set k compress the current, i becomes i / (1 + |i| inv_i_range_a). q_lag_c, i_ref_a: see mirror_lag.
* Defaults: physical values of design.inc without compression and lag. Ideal: as conveyor, inv_i_range_a = q_lag_c = 0.
.subckt conveyor_multi y x zp zn ibias vdd vss
+ params: k={interface_k} r_x_ohm={conveyor_r_x_ohm} v_offset_v={conveyor_v_offset_v} t_pole_s={conveyor_t_pole_s}
+ r_z_ohm={conveyor_r_z_ohm} i_out_max_a={conveyor_i_out_max_a} gain_error={conveyor_gain_error}
+ inv_i_range_a=0 q_lag_c=0 i_ref_a={converter_i0_a}
.if (i_out_max_a < 1e3)
* Above the current limit x is released: 100 kohm in series with the excess.
vx x v_x {v_offset_v}
bx v_x y v = i(vx) > {i_out_max_a} ? {r_x_ohm}*i(vx) + (i(vx) - {i_out_max_a})*1e5 :
+ (i(vx) < {-i_out_max_a} ? {r_x_ohm}*i(vx) + (i(vx) + {i_out_max_a})*1e5 : {r_x_ohm}*i(vx))
.elseif (r_x_ohm > 0)
vx x v_x {v_offset_v}
rx v_x y {r_x_ohm}
.else
vx x y {v_offset_v}
.endif
.if (t_pole_s + inv_i_range_a + q_lag_c > 0)
.if (inv_i_range_a > 0)
bpole 0 v_z i = ({1 + gain_error})*i(vx)/(1 + {inv_i_range_a}*abs(i(vx)))
.else
fpole 0 v_z vx {1 + gain_error}
.endif
rpole v_z 0 1e3
.if (t_pole_s > 0)
cpole v_z 0 {1e-3*t_pole_s}
.endif
.if (q_lag_c > 0)
gz 0 v_late v_z 0 {1e-3/k}
xlag v_late zp zn mirror_lag q_lag_c={q_lag_c} i_ref_a={i_ref_a}
.else
gzp 0 zp v_z 0 {1e-3/k}
gzn zn 0 v_z 0 {1e-3/k}
.endif
.else
fzp 0 zp vx {(1 + gain_error)/k}
fzn zn 0 vx {(1 + gain_error)/k}
.endif
.if (r_z_ohm < 1e17)
* an output stage k times smaller has k times the output resistance
rzp zp 0 {k*r_z_ohm}
rzn zn 0 {k*r_z_ohm}
.endif
.ends conveyor_multi
