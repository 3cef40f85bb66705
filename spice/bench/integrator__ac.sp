* SPDX-License-Identifier: Apache-2.0
* integrator: open-loop gain and gain-bandwidth of its amplifier, the loop closed for dc only (1e12 H).
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: small-signal points are linear; the operating point must exceed the six digits compared
.options reltol=1e-6
* parameters
.param f_low = 1
.param f_band = 1e6
* stimulus
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vpreset d_preset 0 0
vin v_in 0 dc 0 ac 1
cin v_in v_sum 1e6
lfb v_int v_sum 1e12
* DUT
xdut v_sum 0 d_preset v_int 0 0 vdd vss 0 0 integrator
* measure
.ac dec 20 1 1e8
.meas ac gain_low find vm(v_int) at={f_low}
.meas ac gain_band find vm(v_int) at={f_band}
.meas ac gbw_hz param='gain_band*f_band'
.meas ac phase_low_deg find vp(v_int) at={f_low}
* control
.control
run
quit
.endc
.end
