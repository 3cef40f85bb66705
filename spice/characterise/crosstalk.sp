* SPDX-License-Identifier: Apache-2.0
* Sixteen columns at direct current, each with a bias current of its own. Column 0 has a taxel of 1 kohm and 14 of 500
* ohm on held rows; the other 15 go from 0 to 1 mA. The charge sources are on. All share one resistor in each return, or
* in the mid rail; rows, vbias and the reference are at the pads. The offset null, which has no direct path, is left
* out: it takes away what moves the column. Fields: both resistors, and the other columns.
rvss vss_c vss {return_ohm}
rvdd vdd_c vdd {return_ohm}
ragnd agnd_c agnd {mid_rail_ohm}
vs s 0 0
vhold logic_hold 0 1
vcharge logic_charge 0 1
vrow row 0 0.5
rrow row col 1k
rheld col 0 35.714285714285715
xline ibias vdd_c vss_c bias_line
xconveyor agnd_c col z ibias vdd_c vss_c conveyor
xmirror z out ibias vdd_c vss_c mirror_fixed
vout out sum 0
xcharge d_charge packet ibias vdd_c vss_c vdd_d vss_d charge_source
vpacket packet sum 0
xintegrator sum agnd_c d_hold v_int vref ibias vdd_c vss_c vdd_d vss_d integrator
{others}
.dc vs 0 1 0.25
.meas dc out_idle find i(vout) at=0
.meas dc out_pressed find i(vout) at=1
.meas dc packet_idle find i(vpacket) at=0
.meas dc packet_pressed find i(vpacket) at=1
