* SPDX-License-Identifier: Apache-2.0
* Of dermis extract: the column as the channel holds it, offset null included, over slots of the chip. Fields: times of
* a slot, steps of the current, conveyor and mirror, measures.
xline ibias vdd vss bias_line
vpreset logic_preset 0 pulse(1 0 {preset_s!r} 1n 1n {gate_s!r} {slot_s!r})
ix 0 x pwl({steps})
ccolumn x 0 400p
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
{copy}
vsum sum 0 0
.tran 100n {end_s!r}
{meas}
