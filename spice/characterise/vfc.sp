* SPDX-License-Identifier: Apache-2.0
* A charge of 1 us into 5 pF, then a packet: slopes and steps of the integrator are the currents, its first value the
* preset. Fields: the current, the converter.
vpreset logic_preset 0 pwl(0 1 1u 1 1.001u 0)
vcharge logic_charge 0 pwl(0 0 2u 0 2.001u 1 2.2u 1 2.201u 0)
iin 0 sum {i_in}
xdut sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d {dut}
.tran 10n 3.2u
.meas tran v_0 find v(xdut.v_int) at=1.1u
.meas tran v_1 find v(xdut.v_int) at=1.9u
.meas tran v_2 find v(xdut.v_int) at=2.3u
.meas tran v_3 find v(xdut.v_int) at=3.1u
.meas tran comp_0 find v(comp) at=0.9u
.meas tran comp_1 find v(comp) at=1.95u
.meas tran comp_2 find v(comp) at=3.1u
