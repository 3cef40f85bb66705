* SPDX-License-Identifier: Apache-2.0
* A column of 16 taxels of 500 ohm, one of them driven. 3 mV in series with y stand for the conveyor, so that there is
* something to null where mismatch draws nothing; the first gate finds y, the second is as all others.
xline ibias vdd vss bias_line
vpreset logic_preset 0 pwl(0 1 5u 1 5.001u 0 45u 0 45.001u 1 68u 1 68.001u 0)
vrow row 0 0.5
rrow row x 500
rheld x 0 33.333
cx x 0 400p
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
voffset y y_off 0.003
xconveyor y_off x z ibias vdd vss conveyor
vz z 0 -0.6
.save v(x) v(y)
.tran 50n 101u
.meas tran raw find v(x) at=4.9u
.meas tran first find v(x) at=44u
.meas tran held find v(x) at=67.9u
.meas tran second find v(x) at=100u
