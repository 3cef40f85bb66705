* SPDX-License-Identifier: Apache-2.0
* Integrator with preset: current into iin pulls out down by q / 5 pF; while d_preset is high the capacitor is charged to the preset reference.
* The reference is vref, 0.5 V above vcm, half a packet. Preset closes the amplifier on itself and puts the far plate,
* at out, on vref: the offset of the amplifier is stored and cancels (auto-zero).
* When preset begins, out stays on the amplifier for some 10 ns more, and both plates move together through the switches:
* from an out at vss, its jump to vref alone would lift iin 0.4 V above vdd. xn_late is weak and xp_late strong, so at
* the end of preset all switches move together.
* c_int_f is taken and not used: without a parameter ngspice refuses those that a behavioural vfc passes.
.subckt integrator iin vcm d_preset out vref ibias vdd vss vdd_d vss_d params: c_int_f=0
xlevel d_preset on off vdd vss vdd_d vss_d level_shifter
xamp vcm iin v_amp ibias vdd vss ota
* After the capacitor the amplifier has only the line iin as load, a tenth of its 3 pF: 1 pF keeps it stable.
xc_amp v_amp vss sky130_fd_pr__cap_mim_m3_1 w=22 l=22
xs_unity iin v_amp on off vdd vss switch
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=28.7 l=28.735 m=3 mult=3
xn_late off_late on vss vss nmos w=0.5 l=20
xp_late off_late on vdd vdd pmos w=4 l=0.5
xon_late off_late on_late vdd vss vss inverter
xs_preset out vref on_late off_late vdd vss switch
xs_out out v_amp off_late on_late vdd vss switch k=2
.ends integrator
* The opposite sign: preset reverses the capacitor, the near plate on vref and the far one on vcm; then the offset of
* some millivolts counts.
.subckt integrator_inverted iin vcm d_preset out vref ibias vdd vss vdd_d vss_d params: c_int_f=0
xlevel d_preset on off vdd vss vdd_d vss_d level_shifter
xamp vcm iin v_amp ibias vdd vss ota
xc_amp v_amp vss sky130_fd_pr__cap_mim_m3_1 w=22 l=22
xs_unity iin v_amp on off vdd vss switch
xc_int v_far v_near sky130_fd_pr__cap_mim_m3_1 w=28.7 l=28.735 m=3 mult=3
xs_level v_near vref on off vdd vss switch
xs_ground v_far vcm on off vdd vss switch
xs_near v_near iin off on vdd vss switch k=2
xs_far v_far v_amp off on vdd vss switch k=2
xs_out out v_far off on vdd vss switch
* During preset out must be away from the decision level; the supply is accurate enough.
xs_hold out v_hold on off vdd vss switch
xr_low vss v_hold vss sky130_fd_pr__res_xhigh_po w=0.69 l=38.6
xr_high v_hold vcm vss sky130_fd_pr__res_xhigh_po w=0.69 l=16.8
.ends integrator_inverted
* For the direct interface: 80 times the current, 80 times the capacitor (without that of the column line).
.subckt integrator_direct iin vcm d_preset out vref ibias vdd vss vdd_d vss_d
xlevel d_preset small_on small_off vdd vss vdd_d vss_d level_shifter
xon small_off on vdd vss vss inverter k=20
xoff small_on off vdd vss vss inverter k=20
xamp vcm iin v_amp ibias vdd vss ota pairs=320 branches=320
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=28.7 l=28.735 m=240 mult=240
xs_unity iin v_amp on off vdd vss switch k=40
xs_preset out vref on off vdd vss switch k=40
xs_out out v_amp off on vdd vss switch k=160
.ends integrator_direct
