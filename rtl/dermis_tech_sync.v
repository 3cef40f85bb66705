// SPDX-License-Identifier: Apache-2.0
// Technology cell: two-flop synchronizer of one level into the domain of clk_i.
// Interface: q_o follows d_i, which may change at any time; rst_ni low forces q_o to 0.
// Timing: a change of d_i is on q_o after the second edge that samples it, one later if the first
// was metastable.
// Why a module: a synchronizer cell of a library replaces it. DERMIS_SYNC_RANDOM draws the extra
// edge at random.
`default_nettype none

module dermis_tech_sync (
  input  wire clk_i,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  wire first_d;
  wire first_q;

`ifdef DERMIS_SYNC_RANDOM
  // A metastable first flop may fall back to the previous level and take the new one an edge later.
  reg before_q;
  reg late_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      before_q <= 1'b0;
      late_q   <= 1'b0;
    end else begin
      before_q <= d_i;
      late_q   <= $random;
    end

  assign first_d = late_q ? before_q : d_i;
`else
  assign first_d = d_i;
`endif

  dermis_tech_dff u_first (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (first_d),
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
