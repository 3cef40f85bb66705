// SPDX-License-Identifier: Apache-2.0
// Takes the analog side off while the enable pin is low, with or without a clock: no row, charge or
// test current, preset on.
// Interface: enable_i is a pin and may change at any time; row_select_i .. test_current_i come from
// dermis_reader, working_i while it measures a slot or has its row; enable_o is its enable.
// Timing: the outputs are off as soon as enable_i is low and stay off until working_i is low.
// enable_o falls two or three edges later, and rises two or three after the first edge with
// enable_i high.
// Why a flop with the pin as its clear: a low pulse between two edges took the analog side off too,
// and the slot that it disturbed must not be delivered. It opens only while nothing is driven, so
// that it has no glitch.
`default_nettype none

module dermis_safe_outputs #(
  parameter ROWS = 2,
  parameter COLS = 2
) (
  input  wire            clk_i,
  input  wire            rst_ni,
  input  wire            enable_i,
  input  wire            working_i,
  input  wire [ROWS-1:0] row_select_i,
  input  wire            preset_i,
  input  wire [COLS-1:0] charge_i,
  input  wire [COLS-1:0] test_current_i,
  output wire            enable_o,
  output wire [ROWS-1:0] row_select_o,
  output wire            preset_o,
  output wire [COLS-1:0] charge_o,
  output wire [COLS-1:0] test_current_o
);

  wire safe_n;
  reg  on_q;

  assign safe_n = rst_ni & enable_i;

  always @(posedge clk_i or negedge safe_n)
    if (!safe_n)          on_q <= 1'b0;
    else if (!working_i) on_q <= 1'b1;

  dermis_tech_sync u_enable_sync (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (on_q),
    .q_o    (enable_o)
  );

  assign row_select_o   = row_select_i & {ROWS{on_q}};
  assign preset_o       = preset_i | ~on_q;
  assign charge_o       = charge_i & {COLS{on_q}};
  assign test_current_o = test_current_i & {COLS{on_q}};

endmodule

`default_nettype wire
