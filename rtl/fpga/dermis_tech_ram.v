// SPDX-License-Identifier: Apache-2.0
// Technology cell for FPGAs: a frame bank in block RAM, in place of ../dermis_tech_ram.v.
// Interface: that of the ASIC's version; rdata_o is the byte at raddr_i, 0 past the last.
// Timing: a byte is read at the rising edge of rclk_i after its address. rclk_i is SCK: dermis_spi
// sets an address eight edges before it takes the byte, and the first byte 24 edges after the grant
// of the bank.
// Why SCK: the address moves with it. clk_i may be ten times slower, too slow for one byte.
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

  (* ram_style = "block" *)
  reg [7:0] mem [0:WORDS-1];
  reg [7:0] rdata_q;

  always @(posedge clk_i)
    if (we_i && {1'b0, waddr_i} < SIZE[16:0]) mem[waddr_i[ADDRESS_BITS-1:0]] <= wdata_i;

  // No enable: a byte that is written at the same time is in the bank that nobody reads.
  always @(posedge rclk_i) rdata_q <= mem[raddr_i[ADDRESS_BITS-1:0]];

  assign rdata_o = ({1'b0, raddr_i} < SIZE[16:0]) ? rdata_q : 8'h00;

endmodule

`default_nettype wire
