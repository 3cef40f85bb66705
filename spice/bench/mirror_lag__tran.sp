* SPDX-License-Identifier: Apache-2.0
* mirror_lag: current after steps of the input up, down and to zero, and the delayed charge.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: the current falls by five decades, all of which must be right; the gate charge of 5e-14 C to 1e-6
.options reltol=1e-6 abstol=1e-15 vntol=1e-9 chgtol=1e-20 trtol=1
* parameters
.param i_low = 1e-7
.param i_high = 1e-5
* four time constants at i_low, so that every sample is in the transient
.param t_step = 10u
.param t_edge = 1p
* stimulus: settled at i_low, up to i_high at 1 us, back at 1 us + t_step, to zero after another t_step
iin 0 v_in pwl(0 {i_low} 1u {i_low} {1u + t_edge} {i_high} {1u + t_step} {i_high} {1u + t_step + t_edge} {i_low}
+ {1u + 2*t_step} {i_low} {1u + 2*t_step + t_edge} 0 1 0)
vprobe v_out 0 0
vprobe_n v_outn 0 0
* DUT
xdut v_in v_out v_outn mirror_lag
* measure
.tran 1n 41u 0 1n
.meas tran i_start find i(vprobe) at=0.9u
.meas tran i_up find i(vprobe) at=1.02u
.meas tran i_top find i(vprobe) at=10.9u
.meas tran i_down find i(vprobe) at=11.1u
.meas tran i_low_again find i(vprobe) at=20.9u
.meas tran i_open find i(vprobe) at=31u
.meas tran i_sunk find i(vprobe_n) at=31u
.meas tran charge_c integ i(vprobe) from=0.9u to=10.9u
* control
.control
run
quit
.endc
.end
