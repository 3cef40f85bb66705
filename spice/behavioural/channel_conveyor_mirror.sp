* SPDX-License-Identifier: Apache-2.0
* Conveyor and asymmetrical mirror (Fig. 5a): the mirror sources 1/k of the column current into the integrator.
* Defaults: ideal, values of design.inc. Prefix of a parameter: its block (int_, comp_, conv_, mir_; out_ divides by k).
.subckt channel_conveyor_mirror col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_a} c_int_f={converter_c_int_f} v_preset_v={integrator_v_preset_v} packet_error=0
+ int_gain_dc=1e12 int_t_gbw_s=0 int_v_offset_v=0 int_v_out_max_v=1e9 int_v_out_min_v=-1e9 int_r_in_ohm=1e18 int_r_preset_ohm=0
+ comp_gain_dc=1e9 comp_v_offset_v=0 comp_v_hysteresis_v=0 comp_t_delay_s=0
+ k={interface_k} conv_r_x_ohm=0 conv_v_offset_v=0 conv_t_pole_s=0 conv_r_z_ohm=1e18 conv_i_out_max_a=1e9 conv_gain_error=0
+ mir_ratio_error=0 mir_r_out_ohm=1e18 mir_t_pole_s=0
+ out_inv_i_range_a=0 out_q_lag_c=0
xconveyor 0 col v_z ibias vdd vss conveyor
+ r_x_ohm={conv_r_x_ohm} v_offset_v={conv_v_offset_v} t_pole_s={conv_t_pole_s} r_z_ohm={conv_r_z_ohm}
+ i_out_max_a={conv_i_out_max_a} gain_error={conv_gain_error}
xmirror v_z v_sum vss_d vss_d ibias vdd vss vdd_d vss_d mirror polarity=1
+ k={k} ratio_error={mir_ratio_error} r_out_ohm={mir_r_out_ohm} t_pole_s={mir_t_pole_s}
+ inv_i_range_a={out_inv_i_range_a} q_lag_c={out_q_lag_c} i_ref_a={i0_a}
xvfc v_sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d vfc
+ i0_a={i0_a} c_int_f={c_int_f} v_preset_v={v_preset_v} packet_error={packet_error}
+ int_gain_dc={int_gain_dc} int_t_gbw_s={int_t_gbw_s} int_v_offset_v={int_v_offset_v} int_v_out_max_v={int_v_out_max_v}
+ int_v_out_min_v={int_v_out_min_v} int_r_in_ohm={int_r_in_ohm} int_r_preset_ohm={int_r_preset_ohm}
+ comp_gain_dc={comp_gain_dc} comp_v_offset_v={comp_v_offset_v} comp_v_hysteresis_v={comp_v_hysteresis_v} comp_t_delay_s={comp_t_delay_s}
.ends channel_conveyor_mirror
