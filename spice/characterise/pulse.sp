* SPDX-License-Identifier: Apache-2.0
* One pulse of a charge source, with the edges of the core's last flop: it lasts from where the gates of the pair
* cross to where they cross again. Field: the source.
xline ibias vdd vss bias_line
vcharge logic_charge 0 pwl(0 0 50n 0 50.2n 1 250n 1 250.2n 0)
xdut d_charge out ibias vdd vss vdd_d vss_d {source}
vout out 0 0
* The charge of a pulse is a difference of areas: reltol 1e-3 moves it by a part of 1e-3.
.options reltol=1e-4
.tran 0.05n 270n 0 0.5n
.meas tran rise when v(xdut.on)=v(xdut.off) rise=1
.meas tran fall when v(xdut.on)=v(xdut.off) fall=1
