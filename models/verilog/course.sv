// SPDX-License-Identifier: Apache-2.0
// One column current over time: its mean over the clock before the next edge, and its value at the start of the slot.
// Interface: cell_i has TERMS coefficients of the functions in basis_i (drive.sv). With DARK, TERMS coefficients of the
// break follow.
// Why a break matters with MEMORY only: preset holds the integrator, but a slow mirror continues.
`default_nettype none

module course #(
  parameter TERMS  = 1,
  parameter MEMORY = 0,
  parameter DARK   = 0
) (
  input  wire                         dark_i,
  input  wire [64*(1+DARK)*TERMS-1:0] cell_i,
  input  wire [64*TERMS-1:0]          basis_i,
  input  wire [64*TERMS-1:0]          basis_begin_i,
  output real                         i_mean,
  output real                         i_begin
);

  wire [64*TERMS-1:0] factors;
  generate
    if (DARK != 0) begin : gen_dark
      assign factors = dark_i ? cell_i[64*TERMS +: 64*TERMS] : cell_i[0 +: 64*TERMS];
    end else begin : gen_no_dark
      assign factors = cell_i[0 +: 64*TERMS];
    end
  endgenerate

  genvar k;
  generate
    for (k = 0; k < TERMS; k = k + 1) begin : gen_term
      real factor;
      real sum;
      real sum_begin;
      assign factor = $bitstoreal(factors[64*k +: 64]);
      if (TERMS == 1) begin : gen_constant
        assign sum       = factor;
        assign sum_begin = factor;
      end else if (k == 0) begin : gen_first
        assign sum       = $bitstoreal(basis_i[64*k +: 64]) * factor;
        assign sum_begin = $bitstoreal(basis_begin_i[64*k +: 64]) * factor;
      end else begin : gen_next
        assign sum       = gen_term[k-1].sum + $bitstoreal(basis_i[64*k +: 64]) * factor;
        assign sum_begin = gen_term[k-1].sum_begin + $bitstoreal(basis_begin_i[64*k +: 64]) * factor;
      end
    end
    if (MEMORY != 0 && DARK == 0) begin : gen_break
      wire lit;
      assign lit    = ~dark_i;
      assign i_mean = lit * gen_term[TERMS-1].sum;
    end else begin : gen_no_break
      assign i_mean = gen_term[TERMS-1].sum;
    end
  endgenerate
  assign i_begin = gen_term[TERMS-1].sum_begin;

endmodule

`default_nettype wire
