// SPDX-License-Identifier: Apache-2.0
// Theorems of the safe outputs: off with the pin at once, and no cut that the core does not see.
// Interface: clock, enable pin and reset are free at every step of a global clock; the reader is a
// free model: it drives while working, starts only with enable and stops at the first edge without.
// Timing: a step is any part of a half period; the clock may stand for ever at either level.
// Why steps: the pin may be low between two edges only, which no flop of the clock samples.
`default_nettype none

module check_safe_outputs (
  input wire clk_i,
  input wire rst_ni,
  input wire enable_i,
  input wire working_i,
  input wire row_i,
  input wire preset_i,
  input wire charge_i,
  input wire test_i
);

  wire enable;
  wire row;
  wire preset;
  wire charge;
  wire test;

  dermis_safe_outputs #(.ROWS (1), .COLS (1)) u_dut (
    .clk_i          (clk_i),
    .rst_ni         (rst_ni),
    .enable_i       (enable_i),
    .working_i     (working_i),
    .row_select_i   (row_i),
    .preset_i       (preset_i),
    .charge_i       (charge_i),
    .test_current_i (test_i),
    .enable_o       (enable),
    .row_select_o   (row),
    .preset_o       (preset),
    .charge_o       (charge),
    .test_current_o (test)
  );

  (* gclk *) reg global;

  reg       started_q = 1'b0;
  reg       clk_q;
  reg       rst_nq;
  reg       working_q;
  reg       row_q;
  reg       on_q;
  reg       cut_q;
  reg       enable_q;
  reg [1:0] edges_q;
  wire      rises = clk_i & ~clk_q;

  always @(posedge global) begin
    started_q  <= 1'b1;
    clk_q      <= clk_i;
    rst_nq     <= rst_ni;
    working_q <= working_i;
    row_q      <= row_i;
    on_q       <= row;
    enable_q   <= enable;
    // A slot that was cut, and the edges since.
    cut_q      <= rst_ni & working_i & (cut_q | ~enable_i);
    edges_q    <= !(rst_ni && cut_q) ? 2'd0 : rises && edges_q != 2'd3 ? edges_q + 2'd1 : edges_q;
  end

  always @(posedge global) begin
    if (!started_q) assume (!rst_ni && !clk_i && !working_i);
    if (started_q && rst_ni && !rst_nq) assume (!clk_i && !clk_q);
    // The reader: everything moves at edges; it scans from an edge with enable to one without.
    if (!rst_ni) assume (!working_i && !row_i);
    if (started_q && rst_ni && !rises) assume (working_i == working_q && row_i == row_q);
    if (started_q && rst_ni && rises && !enable_q) assume (!working_i);
    if (!working_i) assume (!row_i && preset_i && !test_i);

    if (started_q && !(enable_i && rst_ni)) off_at_once: assert (!row && preset && !charge && !test);
    if (started_q && cut_q) stays_off: assert (!row && preset && !charge && !test);
    if (started_q && row != on_q && row) opens_without_a_glitch: assert (rises);
    if (started_q && cut_q && edges_q == 2'd3) cut_is_seen: assert (!enable);

    drives: cover (started_q && row && enable_i && rst_ni);
    cut_between_edges: cover (started_q && cut_q && enable_i && edges_q == 2'd1 && working_i);
    drives_again: cover (started_q && row && edges_q == 2'd0 && enable_i && clk_i);
  end

endmodule

`default_nettype wire
