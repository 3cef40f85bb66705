* SPDX-License-Identifier: Apache-2.0
* Folded-cascode amplifier, nmos pair: 80 dB; 40 uA a side at pairs=8 branches=6, which gives 34 MHz on 3 pF.
* pairs: tail in units of 10 uA; branches: current of each output branch in units of 10 uA, the limit of out.
.subckt ota inp inn out ibias vdd vss params: pairs=8 branches=6
xbias_p ibias vbp vdd vss bias_p
xbias_cp ibias vcp vdd vss bias_cascode_p
xbias_cn vbp vcn vdd vss bias_cascode_n
xn_tail v_tail ibias vss vss nmos w=5 l=2 k={2*pairs}
xn_inp v_foldp inp v_tail vss nmos w=20 l=1 k={pairs/2}
xn_inn v_foldn inn v_tail vss nmos w=20 l=1 k={pairs/2}
xp_foldp v_foldp vbp vdd vdd pmos w=20 l=2 k={pairs/2 + branches}
xp_foldn v_foldn vbp vdd vdd pmos w=20 l=2 k={pairs/2 + branches}
xp_cascp v_mirror vcp v_foldp vdd pmos w=20 l=1 k={branches}
xp_cascn out vcp v_foldn vdd pmos w=20 l=1 k={branches}
xn_cascp v_mirror vcn v_mp vss nmos w=10 l=1 k={branches}
xn_cascn out vcn v_mn vss nmos w=10 l=1 k={branches}
xn_mirrorp v_mp v_mirror vss vss nmos w=5 l=2 k={branches}
xn_mirrorn v_mn v_mirror vss vss nmos w=5 l=2 k={branches}
.ends ota
