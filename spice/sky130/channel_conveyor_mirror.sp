* SPDX-License-Identifier: Apache-2.0
* Conveyor and asymmetrical mirror (Fig. 5a): the mirror sources 1/k of the column current into the integrator.
.subckt channel_conveyor_mirror col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d params: k=80
xline ibias vdd vss bias_line
xnull col v_y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum ibias vdd vss mirror_fixed k={k}
xvfc v_sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d vfc
.ends channel_conveyor_mirror
