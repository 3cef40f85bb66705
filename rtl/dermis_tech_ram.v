// SPDX-License-Identifier: Apache-2.0
// Technology cell: storage of one frame bank, one write port and one combinational read port.
// Interface: we_i writes wdata_i to waddr_i at the rising edge of clk_i; rdata_o is the byte at
// raddr_i, 0 past the last. rclk_i is ignored here: fpga/dermis_tech_ram.v reads with it.
// Timing: rdata_o follows raddr_i, which is stable for eight periods of SCK before rdata_o is
// sampled.
// Why without reset: only written bytes are read, and an SRAM macro, which may replace this module,
// has none.
`default_nettype none

module dermis_tech_ram #(
  parameter WORDS = 2
) (
  input  wire        clk_i,
  input  wire        we_i,
  input  wire [15:0] waddr_i,
  input  wire [7:0]  wdata_i,
  input  wire        rclk_i,
  input  wire [15:0] raddr_i,
  output wire [7:0]  rdata_o
);

  localparam         ADDRESS_BITS = (WORDS > 1) ? $clog2(WORDS) : 1;
  localparam integer SIZE         = WORDS;

  reg [7:0] mem [0:WORDS-1];

  always @(posedge clk_i)
    if (we_i && {1'b0, waddr_i} < SIZE[16:0]) mem[waddr_i[ADDRESS_BITS-1:0]] <= wdata_i;

  assign rdata_o = ({1'b0, raddr_i} < SIZE[16:0]) ? mem[raddr_i[ADDRESS_BITS-1:0]] : 8'h00;

  wire unused_rclk;
  assign unused_rclk = rclk_i;

endmodule

`default_nettype wire
