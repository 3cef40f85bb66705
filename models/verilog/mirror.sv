// SPDX-License-Identifier: Apache-2.0
// Asymmetrical current mirror: out sources 1/k of what enters in. In the units of these models (k i0 in front, i0 behind) that is a factor of 1.
// Effects: GAIN, the ratio error of a column.
`include "values.vh"
`default_nettype none

module mirror #(
  parameter EFFECTS = 0
) (
  input  real                         in,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         out
);

  generate
    if (EFFECTS[`DERMIS_GAIN]) begin : gen_gain
      real gain;
      assign gain = $bitstoreal(values_i[64*`DERMIS_GAIN +: 64]);
      assign out  = in * gain;
    end else begin : gen_ideal
      assign out  = in;
    end
  endgenerate

endmodule

`default_nettype wire
