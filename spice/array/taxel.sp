* SPDX-License-Identifier: Apache-2.0
* Taxel: the pressed sheet between a row and its inner electrode on the column, and the sheet's lateral paths to the next two inner electrodes.
* `right` is the inner electrode of the next column, `below` that of the next row (the same line where a column has no trace resistance).
* Ideal: r_lateral_ohm = 1e18, which writes nothing. R = 0 is array_r_floor_ohm: a resistor of 0 becomes 1 mohm in ngspice without a word.
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
