* SPDX-License-Identifier: Apache-2.0
* The amplifier closed on itself.
xline ibias vdd vss bias_line
xdut 0 out out ibias vdd vss ota
vx x 0 0
.dc vx 0 1 1
.meas dc offset find v(out) at=0
