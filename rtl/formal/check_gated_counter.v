// SPDX-License-Identifier: Apache-2.0
// Theorems of the gated counter: it equals min(edges, full scale) and never falls within a gate.
// Interface: gate and pulse are free at every clock, reset may fall at any time.
// Timing: one step is one clock.
// Why a saturating reference one bit wider: min(min(n, 2m + 1), m) is min(n, m), the same as an unbounded one.
`default_nettype none

module check_gated_counter #(
  parameter CODE_BITS = 4
) (
  input wire clk_i,
  input wire rst_ni,
  input wire gate_i,
  input wire pulse_i
);

  wire [CODE_BITS-1:0] count;

  dermis_gated_counter #(.CODE_BITS (CODE_BITS)) u_dut (
    .clk_i   (clk_i),
    .rst_ni  (rst_ni),
    .gate_i  (gate_i),
    .pulse_i (pulse_i),
    .count_o (count)
  );

  localparam [CODE_BITS:0] FULL = {1'b0, {CODE_BITS{1'b1}}};

  reg                 started_q = 1'b0;
  reg                 pulse_q;
  reg                 gate_q;
  reg [CODE_BITS:0]   edges_q;
  reg [CODE_BITS-1:0] last_q;
  wire [CODE_BITS:0]  begun = gate_q ? edges_q : {(CODE_BITS+1){1'b0}};

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      pulse_q <= 1'b0;
      gate_q  <= 1'b0;
      edges_q <= {(CODE_BITS+1){1'b0}};
    end else begin
      pulse_q <= pulse_i;
      gate_q  <= gate_i;
      if (gate_i) edges_q <= (pulse_i && !pulse_q && !(&begun)) ? begun + 1'b1 : begun;
    end

  always @(posedge clk_i) begin
    started_q <= 1'b1;
    last_q    <= count;
  end

  // In the second clock of a gate and after it: the count before belongs to the same gate.
  reg inside_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) inside_q <= 1'b0;
    else         inside_q <= gate_i & gate_q;

  always @* begin
    if (!started_q) assume (!rst_ni);
    counts_edges: assert (count == ((edges_q > FULL) ? FULL[CODE_BITS-1:0] : edges_q[CODE_BITS-1:0]));
    if (inside_q && rst_ni) does_not_fall: assert (count >= last_q);
    full_scale: cover (rst_ni && edges_q > FULL);
    held_behind_the_gate: cover (rst_ni && !gate_q && count == 2);
    second_gate: cover (rst_ni && inside_q && last_q == 1 && count == 2);
  end

endmodule

`default_nettype wire
