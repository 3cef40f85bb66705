// SPDX-License-Identifier: Apache-2.0
// Theorems of the two-flop synchronizer: no two consecutive ones, a one only for a sample, no sample in preset.
// Interface: comparator and preset are free at every clock, reset may fall at any time.
// Timing: one step is one clock.
// Why edges suffice for the comparator: only its level at an edge enters, and a late decision is either level.
`default_nettype none

module check_sync_ff (
  input wire clk_i,
  input wire rst_ni,
  input wire inhibit_i,
  input wire comp_async_i
);

  wire pulse;

  dermis_sync_ff u_dut (
    .clk_i        (clk_i),
    .rst_ni       (rst_ni),
    .inhibit_i    (inhibit_i),
    .comp_async_i (comp_async_i),
    .pulse_o      (pulse)
  );

  reg       started_q = 1'b0;
  reg       last_q;
  // Reference: q[n] = comparator and not q[n-1] and not preset, one clock later.
  reg [1:0] sample_q;
  reg [2:0] allowed_q;

  always @(posedge clk_i) begin
    started_q <= 1'b1;
    last_q    <= pulse;
  end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      sample_q  <= 2'b00;
      allowed_q <= 3'b000;
    end else begin
      sample_q  <= {sample_q[0], comp_async_i & ~sample_q[0] & ~inhibit_i};
      allowed_q <= {allowed_q[1:0], ~inhibit_i};
    end

  always @* begin
    if (!started_q) assume (!rst_ni);
    if (started_q) no_two_ones: assert (!(pulse && last_q));
    decides: assert (pulse == sample_q[1]);
    none_in_preset: assert (!pulse || allowed_q[1]);
    one: cover (pulse && rst_ni);
    one_zero_one: cover (rst_ni && sample_q == 2'b01 && last_q);
  end

endmodule

`default_nettype wire
