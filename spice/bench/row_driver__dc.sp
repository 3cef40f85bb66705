* SPDX-License-Identifier: Apache-2.0
* row_driver: level and resistance of a driven and of a grounded row, and the crossfade between them.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: six digits are compared; the default gmin of 1e-12 S matters with an open row
.options reltol=1e-6 gmin=1e-18
* parameters
.param i_load = 1e-3
* stimulus: each row without and with a load of 1 mA
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vbias vbias 0 {interface_v_bias_v}
vrow d_row 0 1
iload1 v_row1 0 {i_load}
* DUT
xdut_0 d_row v_row0 vbias 0 vdd vss 0 0 row_driver
xdut_1 d_row v_row1 vbias 0 vdd vss 0 0 row_driver
* measure
.dc vrow 0 1 0.25
.meas dc v_driven find v(v_row0) at=1
.meas dc v_driven_loaded find v(v_row1) at=1
.meas dc v_grounded find v(v_row0) at=0
.meas dc v_grounded_loaded find v(v_row1) at=0
.meas dc v_half find v(v_row0) at=0.5
.meas dc r_on_ohm param='(v_driven - v_driven_loaded)/i_load'
.meas dc r_ground_ohm param='(v_grounded - v_grounded_loaded)/i_load'
* control
.control
run
quit
.endc
.end
