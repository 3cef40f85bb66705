* SPDX-License-Identifier: Apache-2.0
* Asymmetrical current mirror: k input devices, one output device; out sources 1/k.
* A threshold error is a larger share of a small current than of a large one, which makes the code nonlinear: with
* units of w=5 l=2 and turns of w=20 l=2 by 2.6 LSB in the worst of 100 draws. It scales with 1 / l at constant w / l.
* The pedestal of the conveyor, 50 uA, is part of the input and is subtracted at out by an equally made 50 uA / k.
* The ratio is 20, 40, 80, 160 for the pins (d_k1, d_k0) = 00, 01, 10, 11: groups of devices with released gates, so
* that no switch carries the current.
.subckt mirror in out d_k0 d_k1 ibias vdd vss vdd_d vss_d
xlevel0 d_k0 k0 k0_n vdd vss vdd_d vss_d level_shifter
xlevel1 d_k1 k1 k1_n vdd vss vdd_d vss_d level_shifter
xnand0 k01_n k0 v_nand vss nmos w=2 l=0.5
xnand1 v_nand k1 vss vss nmos w=2 l=0.5
xnand2 k01_n k0 vdd vdd pmos w=4 l=0.5
xnand3 k01_n k1 vdd vdd pmos w=4 l=0.5
xnot k01_n k01 vdd vss vss inverter
xin in in vcn vss mirror_group units=20
xin0 in g_0 vcn vss mirror_group units=20
xin1 in g_1 vcn vss mirror_group units=60
xin01 in g_01 vcn vss mirror_group units=60
xs0 in g_0 k0 k0_n vdd vss mirror_gate
xs1 in g_1 k1 k1_n vdd vss mirror_gate
xs01 in g_01 k01 k01_n vdd vss mirror_gate
xpedin v_pedgate v_pedgate vcn vss mirror_group units=2
xpedin0 v_pedgate p_0 vcn vss mirror_group units=2
xpedin1 v_pedgate p_1 vcn vss mirror_group units=6
xpedin01 v_pedgate p_01 vcn vss mirror_group units=6
xsp0 v_pedgate p_0 k0 k0_n vdd vss mirror_gate
xsp1 v_pedgate p_1 k1 k1_n vdd vss mirror_gate
xsp01 v_pedgate p_01 k01 k01_n vdd vss mirror_gate
xlines ibias vcn vcp v_pedgate vdd vss mirror_lines
xcopy v_copy in vcn vss mirror_group
xn_ped v_ped v_pedgate vss vss nmos w=30 l=12
xn_pedc out vcn v_ped vss nmos w=20 l=1
xturn v_copy out vcp vdd mirror_turn
* While the bias comes up both devices are off and the gate's charge takes v_ped 0.8 V above vdd at sf, 27 C, 0.9.
xc_ped v_ped vss sky130_fd_pr__cap_mim_m3_1 w=2 l=2
.ends mirror
* The same with a ratio k that is drawn, not switched.
.subckt mirror_fixed in out ibias vdd vss params: k=80
xin in in vcn vss mirror_group units={k}
xpedin v_pedgate v_pedgate vcn vss mirror_group units={k/10}
xlines ibias vcn vcp v_pedgate vdd vss mirror_lines
xcopy v_copy in vcn vss mirror_group
xped out v_pedgate vcn vss mirror_group
xturn v_copy out vcp vdd mirror_turn
.ends mirror_fixed
* out sinks 1/k.
.subckt mirror_inverted in out ibias vdd vss params: k=80
xin in in vcn vss mirror_group units={k}
xpedin v_pedgate v_pedgate vcn vss mirror_group units={k/10}
xlines ibias vcn vcp v_pedgate vdd vss mirror_lines
xcopy out in vcn vss mirror_group
xped v_pedcopy v_pedgate vcn vss mirror_group
xturn v_pedcopy out vcp vdd mirror_turn
.ends mirror_inverted
* Cascode lines, and the current that the pedestal's mirror divides.
.subckt mirror_lines ibias vcn vcp v_pedgate vdd vss
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xbias_cp ibias vcp vdd vss bias_cascode_p
xp_ped v_p vbp vdd vdd pmos w=10 l=2
xp_pedc v_pedgate vcp v_p vdd pmos w=10 l=0.5
.ends mirror_lines
* A number of devices of the mirror with a common gate: at the input, or one at the output. Cascodes of w=5 l=0.5 let
* the gain drift by 0.1 % from 27 to -40 C.
.subckt mirror_group in gate vcn vss params: units=1
xn_in v_in gate vss vss nmos w=30 l=12 k={units}
xn_inc in vcn v_in vss nmos w=20 l=1 k={units}
.ends mirror_group
* Gate of a group: that of the mirror if on, vss if off. Behind a switch of 2 kohm the 43 pF of a group stand still above
* 2 MHz, and the ratio there is 20: ripple of the supply came through twice as large.
.subckt mirror_gate line gate on off vdd vss
xswitch line gate on off vdd vss switch k=10
xn_off gate off vss vss nmos w=2 l=0.5
.ends mirror_gate
* 1:1: the current drawn from in is sourced at out.
.subckt mirror_turn in out vcp vdd
xp_in v_in in vdd vdd pmos w=80 l=16 k=2
xp_inc in vcp v_in vdd pmos w=20 l=0.5
xp_out v_out in vdd vdd pmos w=80 l=16 k=2
xp_outc out vcp v_out vdd pmos w=20 l=0.5
.ends mirror_turn
