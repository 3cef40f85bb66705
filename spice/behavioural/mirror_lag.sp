* SPDX-License-Identifier: Apache-2.0
* Slow mirror: q_lag_c di/dt = i (i_in - i), the gate of a device in weak inversion with time constant q_lag_c / i.
* v_gate is ln(i / i_ref_a) volts on q_lag_c farad, which conserves charge at any step. out sources i, outn sinks it.
* i is limited to 1e-6 i_ref_a, a leakage without which it would never rise again, and 1e3 i_ref_a.
.subckt mirror_lag in out outn
+ params: q_lag_c={mirror_q_lag_c} i_ref_a={converter_i0_a}
vin in 0 0
bgate 0 v_gate i = min(max(i(vin), {1e-6*i_ref_a}), {1e3*i_ref_a})
cgate v_gate 0 {q_lag_c}
* Above 1e3 i_ref_a a straight line: an exponential would overflow at a first guess of Newton's method.
bcopy v_gate v_copy i = v(v_gate) < 7 ? {i_ref_a}*exp(v(v_gate)) : {i_ref_a*exp(7)}*(v(v_gate) - 6)
vcopy v_copy 0 0
fout 0 out vcopy 1
foutn outn 0 vcopy 1
.ends mirror_lag
