* SPDX-License-Identifier: Apache-2.0
* vfc: pulses in 512 clocks at R = 510 ohm, in a plain transient with an ideal flip-flop.
* The flip-flop and its bridges are XSPICE devices, an independent peer of the lock-step and nothing more: they
* silently set trtol from 7 to 1, and an adc_bridge with in_low < in_high makes half a packet of an unknown level.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: one packet is 5e-12 C: 1e-16 C a step is 2e-5 of a count
.options reltol=1e-5 chgtol=1e-16
* parameters
.param r_taxel = 510
.param n_clocks = 512
.param t_clk = {converter_t_clk_s}
.param t_edge = {converter_t_edge_s}
.param i0 = {converter_i0_a}
* stimulus: edges of the clock at n t_clk; the preset ends at edge 5, decisions 1 to n_clocks follow
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
itaxel 0 v_sum {interface_v_bias_v/(interface_k*r_taxel)}
vclk v_clk 0 pulse(0 1 {t_clk} 10p 10p {0.5*t_clk} {t_clk})
vpreset d_preset 0 pulse(1 0 {5*t_clk} {t_edge} {t_edge} 1 2)
* DUT
xdut v_sum d_charge d_preset v_comp 0 0 0 vdd vss 0 0 vfc
acomp [v_comp] [comp] zero
aclk [v_clk d_preset] [clk preset] half
agate [comp charge_n] data both
aflop data clk low preset charge charge_n flop
alow low pulldown
acharge [charge] [d_charge] drive
.model zero adc_bridge(in_low=0 in_high=0 rise_delay=1p fall_delay=1p)
.model half adc_bridge(in_low=0.5 in_high=0.5 rise_delay=1p fall_delay=1p)
.model both d_and(rise_delay=1p fall_delay=1p)
.model flop d_dff(clk_delay=1p set_delay=1p reset_delay=1p rise_delay=1p fall_delay=1p ic=0)
.model pulldown d_pulldown(load=1f)
.model drive dac_bridge(out_low=0 out_high=1 out_undef=0.5 t_rise=1n t_fall=1n)
* measure: a pulse is one t_clk long, so the integral counts them
.tran 10n {(n_clocks + 6)*t_clk} 0 10n
.meas tran t_high integ v(d_charge) from={5.5*t_clk} to={(n_clocks + 5.9)*t_clk}
.meas tran pulses param='t_high/t_clk'
.meas tran v_end find v(xdut.v_int) at={(n_clocks + 5.9)*t_clk}
* charge balance: input charge less packets is the stored charge
.meas tran balance_v param='integrator_v_preset_v - ((n_clocks + 0.9)*t_clk*interface_v_bias_v/(interface_k*r_taxel) - t_high*i0)/converter_c_int_f'
* control
.control
run
quit
.endc
.end
