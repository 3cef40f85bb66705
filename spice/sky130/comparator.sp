* SPDX-License-Identifier: Apache-2.0
* Comparator: out = vdd where v(inp) > v(inn), else vss: a pair of 40 uA on a mirror, a common source and an inverter.
* Only the pair gets small signals. A folded-cascode amplifier is no better here, and its cascodes, in and out of
* saturation, cost Newton's method 90 iterations per decision instead of 20: half the time of a frame.
* t_delay_s is taken and not used: without a parameter of its own ngspice refuses those that a behavioural vfc passes.
.subckt comparator inp inn out ibias vdd vss params: t_delay_s=0
xn_tail v_tail v_own vss vss nmos w=5 l=2 k=8
xn_inp v_load inp v_tail vss nmos w=20 l=1 k=2
xn_inn v_pair inn v_tail vss nmos w=20 l=1 k=2
xp_load v_load v_load vdd vdd pmos w=10 l=1 k=2
xp_pair v_pair v_load vdd vdd pmos w=10 l=1 k=2
xp_first v_first v_pair vdd vdd pmos w=10 l=1 k=2
* A separate gate line keeps large swings away from ibias, which sets the packets: the first stage, and the tail of
* the pair, which follows inp down to vss. With only the tail on ibias, 16 sourcing channels in step had packets 2 %
* too small and a nonlinearity of 2.9 LSB.
xbias_p ibias vbp vdd vss bias_p
xp_own v_own vbp vdd vdd pmos w=20 l=2
xn_own v_own v_own vss vss nmos w=5 l=2 k=2
xn_first v_first v_own vss vss nmos w=5 l=2 k=4
xn_out out v_first vss vss nmos w=5 l=0.5
xp_out out v_first vdd vdd pmos w=12 l=0.5
.ends comparator
