// SPDX-License-Identifier: Apache-2.0
// Asymmetrical current mirror: out sources 1/k of the input. In units of k i0 before it and i0 after it, the factor is 1.
// Interface: in and out are means over the clock before the next edge; in_begin and frame_start_i are for the slow mirror.
// Effects: I_RANGE, a range switch in series compresses; GAIN, the ratio error of a column; Q_MIRROR, out = y follows x by dy/dt = y (x - y) / Q_MIRROR,
// so 1/y is an exponential, and the charge of a clock is x less Q_MIRROR times the growth of ln y. A frame begins settled.
`include "values.vh"
`default_nettype none

module mirror #(
  parameter EFFECTS = 0
) (
  input  wire                         clk_i,
  input  wire                         frame_start_i,
  input  real                         in,
  input  real                         in_begin,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         out
);

  real i_switch;
  real i_switch_begin;
  real i_copy;
  real i_copy_begin;

  generate
    if (EFFECTS[`DERMIS_I_RANGE]) begin : gen_range_switch
      real i_range;
      assign i_range        = $bitstoreal(values_i[64*`DERMIS_I_RANGE +: 64]);
      assign i_switch       = in / (1.0 + (in < 0.0 ? -in : in) * i_range);
      assign i_switch_begin = in_begin / (1.0 + (in_begin < 0.0 ? -in_begin : in_begin) * i_range);
    end else begin : gen_no_range_switch
      assign i_switch       = in;
      assign i_switch_begin = in_begin;
    end

    if (EFFECTS[`DERMIS_GAIN]) begin : gen_gain
      real gain;
      assign gain         = $bitstoreal(values_i[64*`DERMIS_GAIN +: 64]);
      assign i_copy       = i_switch * gain;
      assign i_copy_begin = i_switch_begin * gain;
    end else begin : gen_no_gain
      assign i_copy       = i_switch;
      assign i_copy_begin = i_switch_begin;
    end

    if (EFFECTS[`DERMIS_Q_MIRROR]) begin : gen_lag
      // Leakage, without which it would never rise again; the upper limit only keeps sums finite.
      localparam real FLOOR = 1.0e-6;
      localparam real MOST  = 1.0e12;
      real q_mirror;
      real x;
      real x_begin;
      real inverse_q;
      real inverse_old;
      real inverse_new;
      assign q_mirror    = $bitstoreal(values_i[64*`DERMIS_Q_MIRROR +: 64]);
      assign x           = i_copy < FLOOR ? FLOOR : (i_copy > MOST ? MOST : i_copy);
      assign x_begin     = i_copy_begin < FLOOR ? FLOOR : (i_copy_begin > MOST ? MOST : i_copy_begin);
      assign inverse_old = frame_start_i ? 1.0 / x_begin : inverse_q;
      assign inverse_new = 1.0 / x + (inverse_old - 1.0 / x) * $exp(-x / q_mirror);
      assign out         = x + q_mirror * $ln(inverse_new / inverse_old);
      always @(posedge clk_i) inverse_q <= inverse_new;
    end else begin : gen_at_once
      assign out = i_copy;
    end
  endgenerate

endmodule

`default_nettype wire
