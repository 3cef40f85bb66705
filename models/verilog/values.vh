// SPDX-License-Identifier: Apache-2.0
// What a build of the real-number models can hold: bit n of EFFECTS builds it, and run-time value n of a column stands at
// values_i[64 n +: 64] as the bits of a double. A bit that is 0 builds nothing; names with a letter at the end are values only.
// dermis.engines.rtl reads this list by name.
// Units: one packet of charge (on the integrator: its voltage), one clock, and i0 (in front of the mirror: k i0).
`ifndef DERMIS_VALUES_VH
`define DERMIS_VALUES_VH
`define DERMIS_GAIN        0  // of the mirror
`define DERMIS_I_OFFSET    1  // current into the integrator behind the mirror
`define DERMIS_PACKET      2  // charge of one packet
`define DERMIS_W_PRESET    3  // charge the preset holds
`define DERMIS_RISE        4  // level at which the comparator goes high
`define DERMIS_FALL        5  // level at which it goes low: hysteresis
`define DERMIS_DELAY       6  // of the comparator; value: the end of piece a, in clocks after the last edge
`define DERMIS_T_B         7  // end of piece b (flip-flop + latch only)
`define DERMIS_SEEN_B      8  // 1: the comparator is looked at where piece b ends, 0: where piece a ends
`define DERMIS_W_LOW       9  // range of the integrator
`define DERMIS_W_HIGH      10
`define DERMIS_LEAK        11 // what is left of the charge after piece a, b, c
`define DERMIS_KEEP_B      12
`define DERMIS_KEEP_C      13
`define DERMIS_FILL_A      14 // what a current of 1 leaves after piece a, b, c
`define DERMIS_FILL_B      15
`define DERMIS_FILL_C      16
`define DERMIS_VALUES      17 // how many there are
`define DERMIS_EACH_FRAME  30 // values are read anew with every frame
`endif
