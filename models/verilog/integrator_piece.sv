// SPDX-License-Identifier: Apache-2.0
// The charge of an integrator over a piece of a clock in which the current is constant: exact, with leak and range where they are built.
`include "values.vh"
`default_nettype none

module integrator_piece #(
  parameter EFFECTS = 0,
  parameter KEEP    = `DERMIS_LEAK,
  parameter FILL    = `DERMIS_FILL_A
) (
  input  real                         from,
  input  real                         length,
  input  real                         current,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         to
);

  real free;

  generate
    if (EFFECTS[`DERMIS_LEAK]) begin : gen_leak
      real keep;
      real fill;
      assign keep = $bitstoreal(values_i[64*KEEP +: 64]);
      assign fill = $bitstoreal(values_i[64*FILL +: 64]);
      assign free = keep * from + fill * current;
    end else begin : gen_no_leak
      assign free = from + length * current;
    end
    if (EFFECTS[`DERMIS_W_LOW]) begin : gen_range
      real w_low;
      real w_high;
      assign w_low  = $bitstoreal(values_i[64*`DERMIS_W_LOW +: 64]);
      assign w_high = $bitstoreal(values_i[64*`DERMIS_W_HIGH +: 64]);
      assign to     = free < w_low ? w_low : (free > w_high ? w_high : free);
    end else begin : gen_no_range
      assign to     = free;
    end
  endgenerate

endmodule

`default_nettype wire
