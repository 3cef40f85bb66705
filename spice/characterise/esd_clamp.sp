* SPDX-License-Identifier: Apache-2.0
* The clamp between the supplies: 3.6 V within 20 ns, and a supply that rises in 10 us.
vzap zap vss pwl(0 0 0.1u 0 0.12u 3.6)
xzap zap vss esd_clamp
vramp ramp vss pwl(0 0 0.1u 0 10.1u 3.3)
xramp ramp vss esd_clamp
.save i(vzap) i(vramp)
.tran 10n 12u
.meas tran zap min i(vzap)
.meas tran ramp min i(vramp)
.meas tran rest find i(vramp) at=11.9u
