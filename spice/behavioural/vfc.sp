* SPDX-License-Identifier: Apache-2.0
* The analog half of the synchronized converter: integrator, comparator and charge source; the flip-flops are in rtl/.
* polarity = 1: iin pulls v_int down from +v_preset_v, comp is high where v_int <= 0, a packet is drawn from iin. -1: all opposite (Fig. 5b).
* polarity is for blocks in transistors; behavioural blocks have it in the sign of their values.
* Defaults are the ideal converter with the packet of design.inc.
.subckt vfc iin d_charge d_preset comp ibias vdd vss
+ params: i0_a={converter_i0_a} c_int_f={converter_c_int_f} v_preset_v={integrator_v_preset_v} packet_error=0
+ int_gain_dc=1e12 int_t_gbw_s=0 int_v_offset_v=0 int_v_out_max_v=1e9 int_v_out_min_v=-1e9 int_r_in_ohm=1e18 int_r_preset_ohm=0
+ comp_gain_dc=1e9 comp_v_offset_v=0 comp_v_hysteresis_v=0 comp_t_delay_s=0
+ polarity=1
xintegrator iin 0 d_preset v_int ibias vdd vss integrator polarity={polarity}
+ c_int_f={c_int_f} v_preset_v={polarity*v_preset_v} gain_dc={int_gain_dc} t_gbw_s={int_t_gbw_s} v_offset_v={int_v_offset_v}
+ v_out_max_v={int_v_out_max_v} v_out_min_v={int_v_out_min_v} r_in_ohm={int_r_in_ohm} r_preset_ohm={int_r_preset_ohm}
xcharge d_charge iin ibias vdd vss charge_source polarity={polarity}
+ i0_a={polarity*i0_a} packet_error={packet_error}
.if (polarity > 0)
xcomparator 0 v_int comp ibias vdd vss comparator
+ gain_dc={comp_gain_dc} v_offset_v={comp_v_offset_v} v_hysteresis_v={comp_v_hysteresis_v} t_delay_s={comp_t_delay_s}
.else
xcomparator v_int 0 comp ibias vdd vss comparator
+ gain_dc={comp_gain_dc} v_offset_v={comp_v_offset_v} v_hysteresis_v={comp_v_hysteresis_v} t_delay_s={comp_t_delay_s}
.endif
.ends vfc
