* SPDX-License-Identifier: Apache-2.0
* A channel with 1 kohm on its column: preset, integral, decision and one packet. Fields: the topology, pins of its ratio, the integrator.
xdut col d_charge d_preset {pins} comp vref agnd ibias vdd vss vdd_d vss_d channel_{topology}
vrow row 0 0.5
rtaxel row col 1k
ccol col 0 400p
v_preset logic_preset 0 pwl(0 1 20u 1 20.001u 0)
v_charge logic_charge 0 pwl(0 0 20.8u 0 20.801u 1 21u 1 21.001u 0)
.tran 10n 22u
.meas tran low_rail find v(vss) at=1u
.meas tran high_rail find v(vdd) at=1u
.meas tran low find v(comp) at=20.1u
.meas tran high find v(comp) at=20.75u
.meas tran fast_0 find v({integrator}) at=20.2u
.meas tran fast_1 find v({integrator}) at=20.6u
.meas tran before find v({integrator}) at=20.78u
.meas tran after find v({integrator}) at=21.18u
