* SPDX-License-Identifier: Apache-2.0
* board column: one conversion of the direct interface from parts on a board, around the digital core.
* The core's flip-flops are XSPICE devices with the behaviour of rtl/dermis_sync_ff.v. `dermis board` changes parameters.
* include
.include ../design.inc
* options: a packet is 2 nC at 1 MHz, so chgtol is 5e-8 of a count; Gear damps the ringing at the edges of the charge pin
.options method=gear reltol=1e-4 abstol=1e-11 vntol=1e-6 chgtol=1e-16
* parameters: the operating point
.param f_clk_hz = 1e6
.param r_taxel_ohm = 1e3
* other taxels of the column and of the row, at full force; rows that are not driven are at v_undriven_v
.param other_column = 0
.param other_row = 0
.param v_ground_v = {supply_vdd_v}
.param v_undriven_v = {v_ground_v}
* amplifier: a quad of 10 MHz and 7 V/us, rail to rail; 6 pF and 40 ohm are typical of such parts
.param gbw_hz = 10e6
.param w_gbw = {6.283185307179586*gbw_hz}
.param slew_v_per_s = 7e6
.param gain_dc = 1e5
.param v_offset_v = 0
.param c_input_f = 6e-12
.param r_output_ohm = 40
* comparator: propagation delay at 10 mV of overdrive
.param t_delay_s = 100e-9
* charge pin of the FPGA: 12 mA driver, pin and track
.param r_pin_ohm = 19
.param c_pin_f = 10e-12
* reset switch across the capacitor, with its charge injection; row switch
.param r_reset_ohm = 5
.param c_injection_f = 1e-12
.param r_switch_ohm = {row_driver_r_on_ohm}
* values from the charge balance: the packet current is 2 v_bias / r_min, and a packet moves the integrator by packet_v
.param i_packet_a = {converter_i0_direct_a}
.param c_int_f = {i_packet_a/f_clk_hz/converter_packet_v}
.param r_charge_ohm = {v_ground_v/i_packet_a - r_pin_ohm}
.param t_clk = {1/f_clk_hz}
.param n_preset = 20
.param t_begin = {n_preset*t_clk + 3e-9}
.param t_end = {(n_preset + timing_gate_clocks + 2)*t_clk + 3e-9}
* stimulus: preset falls behind edge n_preset, as a flip-flop's output; the next edge takes the first decision
vground agnd 0 {v_ground_v}
vbias vb agnd {interface_v_bias_v}
vlevel v_level agnd {-0.5*converter_packet_v}
vundriven v_undriven 0 {v_undriven_v}
vclk clk 0 pulse(0 1 0 1n 1n {0.5*t_clk} {t_clk})
vpreset d_preset 0 pulse(1 0 {t_begin} 1n 1n 1 2)
* DUT: rows; a large resistor for no other taxels
rswitch vb row {r_switch_ohm}
rtaxel row col {r_taxel_ohm}
rrow row agnd {sensor_r_min_ohm/max(other_row, 1e-9)}
rcolumn v_undriven col {(sensor_r_min_ohm + r_switch_ohm)/max(other_column, 1e-9)}
ccolumn col agnd {array_c_column_f}
* amplifier: a transconductance that saturates at the slew rate into 1 nF, its swing within the supply
cinput col agnd {c_input_f}
voffset v_plus agnd {v_offset_v}
bgm 0 v_amp i = {slew_v_per_s*1e-9}*tanh({w_gbw/slew_v_per_s}*v(v_plus,col))
rgm v_amp 0 {gain_dc/(w_gbw*1e-9)}
cgm v_amp 0 1n
bswing v_amp 0 i = 0.1*(max(0, v(v_amp) - ({supply_vdd_v - 0.05})) + min(0, v(v_amp) - ({supply_vss_v + 0.05})))
eamp v_drive agnd v_amp 0 1
rout v_drive v_int {r_output_ohm}
* capacitor and its reset switch
cint v_int col {c_int_f} ic=0
estored v_stored 0 v_int col 1
sreset v_int col d_preset 0 reset
cinjection d_preset col {c_injection_f}
.model reset sw vt=0.5 vh=0.2 ron={r_reset_ohm} roff=1e9
* charge: an open drain through a resistor takes a packet out of the column
rcharge col pin {r_charge_ohm}
cpin pin 0 {c_pin_f}
scharge pin 0 d_charge 0 drain
.model drain sw vt=0.5 vh=0.2 ron={r_pin_ohm} roff=1e8
* comparator: high while the integrator is below its level
bcomp v_fast 0 v = 0.5 + 0.5*tanh(v(v_level,v_int)/0.2m)
tdelay v_fast 0 v_comp 0 z0=50 td={t_delay_s}
rdelay v_comp 0 50
* the core: a sample comp & ~sample & ~preset, and a flip-flop that drives the charge pin a clock later
abridge [v_comp clk d_preset] [comp clock preset] level
anot1 preset run not
asample [comp sample_n run] sample_d and
aflop1 sample_d clock low preset sample sample_n flop
aflop2 sample clock low preset charge charge_n flop
alow low pulldown
adrive [charge] [d_charge] drive
.model level adc_bridge(in_low=0.5 in_high=0.5 rise_delay=1n fall_delay=1n)
.model not d_inverter(rise_delay=1n fall_delay=1n)
.model and d_and(rise_delay=1n fall_delay=1n)
.model flop d_dff(clk_delay=1n set_delay=1n reset_delay=1n rise_delay=1n fall_delay=1n ic=0)
.model pulldown d_pulldown(load=1f)
.model drive dac_bridge(out_low=0 out_high=1 out_undef=0.5 t_rise=2n t_fall=2n)
* measure: pulses of the gate's decisions; what is left on the capacitor makes the count one with fractions
.tran {0.05*t_clk} {t_end + t_clk} 0 {0.1*t_clk}
.meas tran t_high integ v(d_charge) from={t_begin} to={t_end}
.meas tran pulses param='t_high*f_clk_hz'
.meas tran v_begin find v(v_stored) at={t_begin}
.meas tran v_left find v(v_stored) at={t_end}
.meas tran packets param='(pulses - (v_left - v_begin)/converter_packet_v)*timing_gate_clocks/(timing_gate_clocks + 2)'
.meas tran v_low min v(v_int) from={t_begin} to={t_end}
.meas tran v_high max v(v_int) from={t_begin} to={t_end}
* control
.control
run
quit
.endc
.end
