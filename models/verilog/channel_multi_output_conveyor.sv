// SPDX-License-Identifier: Apache-2.0
// Multiple-output conveyor (Fig. 6): an output stage of 1/k feeds the integrator; no mirror.
`include "values.vh"
`default_nettype none

module channel_multi_output_conveyor #(
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

  real i_sum;

  conveyor_multi #(.EFFECTS(EFFECTS)) u_conveyor (
    .clk_i         (clk_i),
    .frame_start_i (frame_start_i),
    .x             (col),
    .x_begin       (col_begin),
    .values_i      (values_i),
    .zp            (i_sum)
  );

  vfc #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_vfc (
    .clk_i    (clk_i),
    .t_clocks (t_clocks),
    .iin      (i_sum),
    .d_charge (d_charge),
    .d_preset (d_preset),
    .values_i (values_i),
    .comp     (comp)
  );

endmodule

`default_nettype wire
