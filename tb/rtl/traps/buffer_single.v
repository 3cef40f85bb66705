// SPDX-License-Identifier: Apache-2.0
// WRONG on purpose: dermis_row_buffer without its register, so that the counters themselves are
// read out. 128 bits do not shift out in the 115 clocks before the counters start again.
`include "dermis_design.vh"
`default_nettype none

module dermis_row_buffer #(
  parameter COLS       = `DERMIS_COLS,
  parameter COUNT_BITS = `DERMIS_CODE_BITS + 1
) (
  input  wire                       clk_i,
  input  wire                       rst_ni,
  input  wire                       load_i,
  input  wire                       shift_i,
  input  wire [COLS*COUNT_BITS-1:0] counts_i,
  output wire [COUNT_BITS-1:0]      count_o,
  output wire                       valid_o
);

  reg [7:0] column_q;
  reg       valid_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      column_q <= 8'd0;
      valid_q  <= 1'b0;
    end else begin
      valid_q <= load_i;
      if (load_i)       column_q <= 8'd0;
      else if (shift_i) column_q <= column_q + 8'd1;
    end

  assign count_o = counts_i[column_q*COUNT_BITS +: COUNT_BITS];
  assign valid_o = valid_q;

endmodule

`default_nettype wire
