* SPDX-License-Identifier: Apache-2.0
* Integrator with preset: current into iin pulls out down by q / 5 pF; while d_preset is 1 V the capacitor is charged to the preset reference.
* The reference is vref, 0.5 V, half a packet: a net of the whole chip, the one at bias, and no pin. Preset closes the
* amplifier on itself. polarity = 1 lays the far plate, which is out, on vref: so the amplifier's offset is stored and
* does not count (auto-zero). polarity = -1 turns the capacitor round, the near plate on vref and the far one on ground;
* there the amplifier's offset, some millivolts, counts.
.subckt integrator iin vcm d_preset out ibias vdd vss params: polarity=1
.global vref
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota
* Behind the capacitor the amplifier sees nothing but the line iin, a tenth of the 3 pF that it is made for: 1 pF keeps it from ringing.
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
* Meanwhile out has to lie where no decision stands, which the supply is good enough for.
xs_hold out v_hold on off vdd vss switch
rhigh vss v_hold 115k
rlow v_hold vcm 50k
.endif
.ends integrator
* The same for the direct interface: 80 times the current, 80 times the capacitor (what the column line itself has is not in it).
.subckt integrator_direct iin vcm d_preset out ibias vdd vss
.global vref
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota pairs=320 branches=320
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7 m=80
xs_unity iin v_amp on off vdd vss switch k=40
xs_preset out vref on off vdd vss switch k=40
xs_out out v_amp off on vdd vss switch k=160
.ends integrator_direct
