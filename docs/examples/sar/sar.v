// SPDX-License-Identifier: Apache-2.0
// Successive approximation: sample, open the top switch, then the bottom ones, then one bit a clock from the highest.
`timescale 1ns / 1ps
module sar (
  input  wire       clk,
  input  wire       rst_n,
  input  wire       comp,    // high while the guess is above the input
  output reg        top,     // the top plate is on ground
  output reg        bottom,  // the bottom plates are on the input
  output reg  [7:0] guess,
  output reg  [7:0] code,
  output reg        done
);
  reg [7:0] bit_q;

  wire [7:0] kept = comp ? guess & ~bit_q : guess;

  always @(posedge clk or negedge rst_n)
    if (!rst_n) begin
      {top, bottom, done}  <= 3'b110;
      {guess, code, bit_q} <= 24'd0;
    end else if (top) {top, done} <= 2'b00;
    else if (bottom) begin
      bottom <= 1'b0;
      guess  <= 8'h80;
      bit_q  <= 8'h80;
    end else begin
      bit_q               <= bit_q >> 1;
      guess               <= bit_q[0] ? 8'd0 : kept | bit_q >> 1;
      {top, bottom, done} <= {3{bit_q[0]}};
      if (bit_q[0]) code <= kept;
    end
endmodule
