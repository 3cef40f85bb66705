* SPDX-License-Identifier: Apache-2.0
* Level shifter: d of the digital core (vss_d or vdd_d) becomes on and its complement off (vss or vdd).
.subckt level_shifter d on off vdd vss vdd_d vss_d
xnot d d_n vdd_d vss_d inverter_lv
xshift d d_n on off vdd vss level_shifter_pair
.ends level_shifter
* The same for what must be off while the digital supply is missing: then v_missing is high and holds on low.
.subckt level_shifter_low d on off vdd vss vdd_d vss_d
xlevel d on off vdd vss vdd_d vss_d level_shifter
xn_core v_missing vdd_d vss vss nmos w=5 l=0.5
xp_core v_missing vdd_d vdd vdd pmos w=0.5 l=20
xn_low on v_missing vss vss nmos w=5 l=0.5
.ends level_shifter_low
* The same with both edges of d equally late: d and its complement leave through two stages each, an inverter against
* a transmission gate that is always on.
.subckt level_shifter_matched d on off vdd vss vdd_d vss_d
xnot d d_n vdd_d vss_d inverter_lv k=4
xn_gate d_n vdd_d d_late vss_d nmos_lv w=4
xp_gate d_n vss_d d_late vdd_d pmos_lv w=8
xtrue d_n d_p vdd_d vss_d inverter_lv k=2
xshift d_p d_late on off vdd vss level_shifter_pair
.ends level_shifter_matched
* Cross-coupled pair: a gate of 1.8 V pulls against a pmos whose gate has 3.3 V, so the nmos are the wider ones.
.subckt level_shifter_pair d d_n on off vdd vss
xn_off off d vss vss nmos w=5 l=0.5 k=2
xn_on on d_n vss vss nmos w=5 l=0.5 k=2
xp_off off on vdd vdd pmos w=1.5 l=0.5
xp_on on off vdd vdd pmos w=1.5 l=0.5
.ends level_shifter_pair
* Back to the digital core: in swings between vss and vdd, out between vss_d and vdd_d.
.subckt level_down in out vdd_d vss_d
xfirst in in_n vdd_d vss_d vss_d inverter
xout in_n out vdd_d vss_d inverter_lv k=6
.ends level_down
