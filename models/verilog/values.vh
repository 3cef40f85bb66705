// SPDX-License-Identifier: Apache-2.0
// What a build of the real-number models can hold: bit n of EFFECTS builds it, and run-time value n of a column stands at
// values_i[64 n +: 64] as the bits of a double. A bit that is 0 builds nothing; from T_B on there are values only.
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
`define DERMIS_DELAY       6  // of the comparator; the value is the end of piece a of a clock
`define DERMIS_W_LOW       7  // range of the integrator
`define DERMIS_LEAK        8  // of the integrator; the value is what is left of the charge after piece a
`define DERMIS_I_RANGE     9  // compression in front of the mirror: 1 / the current at which half of it is left
`define DERMIS_Q_MIRROR    10 // charge of a slow mirror: its time constant times its output
`define DERMIS_GBW         11 // finite bandwidth; the value is what is left after piece a of what the output has not followed yet
`define DERMIS_T_B         12 // end of piece b (flip-flop + latch only)
`define DERMIS_SEEN_B      13 // 1: the comparator is looked at where piece b ends, 0: where piece a ends
`define DERMIS_W_HIGH      14
`define DERMIS_KEEP_B      15 // what is left of the charge after pieces b and c
`define DERMIS_KEEP_C      16
`define DERMIS_FILL_A      17 // what a current of 1 leaves after pieces a, b, c
`define DERMIS_FILL_B      18
`define DERMIS_FILL_C      19
`define DERMIS_FAST_KEEP_B 20 // the same of the part that the output has not followed yet
`define DERMIS_FAST_KEEP_C 21
`define DERMIS_FAST_FILL_A 22
`define DERMIS_FAST_FILL_B 23
`define DERMIS_FAST_FILL_C 24
`define DERMIS_FAST_START  25 // that part in the preset
`define DERMIS_SLOW_WEIGHT 26 // charge = SLOW_WEIGHT slow part + FAST_WEIGHT fast part
`define DERMIS_FAST_WEIGHT 27
`define DERMIS_SLOW_RATE   28 // exponents of the two a clock, and what a current of 1 adds to each a clock
`define DERMIS_FAST_RATE   29
`define DERMIS_SLOW_DRIVE  31
`define DERMIS_FAST_DRIVE  32
`define DERMIS_LAG         33 // time constant by which the output follows a charge that stands still
`define DERMIS_VALUES      34 // how many there are
`define DERMIS_EACH_ROW    30 // values are read anew with every row
`endif
