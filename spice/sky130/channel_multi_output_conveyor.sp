* SPDX-License-Identifier: Apache-2.0
* Multiple-output conveyor (Fig. 6): an output stage of 1/k feeds the integrator; the complement goes to agnd.
.subckt channel_multi_output_conveyor col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d params: k=80
xline ibias vdd vss bias_line
xnull col v_y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor v_y col v_sum agnd ibias vdd vss conveyor_multi k={k}
xvfc v_sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d vfc
.ends channel_multi_output_conveyor
