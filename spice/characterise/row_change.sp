* SPDX-License-Identifier: Apache-2.0
* A row of 16 taxels of 500 ohm and 100 pF is driven and let go. `through` is what flows from the bias to agnd at once.
vb vb 0 0.5
vground ground 0 0
vrow logic_row 0 pwl(0 0 100n 0 101n 1 600n 1 601n 0)
xdut d_row row vb ground vdd vss vdd_d vss_d row_driver
rl row 0 31.25
cl row 0 100p
bthrough through 0 v=min(max(-i(vb),0),max(i(vground),0))
.save i(vb) v(row) v(through)
.tran 0.1n 1100n
.meas tran lowest min i(vb)
.meas tran through max v(through)
.meas tran up when v(row)=0.25 rise=1
.meas tran down when v(row)=0.25 fall=1
