* SPDX-License-Identifier: Apache-2.0
* Three packets in the rhythm of x = 1/2, then one in that of x = 1/10, the input current with them: what the integrator
* gains over whole periods is the packet less the input's charge. Fields: the sign of the current, the converter.
xline ibias vdd vss bias_line
vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0)
vcharge logic_charge 0 pwl(0 0 1.1u 0 1.101u 1 1.3u 1 1.301u 0 1.5u 0 1.501u 1 1.7u 1 1.701u 0
+ 1.9u 0 1.901u 1 2.1u 1 2.101u 0 2.3u 0 2.301u 1 2.5u 1 2.501u 0
+ 3.2u 0 3.201u 1 3.4u 1 3.401u 0 5.2u 0 5.201u 1 5.4u 1 5.401u 0)
iin 0 sum pwl(0 {sign}12.5u 2.7u {sign}12.5u 2.701u {sign}2.5u)
xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {dut}
.tran 10n 7.2u
.meas tran dense_0 find v(xdut.v_int) at=1.49u
.meas tran dense_1 find v(xdut.v_int) at=2.69u
.meas tran sparse_0 find v(xdut.v_int) at=5.19u
.meas tran sparse_1 find v(xdut.v_int) at=7.19u
