* SPDX-License-Identifier: Apache-2.0
* A run of phase_margin.sp. Fields: name of the load, its current and resistor, capacitance of the column.
alter ix dc = {i}
alter rx = {r}
alter cx = {c}
ac dec 40 1k 1g
let loop = v(x)/(1 - v(x))
let db = db(mag(loop))
let degrees = 57.29578*cph(loop)
meas ac {load}_{c} find degrees when db=0 fall=1
print {load}_{c}
