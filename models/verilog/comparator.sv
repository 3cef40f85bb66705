// SPDX-License-Identifier: Apache-2.0
// Comparator: out is high if in_c, the integrator at the next clock edge, reaches the level; in_a, in_b: integrator.sv.
// Effects: RISE, the level; FALL, the lower level of the window; DELAY, out is the decision this long before the edge.
// Why the window is evaluated only where pieces of a clock end or the input turns: between them it is monotone.
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
  input  wire                         turns_a,
  input  wire                         turns_b,
  input  wire                         turns_c,
  input  real                         turn_a,
  input  real                         turn_b,
  input  real                         turn_c,
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
      assign high_a = PIECE_A ? past(past(high_q, turns_a, turn_a), 1'b1, in_a) : high_q;
      assign high_b = PIECE_B ? past(past(high_a, turns_b, turn_b), 1'b1, in_b) : high_a;
      assign high_c = past(past(high_b, turns_c, turn_c), 1'b1, in_c);

      // State of the window after the input reached a value.
      function automatic past(input was, input there, input real value);
        past = there ? (value >= rise) | (was & (value >= fall)) : was;
      endfunction

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
