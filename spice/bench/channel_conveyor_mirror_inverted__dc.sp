* SPDX-License-Identifier: Apache-2.0
* channel_conveyor_mirror_inverted: column current against integrator current in preset, from 16 taxels of 31 ohm to an open column.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: currents from 1e-15 A to 16 mA are measured; gmin below the 1e-18 S of an open taxel
.options reltol=1e-9 abstol=1e-18 vntol=1e-12 gmin=1e-18
* parameters
.param v_row = 0.5
* stimulus: a row at v_row through the conductance g_taxel
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vrow row 0 {v_row}
vpreset d_preset 0 1
vcharge d_charge 0 0
vprobe_col row v_taxel 0
btaxel v_taxel v_col i = v(v_taxel,v_col)*v(g_taxel)
vg g_taxel 0 0
* DUT
xdut v_col d_charge d_preset v_comp 0 0 0 vdd vss 0 0 channel_conveyor_mirror_inverted int_r_preset_ohm=1e3
* measure: in preset the input current leaves through the preset switch, here 1 kohm to be read without rounding
.save all @b.xdut.xvfc.xintegrator.xint.bpreset[i]
.dc vg 0 32e-3 0.5e-3
.meas dc i_col_open find i(vprobe_col) at=0
.meas dc i_int_open find @b.xdut.xvfc.xintegrator.xint.bpreset[i] at=0
.meas dc i_col_full find i(vprobe_col) at=2e-3
.meas dc i_int_full find @b.xdut.xvfc.xintegrator.xint.bpreset[i] at=2e-3
.meas dc i_col_all find i(vprobe_col) at=32e-3
.meas dc i_int_all find @b.xdut.xvfc.xintegrator.xint.bpreset[i] at=32e-3
.meas dc v_col_full find v(v_col) at=2e-3
.meas dc v_int_full find v(xdut.xvfc.v_int) at=2e-3
.meas dc v_comp_full find v(v_comp) at=2e-3
.meas dc transfer param='-(i_int_full - i_int_open)/(i_col_full - i_col_open)'
* control
.control
run
quit
.endc
.end
