* SPDX-License-Identifier: Apache-2.0
* The current of a whole row, out of the driver. Field: 1 driven, 0 grounded.
vd logic_row 0 {driven}
vb vb 0 0.5
xdut d_row row vb 0 vdd vss vdd_d vss_d row_driver
il row 0 0
.dc il 0 16m 16m
.meas dc none find v(row) at=0
.meas dc full find v(row) at=0.016
