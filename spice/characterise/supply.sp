* SPDX-License-Identifier: Apache-2.0
* A channel with separate rails; the reference uses those of the deck. Field: the topology.
vpreset logic_preset 0 1
vcharge logic_charge 0 0
vchannel vdd vdd_c 0
vreturn vss_c vss 0
ix 0 col 0
xdut col d_charge d_preset comp vref agnd ibias vdd_c vss_c vdd_d vss_d channel_{topology}
.dc ix 0 1.01m 0.1m
.meas dc idle find i(vchannel) at=0
.meas dc pressed find i(vreturn) at=1m
.meas dc all find i(vdd) at=0
