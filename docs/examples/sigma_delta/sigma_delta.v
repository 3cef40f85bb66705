// SPDX-License-Identifier: Apache-2.0
// Digital half of a first-order sigma-delta: a flip-flop behind the comparator, and a counter.
`timescale 1ns / 1ps
module sigma_delta (
  input  wire        clk,
  input  wire        rst_n,
  input  wire        comp,
  output reg         dac,
  output reg  [15:0] ones
);
  always @(posedge clk or negedge rst_n)
    if (!rst_n) begin
      dac  <= 1'b0;
      ones <= 16'd0;
    end else begin
      dac  <= comp;
      ones <= ones + {15'd0, comp};
    end
endmodule
