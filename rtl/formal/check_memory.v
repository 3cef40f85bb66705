// SPDX-License-Identifier: Apache-2.0
// Theorems of the frame memory of latches: a byte is what was last written to it, and rests otherwise.
// Interface: writes move at edges of the clock; reads are free at every step of a global clock.
// Timing: a step is any part of a half period; the duty of the clock is free.
// Why any one address: no state of another byte matters for it, and a theorem of one holds for all.
`default_nettype none

module check_memory #(
  parameter WORDS = 3
) (
  input wire        clk_i,
  input wire        we_i,
  input wire [15:0] waddr_i,
  input wire [7:0]  wdata_i
);

  (* anyconst *) wire [15:0] one;
  wire [7:0] rdata;

  dermis_tech_ram #(.WORDS (WORDS)) u_dut (
    .clk_i   (clk_i),
    .we_i    (we_i),
    .waddr_i (waddr_i),
    .wdata_i (wdata_i),
    .rclk_i  (1'b0),
    .raddr_i (one),
    .rdata_o (rdata)
  );

  (* gclk *) reg global;

  reg        started_q = 1'b0;
  reg        written_q = 1'b0;
  reg        newer_q   = 1'b0;
  reg        clk_q;
  reg [7:0]  byte_q;
  reg [7:0]  rdata_q;
  reg [24:0] write_q;
  wire       rises = started_q & clk_i & ~clk_q;

  always @(posedge global) begin
    started_q <= 1'b1;
    clk_q     <= clk_i;
    rdata_q   <= rdata;
    write_q   <= {we_i, waddr_i, wdata_i};
    if (rises) newer_q <= write_q[24] & (write_q[23:8] == one);
    if (rises && write_q[24] && write_q[23:8] == one) {written_q, byte_q} <= {1'b1, write_q[7:0]};
  end

  always @(posedge global) begin
    assume (one < WORDS);
    if (!started_q) assume (!clk_i && !we_i);
    if (started_q && !rises) assume ({we_i, waddr_i, wdata_i} == write_q);

    // Reads are at edges of SCK, at any time: the old byte until the clock falls, then the new one.
    if (started_q && written_q && !clk_i && !clk_q) is_the_last_written: assert (rdata == byte_q);
    if (started_q && written_q) rests: assert (rdata == rdata_q || (newer_q && clk_q && !clk_i));

    writes_twice: cover (started_q && written_q && !clk_i && byte_q == 8'h5A && rdata_q == 8'hA5 && rdata == 8'h5A);
  end

endmodule

`default_nettype wire
