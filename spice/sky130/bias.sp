* SPDX-License-Identifier: Apache-2.0
* Reference: 10 uA = v(vref) / r_ref, an external resistor from pin r_ref to agnd; each output of the bank repeats it.
* A start current of 2 uA through a poly resistor feeds the amplifier; its spread of +-20 % changes only loop gain.
.subckt bias vref r_ref v_gate v_cp vdd vss
* amplifier: pair, mirror load, tail
xstart vdd v_start vss sky130_fd_pr__res_xhigh_po w=0.69 l=403
xn_start v_start v_start vss vss nmos w=5 l=4
xn_tail v_tail v_start vss vss nmos w=5 l=4 k=2
xn_ref v_gate vref v_tail vss nmos w=40 l=4
xn_sense v_load r_ref v_tail vss nmos w=40 l=4
xp_load v_load v_load vdd vdd pmos w=10 l=6
xp_gate v_gate v_load vdd vdd pmos w=10 l=6
* reference branch
xn_cp v_cp v_start vss vss nmos w=5 l=4
xp_cp v_cp v_cp vdd vdd pmos w=1 l=5
xr v_gate v_cp r_ref vdd bias_output
xc_gate vdd v_gate sky130_fd_pr__cap_mim_m3_1 w=28.75 l=28.75 m=12 mult=12
.ends bias
* One output of the bank: 10 uA into out, from gate and cascode line of the reference. Only a current leaves for a
* channel, so no voltage between reference and channel changes a packet.
.subckt bias_output v_gate v_cp out vdd
xp v_out v_gate vdd vdd pmos w=60 l=12 k=2
xpc out v_cp v_out vdd pmos w=20 l=1
.ends bias_output
* Power-down: while d_enable is low the gate line of the bank is at vdd, and no output has a current.
.subckt power_down d_enable v_gate vdd vss vdd_d vss_d
xlevel d_enable on off vdd vss vdd_d vss_d level_shifter
xp_off v_gate on vdd vdd pmos w=20 l=0.5
.ends power_down
* In a channel 10 uA into ibias make the gate line ibias: 5 uA for each cascoded nmos_long, and within 6 % for each nmos
* w=5 l=2 of the amplifiers. The device of the line has the drain voltage of the cascoded devices that follow it (1.5 %
* at ss without).
* A threshold's error is a larger share of a smaller overdrive, so what mismatch does to a packet changes with
* temperature: with units of w=5 l=2 in line and charge source, w=20 l=4 in the bank and a tenth of the area in the
* reference's amplifier, a column calibrated at 27 C was up to 4 codes off at -40 C (sky130.calibrated_drift).
.subckt bias_line ibias vdd vss
xn_line v_line ibias vss vss nmos_long k=2
xn_linec ibias vcn v_line vss nmos w=5 l=0.5 k=2
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xc_line ibias vss sky130_fd_pr__cap_mim_m3_1 w=28.8 l=28.8 m=3 mult=3
.ends bias_line
* Gate lines that a block derives from ibias: p for 10 uA in a pmos w=20 l=2, and those of its cascodes.
.subckt bias_p ibias vbp vdd vss
xn_b vbp ibias vss vss nmos w=5 l=2 k=2
xp_b vbp vbp vdd vdd pmos w=20 l=2
.ends bias_p
.subckt bias_cascode_p ibias vcp vdd vss
xn_b vcp ibias vss vss nmos w=5 l=2 k=2
xp_b vcp vcp vdd vdd pmos w=2 l=2
.ends bias_cascode_p
.subckt bias_cascode_n vbp vcn vdd vss
xp_b vcn vbp vdd vdd pmos w=20 l=2
xn_b vcn vcn vss vss nmos w=1 l=2
.ends bias_cascode_n
