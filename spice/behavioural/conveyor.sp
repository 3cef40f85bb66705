* SPDX-License-Identifier: Apache-2.0
* Second-generation current conveyor: x follows y, no current into y, and z sources what enters x.
* Defaults are the physical values of design.inc. Ideal: r_x_ohm = 0, v_offset_v = 0, t_pole_s = 0, r_z_ohm = 1e18, i_out_max_a = 1e9, gain_error = 0.
.subckt conveyor y x z ibias vdd vss
+ params: r_x_ohm={conveyor_r_x_ohm} v_offset_v={conveyor_v_offset_v} t_pole_s={conveyor_t_pole_s} r_z_ohm={conveyor_r_z_ohm}
+ i_out_max_a={conveyor_i_out_max_a} gain_error={conveyor_gain_error}
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
.if (t_pole_s > 0)
* 1 kohm, so that vntol = 1 uV is 1 nA
fpole 0 v_z vx {1 + gain_error}
rpole v_z 0 1e3
cpole v_z 0 {1e-3*t_pole_s}
gz 0 z v_z 0 1e-3
.else
fz 0 z vx {1 + gain_error}
.endif
.if (r_z_ohm < 1e17)
rz z 0 {r_z_ohm}
.endif
.ends conveyor
