* SPDX-License-Identifier: Apache-2.0
* Impedance at the column at 1 mA, with its 400 pF and without the offset null.
xline ibias vdd vss bias_line
vy y 0 0
ix 0 x dc 1m ac 1
xconveyor y x z ibias vdd vss conveyor
cx x 0 400p
vz z 0 -0.6
.save v(x)
.ac dec 20 100 11meg
.meas ac r100 find vm(x) at=100
.meas ac r1000 find vm(x) at=1000
.meas ac r10000 find vm(x) at=10000
.meas ac r100000 find vm(x) at=100000
.meas ac r1000000 find vm(x) at=1000000
.meas ac r10000000 find vm(x) at=10000000
