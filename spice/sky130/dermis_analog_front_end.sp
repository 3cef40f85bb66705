* SPDX-License-Identifier: Apache-2.0
* The analog front end of 16 rows and 16 columns. Generated from models/design.toml; change it there and run: dermis generate
* From outside come vbias (0.5 V, all current of the taxels), vref (0.5 V), 50 kohm from r_ref to agnd,
* and agnd, half way between vdd and vss; vss and vss_d are the board's ground.
.subckt dermis_analog_front_end
+ row0 row1 row2 row3 row4 row5 row6 row7 row8 row9 row10 row11
+ row12 row13 row14 row15 col0 col1 col2 col3 col4 col5 col6 col7
+ col8 col9 col10 col11 col12 col13 col14 col15 d_row0 d_row1 d_row2 d_row3
+ d_row4 d_row5 d_row6 d_row7 d_row8 d_row9 d_row10 d_row11 d_row12 d_row13 d_row14 d_row15
+ d_charge0 d_charge1 d_charge2 d_charge3 d_charge4 d_charge5 d_charge6 d_charge7 d_charge8 d_charge9 d_charge10 d_charge11
+ d_charge12 d_charge13 d_charge14 d_charge15 d_range0 d_range1 d_range2 d_range3 d_range4 d_range5 d_range6 d_range7
+ d_range8 d_range9 d_range10 d_range11 d_range12 d_range13 d_range14 d_range15 d_range16 d_range17 d_range18 d_range19
+ d_range20 d_range21 d_range22 d_range23 d_range24 d_range25 d_range26 d_range27 d_range28 d_range29 d_range30 d_range31
+ d_test0 d_test1 d_test2 d_test3 d_test4 d_test5 d_test6 d_test7 d_test8 d_test9 d_test10 d_test11
+ d_test12 d_test13 d_test14 d_test15 d_sense0 d_sense1 d_sense2 d_sense3 d_sense4 d_sense5 d_sense6 d_sense7
+ d_sense8 d_sense9 d_sense10 d_sense11 d_sense12 d_sense13 d_sense14 d_sense15 comp0 comp1 comp2 comp3
+ comp4 comp5 comp6 comp7 comp8 comp9 comp10 comp11 comp12 comp13 comp14 comp15
+ d_preset d_enable vbias vref r_ref agnd vdd vss vdd_d vss_d
xbias vref r_ref v_gate v_cp vdd vss bias
xenable d_enable v_gate vdd vss vdd_d vss_d power_down
xr_high vbias v_half vss sky130_fd_pr__res_xhigh_po w=0.69 l=33.6
xr_low v_half agnd vss sky130_fd_pr__res_xhigh_po w=0.69 l=33.6
xout_ibias_rows v_gate v_cp ibias_rows vdd bias_output
xline_rows ibias_rows vdd vss bias_line
xclamp vdd vss esd_clamp
xrow0 d_row0 row0 vbias agnd vdd vss vdd_d vss_d row_driver
xsense0 row0 d_sense0 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow1 d_row1 row1 vbias agnd vdd vss vdd_d vss_d row_driver
xsense1 row1 d_sense1 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow2 d_row2 row2 vbias agnd vdd vss vdd_d vss_d row_driver
xsense2 row2 d_sense2 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow3 d_row3 row3 vbias agnd vdd vss vdd_d vss_d row_driver
xsense3 row3 d_sense3 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow4 d_row4 row4 vbias agnd vdd vss vdd_d vss_d row_driver
xsense4 row4 d_sense4 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow5 d_row5 row5 vbias agnd vdd vss vdd_d vss_d row_driver
xsense5 row5 d_sense5 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow6 d_row6 row6 vbias agnd vdd vss vdd_d vss_d row_driver
xsense6 row6 d_sense6 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow7 d_row7 row7 vbias agnd vdd vss vdd_d vss_d row_driver
xsense7 row7 d_sense7 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow8 d_row8 row8 vbias agnd vdd vss vdd_d vss_d row_driver
xsense8 row8 d_sense8 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow9 d_row9 row9 vbias agnd vdd vss vdd_d vss_d row_driver
xsense9 row9 d_sense9 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow10 d_row10 row10 vbias agnd vdd vss vdd_d vss_d row_driver
xsense10 row10 d_sense10 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow11 d_row11 row11 vbias agnd vdd vss vdd_d vss_d row_driver
xsense11 row11 d_sense11 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow12 d_row12 row12 vbias agnd vdd vss vdd_d vss_d row_driver
xsense12 row12 d_sense12 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow13 d_row13 row13 vbias agnd vdd vss vdd_d vss_d row_driver
xsense13 row13 d_sense13 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow14 d_row14 row14 vbias agnd vdd vss vdd_d vss_d row_driver
xsense14 row14 d_sense14 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xrow15 d_row15 row15 vbias agnd vdd vss vdd_d vss_d row_driver
xsense15 row15 d_sense15 v_half ibias_rows vdd vss vdd_d vss_d row_sense
xout_ibias0 v_gate v_cp ibias0 vdd bias_output
xcolumn0 col0 d_charge0 d_preset d_range0 d_range1 d_test0 comp0 vbias vref agnd ibias0 vdd vss vdd_d vss_d column
xout_ibias1 v_gate v_cp ibias1 vdd bias_output
xcolumn1 col1 d_charge1 d_preset d_range2 d_range3 d_test1 comp1 vbias vref agnd ibias1 vdd vss vdd_d vss_d column
xout_ibias2 v_gate v_cp ibias2 vdd bias_output
xcolumn2 col2 d_charge2 d_preset d_range4 d_range5 d_test2 comp2 vbias vref agnd ibias2 vdd vss vdd_d vss_d column
xout_ibias3 v_gate v_cp ibias3 vdd bias_output
xcolumn3 col3 d_charge3 d_preset d_range6 d_range7 d_test3 comp3 vbias vref agnd ibias3 vdd vss vdd_d vss_d column
xout_ibias4 v_gate v_cp ibias4 vdd bias_output
xcolumn4 col4 d_charge4 d_preset d_range8 d_range9 d_test4 comp4 vbias vref agnd ibias4 vdd vss vdd_d vss_d column
xout_ibias5 v_gate v_cp ibias5 vdd bias_output
xcolumn5 col5 d_charge5 d_preset d_range10 d_range11 d_test5 comp5 vbias vref agnd ibias5 vdd vss vdd_d vss_d column
xout_ibias6 v_gate v_cp ibias6 vdd bias_output
xcolumn6 col6 d_charge6 d_preset d_range12 d_range13 d_test6 comp6 vbias vref agnd ibias6 vdd vss vdd_d vss_d column
xout_ibias7 v_gate v_cp ibias7 vdd bias_output
xcolumn7 col7 d_charge7 d_preset d_range14 d_range15 d_test7 comp7 vbias vref agnd ibias7 vdd vss vdd_d vss_d column
xout_ibias8 v_gate v_cp ibias8 vdd bias_output
xcolumn8 col8 d_charge8 d_preset d_range16 d_range17 d_test8 comp8 vbias vref agnd ibias8 vdd vss vdd_d vss_d column
xout_ibias9 v_gate v_cp ibias9 vdd bias_output
xcolumn9 col9 d_charge9 d_preset d_range18 d_range19 d_test9 comp9 vbias vref agnd ibias9 vdd vss vdd_d vss_d column
xout_ibias10 v_gate v_cp ibias10 vdd bias_output
xcolumn10 col10 d_charge10 d_preset d_range20 d_range21 d_test10 comp10 vbias vref agnd ibias10 vdd vss vdd_d vss_d column
xout_ibias11 v_gate v_cp ibias11 vdd bias_output
xcolumn11 col11 d_charge11 d_preset d_range22 d_range23 d_test11 comp11 vbias vref agnd ibias11 vdd vss vdd_d vss_d column
xout_ibias12 v_gate v_cp ibias12 vdd bias_output
xcolumn12 col12 d_charge12 d_preset d_range24 d_range25 d_test12 comp12 vbias vref agnd ibias12 vdd vss vdd_d vss_d column
xout_ibias13 v_gate v_cp ibias13 vdd bias_output
xcolumn13 col13 d_charge13 d_preset d_range26 d_range27 d_test13 comp13 vbias vref agnd ibias13 vdd vss vdd_d vss_d column
xout_ibias14 v_gate v_cp ibias14 vdd bias_output
xcolumn14 col14 d_charge14 d_preset d_range28 d_range29 d_test14 comp14 vbias vref agnd ibias14 vdd vss vdd_d vss_d column
xout_ibias15 v_gate v_cp ibias15 vdd bias_output
xcolumn15 col15 d_charge15 d_preset d_range30 d_range31 d_test15 comp15 vbias vref agnd ibias15 vdd vss vdd_d vss_d column
xesd_row0 row0 vdd vss esd_pad
xesd_row1 row1 vdd vss esd_pad
xesd_row2 row2 vdd vss esd_pad
xesd_row3 row3 vdd vss esd_pad
xesd_row4 row4 vdd vss esd_pad
xesd_row5 row5 vdd vss esd_pad
xesd_row6 row6 vdd vss esd_pad
xesd_row7 row7 vdd vss esd_pad
xesd_row8 row8 vdd vss esd_pad
xesd_row9 row9 vdd vss esd_pad
xesd_row10 row10 vdd vss esd_pad
xesd_row11 row11 vdd vss esd_pad
xesd_row12 row12 vdd vss esd_pad
xesd_row13 row13 vdd vss esd_pad
xesd_row14 row14 vdd vss esd_pad
xesd_row15 row15 vdd vss esd_pad
xesd_col0 col0 vdd vss esd_pad
xesd_col1 col1 vdd vss esd_pad
xesd_col2 col2 vdd vss esd_pad
xesd_col3 col3 vdd vss esd_pad
xesd_col4 col4 vdd vss esd_pad
xesd_col5 col5 vdd vss esd_pad
xesd_col6 col6 vdd vss esd_pad
xesd_col7 col7 vdd vss esd_pad
xesd_col8 col8 vdd vss esd_pad
xesd_col9 col9 vdd vss esd_pad
xesd_col10 col10 vdd vss esd_pad
xesd_col11 col11 vdd vss esd_pad
xesd_col12 col12 vdd vss esd_pad
xesd_col13 col13 vdd vss esd_pad
xesd_col14 col14 vdd vss esd_pad
xesd_col15 col15 vdd vss esd_pad
xesd_vbias vbias vdd vss esd_pad
xesd_vref vref vdd vss esd_pad
xesd_r_ref r_ref vdd vss esd_pad
xesd_agnd agnd vdd vss esd_pad
.ends dermis_analog_front_end
