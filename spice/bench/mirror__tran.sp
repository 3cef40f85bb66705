* SPDX-License-Identifier: Apache-2.0
* mirror: settling of the output current after a step of the input, for a fixed k and for the slowest and fastest pin setting.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: time constants are compared to 0.2 %; 1e-18 C is 1e-6 of the gate charge at 8 ns
.options reltol=1e-5 trtol=1 chgtol=1e-18
* parameters
.param i_step = 1e-3
.param t_edge = 1p
* about a third of the time constant at the fastest setting
.param t_look = 2n
* stimulus: a step at 10 ns
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vhigh d_high 0 1
iinf 0 v_inf pwl(0 0 10n 0 {10n + t_edge} {i_step} 1u {i_step})
iin0 0 v_in0 pwl(0 0 10n 0 {10n + t_edge} {i_step} 1u {i_step})
iin3 0 v_in3 pwl(0 0 10n 0 {10n + t_edge} {i_step} 1u {i_step})
vprobe_f v_outf 0 0
vprobe_0 v_out0 0 0
vprobe_3 v_out3 0 0
* DUT
xdut_fixed v_inf v_outf 0 0 0 vdd vss 0 0 mirror k={interface_k}
xdut_k0 v_in0 v_out0 0 0 0 vdd vss 0 0 mirror
xdut_k3 v_in3 v_out3 d_high d_high 0 vdd vss 0 0 mirror
* measure
.tran 20p 300n 0 20p
.meas tran i_end_fixed find i(vprobe_f) at=299n
.meas tran i_end_k0 find i(vprobe_0) at=299n
.meas tran i_end_k3 find i(vprobe_3) at=299n
.meas tran i_fixed find i(vprobe_f) at={10n + t_look}
.meas tran i_k0 find i(vprobe_0) at={10n + t_look}
.meas tran i_k3 find i(vprobe_3) at={10n + t_look}
.meas tran tau_fixed_s param='-t_look/ln(1 - i_fixed/i_end_fixed)'
.meas tran tau_k0_s param='-t_look/ln(1 - i_k0/i_end_k0)'
.meas tran tau_k3_s param='-t_look/ln(1 - i_k3/i_end_k3)'
* control
.control
run
quit
.endc
.end
