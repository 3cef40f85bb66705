* SPDX-License-Identifier: Apache-2.0
* Row sense: d_sense is high where row is above v_half, half of the bias of the rows.
.subckt row_sense row d_sense v_half ibias vdd vss vdd_d vss_d
xn_tail v_tail ibias vss vss nmos w=5 l=2
xn_row v_load row v_tail vss nmos w=20 l=1
xn_half v_pair v_half v_tail vss nmos w=20 l=1
xp_load v_load v_load vdd vdd pmos w=10 l=1
xp_pair v_pair v_load vdd vdd pmos w=10 l=1
xp_first v_first v_pair vdd vdd pmos w=10 l=1
xn_first v_first ibias vss vss nmos w=5 l=2
* Without bias v_first would be where leaks put it, and the inverter may take 80 uA there.
xr_off v_first vss vss sky130_fd_pr__res_xhigh_po w=0.69 l=403
xnot v_first v_full vdd vss vss inverter
xdown v_full d_sense vdd_d vss_d level_down
.ends row_sense
