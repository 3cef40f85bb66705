* SPDX-License-Identifier: Apache-2.0
* Conveyor and mirror with a taxel and its current, for noise.sp. No other taxel is pressed: where 32 mS turn the
* conveyor's noise into current, the offset null holds the column, and its noise takes the place of the conveyor's
* below 80 kHz, above which a gate averages. Fields: ratio, current and resistance of the taxel.
vsum sum 0 0
hout out 0 vsum 1
ix 0 x dc {i} ac 1
rx x 0 {r}
cx x 0 400p
xesd x vdd vss esd_pad
vy y 0 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum ibias vdd vss mirror_fixed k={k}
