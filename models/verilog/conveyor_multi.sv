// SPDX-License-Identifier: Apache-2.0
// Multiple-output conveyor: zp sources 1/k of the current into x; its output stages have the effects of mirror.sv.
`include "values.vh"
`default_nettype none

module conveyor_multi #(
  parameter EFFECTS = 0
) (
  input  wire                         clk_i,
  input  wire                         frame_start_i,
  input  real                         x,
  input  real                         x_begin,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         zp
);

  mirror #(.EFFECTS(EFFECTS)) u_stage (
    .clk_i         (clk_i),
    .frame_start_i (frame_start_i),
    .in            (x),
    .in_begin      (x_begin),
    .values_i      (values_i),
    .out           (zp)
  );

endmodule

`default_nettype wire
