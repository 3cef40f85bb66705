* SPDX-License-Identifier: Apache-2.0
* The charge source, on, for noise.sp. Field: level of a high digital net.
vsum sum 0 0
hout out 0 vsum 1
vc d_charge vss_d dc {high_v} ac 1
xdut d_charge sum ibias vdd vss vdd_d vss_d charge_source
