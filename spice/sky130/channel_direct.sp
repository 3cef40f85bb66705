* SPDX-License-Identifier: Apache-2.0
* Direct interface (Fig. 3): the column is the summing node of an integrator of 80 times the current; k is unused.
.subckt channel_direct col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d params: k=80
xline ibias vdd vss bias_line
xintegrator col agnd d_preset v_int vref ibias vdd vss vdd_d vss_d integrator_direct
xcharge d_charge col ibias vdd vss vdd_d vss_d charge_source units=400
xcomparator agnd v_int comp ibias vdd vss comparator
.ends channel_direct
