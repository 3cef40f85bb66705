* SPDX-License-Identifier: Apache-2.0
* Of dermis extract: the path from column to summing node, and a charge source on a node of its own. The swept source is
* a number: 0 .. 10 are the currents, 11 and 12 the half of them with the summing node moved. Fields: measures, a step of
* the current, conveyor and mirror, the step of the node, the charge source.
{meas}
xline ibias vdd vss bias_line
vs s 0 0
vy y 0 0
bix 0 x i = {step_a!r}*(v(s) < 10.5 ? v(s) : 5)
{copy}
vsum sum lift 0
blift lift 0 v = v(s) < 10.5 ? 0 : (v(s) < 11.5 ? -{lift_v} : {lift_v})
vd logic_charge 0 0
xcharge d_charge out ibias vdd vss vdd_d vss_d {source}
vout out lift 0
* An output current is a small difference of large ones: reltol 1e-6 leaves a part of 1e-4 of it.
.options reltol=1e-6
.dc vs 0 12 1
