* SPDX-License-Identifier: Apache-2.0
* Row driver: row on vbias if d_row is 1 V, on vss_ref if 0 V; about 1 ohm, with the gates on both supplies.
.subckt row_driver d_row row vbias vss_ref vdd vss
xlevel d_row on off logic_level
xs_bias row vbias on off vdd vss row_switch
xs_ground row vss_ref off on vdd vss row_switch
.ends row_driver
.subckt row_switch a b on off vdd vss
xn a on b vss nmos w=100 l=0.5 k=60
xp a off b vdd pmos w=100 l=0.5 k=100
.ends row_switch
