// SPDX-License-Identifier: Apache-2.0
// Technology cell: latch, transparent while gate_ni is low, with asynchronous active-low reset.
// Interface: q_o follows d_i while gate_ni is low and holds while it is high; rst_ni low forces q_o
// to 0 at any gate.
// Why: the only deliberate latch of the design has its own module, so that every other latch is a
// lint failure.
// Why reset: with the clock stopped high at power-up an unreset latch could hold a charge switch
// on.
`default_nettype none

module dermis_tech_latch (
  input  wire gate_ni,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  reg state_q;

  always @*
    if (!rst_ni)       state_q = 1'b0;
    else if (!gate_ni) state_q = d_i;

  assign q_o = state_q;

endmodule

`default_nettype wire
