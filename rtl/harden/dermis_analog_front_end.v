// SPDX-License-Identifier: Apache-2.0
// Black box of the analog front end: row drivers with read-back, bias, and a column circuit per column.
// Interface: the pins of spice/sky130/dermis_analog_front_end.sp; d_range is d_k1, d_k0 of each column. vbias and vref
// are 0.5 V above agnd, the mid rail; 50 kohm from r_ref to agnd set the bias.
// Timing: comp is asynchronous; d_row, d_preset and d_charge come from registers of dermis_top.
// Why empty: the layout is drawn, not synthesized; a LEF and a GDS with the same pins replace it.
`default_nettype none

(* blackbox *)
module dermis_analog_front_end #(
  parameter ROWS = 8,
  parameter COLS = 8
) (
`ifdef USE_POWER_PINS
  inout  wire              vdd,
  inout  wire              vss,
  inout  wire              vdd_d,
  inout  wire              vss_d,
`endif
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
endmodule

`default_nettype wire
