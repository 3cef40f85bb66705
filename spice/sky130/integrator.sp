* SPDX-License-Identifier: Apache-2.0
* Integrator with preset: current into iin pulls out down by q / 5 pF; while d_preset is 1 V the capacitor is charged to the preset reference.
* Preset closes the amplifier on itself and lays the far plate, which is out, on the reference: half a packet, 0.5 V (polarity = -1: -0.5 V).
* So the amplifier's offset is stored and does not count (auto-zero); afterwards a switch joins the plate to the amplifier.
.subckt integrator iin vcm d_preset out ibias vdd vss params: polarity=1
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota
* Behind the capacitor the amplifier sees nothing but the line iin, a tenth of the 3 pF that it is made for: 1 pF keeps it from ringing.
xc_amp v_amp vss sky130_fd_pr__cap_mim_m3_1 w=22 l=22
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7
xs_unity iin v_amp on off vdd vss switch
xs_preset out v_preset on off vdd vss switch
xs_out out v_amp off on vdd vss switch k=2
* Reference from the supply: 10 % of it are 0.05 packet, the same in every slot.
.if (polarity > 0)
rhigh vdd v_preset 115k
.else
rhigh vss v_preset 115k
.endif
rlow v_preset vcm 50k
.ends integrator
* The same for the direct interface: 80 times the current, 80 times the capacitor (what the column line itself has is not in it).
.subckt integrator_direct iin vcm d_preset out ibias vdd vss
xlevel d_preset on off logic_level
xamp vcm iin v_amp ibias vdd vss ota pairs=320 branches=320
xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7 m=80
xs_unity iin v_amp on off vdd vss switch k=40
xs_preset out v_preset on off vdd vss switch k=40
xs_out out v_amp off on vdd vss switch k=160
rhigh vdd v_preset 1.15k
rlow v_preset vcm 0.5k
.ends integrator_direct
