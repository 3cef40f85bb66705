* SPDX-License-Identifier: Apache-2.0
* Row driver: row is at vss_ref + v_bias_v through r_on_ohm if d_row is 1 V, at vss_ref through r_ground_ohm if 0 V.
* v_bias_v is a parameter: a product of d_row and the pin vbias is a nonlinear source per row, evaluated at each
* step; only a changing bias needs it (follow = 1).
* Defaults are the physical values of design.inc. Ideal: r_on_ohm = r_ground_ohm = 0.
.subckt row_driver d_row row vbias vss_ref
+ params: r_on_ohm={row_driver_r_on_ohm} r_ground_ohm={row_driver_r_ground_ohm} v_bias_v={interface_v_bias_v} follow=0
.if (abs(r_on_ohm - r_ground_ohm) > 0)
* 1 uohm at least: two conductances, crossfaded by d_row
.if (follow > 0)
bon row vss_ref i = v(d_row)*v(row,vbias)*{1/max(r_on_ohm, 1e-6)}
.else
bon row vss_ref i = v(d_row)*(v(row,vss_ref) - {v_bias_v})*{1/max(r_on_ohm, 1e-6)}
.endif
bground row vss_ref i = (1 - v(d_row))*v(row,vss_ref)*{1/max(r_ground_ohm, 1e-6)}
.elseif (r_on_ohm > 0)
ron v_drive row {r_on_ohm}
.if (follow > 0)
bdrive v_drive vss_ref v = v(d_row)*v(vbias,vss_ref)
.else
edrive v_drive vss_ref d_row 0 {v_bias_v}
.endif
.elseif (follow > 0)
bdrive row vss_ref v = v(d_row)*v(vbias,vss_ref)
.else
edrive row vss_ref d_row 0 {v_bias_v}
.endif
.ends row_driver
