* SPDX-License-Identifier: Apache-2.0
* A level that moves by 10 mV moves where a count begins by 0.01 packet: half a millivolt is fine enough a step.
xline ibias vdd vss bias_line
vin inn 0 0
xdut 0 inn out ibias vdd vss comparator
.dc vin -50m 50m 0.5m
.meas dc offset when v(out)=0
