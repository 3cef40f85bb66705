// SPDX-License-Identifier: Apache-2.0
// Reset synchronizer: asynchronous assertion, synchronous release.
// Interface: rst_no falls with rst_ni at once, and rises after the second edge of clk_i after
// rst_ni rose.
// Why: flops that leave reset at different edges start in an undefined state.
`default_nettype none

module dermis_reset_sync (
  input  wire clk_i,
  input  wire rst_ni,
  output wire rst_no
);

  wire first_q;

  dermis_tech_dff u_first (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (1'b1),
    .q_o    (first_q)
  );

  dermis_tech_dff u_second (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (first_q),
    .q_o    (rst_no)
  );

endmodule

`default_nettype wire
