* SPDX-License-Identifier: Apache-2.0
* The analog half of the synchronized converter: integrator, comparator and charge source; the flip-flops are in rtl/.
* polarity = 1: iin pulls v_int down from +0.5 V, comp is high where v_int <= 0, a packet is drawn from iin. -1: all opposite (Fig. 5b).
.subckt vfc iin d_charge d_preset comp ibias vdd vss params: polarity=1
xintegrator iin 0 d_preset v_int ibias vdd vss integrator polarity={polarity}
xcharge d_charge iin ibias vdd vss charge_source polarity={polarity}
.if (polarity > 0)
xcomparator 0 v_int comp ibias vdd vss comparator
.else
xcomparator v_int 0 comp ibias vdd vss comparator
.endif
.ends vfc
