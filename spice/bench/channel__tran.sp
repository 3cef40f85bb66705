* SPDX-License-Identifier: Apache-2.0
* The four channels on the same taxel: integrator after preset, after packets, at the end of its range, preset again.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: lines between corners are straight, so the corners set the steps and not truncation error
.options reltol=1e-6 abstol=1e-13 vntol=1e-9 trtol=1e9
* parameters
.param r_taxel = 500
.param n_packets = 10
.param t_clk = {converter_t_clk_s}
.param t_edge = {converter_t_edge_s}
.param t_step = 100n
* stimulus: preset to clock 10; the charge source on for n_packets clocks from 11 on; preset again from clock 200
* One long pulse, not a train: ngspice 46 sometimes loses a corner of a periodic PULSE (here at 2.6 us: 2.5 mV).
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vrow row 0 {interface_v_bias_v}
vpreset d_preset 0 pwl(0 1 {10*t_clk} 1 {10*t_clk + t_edge} 0 {200*t_clk} 0 {200*t_clk + t_edge} 1 {220*t_clk} 1)
vcharge d_charge 0 pwl(0 0 {11*t_clk} 0 {11*t_clk + t_edge} 1 {(11 + n_packets)*t_clk} 1
+ {(11 + n_packets)*t_clk + t_edge} 0 {220*t_clk} 0)
rtaxel_d row v_col_d {r_taxel}
rtaxel_m row v_col_m {r_taxel}
rtaxel_i row v_col_i {r_taxel}
rtaxel_o row v_col_o {r_taxel}
* DUT
xdut_d v_col_d d_charge d_preset v_comp_d 0 0 0 vdd vss 0 0 channel_direct
xdut_m v_col_m d_charge d_preset v_comp_m 0 0 0 vdd vss 0 0 channel_conveyor_mirror
xdut_i v_col_i d_charge d_preset v_comp_i 0 0 0 vdd vss 0 0 channel_conveyor_mirror_inverted
xdut_o v_col_o d_charge d_preset v_comp_o 0 0 0 vdd vss 0 0 channel_multi_output_conveyor
* measure: just before the release, one clock after it, n_packets clocks after the last packet, and around the second preset
.tran {t_step} {220*t_clk} 0 {t_step}
.meas tran v_preset_d find v(xdut_d.xvfc.v_int) at={10*t_clk}
.meas tran v_preset_m find v(xdut_m.xvfc.v_int) at={10*t_clk}
.meas tran v_preset_i find v(xdut_i.xvfc.v_int) at={10*t_clk}
.meas tran v_preset_o find v(xdut_o.xvfc.v_int) at={10*t_clk}
.meas tran v_clock_d find v(xdut_d.xvfc.v_int) at={11*t_clk}
.meas tran v_clock_m find v(xdut_m.xvfc.v_int) at={11*t_clk}
.meas tran v_clock_i find v(xdut_i.xvfc.v_int) at={11*t_clk}
.meas tran v_clock_o find v(xdut_o.xvfc.v_int) at={11*t_clk}
.meas tran v_train_d find v(xdut_d.xvfc.v_int) at={(11 + 2*n_packets)*t_clk}
.meas tran v_train_m find v(xdut_m.xvfc.v_int) at={(11 + 2*n_packets)*t_clk}
.meas tran v_train_i find v(xdut_i.xvfc.v_int) at={(11 + 2*n_packets)*t_clk}
.meas tran v_train_o find v(xdut_o.xvfc.v_int) at={(11 + 2*n_packets)*t_clk}
.meas tran v_end_d find v(xdut_d.xvfc.v_int) at={200*t_clk}
.meas tran v_end_m find v(xdut_m.xvfc.v_int) at={200*t_clk}
.meas tran v_end_i find v(xdut_i.xvfc.v_int) at={200*t_clk}
.meas tran v_end_o find v(xdut_o.xvfc.v_int) at={200*t_clk}
.meas tran v_again_d find v(xdut_d.xvfc.v_int) at={219.9*t_clk}
.meas tran v_again_m find v(xdut_m.xvfc.v_int) at={219.9*t_clk}
.meas tran v_again_i find v(xdut_i.xvfc.v_int) at={219.9*t_clk}
.meas tran v_again_o find v(xdut_o.xvfc.v_int) at={219.9*t_clk}
.meas tran comp_clock_m find v(v_comp_m) at={11*t_clk}
.meas tran comp_end_d find v(v_comp_d) at={200*t_clk}
.meas tran comp_end_m find v(v_comp_m) at={200*t_clk}
.meas tran comp_end_i find v(v_comp_i) at={200*t_clk}
.meas tran comp_end_o find v(v_comp_o) at={200*t_clk}
* control
.control
run
quit
.endc
.end
