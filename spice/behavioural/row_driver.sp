* SPDX-License-Identifier: Apache-2.0
* Row driver: row is at agnd + v_bias_v through r_on_ohm if d_row is high, at agnd through r_ground_ohm if low.
* v_bias_v is a parameter: a product of d_row and the pin vbias is a nonlinear source per row, evaluated at each
* step; only a changing bias needs it (follow = 1). Its current returns through agnd, which matters only if agnd has a
* resistance: with follow = 2 it comes from vbias.
* Defaults are the physical values of design.inc. Ideal: r_on_ohm = r_ground_ohm = 0.
.subckt row_driver d_row row vbias agnd vdd vss vdd_d vss_d
+ params: r_on_ohm={row_driver_r_on_ohm} r_ground_ohm={row_driver_r_ground_ohm} v_bias_v={interface_v_bias_v} follow=0
.if ((abs(r_on_ohm - r_ground_ohm) > 0) || (follow > 1))
* 1 uohm at least: two conductances, crossfaded by d_row
.if (follow > 1)
bon row vbias i = v(d_row,vss_d)*v(row,vbias)*{1/max(r_on_ohm, 1e-6)/supply_v_logic_v}
.elseif (follow > 0)
bon row agnd i = v(d_row,vss_d)*v(row,vbias)*{1/max(r_on_ohm, 1e-6)/supply_v_logic_v}
.else
bon row agnd i = v(d_row,vss_d)*(v(row,agnd) - {v_bias_v})*{1/max(r_on_ohm, 1e-6)/supply_v_logic_v}
.endif
bground row agnd i = ({supply_v_logic_v} - v(d_row,vss_d))*v(row,agnd)*{1/max(r_ground_ohm, 1e-6)/supply_v_logic_v}
.elseif (r_on_ohm > 0)
ron v_drive row {r_on_ohm}
.if (follow > 0)
bdrive v_drive agnd v = v(d_row,vss_d)*v(vbias,agnd)*{1/supply_v_logic_v}
.else
edrive v_drive agnd d_row vss_d {v_bias_v/supply_v_logic_v}
.endif
.elseif (follow > 0)
bdrive row agnd v = v(d_row,vss_d)*v(vbias,agnd)*{1/supply_v_logic_v}
.else
edrive row agnd d_row vss_d {v_bias_v/supply_v_logic_v}
.endif
.ends row_driver
