* SPDX-License-Identifier: Apache-2.0
* The clamp between the supplies: 3.6 V within 20 ns, and a supply that rises in 10 us; 10 mA into and out of a pad.
vzap zap vss pwl(0 0 0.1u 0 0.12u 3.6)
xzap zap vss esd_clamp
vramp ramp vss pwl(0 0 0.1u 0 10.1u 3.3)
xramp ramp vss esd_clamp
iup 0 high 10m
xup high vdd vss esd_pad
ebeyond_up beyond_up 0 high vdd 1
idown low 0 10m
xdown low vdd vss esd_pad
ebeyond_down beyond_down 0 vss low 1
.save v(beyond_up) v(beyond_down) i(vzap) i(vramp)
.tran 10n 12u
.meas tran up find v(beyond_up) at=11.9u
.meas tran down find v(beyond_down) at=11.9u
.meas tran zap min i(vzap)
.meas tran ramp min i(vramp)
.meas tran rest find i(vramp) at=11.9u
