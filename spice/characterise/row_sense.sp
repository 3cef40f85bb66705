* SPDX-License-Identifier: Apache-2.0
* The row voltage above which a row counts as driven, between agnd and the bias.
xline ibias vdd vss bias_line
vhalf v_half 0 0.25
vrow row 0 0
xdut row d_sense v_half ibias vdd vss vdd_d vss_d row_sense
esense sense 0 d_sense vss_d 1
.dc vrow 0 0.5 1m
.meas dc level when v(sense)=0.9 rise=1
