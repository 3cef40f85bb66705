// SPDX-License-Identifier: Apache-2.0
// Comparator: out is high where in_c, the integrator at the coming clock edge, is at its level or above; see the integrator for in_a and in_b.
// Effects: RISE, its level; FALL, the level at which a window lets go again; DELAY, out shows what was seen that long before the edge.
// Why the window is looked at where pieces of a clock end, nowhere else: the charge is monotone on a piece.
`include "values.vh"
`default_nettype none

module comparator #(
  parameter EFFECTS    = 0,
  parameter SYNC_LATCH = 0
) (
  input  wire                         clk_i,
  input  real                         in_preset,
  input  real                         in_a,
  input  real                         in_b,
  input  real                         in_c,
  input  wire                         d_preset,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output wire                         out
);

  localparam DELAY   = EFFECTS[`DERMIS_DELAY];
  localparam PIECE_A = DELAY || (SYNC_LATCH != 0);
  localparam PIECE_B = DELAY && (SYNC_LATCH != 0);

  wire high_a;
  wire high_b;
  wire high_c;

  generate
    real rise;
    if (EFFECTS[`DERMIS_RISE]) begin : gen_rise
      assign rise = $bitstoreal(values_i[64*`DERMIS_RISE +: 64]);
    end else begin : gen_no_rise
      assign rise = 0.0;
    end

    if (EFFECTS[`DERMIS_FALL]) begin : gen_window
      real fall;
      reg  high_q;
      assign fall   = $bitstoreal(values_i[64*`DERMIS_FALL +: 64]);
      assign high_a = PIECE_A ? (in_a >= rise) | (high_q & (in_a >= fall)) : high_q;
      assign high_b = PIECE_B ? (in_b >= rise) | (high_a & (in_b >= fall)) : high_a;
      assign high_c = (in_c >= rise) | (high_b & (in_c >= fall));
      always @(posedge clk_i) high_q <= d_preset ? in_preset >= rise : high_c;
    end else begin : gen_level
      assign high_a = in_a >= rise;
      assign high_b = in_b >= rise;
      assign high_c = in_c >= rise;
    end

    if (PIECE_B) begin : gen_seen_either
      assign out = ($bitstoreal(values_i[64*`DERMIS_SEEN_B +: 64]) > 0.5) ? high_b : high_a;
    end else if (DELAY) begin : gen_seen_before
      assign out = high_a;
    end else begin : gen_seen_now
      assign out = high_c;
    end
  endgenerate

endmodule

`default_nettype wire
