* SPDX-License-Identifier: Apache-2.0
* Two taxels at the ends of the range, the other 14 pressed. The second slot begins at 45 us; its gate 115 clocks later,
* 14.375 us at 8 MHz and 23 us at 5 MHz. Its count is the integral of the current over its gate.
* Fields: voltage of the row of 500 ohm and of that of 64.25 kohm in the first slot; they change places.
xline ibias vdd vss bias_line
vpreset logic_preset 0 pwl(0 1 5u 1 5.001u 0 45u 0 45.001u 1 59.375u 1 59.376u 0)
vone one 0 pwl(0 {one} 45u {one} 45.001u 0 45.2u 0 45.201u {other})
vother other 0 pwl(0 {other} 45u {other} 45.001u 0 45.2u 0 45.201u {one})
rone one x 500
rother other x 64.25k
rheld x 0 35.714
cx x 0 400p
xesd x vdd vss esd_pad
xnull x y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor y x z ibias vdd vss conveyor
xmirror z sum ibias vdd vss mirror_fixed k=80
vsum sum 0 0
.save i(vsum) v(x) v(y)
.tran 50n 171u
.meas tran i_end find i(vsum) at=170.9u
.meas tran fast integ i(vsum) from=59.375u to=123.125u
.meas tran slow integ i(vsum) from=68u to=170u
.meas tran x1000 find v(x) at=46200n
.meas tran x2000 find v(x) at=47200n
.meas tran x3000 find v(x) at=48200n
.meas tran x5000 find v(x) at=50200n
.meas tran x8000 find v(x) at=53200n
.meas tran x11000 find v(x) at=56200n
.meas tran x14000 find v(x) at=59200n
