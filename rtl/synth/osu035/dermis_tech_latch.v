// SPDX-License-Identifier: Apache-2.0
// Technology cell of osu035: replaces rtl/dermis_tech_latch.v in synthesis.
// Interface: the same; transparent while gate_ni is low, rst_ni low forces q_o to 0.
// Timing: NAND2X1 or AND2X1 before LATCH, which is transparent while its CLK is high.
// Why two gates: the library has no latch with reset. Reset opens it with input 0. At a release with gate_ni high
// the latch closes while its input may rise, but d_i, a flop with the same reset, is still 0: no race.
`default_nettype none

module dermis_tech_latch (
  input  wire gate_ni,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  wire open;
  wire data;

  NAND2X1 u_open (
    .A (gate_ni),
    .B (rst_ni),
    .Y (open)
  );

  AND2X1 u_data (
    .A (d_i),
    .B (rst_ni),
    .Y (data)
  );

  LATCH u_latch (
    .CLK (open),
    .D   (data),
    .Q   (q_o)
  );

endmodule

`default_nettype wire
