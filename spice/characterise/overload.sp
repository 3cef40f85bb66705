* SPDX-License-Identifier: Apache-2.0
* One row, driven by its driver: a taxel that is too strong on column 0, 1 kohm on column 1, and 1 kohm from column to
* column. The swept source chooses 500 ohm, 100 ohm or a short of 10 mohm.
xline ibias vdd vss bias_line
xout_ibias1 v_gate v_cp ibias1 vdd bias_output
xline1 ibias1 vdd vss bias_line
vs s 0 0
vb vb 0 0.5
vrow logic_row 0 1
xdriver d_row row vb 0 vdd vss vdd_d vss_d row_driver
bstrong row x i = (v(row) - v(x))*(v(s) < 0.5 ? 2m : (v(s) < 1.5 ? 10m : 100))
rside x x1 1k
rtaxel row x1 1k
vy y 0 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum ibias vdd vss mirror_fixed
vsum sum 0 0
xconveyor1 y x1 z1 ibias1 vdd vss conveyor
xmirror1 z1 sum1 ibias1 vdd vss mirror_fixed
vsum1 sum1 0 0
.dc vs 0 2 0.1
.meas dc x0 find v(x) at=0
.meas dc row0 find v(row) at=0
.meas dc out0 find i(vsum1) at=0
.meas dc x1 find v(x) at=1
.meas dc row1 find v(row) at=1
.meas dc out1 find i(vsum1) at=1
.meas dc x2 find v(x) at=2
.meas dc row2 find v(row) at=2
.meas dc out2 find i(vsum1) at=2
