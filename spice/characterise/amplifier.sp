* SPDX-License-Identifier: Apache-2.0
* The amplifier on 3 pF, closed at direct current by 1 Gohm and 1 kF.
xline ibias vdd vss bias_line
xdut inp inn out ibias vdd vss ota
vin inp 0 dc 0 ac 1
lback out inn 1e9
cback inn 0 1e3
cload out 0 3p
.save v(out)
.ac dec 40 1 1g
.meas ac gain_db find vdb(out) at=1
.meas ac gbw_hz when vdb(out)=0
.meas ac phase_rad find vp(out) when vdb(out)=0
