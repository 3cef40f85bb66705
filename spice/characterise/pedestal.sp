* SPDX-License-Identifier: Apache-2.0
* The current that flows into a column always, on agnd.
xline ibias vdd vss bias_line
xdut col ibias vdd vss pedestal
xesd col vdd vss esd_pad
vcol col 0 0
.dc vcol 0 0.01 0.01
.meas dc at_0 find i(vcol) at=0
