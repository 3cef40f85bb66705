* SPDX-License-Identifier: Apache-2.0
* Second-generation current conveyor for currents into x: x follows y, and z sources what enters x plus the pedestal of 50 uA.
* The pedestal keeps the pmos at x on (and the mirror fast) when no taxel is pressed; the mirror subtracts it.
* The gate line needs -1.1 V at 1 mA, out of reach of the cascoded amplifier, hence the follower. The amplifier drives
* 13 pF through 50 kohm: their zero at 0.2 MHz takes back the lag of x with up to 3 nF, where the pedestal alone keeps
* its pole at 0.05 MHz; 1.5 pF beside them end the flat part before the follower's pole (sky130.phase_margin_deg).
* Three quarters of the resistance are a transistor below the plates, without voltage at rest: its mobility falls with
* temperature as that of xp_x does and the poly's resistance, so zero and pole move together. Its gate is 0.3 V below vdd:
* v_low goes 0.17 V below vss for microseconds when a column fills.
.subckt conveyor y x z ibias vdd vss
xamp y x v_amp ibias vdd vss ota pairs=1 branches=1
xr_zero v_amp v_zero vss sky130_fd_pr__res_xhigh_po w=1.41 l=8.5
xc_zero v_zero v_low sky130_fd_pr__cap_mim_m3_1 w=28.2 l=28.2 m=8 mult=8
xn_zero v_low v_ped vss vss nmos w=0.7 l=6
xc_amp v_amp vss sky130_fd_pr__cap_mim_m3_1 w=27.5 l=27.5
xn_follow vdd v_amp v_gate vss nmos w=10 l=0.5 k=2
xn_sink v_gate ibias vss vss nmos w=5 l=2 k=4
xp_x z v_gate x x pmos w=20 l=0.5 k=50
xbias_p ibias vbp vdd vss bias_p
xbias_cp ibias vcp vdd vss bias_cascode_p
xp_pedestal v_ped vbp vdd vdd pmos w=20 l=2 k=5
xp_pedc x vcp v_ped vdd pmos w=20 l=0.5 k=5
.ends conveyor
