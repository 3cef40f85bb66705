// SPDX-License-Identifier: Apache-2.0
// Effects of the real-number models: bit n of EFFECTS builds effect n, and run-time value n of a column is
// values_i[64 n +: 64], the bits of a double. A bit of 0 builds nothing; from W_HIGH on there are only values.
// dermis.engines.rtl reads this list by name.
// Units: one packet of charge (on the integrator: its voltage), one clock, and i0 (before the mirror: k i0).
`ifndef DERMIS_VALUES_VH
`define DERMIS_VALUES_VH
`define DERMIS_GAIN        0  // of the mirror
`define DERMIS_I_OFFSET    1  // current into the integrator after the mirror
`define DERMIS_PACKET      2  // charge of one packet
`define DERMIS_W_PRESET    3  // charge in preset
`define DERMIS_RISE        4  // level at which the comparator goes high
`define DERMIS_FALL        5  // level at which it goes low: hysteresis
`define DERMIS_DELAY       6  // of the comparator; the value is the end of piece a of a clock
`define DERMIS_W_LOW       7  // range of the integrator
`define DERMIS_LEAK        8  // of the integrator; the value is the factor of the charge over piece a
`define DERMIS_I_RANGE     9  // compression before the mirror: 1 / the current at which half is left
`define DERMIS_Q_MIRROR    10 // charge of a slow mirror: its time constant times its output
`define DERMIS_GBW         11 // finite bandwidth; the value is the factor of the lag of the output over piece a
`define DERMIS_COUPLED     12 // columns move each other; the value is the part of its output by which a virtual ground is off
`define DERMIS_SEEN_B      13 // 1: the comparator decides at the end of piece b, 0: of piece a
`define DERMIS_W_HIGH      14
`define DERMIS_KEEP_B      15 // factor of the charge over pieces b and c
`define DERMIS_KEEP_C      16
`define DERMIS_FILL_A      17 // charge from a current of 1 over pieces a, b, c
`define DERMIS_FILL_B      18
`define DERMIS_FILL_C      19
`define DERMIS_FAST_KEEP_B 20 // the same for the lag of the output
`define DERMIS_FAST_KEEP_C 21
`define DERMIS_FAST_FILL_A 22
`define DERMIS_FAST_FILL_B 23
`define DERMIS_FAST_FILL_C 24
`define DERMIS_FAST_START  25 // lag in preset
`define DERMIS_SLOW_WEIGHT 26 // charge = SLOW_WEIGHT slow part + FAST_WEIGHT fast part
`define DERMIS_FAST_WEIGHT 27
`define DERMIS_SLOW_RATE   28 // exponents of the two per clock, and charge per clock from a current of 1
`define DERMIS_FAST_RATE   29
`define DERMIS_SLOW_DRIVE  31
`define DERMIS_FAST_DRIVE  32
`define DERMIS_LAG         33 // time constant of the output at constant charge
`define DERMIS_T_B         34 // end of piece b (flip-flop + latch only)
`define DERMIS_VALUES      35 // number of values
`define DERMIS_EACH_ROW    30 // values are read again with every row
`endif
