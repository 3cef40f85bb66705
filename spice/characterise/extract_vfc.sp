* SPDX-License-Identifier: Apache-2.0
* Of dermis extract: integrator, comparator and charge source, their loop open, on two runs of packets. Fields: times of
* the packets, both currents, the bias line or the capacitance of a column, the converter, measures.
vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0 4.8u 0 4.801u 1 7u 1 7.001u 0)
vcharge logic_charge 0 pwl(0 0{charge})
iin 0 sum pwl(0 {fast} 4.9u {fast} 4.91u {slow})
{line}
xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {dut}
* Ten times finer than ngspice's own: a packet is a difference of levels, and 1e-3 of it is a quarter LSB.
.options reltol=1e-4
.tran 10n 13.5u
{meas}
