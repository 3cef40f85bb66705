// SPDX-License-Identifier: Apache-2.0
// Holding register of one row of counts, the second half of the double buffer; read one column at a
// time.
// Interface: load_i copies counts_i; count_o is then column 0, and the next column after each clock
// with shift_i.
// Timing: valid_o is high for the one clock after the load.
// Why a shift register: no multiplexer of COLS words; the counters are free as soon as it is
// loaded.
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

  reg [COLS*COUNT_BITS-1:0] counts_q;
  reg                       valid_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      counts_q <= {(COLS*COUNT_BITS){1'b0}};
      valid_q  <= 1'b0;
    end else begin
      valid_q <= load_i;
      if (load_i)       counts_q <= counts_i;
      else if (shift_i) counts_q <= counts_q >> COUNT_BITS;
    end

  assign count_o = counts_q[COUNT_BITS-1:0];
  assign valid_o = valid_q;

endmodule

`default_nettype wire
