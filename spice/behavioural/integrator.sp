* SPDX-License-Identifier: Apache-2.0
* Op-amp integrator with preset switch: current into iin pulls out down by q / c_int_f; a high d_preset holds out at vcm + v_preset_v.
* Defaults are the physical values of design.inc. Ideal: gain_dc = 1e12, t_gbw_s = 0, v_offset_v = 0, limits +-1e9, r_in_ohm = 1e18, r_preset_ohm = 0.
.subckt integrator iin vcm d_preset out vref ibias vdd vss vdd_d vss_d
+ params: c_int_f={converter_c_int_f} gain_dc={integrator_gain_dc} t_gbw_s={integrator_t_gbw_s}
+ v_offset_v={integrator_v_offset_v} v_out_max_v={integrator_v_out_max_v} v_out_min_v={integrator_v_out_min_v}
+ r_in_ohm={integrator_r_in_ohm} r_preset_ohm={integrator_r_preset_ohm} v_preset_v={integrator_v_preset_v}
cint iin out {c_int_f}
* The last stage is 1e9 S: the current in cint moves the virtual ground by i / 1e9 S (2 pV at 2 mA; with 1 S it would be 2 mV).
.param v_range = {min(v_out_max_v, -v_out_min_v)}
.if ((t_gbw_s > 0) || (v_range < 1e6))
* gain and pole: 1 S into gain_dc ohm and t_gbw_s farad has its unity gain at 1 / (2 pi t_gbw_s)
gamp v_amp vcm iin vcm 1
ramp v_amp vcm {gain_dc}
.if (t_gbw_s > 0)
camp v_amp vcm {t_gbw_s}
.endif
.if (abs(v_offset_v) > 0)
iofs vcm v_amp {v_offset_v}
.endif
gout out vcm v_amp vcm -1e9
rout out vcm 1e-9
.else
gamp out vcm iin vcm 1e9
ramp out vcm {1e-9*gain_dc}
.if (abs(v_offset_v) > 0)
iofs vcm out {1e9*v_offset_v}
.endif
.endif
.if (r_in_ohm < 1e17)
rin iin vcm {r_in_ohm}
.endif
.if (v_range < 1e6)
* Range: a clamp across cint takes the excess charge, so that the loop stays closed without wind-up. It senses the
* charge, the final value of out (times 1 + 1 / gain_dc, less the offset), and not out: a slow out overshoots the
* limit and swings back as far (32 codes at 1 MHz and +-0.6 V). c_int_f / 50 ps: the overshoot is the travel of out
* in 50 ps, 0.13 mV at full scale.
.param v_high = {v_out_max_v*(1 + 1/gain_dc) - v_offset_v} v_low = {v_out_min_v*(1 + 1/gain_dc) - v_offset_v}
bclamp out iin i = v(out,iin) > ({v_high}) ? (v(out,iin) - ({v_high}))*{c_int_f/50e-12} :
+ (v(out,iin) < ({v_low}) ? (v(out,iin) - ({v_low}))*{c_int_f/50e-12} : 0)
* The amplifier saturates 50 mV further out; only a stiff source at iin (a short in channel_direct) drives it there.
brange v_amp vcm i = v(v_amp) > ({v_out_max_v + 0.05}) ? (v(v_amp) - ({v_out_max_v + 0.05}))*1e3 :
+ (v(v_amp) < ({v_out_min_v - 0.05}) ? (v(v_amp) - ({v_out_min_v - 0.05}))*1e3 : 0)
.endif
* Preset: a conductance over the top 1/20 of d_preset. It ends with the start of the falling edge, so that the
* integral starts at the edge, and is then exactly 0. It closes over 50 ps: a jump of the charge stops ngspice
* ("timestep too small") at tight tolerances; for the same reason r_preset_ohm = 0 is a time constant of 1e-16 s.
* Not a switch in series with a source: with this conductance rounding of a branch current exceeds abstol.
* Newton's first guess of d_preset is 0, which leaves iin without a dc path (singular matrix) without the nodeset.
.nodeset v(d_preset)={supply_v_logic_v}
bpreset out iin i = v(d_preset,vss_d) > {0.95*supply_v_logic_v} ?
+ (v(d_preset,vss_d) - {0.95*supply_v_logic_v})*(v(out,iin) - ({v_preset_v}))*{20/max(r_preset_ohm, 1e-16/c_int_f)/supply_v_logic_v} : 0
.ends integrator
* The name that the opposite sign has in transistors; here it is in v_preset_v.
.subckt integrator_inverted iin vcm d_preset out vref ibias vdd vss vdd_d vss_d
+ params: c_int_f={converter_c_int_f} gain_dc={integrator_gain_dc} t_gbw_s={integrator_t_gbw_s}
+ v_offset_v={integrator_v_offset_v} v_out_max_v={integrator_v_out_max_v} v_out_min_v={integrator_v_out_min_v}
+ r_in_ohm={integrator_r_in_ohm} r_preset_ohm={integrator_r_preset_ohm} v_preset_v={integrator_v_preset_v}
xint iin vcm d_preset out vref ibias vdd vss vdd_d vss_d integrator
+ c_int_f={c_int_f} gain_dc={gain_dc} t_gbw_s={t_gbw_s} v_offset_v={v_offset_v} v_out_max_v={v_out_max_v}
+ v_out_min_v={v_out_min_v} r_in_ohm={r_in_ohm} r_preset_ohm={r_preset_ohm} v_preset_v={v_preset_v}
.ends integrator_inverted
