* SPDX-License-Identifier: Apache-2.0
* The channel of Fig. 5a with its ratio from d_k1, d_k0, as the chip's range pins set it.
.subckt channel_switched col d_charge d_preset d_k0 d_k1 comp vref agnd ibias vdd vss vdd_d vss_d
xline ibias vdd vss bias_line
xnull col v_y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum d_k0 d_k1 ibias vdd vss vdd_d vss_d mirror
xvfc v_sum d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d vfc
.ends channel_switched
