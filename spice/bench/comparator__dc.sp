* SPDX-License-Identifier: Apache-2.0
* comparator: thresholds of a rising and a falling input, gain at the decision level without hysteresis, output levels.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: thresholds are found between points 2 uV apart; gmin below the gain's last digit
.options reltol=1e-6 gmin=1e-15
* parameters
.param v_span = 10e-3
* stimulus: one sweep; the second comparator gets it inverted, so its output falls
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
vin v_in 0 0
erev v_rev 0 v_in 0 -1
* DUT
xdut_up v_in 0 v_up 0 vdd vss comparator
xdut_down v_rev 0 v_down 0 vdd vss comparator
xdut_gain v_in 0 v_gain 0 vdd vss comparator v_hysteresis_v=0 t_delay_s=0
* measure
.dc vin -10m 10m 2u
.meas dc v_rise when v(v_up)=0 rise=1
.meas dc v_fall_reversed when v(v_down)=0 fall=1
.meas dc offset_v param='(v_rise - v_fall_reversed)/2'
.meas dc hysteresis_v param='v_rise + v_fall_reversed'
.meas dc v_lower when v(v_gain)=-0.5
.meas dc v_upper when v(v_gain)=0.5
.meas dc v_one_volt param='v_upper - v_lower'
.meas dc v_low find v(v_up) at=-10m
.meas dc v_high find v(v_up) at=9.99m
* control
.control
run
quit
.endc
.end
