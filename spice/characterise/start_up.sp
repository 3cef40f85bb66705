* SPDX-License-Identifier: Apache-2.0
* A bank of its own behind d_enable, which goes high at 1 us: its output feeds the line of a channel.
* Gear's formula, because trapezoids of 100 ns ring on the cascode's node of 2 ns without end.
xline ibias vdd vss bias_line
venable logic_enable 0 pwl(0 0 1u 0 1.01u 1)
rref_own r_own 0 50k
xbank vref r_own gate cp vdd vss bias
xenable d_enable gate vdd vss vdd_d vss_d power_down
xout gate cp ibias_own vdd bias_output
xline_own ibias_own vdd vss bias_line
xbias_cn_p ibias_own vbp_own vdd vss bias_p
xbias_cn vbp_own vcn_own vdd vss bias_cascode_n
xn v_unit ibias_own vss vss nmos_long k=5
xnc packet vcn_own v_unit vss nmos w=5 l=0.5 k=5
vpacket packet 0 0
.save i(vpacket)
* Gear damps the start; reltol of a tenth of what the settled current is judged to.
.options reltol=1e-4 method=gear
.tran 100n 201u
.meas tran off find i(vpacket) at=0.9u
.meas tran end find i(vpacket) at=200u
.meas tran low when i(vpacket)=-24.75u cross=last
