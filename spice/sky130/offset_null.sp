* SPDX-License-Identifier: Apache-2.0
* Offset null: y holds the voltage that puts col of a conveyor on agnd, and so cancels the offset of its amplifier.
* While d_preset is high the nulling amplifier stores its own offset and y is held; in the gate, when the column is
* quiet, it compares col with agnd and corrects y with a time constant of 0.5 us. On 31 pF, four times as slow, it was
* not done when a gate of 8 MHz began at 125 C (sky130.settling_lsb); 2 pF to 3 nF at the column do not make it ring.
* Its output stays within millivolts of agnd, so five transistors suffice; long and wide against 1/f noise, which
* 20 pF sample. xc_y, 8 pF, is to agnd, not to a supply with ripple. Before the first gate only two diodes hold y.
.subckt offset_null col y d_preset agnd ibias vdd vss vdd_d vss_d
xlevel d_preset on off vdd vss vdd_d vss_d level_shifter
xn_tail v_tail ibias vss vss nmos w=1 l=2
xn_in v_amp v_in v_tail vss nmos w=20 l=8 k=2
xn_ground v_load agnd v_tail vss nmos w=20 l=8 k=2
xp_load v_load v_load vdd vdd pmos w=2 l=20
xp_out v_amp v_load vdd vdd pmos w=2 l=20
xs_col col v_side off on vdd vss switch_small
xs_zero agnd v_side on off vdd vss switch_small
xc_own v_side v_in sky130_fd_pr__cap_mim_m3_1 w=28.75 l=28.75 m=12 mult=12
xs_own v_in v_amp on off vdd vss switch_small
xs_y v_amp y off on vdd vss switch_small
xc_y y agnd sky130_fd_pr__cap_mim_m3_1 w=27.85 l=27.85 m=5 mult=5
xp_y v_mid v_mid y y pmos w=20 l=0.5 k=5
xp_ground v_mid v_mid agnd agnd pmos w=20 l=0.5 k=5
.ends offset_null
