* SPDX-License-Identifier: Apache-2.0
* The test current of a column over temperature: the process's coefficients of poly move it.
vd logic_test 0 1
vb vb 0 0.5
xdut d_test col vb vdd vss vdd_d vss_d test_current
vcol col 0 0
.dc temp 27 125 98
.meas dc at_27 find i(vcol) at=27
.meas dc at_125 find i(vcol) at=125
