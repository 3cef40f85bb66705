// SPDX-License-Identifier: Apache-2.0
// Stands for the black box in simulation: every row answers, every comparator is high, so each column counts every second sample.
// Interface: that of rtl/harden/dermis_analog_front_end.v.
// Timing: none.
// Why constant: the smoke test asks whether the wrapper's wires are right; converters are the business of tb/rtl/top.
`default_nettype none

module dermis_analog_front_end #(
  parameter ROWS = 8,
  parameter COLS = 8
) (
  inout  wire [ROWS-1:0]   row,
  inout  wire [COLS-1:0]   col,
  inout  wire              vbias,
  inout  wire              vref,
  inout  wire              r_ref,
  inout  wire              agnd,
  input  wire              d_enable,
  input  wire [ROWS-1:0]   d_row,
  output wire [ROWS-1:0]   d_sense,
  input  wire              d_preset,
  input  wire [COLS-1:0]   d_charge,
  input  wire [2*COLS-1:0] d_range,
  input  wire [COLS-1:0]   d_test,
  output wire [COLS-1:0]   comp
);

  assign d_sense = d_row;
  assign comp    = {COLS{1'b1}};

endmodule

`default_nettype wire
