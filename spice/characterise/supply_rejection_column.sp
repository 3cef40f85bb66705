* SPDX-License-Identifier: Apache-2.0
* A column of supply_rejection.sp. Fields: its name, the resistance to the held rows. 1 Gohm is the direct path that the
* stored offset of the null lacks.
xout_ibias_{load} v_gate v_cp ibias_{load} vdd bias_output
xline_{load} ibias_{load} vdd vss bias_line
xrow_{load} d_row row_{load} vb agnd vdd vss vdd_d vss_d row_driver
rtaxel_{load} row_{load} col_{load} 500
rheld_{load} col_{load} 0 {held}
ccol_{load} col_{load} 0 400p
xpedestal_{load} col_{load} ibias_{load} vdd vss pedestal
xnull_{load} col_{load} y_{load} d_preset agnd ibias_{load} vdd vss vdd_d vss_d offset_null
rstored_{load} xnull_{load}.v_in xnull_{load}.v_amp 1g
xconveyor_{load} y_{load} col_{load} z_{load} ibias_{load} vdd vss conveyor
xmirror_{load} z_{load} out_{load} d_k0 d_k1 ibias_{load} vdd vss vdd_d vss_d mirror
vout_{load} out_{load} sum_{load} 0
xcharge_{load} d_charge packet_{load} ibias_{load} vdd vss vdd_d vss_d charge_source
vpacket_{load} packet_{load} sum_{load} 0
xintegrator_{load} sum_{load} agnd d_hold v_int_{load} vref ibias_{load} vdd vss vdd_d vss_d integrator
