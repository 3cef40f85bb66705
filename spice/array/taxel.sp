* SPDX-License-Identifier: Apache-2.0
* Taxel: pressed sheet between row and inner electrode on the column; lateral paths to two neighbours.
* `right` is the inner electrode of the next column, `below` that of the next row (same line without trace resistance).
* Ideal: r_lateral_ohm = 1e18, which writes nothing. R = 0 is array_r_floor_ohm: ngspice silently makes 0 ohm 1 mohm.
.subckt taxel row inner right below
+ params: r_taxel_ohm={sensor_r_max_ohm} r_lateral_ohm={array_r_lateral_ohm}
.if (r_taxel_ohm < 1e17)
rtaxel row inner {max(r_taxel_ohm, array_r_floor_ohm)}
.endif
.if (r_lateral_ohm < 1e17)
rlat_right inner right {max(r_lateral_ohm, array_r_floor_ohm)}
rlat_below inner below {max(r_lateral_ohm, array_r_floor_ohm)}
.endif
.ends taxel
