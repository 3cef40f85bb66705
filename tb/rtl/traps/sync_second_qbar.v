// SPDX-License-Identifier: Apache-2.0
// WRONG on purpose: dermis_sync_ff with Q-bar from the second flop. Pulses are two clocks wide and
// half as many.
`default_nettype none

module dermis_sync_ff (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire inhibit_i,
  input  wire comp_async_i,
  output wire pulse_o
);

  wire sample_q;

  dermis_tech_dff u_sample (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (comp_async_i & ~pulse_o & ~inhibit_i),
    .q_o    (sample_q)
  );

  dermis_tech_dff u_pulse (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (sample_q),
    .q_o    (pulse_o)
  );

endmodule

`default_nettype wire
