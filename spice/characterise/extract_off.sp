* SPDX-License-Identifier: Apache-2.0
* Of dermis extract: a charge source that is off, its node moved. Field: by how much.
xline ibias vdd vss bias_line
vs s 0 0
vd logic_charge 0 0
xcharge d_charge out ibias vdd vss vdd_d vss_d charge_source units=400
vout out s 0
.dc vs -{lift_v} {lift_v} {lift_v}
.meas dc low find i(vout) at=-{lift_v}
.meas dc none find i(vout) at=0
.meas dc high find i(vout) at={lift_v}
