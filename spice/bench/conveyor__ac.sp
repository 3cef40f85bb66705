* SPDX-License-Identifier: Apache-2.0
* conveyor: impedance at x and current out of z against frequency.
* include
.include ../design.inc
.include ../behavioural/blocks.inc
* options: small-signal points are linear; the operating point must exceed the six digits compared
.options reltol=1e-6
* parameters
.param f_pole = {conveyor_f_pole_hz}
* stimulus: 1 A into x is the ac unit, z into a short
vdd vdd 0 {supply_vdd_v}
vss vss 0 {supply_vss_v}
iin 0 v_x dc 1e-3 ac 1
vprobe_z v_z 0 0
* DUT
xdut 0 v_x v_z 0 vdd vss conveyor
* measure
.ac dec 20 1k 1e9
.meas ac r_x_low_ohm find vm(v_x) at=1k
.meas ac r_x_high_ohm find vm(v_x) at=100meg
.meas ac gain_low find vm(v_iz) at=1k
.meas ac gain_pole find vm(v_iz) at={f_pole}
.meas ac gain_decade find vm(v_iz) at={10*f_pole}
* the current of a source has no magnitude function, so it becomes a voltage
hiz v_iz 0 vprobe_z 1
* control
.control
run
quit
.endc
.end
