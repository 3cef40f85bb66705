* SPDX-License-Identifier: Apache-2.0
* Conveyor and asymmetrical mirror (Fig. 5a): the mirror sources 1/k of the column current into the integrator.
.subckt channel_conveyor_mirror col d_charge d_preset comp ibias vdd vss params: k=80
xnull col v_y d_preset ibias vdd vss offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum 0 0 ibias vdd vss mirror k={k}
xvfc v_sum d_charge d_preset comp ibias vdd vss vfc
.ends channel_conveyor_mirror
