* SPDX-License-Identifier: Apache-2.0
* Row driver: row on vbias if d_row is high, on agnd if low; about 1 ohm, with the gates on both supplies.
* Each gate has an inverter that opens its switch faster than it closes: vbias and agnd are not joined on the way.
.subckt row_driver d_row row vbias agnd vdd vss vdd_d vss_d
xlevel d_row on off vdd vss vdd_d vss_d level_shifter
xbias on off bias_on bias_off vdd vss row_gates
xground off on ground_on ground_off vdd vss row_gates
xs_bias row vbias bias_on bias_off vdd vss row_switch
xs_ground row agnd ground_on ground_off vdd vss row_switch
.ends row_driver
* on and off of a switch from their small complements.
.subckt row_gates on off gate_on gate_off vdd vss
xn_on gate_on off vss vss nmos w=50 l=0.5 k=4
xp_on gate_on off vdd vdd pmos w=50 l=0.5
xn_off gate_off on vss vss nmos w=25 l=0.5
xp_off gate_off on vdd vdd pmos w=100 l=0.5 k=4
.ends row_gates
.subckt row_switch a b on off vdd vss
xn a on b vss nmos w=100 l=0.5 k=100
xp a off b vdd pmos w=100 l=0.5 k=150
.ends row_switch
