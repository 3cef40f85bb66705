* SPDX-License-Identifier: Apache-2.0
* The blocks of a channel, each with a vdd of its own.
xline ibias vdd vss bias_line
vpreset logic_preset 0 1
vcharge logic_charge 0 0
ix 0 col 0
.dc ix 0 1u 1u
voffset_null vdd vdd_offset_null 0
xoffset_null col y d_preset agnd ibias vdd_offset_null vss vdd_d vss_d offset_null
vconveyor vdd vdd_conveyor 0
xconveyor y col z ibias vdd_conveyor vss conveyor
vmirror vdd vdd_mirror 0
xmirror z sum ibias vdd_mirror vss mirror_fixed
vintegrator vdd vdd_integrator 0
xintegrator sum agnd d_preset v_int vref ibias vdd_integrator vss vdd_d vss_d integrator
vcharge_source vdd vdd_charge_source 0
xcharge_source d_charge sum ibias vdd_charge_source vss vdd_d vss_d charge_source
vcomparator vdd vdd_comparator 0
xcomparator 0 v_int comp ibias vdd_comparator vss comparator
.meas dc offset_null find i(voffset_null) at=0
.meas dc conveyor find i(vconveyor) at=0
.meas dc mirror find i(vmirror) at=0
.meas dc integrator find i(vintegrator) at=0
.meas dc charge_source find i(vcharge_source) at=0
.meas dc comparator find i(vcomparator) at=0
