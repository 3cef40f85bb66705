// SPDX-License-Identifier: Apache-2.0
// The course of one column current: its mean over the clock that leads to the coming edge, and its value where the slot began.
// Interface: cell_i holds TERMS coefficients of the functions of time in basis_i (drive.sv), then MODES charges that the line capacitances still
// deliver in the first clock of the gate, then what is left of each a clock later.
`default_nettype none

module course #(
  parameter TERMS = 1,
  parameter MODES = 0
) (
  input  wire                            clk_i,
  input  wire                            preset_i,
  input  wire [64*(TERMS+2*MODES)-1:0]   cell_i,
  input  wire [64*TERMS-1:0]             basis_i,
  input  wire [64*TERMS-1:0]             basis_begin_i,
  output real                            i_mean,
  output real                            i_begin
);

  genvar k;
  generate
    for (k = 0; k < TERMS; k = k + 1) begin : gen_term
      real factor;
      real sum;
      real sum_begin;
      assign factor = $bitstoreal(cell_i[64*k +: 64]);
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
    for (k = 0; k < MODES; k = k + 1) begin : gen_mode
      real left_q;
      real sum;
      always @(posedge clk_i)
        left_q <= preset_i ? $bitstoreal(cell_i[64*(TERMS+k) +: 64]) : left_q * $bitstoreal(cell_i[64*(TERMS+MODES+k) +: 64]);
      if (k == 0) begin : gen_first
        assign sum = left_q;
      end else begin : gen_next
        assign sum = gen_mode[k-1].sum + left_q;
      end
    end
    if (MODES > 0) begin : gen_settling
      wire gate;
      assign gate   = ~preset_i;
      assign i_mean = gen_term[TERMS-1].sum + gate * gen_mode[MODES-1].sum;
    end else begin : gen_settled
      assign i_mean = gen_term[TERMS-1].sum;
    end
  endgenerate
  assign i_begin = gen_term[TERMS-1].sum_begin;

endmodule

`default_nettype wire
