// SPDX-License-Identifier: Apache-2.0
// The charge of an integrator over a piece of a clock in which the current is constant: exact, with leak, bandwidth and range where they are built.
// Interface: with GBW the output is the sum of two exponentials, slow (the charge) and fast (what the output has not followed yet); else fast is 0.
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
  output real                         fast_to
);

  real slow;

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
        // Beyond a limit it is another course altogether, which takes a search: worked out only there.
        assign output_to   = (w > w_high || w < w_low) ? follow(limit, slow_from, fast_from, current, length) : slow + fast;
        assign slow_to     = (w > w_high || w < w_low) ? (limit - fast_weight * output_to) / (slow_weight - fast_weight) : slow;
        assign fast_to     = (w > w_high || w < w_low) ? output_to - slow_to : fast;

        // Charge of one exponential after a while.
        function automatic real after(input real rate, input real drive, input real from, input real i, input real t);
          real u;
          u     = rate * t;
          after = $exp(u) * from + drive * i * ((u < 1.0e-5 && u > -1.0e-5) ? t * (1.0 + u * (0.5 + u / 6.0)) : ($exp(u) - 1.0) / rate);
        endfunction

        // Output where the piece ends, the charge having stopped at a limit on the way.
        function automatic real follow(input real stop, input real slow_0, input real fast_0, input real i, input real length_);
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
          beyond_right = w - stop;
          t            = 0.0;
          slow_t       = slow_0;
          fast_t       = fast_0;
          if (beyond_left * beyond_right < 0.0) begin
            // The charge is close to a straight line: false position with the stale end halved (Illinois) is there in three to five steps.
            for (n = 0; n < 12; n = n + 1)
              if (right > left && beyond_right != beyond_left && (n == 0 || beyond > 1.0e-14 || beyond < -1.0e-14)) begin
                t      = (left * beyond_right - right * beyond_left) / (beyond_right - beyond_left);
                slow_t = after(slow_rate, slow_drive, slow_0, i, t);
                fast_t = after(fast_rate, fast_drive, fast_0, i, t);
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
        assign slow_to = slow;
        assign fast_to = fast;
      end
    end else begin : gen_at_once
      assign fast_to = 0.0;
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
