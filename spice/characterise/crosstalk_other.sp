* SPDX-License-Identifier: Apache-2.0
* Another column of crosstalk.sp. Field: its number.
xout_ibias{n} v_gate v_cp ibias{n} vdd bias_output
bcol{n} 0 col{n} i = v(s)*1e-3
xline{n} ibias{n} vdd_c vss_c bias_line
xconveyor{n} agnd_c col{n} z{n} ibias{n} vdd_c vss_c conveyor
xmirror{n} z{n} sum{n} ibias{n} vdd_c vss_c mirror_fixed
xcharge{n} d_charge sum{n} ibias{n} vdd_c vss_c vdd_d vss_d charge_source
xintegrator{n} sum{n} agnd_c d_hold v_int{n} vref ibias{n} vdd_c vss_c vdd_d vss_d integrator
