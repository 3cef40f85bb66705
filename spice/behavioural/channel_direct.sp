* SPDX-License-Identifier: Apache-2.0
* Direct interface (Fig. 3): the column is the summing node of the integrator; i0_a and c_int_f are k times larger.
* Defaults: ideal, converter_i0_direct_a and converter_c_direct_f; k, conv_, mir_ and out_ are accepted and unused.
.subckt channel_direct col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_direct_a} c_int_f={converter_c_direct_f} v_preset_v={integrator_v_preset_v} packet_error=0
+ int_gain_dc=1e12 int_t_gbw_s=0 int_v_offset_v=0 int_v_out_max_v=1e9 int_v_out_min_v=-1e9 int_r_in_ohm=1e18 int_r_preset_ohm=0
+ comp_gain_dc=1e9 comp_v_offset_v=0 comp_v_hysteresis_v=0 comp_t_delay_s=0
+ k={interface_k} conv_r_x_ohm=0 conv_v_offset_v=0 conv_t_pole_s=0 conv_r_z_ohm=1e18 conv_i_out_max_a=1e9 conv_gain_error=0
+ mir_ratio_error=0 mir_r_out_ohm=1e18 mir_t_pole_s=0
+ out_inv_i_range_a=0 out_q_lag_c=0
xvfc col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d vfc
+ i0_a={i0_a} c_int_f={c_int_f} v_preset_v={v_preset_v} packet_error={packet_error}
+ int_gain_dc={int_gain_dc} int_t_gbw_s={int_t_gbw_s} int_v_offset_v={int_v_offset_v} int_v_out_max_v={int_v_out_max_v}
+ int_v_out_min_v={int_v_out_min_v} int_r_in_ohm={int_r_in_ohm} int_r_preset_ohm={int_r_preset_ohm}
+ comp_gain_dc={comp_gain_dc} comp_v_offset_v={comp_v_offset_v} comp_v_hysteresis_v={comp_v_hysteresis_v} comp_t_delay_s={comp_t_delay_s}
.ends channel_direct
