* SPDX-License-Identifier: Apache-2.0
* The current of a whole row, out of the driver. Field: 1 driven, 0 grounded.
vd logic_row 0 {driven}
vb vb 0 0.5
xdut d_row row vb 0 vdd vss vdd_d vss_d row_driver
il row 0 0
* In steps: after one of 16 mA Newton's method may stop within reltol of 0.5 V, 3 % of the 14 mV across the driver.
.dc il 0 16m 1m
.meas dc none find v(row) at=0
.meas dc full find v(row) at=0.016
