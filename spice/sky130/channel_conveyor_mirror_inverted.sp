* SPDX-License-Identifier: Apache-2.0
* Simplified conveyor and mirror (Fig. 5b): the mirror sinks; integrator, preset, comparator, charge source are inverted.
.subckt channel_conveyor_mirror_inverted col d_charge d_preset comp ibias vdd vss params: k=80
xnull col v_y d_preset ibias vdd vss offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum 0 0 ibias vdd vss mirror k={k} polarity=-1
xvfc v_sum d_charge d_preset comp ibias vdd vss vfc polarity=-1
.ends channel_conveyor_mirror_inverted
