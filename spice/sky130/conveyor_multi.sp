* SPDX-License-Identifier: Apache-2.0
* Multiple-output conveyor: x follows y, zp sources 1/k of the current into x, zn sinks it; no mirror follows.
.subckt conveyor_multi y x zp zn ibias vdd vss params: k=80
xin y x v_in ibias vdd vss conveyor
xbias_p ibias vbp vdd vss bias_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xbias_cp ibias vcp vdd vss bias_cascode_p
xgroup v_in v_in vcn vss mirror_group units={k}
xp_ped v_pg vbp vdd vdd pmos w=10 l=2
xp_pedc v_pedgate vcp v_pg vdd pmos w=10 l=0.5
xpedgroup v_pedgate v_pedgate vcn vss mirror_group units={k/10}
* source: copied, turned, less the pedestal
xn_zp v_p v_in vss vss nmos w=30 l=12
xn_zpc v_turn vcn v_p vss nmos w=20 l=1
xturn v_turn zp vcp vdd mirror_turn
xn_zpped v_pp v_pedgate vss vss nmos w=30 l=12
xn_zppedc zp vcn v_pp vss nmos w=20 l=1
* sink: copied, less the pedestal turned
xn_zn v_n v_in vss vss nmos w=30 l=12
xn_znc zn vcn v_n vss nmos w=20 l=1
xn_znped v_np v_pedgate vss vss nmos w=30 l=12
xn_znpedc v_pedturn vcn v_np vss nmos w=20 l=1
xpedturn v_pedturn zn vcp vdd mirror_turn
.ends conveyor_multi
