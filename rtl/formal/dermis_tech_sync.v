// SPDX-License-Identifier: Apache-2.0
// For proofs: the two-flop synchronizer whose first flop, where it meets its input moving, takes the old level or the new one.
// Interface: as rtl/dermis_tech_sync.v, whose place it takes.
// Timing: a change is seen by the edge that meets it or by the next one, whichever the solver likes.
// Why any level of the last clock and not only one at the very edge: the solver then has every skew of data against clock as well.
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
