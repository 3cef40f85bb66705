// SPDX-License-Identifier: Apache-2.0
// Multiple-output conveyor: zp sources 1/k of what enters x, in the output stages' unit, so that no mirror follows; ratio errors as in the mirror.
`include "values.vh"
`default_nettype none

module conveyor_multi #(
  parameter EFFECTS = 0
) (
  input  real                         x,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         zp
);

  mirror #(.EFFECTS(EFFECTS)) u_stage (.in(x), .values_i(values_i), .out(zp));

endmodule

`default_nettype wire
