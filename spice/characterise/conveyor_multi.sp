* SPDX-License-Identifier: Apache-2.0
* The conveyor with two outputs over the current of a line. Field: the measures of both.
xline ibias vdd vss bias_line
vy y 0 0
ix 0 x 0
xconveyor y x zp zn ibias vdd vss conveyor_multi
vzp zp 0 0
vzn 0 zn 0
.dc ix 0 1.01m 0.1m
{measures}
