// SPDX-License-Identifier: Apache-2.0
// Theorems of the flip-flop + latch synchronizer: no two consecutive ones, each one clock long, none from preset.
// Interface: the comparator is free at every step of a global clock, so also between the edges; preset moves at rising edges.
// Timing: a step is any part of a half period; the clock itself is free, so is its duty.
// Why a global clock: a latch is transparent for half a period, which the theorems are about.
`default_nettype none

module check_sync_latch (
  input wire clk_i,
  input wire rst_ni,
  input wire inhibit_i,
  input wire comp_async_i
);

  wire pulse;

  dermis_sync_latch u_dut (
    .clk_i        (clk_i),
    .rst_ni       (rst_ni),
    .inhibit_i    (inhibit_i),
    .comp_async_i (comp_async_i),
    .pulse_o      (pulse)
  );

  (* gclk *) reg global;

  reg started_q = 1'b0;
  reg clk_q;
  reg inhibit_q;
  reg pulse_q;
  reg rst_nq;
  always @(posedge global) begin
    started_q <= 1'b1;
    clk_q     <= clk_i;
    inhibit_q <= inhibit_i;
    pulse_q   <= pulse;
    rst_nq    <= rst_ni;
  end
  wire rises = clk_i & ~clk_q;
  wire falls = ~clk_i & clk_q;

  // Reference: q[n] = comparator and not q[n-1] and not preset; and the switch in the last two low phases.
  reg sample_q;
  reg shown_q;
  reg before_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) {before_q, shown_q, sample_q} <= 3'b000;
    else         {before_q, shown_q, sample_q} <= {shown_q, pulse, comp_async_i & ~sample_q & ~inhibit_i};

  always @(posedge global) begin
    if (!started_q) assume (!rst_ni && !clk_i);
    // Preset is a flop of the same clock; reset is released while the clock is low, and may fall at any time.
    if (started_q && inhibit_i != inhibit_q) assume (rises);
    if (started_q && rst_ni && !rst_nq) assume (!clk_i && !clk_q);
    if (started_q) begin
      no_two_ones: assert (!(before_q && shown_q));
      moves_at_the_falling_edge: assert (pulse == pulse_q || falls || !rst_ni);
      decides: assert (clk_i || pulse == sample_q);
      off_in_reset: assert (rst_ni || !pulse);
    end
    one: cover (started_q && pulse && rst_ni && !clk_i);
    over: cover (started_q && pulse_q && !pulse && rst_ni && rst_nq);
  end

endmodule

`default_nettype wire
