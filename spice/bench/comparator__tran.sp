* SPDX-License-Identifier: Apache-2.0
* comparator: delay on a ramp of an integrator's slope, both ways, and on a step.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: the crossing is compared to 1/50 of a step; 1e-18 C is 1/1000 of the charge of the 10 fF pole
.options reltol=1e-5 chgtol=1e-18 trtol=1
* parameters
.param slope = 2.5e6
* stimulus: 1 V/0.4 us through zero at 0.2 us and, falling, at 0.8 us; a step of +-50 mV at 0.5 us
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vin v_in 0 pwl(0 -0.5 0.4u 0.5 0.6u 0.5 1u -0.5 1.2u -0.5)
vstep v_step 0 pwl(0 -50m 0.5u -50m 0.501u 50m 1.2u 50m)
* DUT
xdut_ramp v_in 0 v_ramp 0 vdd vss comparator
xdut_step v_step 0 v_jump 0 vdd vss comparator
* measure
.tran 1n 1.2u 0 1n
.meas tran t_rise when v(v_ramp)=0 rise=1
.meas tran t_fall when v(v_ramp)=0 fall=1
.meas tran t_step when v(v_jump)=0 rise=1
.meas tran delay_rise_s param='t_rise - 0.2e-6'
.meas tran delay_fall_s param='t_fall - 0.8e-6'
.meas tran delay_step_s param='t_step - 0.5005e-6'
* control
.control
run
quit
.endc
.end
