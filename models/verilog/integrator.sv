// SPDX-License-Identifier: Apache-2.0
// Integrator with preset: iin fills it, icharge empties it, d_preset holds it half a packet below the comparator level.
// Interface: out_c is the charge at the next clock edge; out_a and out_b at the ends of pieces a and b of the clock
// before it, where built; turns_* is high if the output turned at turn_* in a piece (GBW with FALL). icharge_a, _b, _c
// are the currents of the charge source in each piece; t_clocks counts the clocks since preset.
// Timing: inputs settle before an edge of clk_i, the state changes at the edge. Exact between edges: no time step.
// Why iin and icharge are separate (one pin in SPICE): without leak or range the charge is t iin less the packets, each
// rounded once, so that a taxel on the boundary of two codes is decided as by the formula.
// Effects: W_PRESET; W_LOW (range), LEAK (finite gain) and GBW (bandwidth) make the state a recursion, as VARIES does:
// iin is then the mean over the clock before the next edge.
`include "values.vh"
`default_nettype none

module integrator #(
  parameter EFFECTS    = 0,
  parameter VARIES     = 0,
  parameter SYNC_LATCH = 0
) (
  input  wire                         clk_i,
  input  real                         t_clocks,
  input  real                         iin,
  input  real                         icharge_a,
  input  real                         icharge_b,
  input  real                         icharge_c,
  input  wire                         d_preset,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         out_preset,
  output real                         out_a,
  output real                         out_b,
  output real                         out_c,
  output wire                         turns_a,
  output wire                         turns_b,
  output wire                         turns_c,
  output real                         turn_a,
  output real                         turn_b,
  output real                         turn_c
);

  // Piece a ends at the decision of the comparator, or half way where the latch opens; piece b exists if both occur.
  localparam DELAY   = EFFECTS[`DERMIS_DELAY];
  localparam BENT    = EFFECTS[`DERMIS_W_LOW] || EFFECTS[`DERMIS_LEAK] || EFFECTS[`DERMIS_GBW] || (VARIES != 0);
  localparam PIECE_A = DELAY || (SYNC_LATCH != 0);
  localparam PIECE_B = DELAY && (SYNC_LATCH != 0);

  generate
    if (EFFECTS[`DERMIS_W_PRESET]) begin : gen_preset
      assign out_preset = $bitstoreal(values_i[64*`DERMIS_W_PRESET +: 64]);
    end else begin : gen_preset_ideal
      assign out_preset = -0.5;
    end

    real t_a;
    real t_b;
    if (DELAY) begin : gen_delay
      assign t_a = $bitstoreal(values_i[64*`DERMIS_DELAY +: 64]);
    end else begin : gen_half
      assign t_a = 0.5;
    end
    if (PIECE_B) begin : gen_t_b
      assign t_b = $bitstoreal(values_i[64*`DERMIS_T_B +: 64]);
    end else begin : gen_no_t_b
      assign t_b = t_a;
    end

    if (BENT) begin : gen_bent
      real slow_q;
      real slow_a;
      real slow_b;
      real slow_c;
      real fast_q;
      real fast_a;
      real fast_b;
      real fast_c;
      real length_c;
      if (PIECE_A) begin : gen_a
        integrator_piece #(
          .EFFECTS(EFFECTS), .KEEP(`DERMIS_LEAK), .FILL(`DERMIS_FILL_A), .FAST_KEEP(`DERMIS_GBW), .FAST_FILL(`DERMIS_FAST_FILL_A)
        ) u_piece (
          .slow_from(slow_q), .fast_from(fast_q), .length(t_a), .current(iin - icharge_a), .values_i(values_i),
          .slow_to(slow_a), .fast_to(fast_a), .turns(turns_a), .turn(turn_a)
        );
        assign length_c = 1.0 - t_b;
      end else begin : gen_no_a
        assign slow_a   = slow_q;
        assign fast_a   = fast_q;
        assign turns_a  = 1'b0;
        assign turn_a   = 0.0;
        assign length_c = 1.0;
      end
      if (PIECE_B) begin : gen_b
        integrator_piece #(
          .EFFECTS(EFFECTS), .KEEP(`DERMIS_KEEP_B), .FILL(`DERMIS_FILL_B), .FAST_KEEP(`DERMIS_FAST_KEEP_B), .FAST_FILL(`DERMIS_FAST_FILL_B)
        ) u_piece (
          .slow_from(slow_a), .fast_from(fast_a), .length(t_b - t_a), .current(iin - icharge_b), .values_i(values_i),
          .slow_to(slow_b), .fast_to(fast_b), .turns(turns_b), .turn(turn_b)
        );
      end else begin : gen_no_b
        assign slow_b = slow_a;
        assign fast_b = fast_a;
        assign turns_b = 1'b0;
        assign turn_b = 0.0;
      end
      integrator_piece #(
        .EFFECTS(EFFECTS), .KEEP(`DERMIS_KEEP_C), .FILL(`DERMIS_FILL_C), .FAST_KEEP(`DERMIS_FAST_KEEP_C), .FAST_FILL(`DERMIS_FAST_FILL_C)
      ) u_piece_c (
        .slow_from(slow_b), .fast_from(fast_b), .length(length_c), .current(iin - icharge_c), .values_i(values_i),
        .slow_to(slow_c), .fast_to(fast_c), .turns(turns_c), .turn(turn_c)
      );
      if (EFFECTS[`DERMIS_COUPLED]) begin : gen_coupled
        // How far the virtual ground is off on the mean of the clock, in packets; read by name (skin.sv).
        real ground;
        assign ground = $bitstoreal(values_i[64*`DERMIS_LAG +: 64]) * (out_c - (slow_q + fast_q))
            + $bitstoreal(values_i[64*`DERMIS_COUPLED +: 64]) * 0.5 * (slow_q + fast_q + out_c);
      end
      if (EFFECTS[`DERMIS_GBW]) begin : gen_bandwidth
        real fast_start;
        assign fast_start = $bitstoreal(values_i[64*`DERMIS_FAST_START +: 64]);
        always @(posedge clk_i) begin
          slow_q <= d_preset ? out_preset - fast_start : slow_c;
          fast_q <= d_preset ? fast_start : fast_c;
        end
        assign out_a = slow_a + fast_a;
        assign out_b = slow_b + fast_b;
        assign out_c = slow_c + fast_c;
      end else begin : gen_at_once
        assign fast_q = 0.0;
        always @(posedge clk_i) slow_q <= d_preset ? out_preset : slow_c;
        assign out_a = slow_a;
        assign out_b = slow_b;
        assign out_c = slow_c;
      end
    end else begin : gen_straight
      // charge drawn by the charge source, preset included
      real drawn_q;
      real drawn_a;
      real drawn_b;
      real drawn_c;
      if (PIECE_A) begin : gen_a
        assign drawn_a = drawn_q + icharge_a * t_a;
        assign out_a   = (t_clocks - (1.0 - t_a)) * iin - drawn_a;
        assign drawn_c = drawn_b + icharge_c * (1.0 - t_b);
      end else begin : gen_no_a
        assign drawn_a = drawn_q;
        assign out_a   = 0.0;
        assign drawn_c = drawn_b + icharge_c;
      end
      if (PIECE_B) begin : gen_b
        assign drawn_b = drawn_a + icharge_b * (t_b - t_a);
        assign out_b   = (t_clocks - (1.0 - t_b)) * iin - drawn_b;
      end else begin : gen_no_b
        assign drawn_b = drawn_a;
        assign out_b   = 0.0;
      end
      assign out_c   = t_clocks * iin - drawn_c;
      assign turns_a = 1'b0;
      assign turns_b = 1'b0;
      assign turns_c = 1'b0;
      assign turn_a  = 0.0;
      assign turn_b  = 0.0;
      assign turn_c  = 0.0;
      always @(posedge clk_i) drawn_q <= d_preset ? -out_preset : drawn_c;
    end
  endgenerate

endmodule

`default_nettype wire
