* SPDX-License-Identifier: Apache-2.0
* The front end with two rows and two columns, from power-up without bias to power-down, on a bias of 0.45 V, so that what
* takes vbias for vref is seen: 1 kohm and 10 kohm a taxel, row 0 driven, then row 1 with the test current of column 1, then of both.
* From its enable the bias takes up to 14 us (sky130.start_up_s) and a column as much again at ss, -40 C. The first gate,
* in which the offset null finds its level, is the one that a host throws away; the second one, from 40 us, is measured.
* Fields: the front end and its pins, with its own vdd_front and r_ref_x.
{front_end}
xdut {pins} dermis_analog_front_end
vbias vbias agnd 0.45
vdd_x vdd vdd_front 0
rref_x r_ref_x agnd 50k
cref_x r_ref_x agnd 10p
bcelsius celsius 0 v=temper
rt00 row0 col0 1k
rt10 row1 col0 1k
rt01 row0 col1 10k
rt11 row1 col1 10k
cc0 col0 0 400p
cc1 col1 0 400p
ccomp0 comp0 vss 50f
ccomp1 comp1 vss 50f
csense0 d_sense0 vss 50f
csense1 d_sense1 vss 50f
v_enable logic_enable 0 pwl(0 0 2u 0 2.01u 1 70u 1 70.01u 0)
v_preset logic_preset 0 pwl(0 1 26u 1 26.001u 0 36u 0 36.001u 1 40u 1 40.001u 0 58u 0 58.01u 1)
v_row0 logic_row0 0 pwl(0 1 53u 1 53.01u 0)
v_row1 logic_row1 0 pwl(0 0 53u 0 53.01u 1)
v_charge0 logic_charge0 0 pwl(0 0 40.8u 0 40.801u 1 41u 1 41.001u 0)
v_charge1 logic_charge1 0 0
v_range0 logic_range0 0 0
v_range1 logic_range1 0 1
v_range2 logic_range2 0 1
v_range3 logic_range3 0 0
v_test0 logic_test0 0 pwl(0 0 61u 0 61.01u 1)
v_test1 logic_test1 0 pwl(0 0 53u 0 53.01u 1)
.tran 50n 95u
.meas tran celsius find v(celsius) at=1u
.meas tran low find v(vss) at=1u
.meas tran high find v(vdd_d) at=1u
.meas tran i_off find i(vdd_x) at=1.9u
.meas tran i_on find i(vdd_x) at=39u
.meas tran i_down find i(vdd_x) at=94u
.meas tran high_sense0 find v(d_sense0) at=50u
.meas tran low_sense1 find v(d_sense1) at=50u
.meas tran low_sense0 find v(d_sense0) at=57u
.meas tran high_sense1 find v(d_sense1) at=57u
.meas tran low_comp find v(comp0) at=39.9u
.meas tran high_comp find v(comp0) at=49.9u
.meas tran fast_0 find v(xdut.xcolumn0.xvfc.v_int) at=40.2u
.meas tran fast_1 find v(xdut.xcolumn0.xvfc.v_int) at=40.6u
.meas tran before find v(xdut.xcolumn0.xvfc.v_int) at=40.78u
.meas tran after find v(xdut.xcolumn0.xvfc.v_int) at=41.18u
.meas tran slow_0 find v(xdut.xcolumn1.xvfc.v_int) at=40.5u
.meas tran slow_1 find v(xdut.xcolumn1.xvfc.v_int) at=42.5u
.meas tran preset_0 find v(xdut.xcolumn0.xvfc.v_int) at=39.9u
.meas tran preset_1 find v(xdut.xcolumn1.xvfc.v_int) at=39.9u
.meas tran i_one find i(vbias) at=60.9u
.meas tran i_both find i(vbias) at=69u
