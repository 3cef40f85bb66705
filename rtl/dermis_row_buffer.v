// SPDX-License-Identifier: Apache-2.0
// Holding register of one row of codes: the second half of the double buffer, the counters being the first.
// Interface: load_i copies counts_i and row_i; codes_o and row_o then stay until the next load, one slot later.
// Timing: valid_o is high for the one clock after the load, frame_done_o with it when last_i was high.
// Why: the counters are busy again SETTLE_CLOCKS later, and 128 bits do not shift out in 115 clocks.
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

  reg [COLS*CODE_BITS-1:0] codes_q;
  reg [ROW_BITS-1:0]       row_q;
  reg                      valid_q;
  reg                      frame_done_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      codes_q      <= {(COLS*CODE_BITS){1'b0}};
      row_q        <= {ROW_BITS{1'b0}};
      valid_q      <= 1'b0;
      frame_done_q <= 1'b0;
    end else begin
      valid_q      <= load_i;
      frame_done_q <= load_i & last_i;
      if (load_i) begin
        codes_q <= counts_i;
        row_q   <= row_i;
      end
    end

  assign codes_o      = codes_q;
  assign row_o        = row_q;
  assign valid_o      = valid_q;
  assign frame_done_o = frame_done_q;

endmodule

`default_nettype wire
