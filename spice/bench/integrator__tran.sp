* SPDX-License-Identifier: Apache-2.0
* integrator: preset value, slope of the ramp, end of the output range, and the next preset.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: slopes are compared to 1e-7: 1e-17 C is two millionths of a packet, and the lines are straight
.options reltol=1e-6 chgtol=1e-17
* parameters
.param i_in_a = 12.5e-6
.param t_edge = {converter_t_edge_s}
* stimulus: preset to 2 us, ramp until the rail, preset again from 6 us to 8 us
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
iin 0 v_sum {i_in_a}
vpreset d_preset 0 pulse(1 0 2u {t_edge} {t_edge} {4u - t_edge} 6u)
* DUT
xdut v_sum 0 d_preset v_int 0 0 vdd vss 0 0 integrator
* measure
.tran 10n 8.2u 0 10n
.meas tran v_preset find v(v_int) at=2u
.meas tran v_early find v(v_int) at=2.1u
.meas tran v_late find v(v_int) at=2.3u
.meas tran slope param='(v_late - v_early)/200e-9'
.meas tran v_released find v(v_int) at=2.2u
.meas tran v_rail find v(v_int) at=5.9u
.meas tran v_sum_rail find v(v_sum) at=5.9u
.meas tran v_preset_again find v(v_int) at=8u
.meas tran v_sum_again find v(v_sum) at=8u
* control
.control
run
quit
.endc
.end
