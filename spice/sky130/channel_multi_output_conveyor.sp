* SPDX-License-Identifier: Apache-2.0
* Multiple-output conveyor (Fig. 6): an output stage of 1/k feeds the integrator; the complement goes to ground.
.subckt channel_multi_output_conveyor col d_charge d_preset comp ibias vdd vss params: k=80
xnull col v_y d_preset ibias vdd vss offset_null
xconveyor v_y col v_sum 0 ibias vdd vss conveyor_multi k={k}
xvfc v_sum d_charge d_preset comp ibias vdd vss vfc
.ends channel_multi_output_conveyor
