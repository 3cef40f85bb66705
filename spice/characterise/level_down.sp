* SPDX-License-Identifier: Apache-2.0
* The level above vss at which a net of the analog supply becomes high for the core.
vin in vss 0
xdut in out vdd_d vss_d level_down
eout high 0 out vss_d 1
.dc vin 0 2.9 10m
.meas dc level when v(high)=0.9 rise=1
