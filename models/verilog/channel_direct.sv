// SPDX-License-Identifier: Apache-2.0
// Direct interface (Fig. 3): the column is the summing node of the integrator; i0 and packet are k times larger.
`include "values.vh"
`default_nettype none

module channel_direct #(
  parameter EFFECTS    = 0,
  parameter VARIES     = 0,
  parameter SYNC_LATCH = 0
) (
  input  wire                         clk_i,
  input  real                         t_clocks,
  input  wire                         frame_start_i,
  input  real                         col,
  input  real                         col_begin,
  input  wire                         d_charge,
  input  wire                         d_preset,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output wire                         comp
);

  vfc #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_vfc (
    .clk_i    (clk_i),
    .t_clocks (t_clocks),
    .iin      (col),
    .d_charge (d_charge),
    .d_preset (d_preset),
    .values_i (values_i),
    .comp     (comp)
  );

endmodule

`default_nettype wire
