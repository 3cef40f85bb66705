* SPDX-License-Identifier: Apache-2.0
* Row driver: row on vbias if d_row is high, on agnd if low; about 1 ohm, with the gates on both supplies.
* A switch closes when both gates of the other one have let go, so vbias and agnd are never joined: not at a change of
* rows, nor while supplies come up. Without the digital supply the row is on agnd.
.subckt row_driver d_row row vbias agnd vdd vss vdd_d vss_d
xlevel d_row on off vdd vss vdd_d vss_d level_shifter_low
xmay_bias on ground_on ground_off bias_p bias_n vdd vss row_interlock
xmay_ground off bias_on bias_off ground_p ground_n vdd vss row_interlock
xbias bias_p bias_n bias_on bias_off vdd vss row_gates
xground ground_p ground_n ground_on ground_off vdd vss row_gates
xs_bias row vbias bias_on bias_off vdd vss row_switch
xs_ground row agnd ground_on ground_off vdd vss row_switch
.ends row_driver
* close is high, and open low, if a switch is wanted and both gates of the other one have let go.
.subckt row_interlock wanted other_on other_off close open vdd vss
xnot other_on other vdd vss vss inverter
xn_other open other v_wanted vss nmos w=12 l=0.5
xn_wanted v_wanted wanted v_off vss nmos w=12 l=0.5
xn_off v_off other_off vss vss nmos w=12 l=0.5
xp_wanted open wanted vdd vdd pmos w=16 l=0.5
xp_other open other vdd vdd pmos w=16 l=0.5
xp_off open other_off vdd vdd pmos w=16 l=0.5
xclose open close vdd vss vss inverter k=2
.ends row_interlock
* Gates of a switch; they open it faster than they close it.
.subckt row_gates close open gate_on gate_off vdd vss
xn_on gate_on open vss vss nmos w=50 l=0.5 k=4
xp_on gate_on open vdd vdd pmos w=50 l=0.5
xn_off gate_off close vss vss nmos w=25 l=0.5
xp_off gate_off close vdd vdd pmos w=100 l=0.5 k=4
.ends row_gates
.subckt row_switch a b on off vdd vss
xn a on b vss nmos w=100 l=0.5 k=100
xp a off b vdd pmos w=100 l=0.5 k=150
.ends row_switch
