* SPDX-License-Identifier: Apache-2.0
* Charge source: out sinks 25 uA while d_charge is 1 V (polarity = -1: sources); else the current goes to ground.
* units: of 5 uA. A swing of 1 V steers the pair, which keeps its tail quiet and its charge small; for the pmos pair
* it is 0.4 V lower, because their thresholds leave less headroom.
.subckt charge_source d_charge out ibias vdd vss params: polarity=1 units=5
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
.if (polarity > 0)
xlevel d_charge on off logic_level swing_v=1
xn_source v_source ibias vss vss nmos w=5 l=2 k={units}
xn_casc v_tail vcn v_source vss nmos w=5 l=0.5 k={units}
xn_on out on v_tail vss nmos w=5 l=0.5 k={units}
xn_off 0 off v_tail vss nmos w=5 l=0.5 k={units}
.else
xlevel d_charge on off logic_level swing_v=1 center_v=-0.4
xbias_cp ibias vcp vdd vss bias_cascode_p
* A separate gate line from as many units as it feeds, because their mismatch adds: mirrors match at one width and one
* drain voltage. Without the two cascodes the unit has 1.4 V at ss, the source 0.5 V, and the packet is 5 % too small.
xn_unit v_nunit ibias vss vss nmos w=5 l=2 k={units}
xn_unitc vbu vcn v_nunit vss nmos w=5 l=0.5 k={units}
xp_unit v_punit vbu vdd vdd pmos w=10 l=2 k={units}
xp_unitc vbu vcp v_punit vdd pmos w=10 l=0.5 k={units}
xp_source v_source vbu vdd vdd pmos w=10 l=2 k={units}
xp_casc v_tail vcp v_source vdd pmos w=10 l=0.5 k={units}
xp_on out off v_tail vdd pmos w=40 l=0.5 k={units}
xp_off 0 on v_tail vdd pmos w=40 l=0.5 k={units}
.endif
.ends charge_source
