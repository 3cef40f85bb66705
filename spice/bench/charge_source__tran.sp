* SPDX-License-Identifier: Apache-2.0
* charge_source: charge of one pulse, of either sign, and the current when it is off.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: a current source into a short: only .meas integrates; the operating point needs six digits
.options reltol=1e-6
* parameters
.param t_edge = {converter_t_edge_s}
.param t_clk = {converter_t_clk_s}
* stimulus: one clock from 100 ns
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vcharge d_charge 0 pulse(0 1 100n {t_edge} {t_edge} {t_clk - t_edge} 1)
vprobe_sink v_out 0 0.3
vprobe_source v_outn 0 0.3
* DUT
xdut d_charge v_out 0 vdd vss 0 0 charge_source
xdut_negative d_charge v_outn 0 vdd vss 0 0 charge_source i0_a={-converter_i0_a}
* measure: a current into the source leaves its probe, hence the sign
.tran 1n 400n 0 1n
.meas tran q_probe integ i(vprobe_sink) from=50n to=350n
.meas tran q_probe_negative integ i(vprobe_source) from=50n to=350n
.meas tran charge_c param='-q_probe'
.meas tran charge_negative_c param='-q_probe_negative'
.meas tran i_on find i(vprobe_sink) at=200n
.meas tran i_off find i(vprobe_sink) at=380n
* control
.control
run
quit
.endc
.end
