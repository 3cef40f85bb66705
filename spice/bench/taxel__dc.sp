* SPDX-License-Identifier: Apache-2.0
* taxel: a 2 x 2 array with trace resistance in the columns, so that all laterals carry current.
* include
.include ../design.inc
.include ../array/taxel.sp
* options: inner nodes are at 1e18 ohm: gmin far below, and tolerances tight enough to remove its effect
.options reltol=1e-9 abstol=1e-18 vntol=1e-12 gmin=1e-18
* parameters
.param r_trace = 10
.param r_column = 5
* stimulus: row 0 driven, row 1 grounded, columns to ground through r_column below the cells of row 1
vrow0 row0 0 {interface_v_bias_v}
vrow1 row1 0 0
rtrace_c0 v_r0c0 v_r1c0 {r_trace}
rtrace_c1 v_r0c1 v_r1c1 {r_trace}
rcolumn_c0 v_r1c0 v_end0 {r_column}
rcolumn_c1 v_r1c1 v_end1 {r_column}
vprobe_c0 v_end0 0 0
vprobe_c1 v_end1 0 0
* DUT: a cell at the edge has its own electrode for a missing neighbour
xdut_r0c0 row0 v_r0c0 v_r0c1 v_r1c0 taxel r_taxel_ohm=500
xdut_r0c1 row0 v_r0c1 v_r0c1 v_r1c1 taxel r_taxel_ohm=2000
xdut_r1c0 row1 v_r1c0 v_r1c1 v_r1c0 taxel r_taxel_ohm=1000
xdut_r1c1 row1 v_r1c1 v_r1c1 v_r1c1 taxel r_taxel_ohm=0
* measure
.dc vrow1 0 1 1
.meas dc i_col_0 find i(vprobe_c0) at=0
.meas dc i_col_1 find i(vprobe_c1) at=0
.meas dc v_inner_00 find v(v_r0c0) at=0
.meas dc v_inner_01 find v(v_r0c1) at=0
.meas dc v_inner_10 find v(v_r1c0) at=0
* control
.control
run
quit
.endc
.end
