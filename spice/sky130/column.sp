* SPDX-License-Identifier: Apache-2.0
* A column of the chip: the channel of Fig. 5a with its ratio from d_k1, d_k0, the test current, and comp for the core.
.subckt column col d_charge d_preset d_k0 d_k1 d_test comp vbias vref agnd ibias vdd vss vdd_d vss_d
xline ibias vdd vss bias_line
xtest d_test col vbias vdd vss vdd_d vss_d test_current
xnull col v_y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum d_k0 d_k1 ibias vdd vss vdd_d vss_d mirror
xvfc v_sum d_charge d_preset v_comp vref agnd ibias vdd vss vdd_d vss_d vfc
xcomp v_comp comp vdd_d vss_d level_down
.ends column
* Test current: 500 ohm from vbias to the column while d_test is high, a taxel of known resistance. Rows of poly of one
* chip are equal to 0.1 %, whatever their process; the switch adds 5 ohm.
.subckt test_current d_test col vbias vdd vss vdd_d vss_d
xlevel d_test small_on small_off vdd vss vdd_d vss_d level_shifter
xon small_off on vdd vss vss inverter k=20
xoff small_on off vdd vss vss inverter k=20
xr_taxel vbias v_taxel vss sky130_fd_pr__res_xhigh_po w=40 l=10
xs_taxel v_taxel col on off vdd vss switch k=1000
.ends test_current
