* SPDX-License-Identifier: Apache-2.0
* Integrator with preset: current into iin pulls out down by q / 5 pF; while d_preset is 1 V the capacitor is charged to the preset reference.
* The reference is vref, 0.5 V, half a packet: a net of the whole chip (bias), not a pin. Preset closes the amplifier
* on itself. polarity = 1 puts the far plate, at out, on vref: the offset of the amplifier is stored and cancels
* (auto-zero). polarity = -1 reverses the capacitor, the near plate on vref and the far one on ground; then the offset
* of some millivolts counts.
.subckt integrator iin vcm d_preset out ibias vdd vss params: polarity=1
.global vref
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota
* After the capacitor the amplifier has only the line iin as load, a tenth of its 3 pF: 1 pF keeps it stable.
xc_amp v_amp vss sky130_fd_pr__cap_mim_m3_1 w=22 l=22
xs_unity iin v_amp on off vdd vss switch
.if (polarity > 0)
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7
xs_preset out vref on off vdd vss switch
xs_out out v_amp off on vdd vss switch k=2
.else
xc_int v_far v_near sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7
xs_level v_near vref on off vdd vss switch
xs_ground v_far vcm on off vdd vss switch
xs_near v_near iin off on vdd vss switch k=2
xs_far v_far v_amp off on vdd vss switch k=2
xs_out out v_far off on vdd vss switch
* During preset out must be away from the decision level; the supply is accurate enough.
xs_hold out v_hold on off vdd vss switch
rhigh vss v_hold 115k
rlow v_hold vcm 50k
.endif
.ends integrator
* For the direct interface: 80 times the current, 80 times the capacitor (without that of the column line).
.subckt integrator_direct iin vcm d_preset out ibias vdd vss
.global vref
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota pairs=320 branches=320
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7 m=80
xs_unity iin v_amp on off vdd vss switch k=40
xs_preset out vref on off vdd vss switch k=40
xs_out out v_amp off on vdd vss switch k=160
.ends integrator_direct
