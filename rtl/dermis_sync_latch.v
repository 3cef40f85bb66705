// SPDX-License-Identifier: Apache-2.0
// Synchronizer of one column, flip-flop + latch form: comparator level in, one-clock charge pulses
// out.
// Interface: comp_async_i is sampled at every rising edge while inhibit_i is low; pulse_o is also
// the charge switch.
// Timing: a sample taken at edge n is on pulse_o from the falling edge after n to the falling edge
// after n+1.
// Why a latch: it opens half a clock after the sample, time to resolve, and charge starts half a
// clock earlier than with two flops. Its input changes at rising edges only, when it is closed, so
// pulse_o has no glitch.
`default_nettype none

module dermis_sync_latch (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire inhibit_i,
  input  wire comp_async_i,
  output wire pulse_o
);

  wire sample_d;
  wire sample_q;

  assign sample_d = comp_async_i & ~pulse_o & ~inhibit_i;

  dermis_tech_dff u_sample (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (sample_d),
    .q_o    (sample_q)
  );

  dermis_tech_latch u_pulse (
    .gate_ni (clk_i),
    .rst_ni  (rst_ni),
    .d_i     (sample_q),
    .q_o     (pulse_o)
  );

endmodule

`default_nettype wire
