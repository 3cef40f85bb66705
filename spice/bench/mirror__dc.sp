* SPDX-License-Identifier: Apache-2.0
* mirror: ratio for each setting of its two pins and for a fixed k, output resistance, polarity.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: six digits are compared; the default gmin of 1e-12 S matters at 50 Mohm of output
.options reltol=1e-6 gmin=1e-18
* parameters
.param i_in = 1e-3
* stimulus
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vlow d_low 0 0
vhigh d_high 0 1
iin0 0 v_in0 {i_in}
iin1 0 v_in1 {i_in}
iin2 0 v_in2 {i_in}
iin3 0 v_in3 {i_in}
iinf 0 v_inf {i_in}
iinr 0 v_inr {i_in}
iinp 0 v_inp {i_in}
vprobe_0 v_out0 0 0
vprobe_1 v_out1 0 0
vprobe_2 v_out2 0 0
vprobe_3 v_out3 0 0
vprobe_f v_outf 0 0
vprobe_r v_outr 0 1
vprobe_p v_outp 0 0
* DUT
xdut_k0 v_in0 v_out0 d_low d_low 0 vdd vss 0 0 mirror
xdut_k1 v_in1 v_out1 d_high d_low 0 vdd vss 0 0 mirror
xdut_k2 v_in2 v_out2 d_low d_high 0 vdd vss 0 0 mirror
xdut_k3 v_in3 v_out3 d_high d_high 0 vdd vss 0 0 mirror
xdut_fixed v_inf v_outf 0 0 0 vdd vss 0 0 mirror k={interface_k}
xdut_lifted v_inr v_outr 0 0 0 vdd vss 0 0 mirror k={interface_k}
xdut_sink v_inp v_outp 0 0 0 vdd vss 0 0 mirror k={interface_k} polarity=-1
* measure: a current into its probe is a current out of the mirror
.dc vlow 0 1e-3 1e-3
.meas dc i_out_0 find i(vprobe_0) at=0
.meas dc i_out_1 find i(vprobe_1) at=0
.meas dc i_out_2 find i(vprobe_2) at=0
.meas dc i_out_3 find i(vprobe_3) at=0
.meas dc i_out_fixed find i(vprobe_f) at=0
.meas dc i_out_lifted find i(vprobe_r) at=0
.meas dc i_out_sink find i(vprobe_p) at=0
.meas dc g_out_s param='i_out_fixed - i_out_lifted'
* control
.control
run
quit
.endc
.end
