* SPDX-License-Identifier: Apache-2.0
* One unit of the charge source: a cascoded n-channel device on the gate line of a channel.
xline ibias vdd vss bias_line
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xn v_unit ibias vss vss nmos_long
xnc out vcn v_unit vss nmos w=5 l=0.5
vx out 0 0
.dc vx 0 0.1 0.1
.meas dc i_unit find i(vx) at=0
