// SPDX-License-Identifier: Apache-2.0
// The charge of an integrator over a piece of a clock in which the current is constant: exact, with leak, bandwidth and range where they are built.
// Interface: with GBW the output is the sum of two exponentials, slow (the charge) and fast (what the output has not followed yet); else fast is 0.
// With FALL as well, turns says that the output turns inside the piece, at the value turn: a comparator's window may see that and not the ends.
// Range: charge beyond it is lost from the instant it gets there, and with GBW the output then follows a charge that stands still.
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

  // Integral of exp(rate t) over 0..t.
  function automatic real grown(input real rate, input real t);
    real u;
    u     = rate * t;
    grown = (u < 1.0e-5 && u > -1.0e-5) ? t * (1.0 + u * (0.5 + u / 6.0)) : ($exp(u) - 1.0) / rate;
  endfunction

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
        assign turn       = turns ? at(slow_from + fast_from, slow_slope, fast_slope) : 0.0;

        // Output where its slope is 0: each exponential moves by its slope times the integral of exp(rate t).
        function automatic real at(input real out_0, input real slow_s, input real fast_s);
          real t;
          t  = $ln(-fast_s / slow_s) / (slow_rate - fast_rate);
          at = out_0 + slow_s * grown(slow_rate, t) + fast_s * grown(fast_rate, t);
        endfunction
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
        // Beyond a limit it is another course altogether, which takes a search: worked out only there.
        assign output_to   = stopped ? follow(limit, w, slow_from, fast_from, current, length) : slow + fast;
        assign slow_to     = stopped ? (limit - fast_weight * output_to) / (slow_weight - fast_weight) : slow;
        assign fast_to     = stopped ? output_to - slow_to : fast;

        // Output where the piece ends, the charge having stopped at a limit on the way. Whatever changes from clock to clock is an argument:
        // a continuous assignment waits for nothing that a function looks up by itself.
        function automatic real follow(input real stop, input real w_free, input real slow_0, input real fast_0, input real i, input real length_);
          integer n;
          real slow_rate;
          real fast_rate;
          real slow_drive;
          real fast_drive;
          real slow_t;
          real fast_t;
          real left;
          real right;
          real beyond_left;
          real beyond_right;
          real t;
          real beyond;
          slow_rate    = $bitstoreal(values_i[64*`DERMIS_SLOW_RATE +: 64]);
          fast_rate    = $bitstoreal(values_i[64*`DERMIS_FAST_RATE +: 64]);
          slow_drive   = $bitstoreal(values_i[64*`DERMIS_SLOW_DRIVE +: 64]);
          fast_drive   = $bitstoreal(values_i[64*`DERMIS_FAST_DRIVE +: 64]);
          left         = 0.0;
          right        = length_;
          beyond_left  = slow_weight * slow_0 + fast_weight * fast_0 - stop;
          beyond_right = w_free - stop;
          t            = 0.0;
          slow_t       = slow_0;
          fast_t       = fast_0;
          if (beyond_left * beyond_right < 0.0) begin
            // The charge is close to a straight line: false position with the stale end halved (Illinois) is there in three to five steps.
            for (n = 0; n < 12; n = n + 1)
              if (right > left && beyond_right != beyond_left && (n == 0 || beyond > 1.0e-14 || beyond < -1.0e-14)) begin
                t      = (left * beyond_right - right * beyond_left) / (beyond_right - beyond_left);
                slow_t = $exp(slow_rate * t) * slow_0 + slow_drive * i * grown(slow_rate, t);
                fast_t = $exp(fast_rate * t) * fast_0 + fast_drive * i * grown(fast_rate, t);
                beyond = slow_weight * slow_t + fast_weight * fast_t - stop;
                if (beyond * beyond_right > 0.0) begin
                  right        = t;
                  beyond_right = beyond;
                  beyond_left  = 0.5 * beyond_left;
                end else begin
                  left         = t;
                  beyond_left  = beyond;
                  beyond_right = 0.5 * beyond_right;
                end
              end
          end
          follow = stop + (slow_t + fast_t - stop) * $exp((t - length_) / $bitstoreal(values_i[64*`DERMIS_LAG +: 64]));
        endfunction
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
