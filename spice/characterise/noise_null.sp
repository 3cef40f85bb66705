* SPDX-License-Identifier: Apache-2.0
* The offset null, for noise.sp: the value that it stores when a gate begins, less the mean of the same noise over the
* gate: 1 - sinc exp(-j pi f T). Both are through the pole of the amplifier on 20 pF.
vpreset logic_preset 0 dc 1 ac 1
xdut 0 y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
eout out 0 xdut.v_in xdut.v_side 1
