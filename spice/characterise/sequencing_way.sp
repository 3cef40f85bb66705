* SPDX-License-Identifier: Apache-2.0
* An order of sequencing.sp. Fields: order, the ramps of the analog and of the digital supply; a row and a test switch
* that the core does not want (0) or wants (1), which charges the row as at any change of rows: `before` and `end`.
bvdd_{order} vdd_{order} 0 v=v(vdd)*v({analog})
bvss_{order} vss_{order} 0 v=v(vss)*v({analog})
bcore_{order} core_{order} vss_{order} v=(v(vdd_d)-v(vss_d))*v({digital})
bvb_{order} bias_{order} 0 v=0.5*v({analog})
vb_{order} bias_{order} vb_{order} 0
vground_{order} ground_{order} 0 0
bthrough_{order} through_{order} 0 v=min(max(i(vb_{order}),0),max(i(vground_{order}),0))
bd_{order} d_{order} vss_{order} v={wanted}*v(core_{order},vss_{order})
xdut_{order} d_{order} row_{order} vb_{order} ground_{order} vdd_{order} vss_{order} core_{order} vss_{order} row_driver
xtest_{order} d_{order} col_{order} vb_{order} vdd_{order} vss_{order} core_{order} vss_{order} test_current
.meas tran through_{order} max v(through_{order})
.meas tran before_{order} find i(vb_{order}) at={late}
.meas tran end_{order} find i(vb_{order}) at={stop}
