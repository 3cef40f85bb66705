* SPDX-License-Identifier: Apache-2.0
* Loop of the conveyor: its amplifier amplifies y - x alone, so the loop gain is v(x) / (v(y) - v(x)).
* Field: `runs`, one for each load and capacitance of the column.
xline ibias vdd vss bias_line
vy y 0 dc 0 ac 1
ix 0 x 0
rx x 0 1g
cx x 0 2p
xconveyor y x z ibias vdd vss conveyor
vz z 0 -0.6
.control
{runs}quit
.endc
