// SPDX-License-Identifier: Apache-2.0
// One column current over time: its mean over the clock before the next edge, and its value at the start of the slot.
// Interface: cell_i has TERMS coefficients of the functions in basis_i (drive.sv), MODES charges that line capacitances
// deliver in the first clock of the gate, and the factor of each per clock. With DARK, TERMS coefficients of the break
// follow. With FADE the charges are of the first clock with the row on, and MODES more with factors are of the break.
// Why a break matters with MEMORY only: preset holds the integrator, but a slow mirror continues.
`default_nettype none

module course #(
  parameter TERMS  = 1,
  parameter MODES  = 0,
  parameter MEMORY = 0,
  parameter DARK   = 0,
  parameter FADE   = 0
) (
  input  wire                                            clk_i,
  input  wire                                            preset_i,
  input  wire                                            dark_i,
  input  wire                                            row_start_i,
  input  wire                                            break_start_i,
  input  wire [64*((1+DARK)*TERMS+2*(1+FADE)*MODES)-1:0] cell_i,
  input  wire [64*TERMS-1:0]                             basis_i,
  input  wire [64*TERMS-1:0]                             basis_begin_i,
  output real                                            i_mean,
  output real                                            i_begin
);

  localparam BEHIND = (1+DARK)*TERMS + 2*MODES;

  wire [64*TERMS-1:0] factors;
  real                settled;
  generate
    if (DARK != 0) begin : gen_glow
      assign factors = dark_i ? cell_i[64*(TERMS+2*MODES) +: 64*TERMS] : cell_i[0 +: 64*TERMS];
    end else begin : gen_no_glow
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
    for (k = 0; k < MODES; k = k + 1) begin : gen_mode
      real left_q;
      real left;
      real sum;
      if (FADE != 0) begin : gen_fade
        assign left = row_start_i ? $bitstoreal(cell_i[64*(TERMS+k) +: 64]) : break_start_i ? $bitstoreal(cell_i[64*(BEHIND+k) +: 64]) : left_q;
        always @(posedge clk_i)
          left_q <= left * (dark_i ? $bitstoreal(cell_i[64*(BEHIND+MODES+k) +: 64]) : $bitstoreal(cell_i[64*(TERMS+MODES+k) +: 64]));
      end else begin : gen_gate
        assign left = left_q;
        always @(posedge clk_i)
          left_q <= preset_i ? $bitstoreal(cell_i[64*(TERMS+k) +: 64]) : left_q * $bitstoreal(cell_i[64*(TERMS+MODES+k) +: 64]);
      end
      if (k == 0) begin : gen_first
        assign sum = left;
      end else begin : gen_next
        assign sum = gen_mode[k-1].sum + left;
      end
    end
    if (MEMORY != 0 && DARK == 0) begin : gen_break
      wire lit;
      assign lit     = ~dark_i;
      assign settled = lit * gen_term[TERMS-1].sum;
    end else begin : gen_no_break
      assign settled = gen_term[TERMS-1].sum;
    end
    if (MODES > 0) begin : gen_settling
      wire gate;
      assign gate   = (FADE != 0) ? 1'b1 : ~preset_i;
      assign i_mean = settled + gate * gen_mode[MODES-1].sum;
    end else begin : gen_settled
      assign i_mean = settled;
    end
  endgenerate
  assign i_begin = gen_term[TERMS-1].sum_begin;

endmodule

`default_nettype wire
