* SPDX-License-Identifier: Apache-2.0
* The analog half of the synchronized converter: integrator, comparator and charge source; the flip-flops are in rtl/.
* iin pulls v_int down from +0.5 V, comp is high where v_int <= 0, a packet is drawn from iin.
.subckt vfc iin d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
xintegrator iin agnd d_preset v_int vref ibias vdd vss vdd_d vss_d integrator
xcharge d_charge iin ibias vdd vss vdd_d vss_d charge_source
xcomparator agnd v_int comp ibias vdd vss comparator
.ends vfc
* All signs opposite (Fig. 5b).
.subckt vfc_inverted iin d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d
xintegrator iin agnd d_preset v_int vref ibias vdd vss vdd_d vss_d integrator_inverted
xcharge d_charge iin ibias vdd vss vdd_d vss_d charge_source_inverted
xcomparator v_int agnd comp ibias vdd vss comparator
.ends vfc_inverted
