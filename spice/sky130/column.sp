* SPDX-License-Identifier: Apache-2.0
* A column of the chip: the channel of Fig. 5a with its ratio from d_k1, d_k0, the pedestal, the test current, and comp
* for the core.
.subckt column col d_charge d_preset d_k0 d_k1 d_test comp vbias vref agnd ibias vdd vss vdd_d vss_d
xline ibias vdd vss bias_line
xpedestal col ibias vdd vss pedestal
xtest d_test col vbias vdd vss vdd_d vss_d test_current
xnull col v_y d_preset agnd ibias vdd vss vdd_d vss_d offset_null
xconveyor v_y col v_z ibias vdd vss conveyor
xmirror v_z v_sum d_k0 d_k1 ibias vdd vss vdd_d vss_d mirror
xvfc v_sum d_charge d_preset v_comp vref agnd ibias vdd vss vdd_d vss_d vfc
xcomp v_comp comp vdd_d vss_d level_down
.ends column
* Pedestal: 16 uA into the column, 4 codes at k = 80. The zero of a channel is above 0.5 code with it, so that dark
* subtraction is never cut at zero. In front of the mirror it follows k, as the offsets of conveyor and mirror do.
.subckt pedestal col ibias vdd vss
xbias_p ibias vbp vdd vss bias_p
xbias_cp ibias vcp vdd vss bias_cascode_p
xp_source v_source vbp vdd vdd pmos w=16 l=2 k=2
xp_casc col vcp v_source vdd pmos w=16 l=0.5 k=2
.ends pedestal
* Test current: 0.9 mA from vbias into the column while d_test is high, a taxel of known resistance. With the pedestal a
* channel 9 % high still counts it. 552 ohm of poly, 3 in the switch; 42 strips, 16 000 um2, are equal to 0.037 % (one
* sigma) in the columns of a chip, 0.1 code at full scale. The sheet's spread of 4 % is one gain of the whole chip.
.subckt test_current d_test col vbias vdd vss vdd_d vss_d
xlevel d_test small_on small_off vdd vss vdd_d vss_d level_shifter_low
xon small_off on vdd vss vss inverter k=20
xoff small_on off vdd vss vss inverter k=20
xr_taxel vbias v_taxel vss sky130_fd_pr__res_xhigh_po w=5.73 l=66.2 m=42 mult=42
xs_taxel v_taxel col on off vdd vss switch k=1000
.ends test_current
