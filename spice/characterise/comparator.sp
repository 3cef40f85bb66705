* SPDX-License-Identifier: Apache-2.0
* A ramp of 0.5 V a clock passes the other input after 140 ns; an offset of 1 mV is 0.4 ns of it.
xline ibias vdd vss bias_line
vin inn 0 pwl(0 0.1 100n 0.1 300n -0.4)
xdut 0 inn out ibias vdd vss comparator
cout out 0 50f
.tran 2n 1.2u
.meas tran late when v(out)=0 rise=1
