// SPDX-License-Identifier: Apache-2.0
// No clock: the flip-flop of a relaxation oscillator, set and cleared by its comparators, and a divider by four.
`timescale 1ns / 1fs
module oscillator (
  input  wire        above_low,
  input  wire        above_high,
  output reg         q,
  output reg  [1:0]  divided,
  output reg  [15:0] periods
);
  initial begin
    q       = 1'b1;
    divided = 2'd0;
    periods = 16'd0;
  end

  always @(posedge above_high or negedge above_low)
    if (above_high) q <= 1'b0;
    else begin
      q       <= 1'b1;
      divided <= divided + 2'd1;
      periods <= periods + 16'd1;
    end
endmodule
