// SPDX-License-Identifier: Apache-2.0
// For proofs: two-flop synchronizer whose first flop takes the old or the new level of a changing input.
// Interface: as rtl/dermis_tech_sync.v, which it replaces.
// Timing: the first or the second edge after a change samples it, at the choice of the solver.
// Why any level of the last clock, not only that at the edge: this includes every skew of data against clock.
`default_nettype none

module dermis_tech_sync (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  (* anyseq *) wire late;

  reg before_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) before_q <= 1'b0;
    else         before_q <= d_i;

  wire first_q;

  dermis_tech_dff u_first (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (late ? before_q : d_i),
    .q_o    (first_q)
  );

  dermis_tech_dff u_second (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (first_q),
    .q_o    (q_o)
  );

endmodule

`default_nettype wire
