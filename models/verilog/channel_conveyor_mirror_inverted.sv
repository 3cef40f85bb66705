// SPDX-License-Identifier: Apache-2.0
// Simplified conveyor and mirror (Fig. 5b): mirror, integrator, preset, comparator and charge source are inverted.
// Charge is counted in the direction of its storage, so no sign appears here; the SPICE block has the signs.
`include "values.vh"
`default_nettype none

module channel_conveyor_mirror_inverted #(
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

  real i_z;
  real i_z_begin;
  real i_sum;

  conveyor u_conveyor (.x(col), .x_begin(col_begin), .z(i_z), .z_begin(i_z_begin));

  mirror #(.EFFECTS(EFFECTS)) u_mirror (
    .clk_i         (clk_i),
    .frame_start_i (frame_start_i),
    .in            (i_z),
    .in_begin      (i_z_begin),
    .values_i      (values_i),
    .out           (i_sum)
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
