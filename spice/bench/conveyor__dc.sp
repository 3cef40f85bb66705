* SPDX-License-Identifier: Apache-2.0
* conveyor: offset, input resistance, gain, output resistance and current limit.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: six digits are compared; the default gmin of 1e-12 S matters at 1 Mohm of output
.options reltol=1e-6 gmin=1e-18
* parameters
.param r_drive = 10
* stimulus: y at 0.1 V, x driven through 10 ohm; the second conveyor has 1 V at z
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vy v_y 0 0.1
vdrive v_drive 0 0
rdrive v_drive v_x {r_drive}
rload v_drive v_x1 {r_drive}
vprobe_z v_z 0 0
vprobe_z1 v_z1 0 1
* DUT
xdut v_y v_x v_z 0 vdd vss conveyor
xdut_z v_y v_x1 v_z1 0 vdd vss conveyor
* measure
.dc vdrive -0.6 0.8 1m
.meas dc i_one find i(vprobe_z) at=0.11
.meas dc i_two find i(vprobe_z) at=0.12
.meas dc v_x_one find v(v_x) at=0.11
.meas dc v_x_two find v(v_x) at=0.12
.meas dc i_x_one param='(0.11 - v_x_one)/r_drive'
.meas dc i_x_two param='(0.12 - v_x_two)/r_drive'
.meas dc gain param='(i_two - i_one)/(i_x_two - i_x_one)'
.meas dc r_x_ohm param='(v_x_two - v_x_one)/(i_x_two - i_x_one)'
.meas dc offset_v param='v_x_one - r_x_ohm*i_x_one - 0.1'
.meas dc i_max_a find i(vprobe_z) at=0.799
.meas dc i_min_a find i(vprobe_z) at=-0.599
.meas dc i_lifted find i(vprobe_z1) at=0.11
.meas dc g_z_s param='i_one - i_lifted'
* control
.control
run
quit
.endc
.end
