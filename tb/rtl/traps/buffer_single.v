// SPDX-License-Identifier: Apache-2.0
// WRONG on purpose: dermis_row_buffer without its register, so that the counters themselves are read out.
// 128 bits do not shift out in the 115 clocks before the counters start again (FACTS 1.6).
`include "dermis_design.vh"
`default_nettype none

module dermis_row_buffer #(
  parameter COLS      = `DERMIS_COLS,
  parameter CODE_BITS = `DERMIS_CODE_BITS,
  parameter ROW_BITS  = (`DERMIS_ROWS > 1) ? $clog2(`DERMIS_ROWS) : 1
) (
  input  wire                      clk_i,
  input  wire                      rst_ni,
  input  wire                      load_i,
  input  wire                      last_i,
  input  wire [ROW_BITS-1:0]       row_i,
  input  wire [COLS*CODE_BITS-1:0] counts_i,
  output wire [COLS*CODE_BITS-1:0] codes_o,
  output wire [ROW_BITS-1:0]       row_o,
  output wire                      valid_o,
  output wire                      frame_done_o
);

  reg valid_q;
  reg frame_done_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      valid_q      <= 1'b0;
      frame_done_q <= 1'b0;
    end else begin
      valid_q      <= load_i;
      frame_done_q <= load_i & last_i;
    end

  assign codes_o      = counts_i;
  assign row_o        = row_i;
  assign valid_o      = valid_q;
  assign frame_done_o = frame_done_q;

endmodule

`default_nettype wire
