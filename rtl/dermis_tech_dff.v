// SPDX-License-Identifier: Apache-2.0
// Technology cell: rising-edge flip-flop with asynchronous active-low reset.
// Interface: q_o takes d_i at the rising edge of clk_i; rst_ni low forces q_o to 0.
// Why: the synchronizer flops can be replaced in one place by a metastability-hardened cell of a
// library.
`default_nettype none

module dermis_tech_dff (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  reg state_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) state_q <= 1'b0;
    else         state_q <= d_i;

  assign q_o = state_q;

endmodule

`default_nettype wire
