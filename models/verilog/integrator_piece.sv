// SPDX-License-Identifier: Apache-2.0
// Exact charge of an integrator over a piece of a clock with constant current; leak, bandwidth and range where built.
// Interface: with GBW the output is a sum of two exponentials, slow (the charge) and fast (the lag of the output).
// With FALL as well, turns is high if the output turns inside the piece, at the value turn, for the comparator window.
// Range: charge above the limit is lost, and with GBW the output then follows a constant charge.
`include "values.vh"
`default_nettype none

module integrator_piece #(
  parameter EFFECTS   = 0,
  parameter KEEP      = `DERMIS_LEAK,
  parameter FILL      = `DERMIS_FILL_A,
  parameter FAST_KEEP = `DERMIS_GBW,
  parameter FAST_FILL = `DERMIS_FAST_FILL_A
) (
  input  real                         slow_from,
  input  real                         fast_from,
  input  real                         length,
  input  real                         current,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         slow_to,
  output real                         fast_to,
  output wire                         turns,
  output real                         turn
);

  real slow;
  wire stopped;

  generate
    if (EFFECTS[`DERMIS_LEAK]) begin : gen_leak
      real keep;
      real fill;
      assign keep = $bitstoreal(values_i[64*KEEP +: 64]);
      assign fill = $bitstoreal(values_i[64*FILL +: 64]);
      assign slow = keep * slow_from + fill * current;
    end else begin : gen_no_leak
      assign slow = slow_from + length * current;
    end

    if (EFFECTS[`DERMIS_GBW]) begin : gen_bandwidth
      real fast_keep;
      real fast_fill;
      real fast;
      assign fast_keep = $bitstoreal(values_i[64*FAST_KEEP +: 64]);
      assign fast_fill = $bitstoreal(values_i[64*FAST_FILL +: 64]);
      assign fast      = fast_keep * fast_from + fast_fill * current;
      if (EFFECTS[`DERMIS_FALL]) begin : gen_turn
        real slow_rate;
        real fast_rate;
        real slow_slope;
        real fast_slope;
        assign slow_rate  = $bitstoreal(values_i[64*`DERMIS_SLOW_RATE +: 64]);
        assign fast_rate  = $bitstoreal(values_i[64*`DERMIS_FAST_RATE +: 64]);
        assign slow_slope = slow_rate * slow_from + $bitstoreal(values_i[64*`DERMIS_SLOW_DRIVE +: 64]) * current;
        assign fast_slope = fast_rate * fast_from + $bitstoreal(values_i[64*`DERMIS_FAST_DRIVE +: 64]) * current;
        assign turns      = !stopped && ((slow_slope + fast_slope) * ($bitstoreal(values_i[64*KEEP +: 64]) * slow_slope + fast_keep * fast_slope) < 0.0);
        assign turn       = turns ? two_exponentials::at_turn(slow_from + fast_from, slow_slope, fast_slope, slow_rate, fast_rate) : 0.0;
      end else begin : gen_no_turn
        assign turns = 1'b0;
        assign turn  = 0.0;
      end
      if (EFFECTS[`DERMIS_W_LOW]) begin : gen_range
        real slow_weight;
        real fast_weight;
        real w;
        real w_low;
        real w_high;
        real limit;
        real output_to;
        assign slow_weight = $bitstoreal(values_i[64*`DERMIS_SLOW_WEIGHT +: 64]);
        assign fast_weight = $bitstoreal(values_i[64*`DERMIS_FAST_WEIGHT +: 64]);
        assign w_low       = $bitstoreal(values_i[64*`DERMIS_W_LOW +: 64]);
        assign w_high      = $bitstoreal(values_i[64*`DERMIS_W_HIGH +: 64]);
        assign w           = slow_weight * slow + fast_weight * fast;
        assign limit       = w > w_high ? w_high : w_low;
        assign stopped     = w > w_high || w < w_low;
        // Above a limit the solution needs a search: done only there.
        assign output_to   = stopped ? two_exponentials::after_stop(
            limit, w - limit, slow_from, fast_from, current, length,
            $bitstoreal(values_i[64*`DERMIS_SLOW_RATE +: 64]), $bitstoreal(values_i[64*`DERMIS_FAST_RATE +: 64]),
            $bitstoreal(values_i[64*`DERMIS_SLOW_DRIVE +: 64]), $bitstoreal(values_i[64*`DERMIS_FAST_DRIVE +: 64]),
            slow_weight, fast_weight, $bitstoreal(values_i[64*`DERMIS_LAG +: 64])) : slow + fast;
        assign slow_to     = stopped ? (limit - fast_weight * output_to) / (slow_weight - fast_weight) : slow;
        assign fast_to     = stopped ? output_to - slow_to : fast;
      end else begin : gen_no_range
        assign stopped = 1'b0;
        assign slow_to = slow;
        assign fast_to = fast;
      end
    end else begin : gen_at_once
      assign fast_to = 0.0;
      assign turns   = 1'b0;
      assign turn    = 0.0;
      assign stopped = 1'b0;
      if (EFFECTS[`DERMIS_W_LOW]) begin : gen_range
        real w_low;
        real w_high;
        assign w_low   = $bitstoreal(values_i[64*`DERMIS_W_LOW +: 64]);
        assign w_high  = $bitstoreal(values_i[64*`DERMIS_W_HIGH +: 64]);
        assign slow_to = slow < w_low ? w_low : (slow > w_high ? w_high : slow);
      end else begin : gen_no_range
        assign slow_to = slow;
      end
    end
  endgenerate

endmodule

`default_nettype wire
