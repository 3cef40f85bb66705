* SPDX-License-Identifier: Apache-2.0
* Conveyor and mirror over the current of a line.
* Fields: pins of the mirror, and `sweep` with its measures.
xline ibias vdd vss bias_line
vy y 0 0
ix 0 x 0
xconveyor y x z ibias vdd vss conveyor
xmirror z sum {mirror}
vsum sum 0 0
{sweep}
