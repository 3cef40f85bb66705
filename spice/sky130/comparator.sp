* SPDX-License-Identifier: Apache-2.0
* Comparator: out = vdd where v(inp) > v(inn), else vss: a folded-cascode amplifier of half the integrator's current and two inverters.
.subckt comparator inp inn out ibias vdd vss
xamp inp inn v_amp ibias vdd vss ota pairs=4 branches=3
xn_first v_first v_amp vss vss nmos w=1.5 l=0.5
xp_first v_first v_amp vdd vdd pmos w=4 l=0.5
xn_out out v_first vss vss nmos w=5 l=0.5
xp_out out v_first vdd vdd pmos w=12 l=0.5
.ends comparator
