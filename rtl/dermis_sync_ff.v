// SPDX-License-Identifier: Apache-2.0
// Synchronizer of one column, flip-flop + flip-flop form: comparator level in, one-clock charge
// pulses out.
// Interface: comp_async_i is sampled at every rising edge while inhibit_i is low; pulse_o is also
// the charge switch.
// Timing: a sample taken at edge n is on pulse_o from edge n+1 to edge n+2.
// Why Q-bar of the first flop gates: from the second, pulses are two clocks wide and half the edges
// are lost; from both, the rate is at most f/3. The first flop may be metastable: only the gate and
// the second flop see it.
`default_nettype none

module dermis_sync_ff (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire inhibit_i,
  input  wire comp_async_i,
  output wire pulse_o
);

  wire sample_d;
  wire sample_q;

  assign sample_d = comp_async_i & ~sample_q & ~inhibit_i;

  dermis_tech_dff u_sample (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (sample_d),
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
