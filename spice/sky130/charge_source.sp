* SPDX-License-Identifier: Apache-2.0
* Charge source: out sinks 25 uA while d_charge is high; else the current comes from vdd, so that vdd carries it always
* and agnd never.
* units: of 5 uA. A swing of 1 V steers the pair, which keeps its tail quiet and its charge small. The levels of its gates
* are as strong as the gates are large: with one divider for 400 units they sank with every packet, by 9 codes at 240.
.subckt charge_source d_charge out ibias vdd vss vdd_d vss_d params: units=5
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xr_high vdd v_high vss sky130_fd_pr__res_xhigh_po w=0.69 l=97.5 m={units/5} mult={units/5}
xr_swing v_high v_low vss sky130_fd_pr__res_xhigh_po w=0.69 l=84 m={units/5} mult={units/5}
xr_low v_low vss vss sky130_fd_pr__res_xhigh_po w=0.69 l=97.5 m={units/5} mult={units/5}
xsteer d_charge on off v_high v_low vdd vss vdd_d vss_d steering_driver units={units}
xn_source v_source ibias vss vss nmos_long k={units}
xn_casc v_tail vcn v_source vss nmos w=5 l=0.5 k={units}
xn_on out on v_tail vss nmos w=5 l=0.5 k={units}
xn_off v_dump off v_tail vss nmos w=5 l=0.5 k={units}
xn_dump vdd vdd v_dump vss nmos w=5 l=0.5 k={units}
.ends charge_source
* The opposite sign: out sources 25 uA, else vss takes them. The swing is 0.4 V lower, because the thresholds of the
* pmos pair leave less headroom.
.subckt charge_source_inverted d_charge out ibias vdd vss vdd_d vss_d params: units=5
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xbias_cp ibias vcp vdd vss bias_cascode_p
xr_high vdd v_high vss sky130_fd_pr__res_xhigh_po w=0.69 l=131 m={units/5} mult={units/5}
xr_swing v_high v_low vss sky130_fd_pr__res_xhigh_po w=0.69 l=84 m={units/5} mult={units/5}
xr_low v_low vss vss sky130_fd_pr__res_xhigh_po w=0.69 l=63.8 m={units/5} mult={units/5}
xsteer d_charge on off v_high v_low vdd vss vdd_d vss_d steering_driver units={units}
* A separate gate line from as many units as it feeds, because their mismatch adds: mirrors match at one width and one
* drain voltage. Without the two cascodes the unit has 1.4 V at ss, the source 0.5 V, and the packet is 5 % too small.
xn_unit v_nunit ibias vss vss nmos_long k={units}
xn_unitc vbu vcn v_nunit vss nmos w=5 l=0.5 k={units}
xp_unit v_punit vbu vdd vdd pmos w=40 l=8 k={units}
xp_unitc vbu vcp v_punit vdd pmos w=10 l=0.5 k={units}
xp_source v_source vbu vdd vdd pmos w=40 l=8 k={units}
xp_casc v_tail vcp v_source vdd pmos w=10 l=0.5 k={units}
xp_on out off v_tail vdd pmos w=40 l=0.5 k={units}
xp_off v_dump on v_tail vdd pmos w=40 l=0.5 k={units}
xp_dump vss vss v_dump vdd pmos w=10 l=0.5 k={units}
.ends charge_source_inverted
* Gates of the pair: d_charge as on and off between v_high and v_low, both edges equally late. The plates hold the
* two levels through an edge.
.subckt steering_driver d_charge on off v_high v_low vdd vss vdd_d vss_d params: units=5
xlevel d_charge full_on full_off vdd vss vdd_d vss_d level_shifter_matched
xon full_off on v_high v_low vss inverter k={units/5}
xoff full_on off v_high v_low vss inverter k={units/5}
xc_high v_high vss sky130_fd_pr__cap_mim_m3_1 w=30 l=30 m={units/5} mult={units/5}
xc_low v_low vss sky130_fd_pr__cap_mim_m3_1 w=30 l=30 m={units/5} mult={units/5}
.ends steering_driver
