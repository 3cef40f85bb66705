* SPDX-License-Identifier: Apache-2.0
* The analog half of the synchronized converter: integrator, comparator and charge source; the flip-flops are in rtl/.
* iin pulls v_int down from +v_preset_v, comp is high where v_int <= 0, a packet is drawn from iin.
* Defaults are the ideal converter with the packet of design.inc.
.subckt vfc iin d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_a} c_int_f={converter_c_int_f} v_preset_v={integrator_v_preset_v} packet_error=0
+ int_gain_dc=1e12 int_t_gbw_s=0 int_v_offset_v=0 int_v_out_max_v=1e9 int_v_out_min_v=-1e9 int_r_in_ohm=1e18 int_r_preset_ohm=0
+ comp_gain_dc=1e9 comp_v_offset_v=0 comp_v_hysteresis_v=0 comp_t_delay_s=0
xintegrator iin agnd d_preset v_int vref ibias vdd vss vdd_d vss_d integrator
+ c_int_f={c_int_f} v_preset_v={v_preset_v} gain_dc={int_gain_dc} t_gbw_s={int_t_gbw_s} v_offset_v={int_v_offset_v}
+ v_out_max_v={int_v_out_max_v} v_out_min_v={int_v_out_min_v} r_in_ohm={int_r_in_ohm} r_preset_ohm={int_r_preset_ohm}
xcharge d_charge iin ibias vdd vss vdd_d vss_d charge_source
+ i0_a={i0_a} packet_error={packet_error}
xcomparator agnd v_int comp ibias vdd vss comparator
+ gain_dc={comp_gain_dc} v_offset_v={comp_v_offset_v} v_hysteresis_v={comp_v_hysteresis_v} t_delay_s={comp_t_delay_s}
.ends vfc
* All signs opposite (Fig. 5b).
.subckt vfc_inverted iin d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_a} c_int_f={converter_c_int_f} v_preset_v={integrator_v_preset_v} packet_error=0
+ int_gain_dc=1e12 int_t_gbw_s=0 int_v_offset_v=0 int_v_out_max_v=1e9 int_v_out_min_v=-1e9 int_r_in_ohm=1e18 int_r_preset_ohm=0
+ comp_gain_dc=1e9 comp_v_offset_v=0 comp_v_hysteresis_v=0 comp_t_delay_s=0
xintegrator iin agnd d_preset v_int vref ibias vdd vss vdd_d vss_d integrator_inverted
+ c_int_f={c_int_f} v_preset_v={-v_preset_v} gain_dc={int_gain_dc} t_gbw_s={int_t_gbw_s} v_offset_v={int_v_offset_v}
+ v_out_max_v={int_v_out_max_v} v_out_min_v={int_v_out_min_v} r_in_ohm={int_r_in_ohm} r_preset_ohm={int_r_preset_ohm}
xcharge d_charge iin ibias vdd vss vdd_d vss_d charge_source_inverted
+ i0_a={-i0_a} packet_error={packet_error}
xcomparator v_int agnd comp ibias vdd vss comparator
+ gain_dc={comp_gain_dc} v_offset_v={comp_v_offset_v} v_hysteresis_v={comp_v_hysteresis_v} t_delay_s={comp_t_delay_s}
.ends vfc_inverted
